/** Files from hosts that send parts, half of what parts need, or none. */

import { type RequestListener, createServer } from "node:http";
import type { AddressInfo } from "node:net";
import { describe, expect, it } from "vitest";
import { Problem } from "../src/problem";
import { openUrl, present } from "../src/stream";

const whole = Uint8Array.from({ length: 200_000 }, (_, i) => (7 * i + (i >> 8)) % 256);

/** What a host gives of a file, and the `Range` of each request. */
async function fetched(listener: RequestListener): Promise<{ bytes: Uint8Array; asked: (string | undefined)[] }> {
  const asked: (string | undefined)[] = [];
  const server = createServer((request, response) => {
    asked.push(request.headers.range);
    listener(request, response);
  });
  await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  try {
    const source = await openUrl(new URL(`http://127.0.0.1:${(server.address() as AddressInfo).port}/a%20b.hmk`));
    await source.upTo(source.size);
    return { bytes: source.bytes, asked };
  } finally {
    server.closeAllConnections();
    server.close();
  }
}

/** A host that answers ranges, with a `Content-Range` as given. */
function ranges(told: (begin: number, end: number) => string | null): RequestListener {
  return (request, response) => {
    const [, begin, end] = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "")?.map(Number) ?? [];
    if (begin === undefined || end === undefined) {
      response.end(whole);
      return;
    }
    const header = told(begin, Math.min(end, whole.length - 1));
    response.writeHead(206, header === null ? {} : { "Content-Range": header });
    response.end(whole.subarray(begin, end + 1));
  };
}

describe("a file from its address", () => {
  it("comes in parts where the host says how long it is", async () => {
    const { bytes, asked } = await fetched(ranges((begin, end) => `bytes ${begin}-${end}/${whole.length}`));
    expect(asked).toEqual(["bytes=0-65535", "bytes=65536-199999"]);
    expect(Buffer.compare(bytes, whole)).toBe(0);
  });

  it.each<[string, RequestListener]>([
    ["Content-Range cannot be read", ranges(() => null)],
    ["Content-Range leaves the length open", ranges((begin, end) => `bytes ${begin}-${end}/*`)],
    ["Range is refused", (request, response) => (request.headers.range === undefined ? response.end(whole) : response.destroy())],
  ])("comes as a whole where %s", async (_, listener) => {
    const { bytes, asked } = await fetched(listener);
    expect(asked.at(-1)).toBeUndefined();
    expect(Buffer.compare(bytes, whole)).toBe(0);
  });

  it("is given up where nothing more comes", async () => {
    const some = ranges((begin, end) => `bytes ${begin}-${end}/${whole.length}`);
    await expect(fetched((request, response) => {
      if (request.headers.range === "bytes=0-65535") {
        some(request, response);
      } else {
        response.writeHead(206).end();
      }
    })).rejects.toThrow("The connection was lost");
  });

  it.each<[string, RequestListener]>([
    ["in parts", (request, response) => {
      const first = request.headers.range === "bytes=0-65535";
      response.writeHead(206, { "Content-Range": `bytes 0-65535/${whole.length}` });
      response.write(whole.subarray(0, first ? 65536 : 9)); // and nothing more for now
      if (first) {
        response.end();
      }
    }],
    ["as a whole", (_, response) => {
      response.writeHead(200, { "Content-Length": whole.length });
      response.write(whole.subarray(0, 9));
    }],
  ])("is fetched no further once it is closed, %s", async (_, listener) => {
    let asked = 0, gone = 0;
    const server = createServer((request, response) => {
      asked += 1;
      response.on("close", () => { gone += 1; });
      listener(request, response);
    });
    await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
    try {
      const source = await openUrl(new URL(`http://127.0.0.1:${(server.address() as AddressInfo).port}/a.hmk`));
      const rest = source.upTo(source.size);
      await new Promise((resolve) => setTimeout(resolve, 100));
      const before = asked;
      source.close();
      await expect(rest).rejects.toThrow("The connection was lost");
      await expect.poll(() => gone).toBe(before);
      expect(asked).toBe(before);
    } finally {
      server.closeAllConnections();
      server.close();
    }
  });

  it("is asked for with the pass of its host, which no other host sees", async () => {
    const seen: (string | undefined)[] = [];
    const server = createServer((request, response) => {
      seen.push(request.headers.authorization);
      response.end(whole);
    });
    await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
    const url = new URL(`http://127.0.0.1:${(server.address() as AddressInfo).port}/a.hmk`);
    try {
      for (const pass of [null, { origin: url.origin, token: "abc" }, { origin: "http://127.0.0.1:1", token: "abc" }]) {
        present(pass);
        const source = await openUrl(url);
        await source.upTo(source.size);
      }
    } finally {
      present(null);
      server.closeAllConnections();
      server.close();
    }
    expect(seen).toEqual([undefined, "Bearer abc", undefined]);
  });

  it("is asked for once where the host ignores Range", async () => {
    const { bytes, asked } = await fetched((_, response) => response.end(whole));
    expect(asked).toEqual(["bytes=0-65535"]);
    expect(Buffer.compare(bytes, whole)).toBe(0);
  });

  it.each<[string, RequestListener]>([
    ["sent a part of a b.hmk where the whole file was asked for", (_, response) => response.writeHead(206).end(whole.subarray(0, 9))],
    ["a b.hmk could not be fetched from 127.0.0.1", (_, response) => response.destroy()],
  ])("is refused with %j", async (sentence, listener) => {
    await expect(fetched(listener)).rejects.toThrow(Problem);
    await expect(fetched(listener)).rejects.toThrow(sentence);
  });

  it.each([
    [401, /^127.0.0.1:\d+ does not allow this page to load a b.hmk: status 401. Ask whoever runs that server/],
    [403, /^127.0.0.1:\d+ does not allow this page to load a b.hmk: status 403. Ask whoever runs that server/],
    [404, /^There is no file a b.hmk on 127.0.0.1:\d+. Check the address.$/],
    [410, /^127.0.0.1:\d+ refused a b.hmk with status 410. Check the address.$/],
    [500, /^127.0.0.1:\d+ failed to send a b.hmk, with status 500. Try again later.$/],
    [503, /^127.0.0.1:\d+ failed to send a b.hmk, with status 503. Try again later.$/],
  ])("is told of by what status %i means", async (status, sentence) => {
    await expect(fetched((_, response) => response.writeHead(status).end())).rejects.toThrow(sentence);
  });
});
