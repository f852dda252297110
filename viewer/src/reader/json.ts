/**
 * JSON read strictly: no white space outside strings, no key twice, no NaN or infinity, no whole number beyond 2^53 - 1.
 *
 * `JSON.parse` keeps the last of two equal keys and makes 1.0 of 1, so it cannot tell.
 */

import { fault } from "./reasons";

/** A number with a fraction or an exponent; whole numbers are plain numbers. */
export class Real {
  constructor(readonly value: number) {}
}

export type Json = null | boolean | number | Real | string | Json[] | JsonObject;
export type JsonObject = Map<string, Json>;

/** Beyond any nesting that makes sense; the exact limit is `checkSizes`' matter. */
const PARSER_DEPTH = 512;

/** A string; white space outside is looked for before anything else, so that of several faults each reader names one. */
const STRING = /"(?:[^"\\]|\\.)*"/g;
const NUMBER = /-?(?:0|[1-9][0-9]*)(\.[0-9]+)?([eE][-+]?[0-9]+)?/y;
const PLAIN = /[^"\\\u0000-\u001f]*/y;
const LITERALS: [string, Json][] = [["null", null], ["true", true], ["false", false]];
const NOT_FINITE = ["NaN", "Infinity", "-Infinity"];
const ESCAPES: Record<string, string> = {
  '"': '"', "\\": "\\", "/": "/", b: "\b", f: "\f", n: "\n", r: "\r", t: "\t",
};

/** Parse a JSON text. */
export function parseJson(text: string, where: string): Json {
  if (text.replace(STRING, "").includes(" ")) {
    throw fault("json-syntax", where, "white space outside strings", "none");
  }
  return new Parser(text, where).document();
}

class Parser {
  private at = 0;

  constructor(private readonly text: string, private readonly where: string) {}

  document(): Json {
    const value = this.value(0);
    if (this.at < this.text.length) {
      throw this.syntax("extra data");
    }
    return value;
  }

  private syntax(message: string): Error {
    return fault("json-syntax", this.where, `${message} at character ${this.at}`, "JSON");
  }

  /** Advance over a pattern and return its match. */
  private skip(pattern: RegExp): RegExpExecArray | null {
    pattern.lastIndex = this.at;
    const match = pattern.exec(this.text);
    this.at += match?.[0].length ?? 0;
    return match;
  }

  private take(word: string): boolean {
    const there = this.text.startsWith(word, this.at);
    this.at += there ? word.length : 0;
    return there;
  }

  private value(depth: number): Json {
    if (depth > PARSER_DEPTH) {
      throw fault("json-depth", this.where, `more than ${PARSER_DEPTH}`, "a lower nesting");
    }
    switch (this.text[this.at]) {
      case "{": return this.object(depth);
      case "[": return this.list(depth);
      case '"': return this.string();
      default: return this.scalar();
    }
  }

  private scalar(): Json {
    for (const [word, value] of LITERALS) {
      if (this.take(word)) {
        return value;
      }
    }
    const constant = NOT_FINITE.find((word) => this.take(word));
    if (constant !== undefined) {
      throw fault("json-number", this.where, constant, "finite numbers");
    }
    const match = this.skip(NUMBER);
    if (match === null) {
      throw this.syntax("no value");
    }
    const value = Number(match[0]);
    if (match[1] !== undefined || match[2] !== undefined) {
      if (!Number.isFinite(value)) {
        throw fault("json-number", this.where, match[0].slice(0, 40), "finite numbers");
      }
      return new Real(value);
    }
    if (!Number.isSafeInteger(value)) {
      throw fault("json-number", this.where, match[0].slice(0, 40), "whole numbers up to 2^53 - 1");
    }
    return value;
  }

  private list(depth: number): Json[] {
    const items: Json[] = [];
    this.at += 1;
    if (this.take("]")) {
      return items;
    }
    for (;;) {
      items.push(this.value(depth + 1));
      if (this.take("]")) {
        return items;
      }
      if (!this.take(",")) {
        throw this.syntax("no comma");
      }
    }
  }

  private object(depth: number): JsonObject {
    const items: JsonObject = new Map();
    let twice: string | undefined;
    this.at += 1;
    if (this.take("}")) {
      return items;
    }
    for (;;) {
      if (this.text[this.at] !== '"') {
        throw this.syntax("no key");
      }
      const key = this.string();
      if (!this.take(":")) {
        throw this.syntax("no colon");
      }
      twice ??= items.has(key) ? key : undefined;
      items.set(key, this.value(depth + 1));
      if (this.take("}")) {
        break;
      }
      if (!this.take(",")) {
        throw this.syntax("no comma");
      }
    }
    if (twice !== undefined) {
      throw fault("json-duplicate-key", this.where, JSON.stringify(twice), "each key once");
    }
    return items;
  }

  private string(): string {
    this.at += 1;
    const pieces: string[] = [];
    for (;;) {
      pieces.push(this.skip(PLAIN)?.[0] ?? "");
      if (this.take('"')) {
        return pieces.join("");
      }
      if (!this.take("\\")) {
        throw this.syntax("unterminated string or control character");
      }
      pieces.push(this.escape());
    }
  }

  private escape(): string {
    const letter = this.text[this.at] ?? "";
    this.at += 1;
    if (letter !== "u") {
      const plain = ESCAPES[letter];
      if (plain === undefined) {
        throw this.syntax("bad escape");
      }
      return plain;
    }
    const digits = this.text.slice(this.at, this.at + 4);
    if (!/^[0-9a-fA-F]{4}$/.test(digits)) {
      throw this.syntax("bad \\u escape");
    }
    this.at += 4;
    return String.fromCharCode(parseInt(digits, 16));
  }
}
