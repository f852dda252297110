/** What the keys do; `docs/viewer.md` has the same table. */
export const KEYS: Record<string, string> = {
  "← → ↑ ↓": "turn the camera, move the view point or the slice",
  "Shift + ← → ↑ ↓": "move the light that the panel shows",
  "+ -": "nearer, farther",
  "[ ]": "level down, up",
  ", .": "previous, next frame",
  Space: "play or pause time",
  C: "compare: off, side by side, error",
  "E Shift+E": "exposure up, down",
  R: "reset the view",
  S: "save the picture, in full",
  Escape: "close the message beside the picture",
  "?": "this list",
};

