/** When frames are drawn. */

import { expect, it } from "vitest";
import { EMPTY, type FrameEvent, type Frames, busy, next } from "../src/frames";

const change = (now = 1): FrameEvent => ({ type: "change", now });
const begin: FrameEvent = { type: "begin", saving: false };
const drawn = (again = false, coarse = false): FrameEvent => ({ type: "drawn", again, coarse });

/** The names of the states after each event. */
function names(...events: FrameEvent[]): string[] {
  let frames: Frames = EMPTY;
  return events.map((event) => (frames = next(frames, event)).name);
}

it("draws what changed, and then is still", () => {
  expect(names(change(), begin, drawn())).toEqual(["waiting", "drawing", "still"]);
  expect(names(change(), begin, drawn(), change(), begin, drawn()).at(-1)).toBe("still");
});

it("draws once for many changes before it begins, and again for one meanwhile", () => {
  expect(names(change(1), change(2), begin, change(3), drawn(), begin, drawn())).toEqual(
    ["waiting", "waiting", "drawing", "drawing", "waiting", "drawing", "still"]);
});

it("goes on until nothing is missing", () => {
  expect(names(change(), begin, drawn(true), begin, drawn())).toEqual(["waiting", "drawing", "waiting", "drawing", "still"]);
});

it("refines a coarse picture once nothing has moved, and not for a timer of before", () => {
  expect(names(change(5), begin, drawn(false, true), { type: "rested", since: 5 })).toEqual(["waiting", "drawing", "resting", "waiting"]);
  expect(names(change(5), begin, drawn(false, true), change(9), begin, drawn(false, true), { type: "rested", since: 5 }).at(-1)).toBe("resting");
});

it("saves between frames, and shows afterwards what is chosen", () => {
  const saving: FrameEvent = { type: "begin", saving: true };
  expect(names(change(), begin, drawn(), { type: "save" }, saving, { type: "saved" }, begin, drawn())).toEqual(
    ["waiting", "drawing", "still", "waiting", "saving", "waiting", "drawing", "still"]);
  expect(names(change(), begin, { type: "save" }, drawn(), saving).slice(2), "not within one").toEqual(["drawing", "waiting", "saving"]);
});

it("is still after what cannot be drawn, until something changes", () => {
  expect(names(change(), begin, { type: "failed" }, change())).toEqual(["waiting", "drawing", "still", "waiting"]);
  expect(names(change(), begin, change(), { type: "failed" }).at(-1), "as taking back does").toBe("waiting");
});

it("stays closed, and takes no event in a state that has no use for it", () => {
  expect(names(change(), begin, { type: "close" }, drawn(), change(), begin).slice(2)).toEqual(new Array(4).fill("closed"));
  expect(names(begin, drawn(), { type: "saved" }, { type: "save" }, { type: "failed" }, { type: "rested", since: 0 })).toEqual(new Array(6).fill("empty"));
});

it("is busy while a frame is under way or will be", () => {
  const of = (name: Frames["name"]): boolean => busy({ name, stale: false, since: 0 });
  expect((["waiting", "drawing", "saving", "resting"] as const).every(of)).toBe(true);
  expect((["empty", "still", "closed"] as const).some(of)).toBe(false);
});
