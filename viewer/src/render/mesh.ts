/** Surfaces with texture coordinates and tangents: sphere, plane, draped cloth, a file's. Twin of `hmkcta.render.mesh`. */

import { Problem } from "../problem";
import { type Vector, cross, difference, dot, normalised, scaled, sum } from "./vector";

/** Interleaved vertices (position 3, normal 3, tangent 4, texture coordinates 2) and triangles. */
export interface Mesh {
  vertices: Float32Array<ArrayBuffer>;
  indices: Uint32Array<ArrayBuffer>;
}

/** What makes a mesh, for a number of repeats. */
export type MeshMaker = (repeat: number) => Mesh;

export const VERTEX_NUMBERS = 12;
export type Shape = "sphere" | "plane" | "cloth";

interface Point {
  position: Vector;
  normal: Vector;
  tangent: Vector;
  hand: number;
  uv: [number, number];
}

/** A surface; a plane gets the shape of the texels. */
export function makeMesh(shape: Shape, repeat: number, rows: number, columns: number): Mesh {
  switch (shape) {
    case "sphere": return quads(128, 64, (u, v) => spherePoint(u, v, repeat));
    case "plane": return quads(1, 1, (u, v) => planePoint(u, v, repeat, rows / columns));
    case "cloth": return quads(128, 128, (u, v) => clothPoint(u, v, repeat));
  }
}

function spherePoint(u: number, v: number, repeat: number): Point {
  const [azimuth, polar] = [2 * Math.PI * (u - 0.5), Math.PI * v];
  const flat = Math.sin(polar);
  const normal: Vector = [flat * Math.cos(azimuth), flat * Math.sin(azimuth), Math.cos(polar)];
  return {
    position: normal, normal, tangent: [-Math.sin(azimuth), Math.cos(azimuth), 0], hand: -1,
    uv: [2 * repeat * u, repeat * v],
  };
}

function planePoint(u: number, v: number, repeat: number, height: number): Point {
  return {
    position: [0, 2 * u - 1, height * (1 - 2 * v)], normal: [1, 0, 0], tangent: [0, 1, 0], hand: -1,
    uv: [repeat * u, repeat * v],
  };
}

/** Flat in the middle, falling in folds around something round. */
function drape(u: number, v: number): Vector {
  const [x, y] = [1.3 * (2 * v - 1), 1.3 * (2 * u - 1)];
  const angle = Math.atan2(y, x);
  const share = Math.min(1, Math.max(0, (Math.hypot(x, y) - 0.45) / (1.6 - 0.45)));
  const fall = share * share * (3 - 2 * share);
  const folds = 0.15 * Math.cos(6 * angle + 0.5) + 0.05 * Math.cos(11 * angle);
  return [x, y, 0.7 + fall * (folds - 1.15)];
}

function clothPoint(u: number, v: number, repeat: number): Point {
  const step = 1e-4;
  const alongU = difference(drape(u + step, v), drape(u - step, v));
  const alongV = difference(drape(u, v + step), drape(u, v - step));
  return {
    position: drape(u, v), normal: cross(alongV, alongU), tangent: alongU, hand: -1, uv: [repeat * u, repeat * v],
  };
}

/** A grid of `across x down` quads over 0..1 squared. */
function quads(across: number, down: number, point: (u: number, v: number) => Point): Mesh {
  const points: Point[] = [];
  for (let j = 0; j <= down; j += 1) {
    for (let i = 0; i <= across; i += 1) {
      points.push(point(i / across, j / down));
    }
  }
  const indices: number[] = [];
  for (let j = 0; j < down; j += 1) {
    for (let i = 0; i < across; i += 1) {
      const corner = j * (across + 1) + i;
      const below = corner + across + 1;
      indices.push(corner, below, corner + 1, corner + 1, below, below + 1);
    }
  }
  return pack(points, indices);
}

