/** Every figure and word that the page says of what it shows, as functions of its state. */

import type { Shown } from "./store";
import { span } from "./render/window";

export function decibels(snr: number): string {
  return snr === Infinity ? "exact" : `${snr.toFixed(1)} dB`;
}

/** What the chosen level is worth, and which one it is. */
export function headline({ state: { level }, metadata: { quality, levels } }: Shown): [snr: string, of: string] {
  return [decibels(quality[level - 1]!.snrDb), levels.length === 1 ? "SNR, one level" : `SNR at level ${level} of ${levels.length}`];
}

export function pageTitle({ name }: { name: string }): string {
  return `${name}: hmkcta`;
}

/** Both sides of a comparison. */
export function sideNames({ state: { level, compare } }: Shown): [left: string, right: string] {
  return [`Level ${level}`, compare.level === null ? "Original" : `Level ${compare.level}`];
}

/** What the picture is called, for those who do not see it. */
export function pictureLabel(shown: Shown): string {
  const { name, state: { compare } } = shown;
  const [left, right] = sideNames(shown);
  const what = compare.mode === "heat" ? `Error of ${left.toLowerCase()} against ${right.toLowerCase()}`
    : compare.mode === "split" ? `${left} beside ${right.toLowerCase()}` : headline(shown).join(" ");
  return `Picture of ${name}. ${what}. Arrow keys turn or move it; press question mark for all keys.`;
}

/** The name for a picture of a model: the model's, but for its ending, and what of it is shown, but for all of it. */
export function pictureName({ name, metadata: { levels }, state: { level, compare } }: Pick<Shown, "name" | "metadata" | "state">): string {
  const stem = name.split(/[/\\]/).pop()!.replace(/\.hmk$/i, "");
  const parts = [
    stem === "" ? "hmkcta" : stem, ...(level < levels.length ? [`level-${level}`] : []),
    ...(compare.mode === "none" ? [] : [compare.mode === "heat" ? "error" : "beside", compare.level === null ? "original" : `level-${compare.level}`]),
  ];
  return `${parts.join("-")}.png`;
}

/** Whether the picture is what is chosen, and nothing of it is missing. */
export function current({ kind, state, drawn }: Shown): boolean {
  return drawn !== null && drawn.whole && drawn.kind === kind && drawn.state === state;
}

/** What lies on a picture that is not, or not yet, what is chosen; null: it is. */
export function badge(shown: Shown): string | null {
  const { share, saving, drawn } = shown;
  const percent = (part: number): string => `${Math.min(99, Math.floor(100 * part))} %`;
  if (saving !== null) {
    return `saving ${percent(saving)}`;
  }
  if (share === 1) {
    return null;
  }
  const old = drawn?.whole === true ? drawn.state.level === shown.state.level ? ", still the picture before" : `, still level ${drawn.state.level}` : "";
  return `decoding ${percent(share)}${old}`;
}

/** The error that the last of the colours stands for, and its unit: the values', but of a volume, whose colours are none. */
export function errorScale(shown: Shown): { most: number; unit: string } | null {
  const { kind, state: { compare } } = shown;
  if (compare.mode !== "heat") {
    return null;
  }
  const most = span(shown) / compare.gain;
  return kind === "volume" ? { most: 100 * most, unit: "% of white" } : { most, unit: "" };
}
