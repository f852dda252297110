/** Type and range of each JSON field: nothing is rounded, clamped, defaulted or ignored. */

import { type Json, type JsonObject, Real } from "./json";
import { type Limits, checkLimit } from "./limits";
import { fault } from "./reasons";

/** Bound the nesting and the length of every string, and refuse half a surrogate pair. */
export function checkSizes(value: Json, where: string, limits: Limits): void {
  let layer: Json[] = [value];
  for (let depth = 1; ; depth += 1) {
    const strings: string[] = [];
    const next: Json[] = [];
    let nested = false;
    for (const item of layer) {
      if (typeof item === "string") {
        strings.push(item);
      } else if (Array.isArray(item)) {
        nested = true;
        for (const inner of item) {
          next.push(inner);
        }
      } else if (item instanceof Map) {
        nested = true;
        for (const [key, inner] of item) {
          strings.push(key);
          next.push(inner);
        }
      }
    }
    checkLimit("json-depth", where, nested ? depth : 0, limits.json_depth);
    for (const text of strings) {
      if (text.length > limits.json_string) {
        checkLimit("json-string", where, [...text].length, limits.json_string);
      }
    }
    const bad = strings.find((text) => !text.isWellFormed());
    if (bad !== undefined) {
      throw fault("json-encoding", where, JSON.stringify(bad), "characters that UTF-8 can hold");
    }
    if (next.length === 0) {
      return;
    }
    layer = next;
  }
}

/** The JSON name of a value's type, for messages. */
function typeName(value: Json): string {
  if (value === null) return "null";
  if (Array.isArray(value)) return "a list";
  if (value instanceof Map) return "an object";
  if (value instanceof Real) return "a number";
  if (typeof value === "string") return "a string";
  return typeof value === "boolean" ? "true or false" : "a whole number";
}

/** An object with any keys. */
export function asMap(value: Json | undefined, where: string): JsonObject {
  if (!(value instanceof Map)) {
    throw fault("field-type", where, typeName(value ?? null), "an object");
  }
  return value;
}

/** The values of an object with exactly these keys, and of those that are `optional` what is there. */
export function asObject<Key extends string, Optional extends string = never>(
  value: Json, where: string, keys: readonly Key[], optional: readonly Optional[] = [],
): Record<Key, Json> & Partial<Record<Optional, Json>> {
  const found = asMap(value, where);
  const result: Partial<Record<Key | Optional, Json>> = {};
  for (const key of keys) {
    const item = found.get(key);
    if (item === undefined) {
      throw fault("field-missing", `${where}.${key}`, "nothing", "a value");
    }
    result[key] = item;
  }
  for (const [key, item] of found) {
    const known = [...keys, ...optional].find((each) => each === key);
    if (known === undefined) {
      throw fault("field-unknown", `${where}.${key}`, key, [...keys, ...optional].join(", "));
    }
    result[known] = item;
  }
  return result as Record<Key, Json> & Partial<Record<Optional, Json>>;
}

/** A list, of the given length if one is given. */
export function asList(value: Json, where: string, length?: number): Json[] {
  if (!Array.isArray(value)) {
    throw fault("field-type", where, typeName(value), "a list");
  }
  if (length !== undefined && value.length !== length) {
    throw fault("field-value", where, `${value.length} items`, `${length} items`);
  }
  return value;
}

/** A string. */
export function asText(value: Json, where: string): string {
  if (typeof value !== "string") {
    throw fault("field-type", where, typeName(value), "a string");
  }
  return value;
}

/** A string out of a list. */
export function asOneOf<Word extends string>(value: Json, where: string, allowed: readonly Word[]): Word {
  const text = asText(value, where);
  const word = allowed.find((each) => each === text);
  if (word === undefined) {
    throw fault("field-value", where, text, allowed.join(", "));
  }
  return word;
}

/** A whole number written without fraction or exponent, in a closed range. */
export function asInteger(value: Json, where: string, low = 0, high = Number.MAX_SAFE_INTEGER): number {
  if (typeof value !== "number") {
    throw fault("field-type", where, typeName(value), "a whole number");
  }
  if (value < low || value > high) {
    throw fault("field-value", where, value, `${low} to ${high}`);
  }
  return value;
}

/** A number not below `low`. */
export function asNumber(value: Json, where: string, low = -Infinity): number {
  const number = value instanceof Real ? value.value : value;
  if (typeof number !== "number") {
    throw fault("field-type", where, typeName(value), "a number");
  }
  if (number < low) {
    throw fault("field-value", where, number, `at least ${low}`);
  }
  return number;
}
