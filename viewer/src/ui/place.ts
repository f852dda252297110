/** Where the picture is on the page. */

const FIXED = "fixed"; // the class of a canvas whose picture has a shape of its own

/** Have the picture fill the canvas, or keep the shape that the address fixes. */
export function keepShape(canvas: HTMLCanvasElement, fixed: boolean): void {
  canvas.classList.toggle(FIXED, fixed);
}

/** The part of the window that the picture covers: the canvas, or as much of its middle as has the picture's shape. */
export function pictureBox(canvas: HTMLCanvasElement): DOMRect {
  const box = canvas.getBoundingClientRect();
  if (!canvas.classList.contains(FIXED)) {
    return box;
  }
  const scale = Math.min(box.width / canvas.width, box.height / canvas.height);
  const [width, height] = [scale * canvas.width, scale * canvas.height];
  return new DOMRect(box.left + (box.width - width) / 2, box.top + (box.height - height) / 2, width, height);
}

/** Where a pointer is in the picture, from 0 to 1; null beside it. */
export function placeIn(canvas: HTMLCanvasElement, event: { clientX: number; clientY: number }): [number, number] | null {
  const box = pictureBox(canvas);
  const place: [number, number] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  return place.every((each) => each >= 0 && each <= 1) ? place : null;
}
