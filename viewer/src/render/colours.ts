/** Colour maps and tables of 256 entries: the twin of `hmkcta.render.colours`. */

type Stop = [number, number, number];

/** Colours 0..255 at even steps from 0 to 1. */
export const COLOURS: Record<string, Stop[]> = {
  grey: [[0, 0, 0], [255, 255, 255]],
  inferno: [[0, 0, 4], [40, 11, 84], [101, 21, 110], [159, 42, 99], [212, 72, 66], [245, 125, 21], [250, 193, 39],
    [252, 255, 164]],
  viridis: [[68, 1, 84], [70, 50, 127], [54, 92, 141], [39, 127, 142], [31, 161, 135], [74, 194, 109],
    [159, 218, 58], [253, 231, 37]],
  ice: [[4, 6, 19], [31, 39, 88], [54, 79, 155], [66, 130, 186], [109, 180, 208], [180, 222, 230], [234, 252, 253]],
  coolwarm: [[59, 76, 192], [124, 159, 249], [192, 212, 245], [221, 221, 221], [244, 196, 173], [222, 96, 77],
    [180, 4, 38]],
};

/** Errors from 0 to the most shown. */
const HEAT: Stop[] = [[4, 4, 14], [40, 16, 92], [106, 28, 129], [170, 48, 118], [224, 80, 88], [250, 140, 70],
  [252, 206, 110], [252, 253, 216]];

const ENTRIES = 256;

/** A point of a curve: share 0..1 and value. */
export type Point = [number, number];

/** The value at a share between points whose shares rise, as NumPy's `interp`. */
export function interpolated(points: Point[], share: number): number {
  const after = points.findIndex(([x]) => x > share);
  if (after === 0) {
    return points[0]![1];
  }
  if (after < 0) {
    return points[points.length - 1]![1];
  }
  const [[x0, y0], [x1, y1]] = [points[after - 1]!, points[after]!];
  return y0 + ((share - x0) / (x1 - x0)) * (y1 - y0);
}

/** Display colour (0..1) and opacity of 256 shares. */
export function colourTable(name: string, opacity: Point[] = [[0, 1], [1, 1]]): Float32Array<ArrayBuffer> {
  return table(COLOURS[name] ?? COLOURS["grey"]!, opacity);
}

function table(stops: Stop[], opacity: Point[]): Float32Array<ArrayBuffer> {
  const entries = new Float32Array(4 * ENTRIES);
  for (let i = 0; i < ENTRIES; i += 1) {
    const share = i / (ENTRIES - 1);
    for (let c = 0; c < 3; c += 1) {
      entries[4 * i + c] = interpolated(stops.map((stop, n): Point => [n / (stops.length - 1), stop[c]! / 255]), share);
    }
    entries[4 * i + 3] = Math.min(1, Math.max(0, interpolated(opacity, share)));
  }
  return entries;
}

/** Display colours of errors from 0 to the most shown. */
export function heatTable(): Float32Array<ArrayBuffer> {
  return table(HEAT, [[0, 1], [1, 1]]);
}

/** A CSS gradient of a colour map. */
export function gradient(name: string): string {
  return cssGradient(COLOURS[name] ?? []);
}

/** Likewise of the colours of errors. */
export function heatGradient(): string {
  return cssGradient(HEAT);
}

function cssGradient(stops: Stop[]): string {
  return `linear-gradient(to right, ${stops.map((stop) => `rgb(${stop.join(" ")})`).join(", ")})`;
}
