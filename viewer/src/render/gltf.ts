/** Triangles of a glTF file (.glb, or .gltf with its buffers inside): positions, texture coordinates, normals. */

import { Problem } from "../problem";
import { type Corners, MOST_TRIANGLES } from "./mesh";

const MAGIC = 0x46546c67; // "glTF"
const JSON_CHUNK = 0x4e4f534a;
const TRIANGLES = 4;
const MOST_PARTS = 20_000; // nodes; and primitives, each counted as often as it is placed
const DEEPEST = 256; // of nodes in nodes
const COMPONENTS: Record<number, [bytes: number, read: (view: DataView, at: number) => number, most: number]> = {
  5120: [1, (view, at) => view.getInt8(at), 127],
  5121: [1, (view, at) => view.getUint8(at), 255],
  5122: [2, (view, at) => view.getInt16(at, true), 32767],
  5123: [2, (view, at) => view.getUint16(at, true), 65535],
  5125: [4, (view, at) => view.getUint32(at, true), 2 ** 32 - 1],
  5126: [4, (view, at) => view.getFloat32(at, true), 1],
};
const WIDTHS: Record<string, number> = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT4: 16 };

interface Accessor { bufferView?: number; byteOffset?: number; componentType: number; count: number; type: string; normalized?: boolean; sparse?: unknown }
interface View { buffer: number; byteOffset?: number; byteLength: number; byteStride?: number }
interface Primitive { attributes: Record<string, number>; indices?: number; mode?: number }
interface Node { mesh?: number; children?: number[]; matrix?: number[]; translation?: number[]; rotation?: number[]; scale?: number[] }
interface Document {
  accessors?: Accessor[]; bufferViews?: View[]; buffers?: { uri?: string; byteLength: number }[];
  meshes?: { primitives: Primitive[] }[]; nodes?: Node[]; scenes?: { nodes?: number[] }[]; scene?: number;
}
type Matrix = number[]; // 4 x 4, column by column

function damaged(detail: string): Problem {
  return new Problem("The mesh is damaged, or uses what this page does not read.", detail,
    "Export it again as .glb, without compression.");
}

function tooMany(): Problem {
  return new Problem(`The mesh has more than ${MOST_PARTS} parts.`, "", "Join them in a modeller, and export it again.");
}

/** The corners of all triangles; throws a sentence where there are no texture coordinates. */
export function readGltf(bytes: Uint8Array<ArrayBuffer>): Corners {
  try {
    return new Gltf(bytes).corners();
  } catch (error) {
    throw error instanceof Problem ? error : damaged(error instanceof Error ? error.message : "");
  }
}

class Gltf {
  private readonly document: Document;
  private readonly buffers: DataView[];
  private readonly found: Corners = { positions: [], uvs: [], normals: [], indices: [] };
  private readonly visited = new Set<number>();
  private parts = 0;

