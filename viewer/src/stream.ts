/** The bytes of a file, from the first to the last: by ranges where the server has them, else as one body. */

import { formatBytes } from "./bytes";
import { Problem } from "./problem";
import { fault } from "./reader/reasons";

const FIRST = 65536;
const TRIES = 3;
const WAIT = 400; // milliseconds before another try

/** Bytes that come in order into one piece of memory. */
export abstract class ByteSource {
  have = 0;
  onBytes: () => void = () => undefined;
  private goal = 0; // up to which bytes are fetched, or wanted next
  private fetching = false;
  private waiting: { end: number; resolve: () => void; reject: (error: unknown) => void }[] = [];

  protected constructor(readonly name: string, readonly bytes: Uint8Array<ArrayBuffer>) {}

  get size(): number {
    return this.bytes.length;
  }

  /** Have the first `end` bytes fetched, no more than the size; kept when they are there, whatever else is on its way. */
  upTo(end: number): Promise<void> {
    const goal = Math.min(end, this.size);
    return new Promise((resolve, reject) => {
      this.waiting.push({ end: goal, resolve, reject });
      this.goal = Math.max(this.goal, goal);
      this.tell();
      if (this.have < this.goal && !this.fetching) {
        void this.fetch();
      }
    });
  }

  /** Fetch nothing more; what is on its way is given up. */
  close(): void {}

  protected abstract fetchTo(end: number): Promise<void>;

  protected add(chunk: Uint8Array): void {
    this.bytes.set(chunk.subarray(0, this.size - this.have), this.have);
    this.have = Math.min(this.size, this.have + chunk.length);
    this.tell();
    this.onBytes();
  }

  private async fetch(): Promise<void> {
    this.fetching = true;
    try {
      while (this.have < this.goal) {
        const before = this.have;
        await this.fetchTo(this.goal);
        if (this.have === before) {
          throw lost(this.name, this.have, this.size, new Error("No more bytes came."));
        }
      }
      this.fetching = false;
    } catch (error) {
      this.fetching = false;
      this.goal = this.have;
      this.waiting.splice(0).forEach(({ reject }) => reject(error));
    }
  }

  private tell(): void {
    const { have } = this;
    this.waiting.filter(({ end }) => end <= have).forEach(({ resolve }) => resolve());
    this.waiting = this.waiting.filter(({ end }) => end > have);
  }
}

function memory(size: number): Uint8Array<ArrayBuffer> {
  try {
    return new Uint8Array(size);
  } catch {
    throw new Problem("The file is too large for this browser.", `It has ${size} bytes.`, "Compress it with a smaller --size.");
  }
}

function lost(name: string, have: number, size: number, error: unknown): Problem {
  const after = size > 0 ? ` after ${formatBytes(have)} of ${formatBytes(size)} of ${name}` : ` on the way of ${name}`;
  return new Problem(`The connection was lost${after}.`,
    error instanceof Error ? error.message : "", "Reload the page to try again.");
}

/** A file that was dropped on the page or chosen. */
export class BlobSource extends ByteSource {
  constructor(private readonly file: File) {
    super(file.name, memory(file.size));
  }

  protected override async fetchTo(end: number): Promise<void> {
    try {
      this.add(new Uint8Array(await this.file.slice(this.have, end).arrayBuffer()));
    } catch (error) {
      throw fault("unreadable", this.name, String(error), "a file that can be read", "choose it again");
    }
  }
}

/** A server that has byte ranges: each part is asked for when it is needed, and asked for again when it breaks off. */
class RangeSource extends ByteSource {
  constructor(name: string, private readonly url: URL, size: number, private readonly stop: AbortController) {
    super(name, memory(size));
  }

  override close(): void {
    this.stop.abort();
  }

  async take(response: Response): Promise<void> {
    const reader = response.body!.getReader();
    for (;;) {
      const { done, value } = await reader.read();
      if (done) {
        return;
      }
      this.add(value);
    }
  }

  protected override async fetchTo(end: number): Promise<void> {
    for (let tries = 1; this.have < end; tries += 1) {
      const before = this.have;
      try {
        const response = await request(this.url, { Range: `bytes=${this.have}-${end - 1}` }, this.stop.signal);
        if (response.status !== 206) {
          throw new Error(`status ${response.status} for a range`);
        }
        await this.take(response);
        if (this.have === before) {
          throw new Error("an empty answer");
        }
      } catch (error) {
        if (tries >= TRIES || this.stop.signal.aborted) {
          throw lost(this.name, this.have, this.size, error);
        }
        await new Promise((resolve) => setTimeout(resolve, WAIT));
      }
      tries = this.have > before ? 0 : tries;
    }
  }
}

