/** When frames are drawn: one machine with named states. `app.ts` does what entering a state asks for. */

/** `empty`: no level is there; `waiting`: for the browser's turn; `drawing` and `saving`; `resting`: drawn with fewer
 * pixels than there may be, until nothing has moved for a while; `still`: drawn as well as it can be; `closed`. */
export type FramesName = "empty" | "waiting" | "drawing" | "saving" | "resting" | "still" | "closed";

export interface Frames {
  readonly name: FramesName;
  readonly stale: boolean; // something changed while the frame was drawn
  readonly since: number; // when something last changed, in milliseconds
}

export type FrameEvent =
  | { type: "change"; now: number }
  | { type: "save" } // a picture is to be saved
  | { type: "begin"; saving: boolean }
  | { type: "drawn"; again: boolean; coarse: boolean } // again: elements are missing; coarse: more pixels may be drawn
  | { type: "saved" }
  | { type: "failed" }
  | { type: "rested"; since: number }
  | { type: "close" };

export const EMPTY: Frames = { name: "empty", stale: false, since: 0 };

/** The state after an event; an event that a state has no use for leaves it as it is. */
export function next(frames: Frames, event: FrameEvent): Frames {
  const { name, since } = frames;
  const go = (to: FramesName): Frames => ({ name: to, stale: false, since });
  if (name === "closed" || event.type === "close") {
    return go("closed");
  }
  switch (event.type) {
    case "change":
      return { name: name === "drawing" || name === "saving" ? name : "waiting", stale: true, since: event.now };
    case "save":
      return name === "drawing" || name === "saving" ? { ...frames, stale: true } : name === "empty" ? frames : go("waiting");
    case "begin":
      return name === "waiting" ? go(event.saving ? "saving" : "drawing") : frames;
    case "drawn":
      return name !== "drawing" ? frames : go(frames.stale || event.again ? "waiting" : event.coarse ? "resting" : "still");
    case "saved": // with other textures than the screen's: draw what is chosen again
      return name === "saving" ? go("waiting") : frames;
    case "failed":
      return name === "drawing" ? go(frames.stale ? "waiting" : "still") : frames;
    case "rested":
      return name === "resting" && event.since === since ? go("waiting") : frames;
  }
}

/** Whether a frame is under way or will be. */
export function busy({ name }: Frames): boolean {
  return name === "waiting" || name === "drawing" || name === "saving" || name === "resting";
}