/** Unit normals, unit tangents across them. */
function pack(points: Point[], indices: number[]): Mesh {
  const vertices = new Float32Array(VERTEX_NUMBERS * points.length);
  points.forEach(({ position, normal, tangent, hand, uv }, i) => {
    const unit = normalised(normal);
    let across = difference(tangent, scaled(unit, dot(tangent, unit)));
    if (Math.hypot(...across) < 1e-9) {
      across = cross(unit, Math.abs(unit[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]);
    }
    vertices.set([...position, ...unit, ...normalised(across), hand, ...uv], VERTEX_NUMBERS * i);
  });
  return { vertices, indices: Uint32Array.from(indices) };
}

export const MOST_TRIANGLES = 2_000_000;

/** A Wavefront OBJ mesh with texture coordinates: y up becomes z up, the largest half extent 1. */
export function parseObj(text: string, repeat: number): Mesh {
  const read = new ObjCorners();
  const indices: number[] = [];
  for (const line of text.split("\n")) {
    const [word, ...rest] = line.trim().split(/\s+/);
    if (word === "v") read.places.push(objVector(rest));
    if (word === "vn") read.normals.push(objVector(rest));
    if (word === "vt") read.uvs.push([Number(rest[0]), Number(rest[1])]);
    if (word === "f") {
      const corners = rest.map((each) => read.corner(each));
      for (let i = 2; i < corners.length; i += 1) {
        indices.push(corners[0]!, corners[i - 1]!, corners[i]!);
      }
    }
  }
  return finished(read.points, indices, repeat);
}

function objVector(words: string[]): Vector {
  return [Number(words[2]), Number(words[0]), Number(words[1])];
}

/** What the lines of an OBJ file so far say, and the corners made of it, each once. */
class ObjCorners {
  readonly places: Vector[] = [];
  readonly uvs: [number, number][] = [];
  readonly normals: Vector[] = [];
  readonly points: Point[] = [];
  private readonly known = new Map<string, number>();

  /** The number of the corner that a word of a face names. */
  corner(word: string): number {
    const [v, t, n] = word.split("/").map(Number);
    // Numbers count from 1, negative ones from the last that has been read; those that are left out are 0.
    const absolute = (number: number | undefined, count: number): number => (number! < 0 ? count + number! : (number ?? 0) - 1);
    const at = [absolute(v, this.places.length), absolute(t, this.uvs.length), absolute(n, this.normals.length)] as const;
    const key = at.join("/");
    let index = this.known.get(key);
    if (index === undefined) {
      const [place, uv] = [this.places[at[0]], this.uvs[at[1]]];
      if (place === undefined || uv === undefined || ![...place, ...uv].every(Number.isFinite)) {
        throw new Problem("The mesh has no texture coordinates, or is damaged.", `At "${word}".`,
          "Unwrap it in a modeller, and export it as OBJ again.");
      }
      index = this.points.length;
      this.points.push({
        position: place, normal: this.normals[at[2]] ?? [0, 0, 0], tangent: [0, 0, 0], hand: 1, uv: [uv[0], 1 - uv[1]],
      });
      this.known.set(key, index);
    }
    return index;
  }
}

/** Triangles of a file: y up, v from the bottom for OBJ, from the top for glTF; normals of length 0 where there are none. */
export interface Corners {
  positions: Vector[];
  uvs: [number, number][];
  normals: Vector[];
  indices: number[];
}

/** A mesh of such triangles, as `parseObj` makes it. */
export function meshOf({ positions, uvs, normals, indices }: Corners, repeat: number): Mesh {
  const turned = ([x, y, z]: Vector): Vector => [z, x, y];
  return finished(positions.map((position, i): Point => (
    { position: turned(position), normal: turned(normals[i]!), tangent: [0, 0, 0], hand: 1, uv: [...uvs[i]!] })), indices, repeat);
}

/** Centred, with frames at each vertex. */
function finished(points: Point[], indices: number[], repeat: number): Mesh {
  if (indices.length === 0 || indices.length > 3 * MOST_TRIANGLES) {
    throw new Problem(`The mesh has ${indices.length / 3} triangles.`, `It may have 1 to ${MOST_TRIANGLES}.`);
  }
  if (!points.every(({ position, uv }) => [...position, ...uv].every(Number.isFinite))) {
    throw new Problem("The mesh has numbers that are not finite.", "", "Export it again.");
  }
  centre(points);
  addFrames(points, indices);
  points.forEach((point) => {
    point.uv = [point.uv[0] * repeat, point.uv[1] * repeat];
  });
  return pack(points, indices);
}

function centre(points: Point[]): void {
  const low: Vector = [Infinity, Infinity, Infinity];
  const high: Vector = [-Infinity, -Infinity, -Infinity];
  for (const { position } of points) {
    for (let c = 0; c < 3; c += 1) {
      low[c] = Math.min(low[c]!, position[c]!);
      high[c] = Math.max(high[c]!, position[c]!);
    }
  }
  const middle = scaled(sum(low, high), 0.5);
  const size = Math.max(...difference(high, middle), 1e-12);
  points.forEach((point) => {
    point.position = scaled(difference(point.position, middle), 1 / size);
  });
}

/** Tangents averaged over the triangles at each vertex, with handedness (Lengyel 2001); normals where there are none. */
function addFrames(points: Point[], indices: number[]): void {
  const alongV = points.map((): Vector => [0, 0, 0]);
  const bare = points.map(({ normal }) => Math.hypot(...normal) < 1e-9);
  for (let i = 0; i < indices.length; i += 3) {
    const corners = [indices[i]!, indices[i + 1]!, indices[i + 2]!];
    const [a, b, c] = corners.map((n) => points[n]!) as [Point, Point, Point];
    const [one, two] = [difference(b.position, a.position), difference(c.position, a.position)];
    const [u1, v1, u2, v2] = [b.uv[0] - a.uv[0], b.uv[1] - a.uv[1], c.uv[0] - a.uv[0], c.uv[1] - a.uv[1]];
    const area = u1 * v2 - u2 * v1;
    const inverse = Math.abs(area) > 1e-20 ? 1 / area : 0;
    const u = scaled(difference(scaled(one, v2), scaled(two, v1)), inverse);
    const v = scaled(difference(scaled(two, u1), scaled(one, u2)), inverse);
    const face = cross(one, two);
    for (const n of corners) {
      points[n]!.tangent = sum(points[n]!.tangent, u);
      alongV[n] = sum(alongV[n]!, v);
      if (bare[n] === true) {
        points[n]!.normal = sum(points[n]!.normal, face);
      }
    }
  }
  points.forEach((point, n) => {
    point.hand = dot(cross(point.normal, point.tangent), alongV[n]!) < 0 ? -1 : 1;
  });
}