  constructor(bytes: Uint8Array<ArrayBuffer>) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    let text = bytes;
    let binary: DataView | null = null;
    if (bytes.length > 20 && view.getUint32(0, true) === MAGIC) {
      const length = view.getUint32(12, true);
      if (view.getUint32(16, true) !== JSON_CHUNK) {
        throw damaged("The first chunk is not JSON.");
      }
      text = bytes.subarray(20, 20 + length);
      const next = 20 + length;
      binary = next + 8 <= bytes.length ? new DataView(bytes.buffer, bytes.byteOffset + next + 8, view.getUint32(next, true)) : null;
    }
    this.document = JSON.parse(new TextDecoder().decode(text)) as Document;
    this.buffers = (this.document.buffers ?? []).map(({ uri }, n) => (uri === undefined && n === 0 && binary !== null ? binary : inside(uri)));
  }

  corners(): Corners {
    const { scenes = [], scene = 0, nodes = [], meshes = [] } = this.document;
    const inside = new Set(nodes.flatMap(({ children = [] }) => children));
    const roots = scenes[scene]?.nodes ?? nodes.flatMap((_, n) => (inside.has(n) ? [] : [n]));
    const identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
    if (nodes.length > MOST_PARTS) {
      throw tooMany();
    }
    roots.forEach((n) => this.node(n, identity, 0));
    if (nodes.length === 0) {
      meshes.forEach(({ primitives }) => primitives.forEach((each) => this.primitive(each, identity)));
    }
    return this.found;
  }

  private node(n: number, parent: Matrix, depth: number): void {
    const node = this.document.nodes?.[n];
    if (node === undefined || this.visited.has(n)) { // glTF's nodes are trees: else a few could stand for millions
      throw damaged(node === undefined ? `There is no node ${n}.` : `Node ${n} is in several places, or inside itself.`);
    }
    if (depth > DEEPEST) {
      throw damaged(`Node ${n} is more than ${DEEPEST} nodes deep.`);
    }
    this.visited.add(n);
    const matrix = times(parent, placed(node));
    if (node.mesh !== undefined) {
      this.document.meshes![node.mesh]!.primitives.forEach((each) => this.primitive(each, matrix));
    }
    node.children?.forEach((child) => this.node(child, matrix, depth + 1));
  }

  private primitive({ attributes, indices, mode = TRIANGLES }: Primitive, matrix: Matrix): void {
    if (mode !== TRIANGLES) {
      return; // lines and points have no surface; strips are rare
    }
    this.parts += 1;
    if (this.parts > MOST_PARTS) {
      throw tooMany();
    }
    const { POSITION: place, TEXCOORD_0: texture, NORMAL: normal } = attributes;
    if (place === undefined || texture === undefined) {
      throw new Problem("The mesh has no texture coordinates.", "", "Unwrap it in a modeller, and export it again.");
    }
    const first = this.found.positions.length;
    const count = this.count(place);
    const corners = this.found.indices.length + (indices === undefined ? count : this.count(indices));
    if (corners > 3 * MOST_TRIANGLES || first + count > 3 * MOST_TRIANGLES) {
      throw new Problem(`The mesh has more than ${MOST_TRIANGLES} triangles.`, "", "Simplify it in a modeller.");
    }
    const [positions, uvs] = [this.numbers(place, 3), this.numbers(texture, 2)];
    const normals = normal === undefined ? null : this.numbers(normal, 3);
    if (uvs.length !== 2 * count || (normals !== null && normals.length !== 3 * count)) {
      throw damaged(`Accessors ${place}, ${texture} and ${normal ?? "-"} differ in length.`);
    }
    const turned = cofactors(matrix);
    for (let i = 0; i < count; i += 1) {
      const [x, y, z] = [positions[3 * i]!, positions[3 * i + 1]!, positions[3 * i + 2]!];
      this.found.positions.push([0, 1, 2].map((r) =>
        matrix[r]! * x + matrix[4 + r]! * y + matrix[8 + r]! * z + matrix[12 + r]!) as [number, number, number]);
      this.found.uvs.push([uvs[2 * i]!, uvs[2 * i + 1]!]);
      const [a, b, c] = normals === null ? [0, 0, 0] : [normals[3 * i]!, normals[3 * i + 1]!, normals[3 * i + 2]!];
      this.found.normals.push([0, 1, 2].map((r) =>
        turned[r]! * a! + turned[3 + r]! * b! + turned[6 + r]! * c!) as [number, number, number]);
    }
    const order = indices === undefined ? Array.from({ length: count }, (_, i) => i) : this.numbers(indices, 1);
    for (const index of order.slice(0, order.length - (order.length % 3))) {
      if (index >= count) {
        throw damaged(`Vertex ${index} of ${count}.`);
      }
      this.found.indices.push(first + index);
    }
  }

  /** How many elements an accessor has. */
  private count(n: number): number {
    const count = this.document.accessors?.[n]?.count;
    if (!Number.isSafeInteger(count) || count! < 0) {
      throw damaged(`Accessor ${n} has ${String(count)} elements.`);
    }
    return count!;
  }

  /** The numbers of an accessor, integers from 0 to 1 where they are normalised. */
  private numbers(n: number, width: number): number[] {
    const accessor = this.document.accessors?.[n];
    const view = this.document.bufferViews?.[accessor?.bufferView ?? -1];
    const kind = COMPONENTS[accessor?.componentType ?? 0];
    if (accessor === undefined || view === undefined || kind === undefined || accessor.sparse !== undefined
      || WIDTHS[accessor.type] !== width) {
      throw damaged(`Accessor ${n}.`);
    }
    const [bytes, read, most] = kind;
    const stride = view.byteStride ?? bytes * width;
    const start = (view.byteOffset ?? 0) + (accessor.byteOffset ?? 0);
    const buffer = this.buffers[view.buffer];
    if (buffer === undefined || stride < bytes * width || start + (this.count(n) - 1) * stride + bytes * width > buffer.byteLength) {
      throw damaged(`Accessor ${n} reaches beyond its buffer.`);
    }
    const scale = accessor.normalized === true ? 1 / most : 1;
    return Array.from({ length: accessor.count * width }, (_, i) =>
      scale * read(buffer, start + Math.floor(i / width) * stride + (i % width) * bytes));
  }
}

/** The bytes of a buffer that is written into the document. */
function inside(uri: string | undefined): DataView {
  const found = /^data:[^,]*;base64,(.*)$/s.exec(uri ?? "");
  if (found === null) {
    throw new Problem("The mesh has its numbers in another file.", uri ?? "", "Export it as one .glb file.");
  }
  return new DataView(Uint8Array.from(atob(found[1]!), (letter) => letter.charCodeAt(0)).buffer);
}

/** The matrix of a node. */
function placed({ matrix, translation = [0, 0, 0], rotation = [0, 0, 0, 1], scale = [1, 1, 1] }: Node): Matrix {
  if (matrix !== undefined) {
    return matrix;
  }
  const [x, y, z, w] = rotation as [number, number, number, number];
  const turn = [
    1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w),
    2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w),
    2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y),
  ];
  const column = (c: number): number[] => [...turn.slice(3 * c, 3 * c + 3).map((each) => each * scale[c]!), 0];
  return [...column(0), ...column(1), ...column(2), ...translation, 1];
}

function times(a: Matrix, b: Matrix): Matrix {
  return Array.from({ length: 16 }, (_, i) => {
    const [row, column] = [i % 4, 4 * Math.floor(i / 4)];
    return [0, 1, 2, 3].reduce((sum, k) => sum + a[4 * k + row]! * b[column + k]!, 0);
  });
}

/** What turns normals as a matrix turns surfaces, 3 x 3. */
function cofactors(m: Matrix): number[] {
  const at = (row: number, column: number): number => m[4 * (column % 3) + (row % 3)]!;
  return Array.from({ length: 9 }, (_, i) => {
    const [row, column] = [i % 3, Math.floor(i / 3)];
    return at(row + 1, column + 1) * at(row + 2, column + 2) - at(row + 1, column + 2) * at(row + 2, column + 1);
  });
}
