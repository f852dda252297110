/** What the page says of a file in words. */

import { formatBytes } from "../bytes";
import type { Metadata } from "../reader/metadata";
import { plain } from "./controls";

const KIND_NAMES = { svbrdf: "Material", lightfield: "Light field", volume: "Volume", generic: "Array" };

/** One line on a model: its kind, its axes, and how much smaller it is. */
export function facts(metadata: Metadata, bytes: number): string {
  const itemSize: Record<string, number> = { bool: 1, int8: 1, uint8: 1, int16: 2, uint16: 2, float16: 2, int64: 8, uint64: 8, float64: 8 };
  const source = metadata.axes.reduce((all, axis) => all * axis.size, itemSize[metadata.sourceDtype] ?? 4);
  const axes = metadata.axes.map((axis) => `${axis.name} ${axis.size}`).join(" × ");
  const ratio = source > bytes ? `, 1/${plain(Number((source / bytes).toPrecision(3)))} of the source` : "";
  return `${KIND_NAMES[metadata.kind]}: ${axes}. ${formatBytes(bytes)}${ratio}.`;
}
