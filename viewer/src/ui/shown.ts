/** Whether the panel is shown beside the picture. */

import { byId } from "./controls";

export function panelShown(): boolean {
  return !document.body.classList.contains("wide");
}

export function showPanel(shown: boolean): void {
  document.body.classList.toggle("wide", !shown);
  byId("toggle").setAttribute("aria-expanded", String(shown));
}

/** Have the button on the picture show and hide it. */
export function listenToToggle(): void {
  byId("toggle").addEventListener("click", () => showPanel(!panelShown()));
}
