/** Numbers of bytes in words. */

/** Bytes for people, in units of 2^10: the twin of `hmkcta.support.memory.format_bytes`. */
export function formatBytes(count: number): string {
  let [size, unit] = [count, "B"];
  for (const larger of ["KiB", "MiB", "GiB", "TiB"]) {
    if (size < 1024) {
      break;
    }
    [size, unit] = [size / 1024, larger];
  }
  return unit === "B" ? `${count} B` : `${size.toFixed(2)} ${unit}`;
}