/** A server that sends the whole file. */
class BodySource extends ByteSource {
  constructor(name: string, size: number, private readonly reader: ReadableStreamDefaultReader<Uint8Array>) {
    super(name, memory(size));
  }

  override close(): void {
    this.reader.cancel().catch(() => undefined); // of a body that broke off there is nothing to give up
  }

  protected override async fetchTo(end: number): Promise<void> {
    while (this.have < end) {
      let chunk: ReadableStreamReadResult<Uint8Array>;
      try {
        chunk = await this.reader.read();
      } catch (error) {
        throw lost(this.name, this.have, this.size, error);
      }
      if (chunk.done) {
        throw lost(this.name, this.have, this.size, new Error("The body ended."));
      }
      this.add(chunk.value);
    }
  }
}

/** What a host wants to see before it gives a file, and which host that is. */
export interface Pass {
  readonly origin: string;
  readonly token: string;
}

let pass: Pass | null = null;

/** Show this to its host, and to no other, with everything that is asked of it from now on. */
export function present(shown: Pass | null): void {
  pass = shown;
}

async function request(url: URL, headers: Record<string, string>, signal: AbortSignal | null = null): Promise<Response> {
  const shown = pass?.origin === url.origin ? { ...headers, Authorization: `Bearer ${pass.token}` } : headers;
  return fetch(url, { headers: shown, signal, cache: "no-cache", credentials: "same-origin" });
}

/** The address of a file named on the page's address: http or https, nothing else. */
export function fileUrl(name: string, base: string | undefined): URL {
  let url: URL;
  try {
    url = new URL(name, base);
  } catch {
    throw new Problem(`"${name}" is no address of a file.`);
  }
  if (url.protocol !== "http:" && url.protocol !== "https:") {
    throw new Problem(`Files are loaded by http and https only, not by ${url.protocol}`);
  }
  return url;
}

/** A part of an address for people; as it is where its escapes are no UTF-8. */
function decoded(part: string): string {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

/**
 * Start to fetch a file: by parts where the host sends them and says how long the file is, else as a whole.
 *
 * Another host may send a part and not let this page read its `Content-Range`, or refuse the header `Range` to it.
 */
export async function openUrl(url: URL): Promise<ByteSource> {
  const name = decoded(url.pathname.split("/").pop() ?? "") || url.href;
  const stop = new AbortController();
  const part = await request(url, { Range: `bytes=0-${FIRST - 1}` }, stop.signal).catch(() => null);
  if (part !== null && part.status !== 206) {
    return wholeFile(name, url, part);
  }
  const total = /^bytes 0-\d+\/(\d+)$/.exec(part?.headers.get("Content-Range") ?? "");
  if (part !== null && total !== null) {
    const source = new RangeSource(name, url, Number(total[1]), stop);
    await source.take(part).catch(() => undefined); // what is missing is asked for again
    return source;
  }
  await part?.body?.cancel().catch(() => undefined); // it may be long, and is of no use
  const whole = await request(url, {}).catch((error: unknown) => {
    throw new Problem(`${name} could not be fetched from ${url.host}.`, String(error),
      "Check the connection, and that the server allows this page to load it.");
  });
  return wholeFile(name, url, whole);
}

/** What to say of a host that does not send a file. */
function refused(name: string, host: string, status: number): Problem {
  if (status >= 500) {
    return new Problem(`${host} failed to send ${name}, with status ${status}.`, "", "Try again later.");
  }
  if (status === 401 || status === 403) {
    return new Problem(`${host} does not allow this page to load ${name}: status ${status}.`, "",
      "Ask whoever runs that server, log in there first, or open the whole address that hmkcta view printed.");
  }
  return new Problem(status === 404 ? `There is no file ${name} on ${host}.` : `${host} refused ${name} with status ${status}.`, "",
    "Check the address.");
}

/** What a host answers with the whole file, or with a refusal. */
async function wholeFile(name: string, url: URL, response: Response): Promise<ByteSource> {
  if (response.status === 416) {
    return new BlobSource(new File([], name));
  }
  if (response.status === 206) {
    throw new Problem(`${url.host} sent a part of ${name} where the whole file was asked for.`, "", "Check the settings of that host.");
  }
  if (!response.ok || response.body === null) {
    throw refused(name, url.host, response.status);
  }
  const length = Number(response.headers.get("Content-Length") ?? "0");
  // Of another host it cannot be seen whether the file was packed on the way, and the length is that of the packed file.
  if (length > 0 && response.type !== "cors" && response.headers.get("Content-Encoding") === null) {
    return new BodySource(name, length, response.body.getReader());
  }
  try {
    return new BlobSource(new File([await response.blob()], name)); // packed on the way: the length comes last
  } catch (error) {
    throw lost(name, 0, 0, error);
  }
}
