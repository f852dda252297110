/** The colours of errors on the picture, with the numbers that they stand for. */

import { errorScale } from "../figures";
import { heatGradient } from "../render/colours";
import type { Shown } from "../store";
import { byId, plain, tell } from "./controls";

/** Show them where errors are shown. */
export function placeErrorBar(shown: Shown): void {
  const scale = errorScale(shown);
  byId("error-bar").hidden = scale === null;
  if (scale !== null) {
    const numbers = [0, scale.most / 2, scale.most].map((value) => plain(value));
    byId("error-colours").style.background = heatGradient();
    ["error-least", "error-middle", "error-most"].forEach((id, n) => tell(byId(id), numbers[n]!));
    tell(byId("error-unit"), scale.unit === "" ? "error, in the units of the source" : `error, in ${scale.unit}`);
  }
}
