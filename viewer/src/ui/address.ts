/** What the page's address says. */

import { Problem } from "../problem";

/** A parameter; one that is empty says as much as none. */
export function given(parameters: URLSearchParams, name: string): string | null {
  return parameters.get(name) || null;
}

/** Where a tab keeps its token while it is reloaded; it is gone with the tab. */
const KEPT = "hmkcta-token";

/**
 * The token by which the server of this page gives its file, or null: pages elsewhere have none.
 *
 * It is taken off the address, which people copy, show and have in their history, and kept for when the tab is reloaded.
 */
export function takeToken(page: Location, tab: History, keep: () => Storage): string | null {
  const parameters = new URLSearchParams(page.search);
  const token = given(parameters, "token");
  try {
    if (token === null) {
      return keep().getItem(KEPT);
    }
    keep().setItem(KEPT, token);
  } catch {
    // Some browsers keep nothing for frames and private windows: the page shows the file until it is reloaded.
  }
  if (token !== null) {
    // As it was written: what the other parameters have must not be escaped in another way.
    const rest = page.search.slice(1).split("&").filter((part) => !part.startsWith("token="));
    tab.replaceState(tab.state, "", `${page.pathname}${rest.length > 0 ? `?${rest.join("&")}` : ""}${page.hash}`);
  }
  return token;
}

/** Width and height that `pixels` fixes for a picture of up to `most` a side; null: they are the page's. */
export function fixedSize(pixels: string | null, most: number): [number, number] | null {
  if (pixels === null) {
    return null;
  }
  const [, width, height] = /^(\d+)x(\d+)$/.exec(pixels)?.map(Number) ?? [];
  if (width === undefined || height === undefined || Math.min(width, height) < 1 || Math.max(width, height) > most) {
    throw new Problem("The address asks for a picture of a size that cannot be.",
      `pixels: found ${pixels}, allowed 1x1 to ${most}x${most} on this graphics adapter.`,
      "Give WIDTHxHEIGHT, as in &pixels=640x480, or leave it out.");
  }
  return [width, height];
}
