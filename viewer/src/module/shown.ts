/** A value of whatever type, as a sentence has it. */

const MOST = 80; // letters

export function shown(value: unknown): string {
  return (Array.isArray(value) ? `[${value.slice(0, MOST).map(single).join(", ")}]` : single(value)).slice(0, MOST);
}

function single(value: unknown): string {
  if (typeof value === "string") {
    return JSON.stringify(value);
  }
  return typeof value === "object" && value !== null ? Object.prototype.toString.call(value) : String(value);
}
