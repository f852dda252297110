/** The renderers' host code without a GPU: meshes, directions, cameras, tables. */

import { describe, expect, it } from "vitest";
import type { Axis } from "../src/reader/metadata";
import { colourTable, interpolated } from "../src/render/colours";
import { angleLists, anglesAt, interpolateAngle } from "../src/render/angles";
import { buildTable, directionsOf, hemisphere, interpolateDirection } from "../src/render/directions";
import { asDrawn, layOut, shownChannels, timeSteps } from "../src/render/layout";
import { aim, findCameras } from "../src/render/lightfield";
import { readGltf } from "../src/render/gltf";
import { VERTEX_NUMBERS, makeMesh, meshOf, parseObj } from "../src/render/mesh";
import { type Vector, cameraRays, clipFromWorld, cross, dot } from "../src/render/vector";
import { spacing } from "../src/render/volume";
import { startWindow, windowBounds, windowEnd } from "../src/render/window";
import { shown } from "./made";

function axis(name: string, size: number, role: Axis["role"], values?: number[], width = 0): Axis {
  const coords = values === undefined ? null : { values: Float64Array.from(values), width };
  return { name, size, role, coords, unit: "" };
}

/** A row of the interleaved vertices: position, normal, tangent with handedness, texture coordinates. */
function vertex(mesh: ReturnType<typeof makeMesh>, i: number): { place: Vector; normal: Vector; tangent: Vector; hand: number; uv: number[] } {
  const row = Array.from(mesh.vertices.subarray(i * VERTEX_NUMBERS, (i + 1) * VERTEX_NUMBERS));
  const three = (at: number): Vector => [row[at]!, row[at + 1]!, row[at + 2]!];
  return { place: three(0), normal: three(3), tangent: three(6), hand: row[9]!, uv: row.slice(10) };
}

describe("meshes", () => {
  it.each(["sphere", "plane", "cloth"] as const)("%s has unit frames and faces outward", (shape) => {
    const mesh = makeMesh(shape, 2, 10, 20);
    const count = mesh.vertices.length / VERTEX_NUMBERS;
    expect(Math.max(...mesh.indices)).toBe(count - 1);
    for (let i = 0; i < count; i += 37) {
      const { normal, tangent } = vertex(mesh, i);
      expect(Math.hypot(...normal)).toBeCloseTo(1, 5);
      expect(Math.hypot(...tangent)).toBeCloseTo(1, 5);
      expect(dot(normal, tangent)).toBeCloseTo(0, 5);
    }
  });

  it("has v along growing rows", () => {
    const mesh = makeMesh("plane", 1, 10, 20);
    const [first, below] = [vertex(mesh, 0), vertex(mesh, 2)];
    expect(first.place).toEqual([0, -1, 0.5]);
    const down = cross(first.normal, first.tangent).map((each) => first.hand * each) as Vector;
    expect(dot(down, below.place)).toBeGreaterThan(dot(down, first.place));
    expect([first.uv, below.uv]).toEqual([[0, 0], [0, 1]]);
  });

  it("reads OBJ: y up, v from the bottom, largest half extent 1", () => {
    const text = "v 0 0 0\nv 4 0 0\nv 4 2 0\nv 0 2 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n";
    const mesh = parseObj(text, 1);
    expect(Array.from(mesh.indices)).toEqual([0, 1, 2, 0, 2, 3]);
    const { place, normal, tangent, hand, uv } = vertex(mesh, 0);
    expect(place).toEqual([0, -1, -0.5]);
    expect(uv).toEqual([0, 1]);
    expect(normal).toEqual([1, 0, 0]);
    expect(tangent).toEqual([0, 1, 0]);
    expect(hand).toBe(-1);
  });

  it("reads OBJ whose corners count from the last vertex", () => {
    const three = "v 0 0 0\nv 4 0 0\nv 4 2 0\nvt 0 0\nvt 1 0\nvt 1 1\nf -3/-3 -2/-2 -1/-1\n";
    expect(Array.from(parseObj(three + three, 1).indices)).toEqual([0, 1, 2, 3, 4, 5]);
  });

  it("refuses OBJ without texture coordinates, and nothing at all", () => {
    expect(() => parseObj("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3", 1)).toThrow("no texture coordinates");
    expect(() => parseObj("v 0 0 0\nvt 0 0\nf 1/1 9/1 1/1", 1)).toThrow("damaged");
    expect(() => parseObj("hello", 1)).toThrow("0 triangles");
  });
});

describe("glTF", () => {
  const OBJ = "v 0 0 0\nv 4 0 0\nv 4 2 0\nv 0 2 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n";
  const PLACES = [[0, 0, 0], [4, 0, 0], [4, 2, 0], [0, 2, 1]];
  const UVS = [[0, 1], [1, 1], [1, 0], [0, 0]]; // v from the top

  /** The quad as a glTF document; its node doubles and turns by 90 degrees what lies halved and turned back in the buffer. */
  function quad(change: (document: Record<string, unknown>) => void = () => undefined): { document: object; buffer: Buffer } {
    const buffer = Buffer.alloc(48 + 16 + 6 * 2);
    PLACES.forEach(([x, y, z], i) => [y! / 2, -x! / 2, z! / 2].forEach((each, k) => buffer.writeFloatLE(each, 12 * i + 4 * k)));
    UVS.forEach(([u, v], i) => [u!, v!].forEach((each, k) => buffer.writeUInt16LE(65535 * each, 48 + 4 * i + 2 * k)));
    [0, 1, 2, 0, 2, 3].forEach((index, i) => buffer.writeUInt16LE(index, 64 + 2 * i));
    const half = Math.SQRT1_2;
    const document = {
      scenes: [{ nodes: [1] }], nodes: [{ mesh: 0, rotation: [0, 0, half, half] }, { children: [0], scale: [2, 2, 2] }],
      meshes: [{ primitives: [{ attributes: { POSITION: 0, TEXCOORD_0: 1 }, indices: 2 }] }],
      accessors: [{ bufferView: 0, componentType: 5126, count: 4, type: "VEC3" },
        { bufferView: 0, byteOffset: 48, componentType: 5123, normalized: true, count: 4, type: "VEC2" },
        { bufferView: 1, componentType: 5123, count: 6, type: "SCALAR" }],
      bufferViews: [{ buffer: 0, byteLength: 64 }, { buffer: 0, byteOffset: 64, byteLength: 12 }],
      buffers: [{ byteLength: buffer.length } as Record<string, unknown>],
    };
    change(document);
    return { document, buffer };
  }

  function glb({ document, buffer }: ReturnType<typeof quad>): Uint8Array<ArrayBuffer> {
    const text = Buffer.from(JSON.stringify(document));
    const json = Buffer.concat([text, Buffer.alloc((4 - (text.length % 4)) % 4, 32)]);
    const head = Buffer.alloc(20);
    [0x46546c67, 2, 28 + json.length + buffer.length, json.length, 0x4e4f534a].forEach((word, i) => head.writeUInt32LE(word, 4 * i));
    const next = Buffer.alloc(8);
    [buffer.length, 0x004e4942].forEach((word, i) => next.writeUInt32LE(word, 4 * i));
    return new Uint8Array(Buffer.concat([head, json, next, buffer]));
  }

  function same(bytes: Uint8Array<ArrayBuffer>): void {
    const [found, expected] = [meshOf(readGltf(bytes), 2), parseObj(OBJ, 2)];
    expect(Array.from(found.indices)).toEqual(Array.from(expected.indices));
    found.vertices.forEach((value, i) => expect(value).toBeCloseTo(expected.vertices[i]!, 5));
  }

  it("reads the same as OBJ, from .glb and .gltf", () => {
    same(glb(quad()));
    const { document, buffer } = quad();
    (document as { buffers: object[] }).buffers = [{ uri: `data:application/octet-stream;base64,${buffer.toString("base64")}`, byteLength: buffer.length }];
    same(new TextEncoder().encode(JSON.stringify(document)));
  });

  it("says what it does not take", () => {
    const bare = quad((document) => {
      document["meshes"] = [{ primitives: [{ attributes: { POSITION: 0 }, indices: 2 }] }];
    });
    expect(() => readGltf(glb(bare))).toThrow("no texture coordinates");
    const apart = quad((document) => {
      document["buffers"] = [{ uri: "mesh.bin", byteLength: 76 }];
    });
    expect(() => readGltf(new TextEncoder().encode(JSON.stringify(apart.document)))).toThrow("in another file");
    expect(() => readGltf(glb(quad()).subarray(0, 300))).toThrow("damaged");
    expect(() => readGltf(new Uint8Array(30))).toThrow("damaged");
    const packed = quad((document) => {
      (document["accessors"] as object[])[0] = { componentType: 5126, count: 4, type: "VEC3" };
    });
    expect(() => readGltf(glb(packed))).toThrow("without compression");
  });

  it("is not kept busy by nodes that share children, hold themselves or lie deep", () => {
    const changed = (change: Record<string, unknown>): (() => unknown) => () => readGltf(glb(quad((document) => Object.assign(document, change))));
    const chain = (length: number, children: (n: number) => number[]): object[] =>
      [...Array.from({ length }, (_, n) => ({ children: children(n) })), { mesh: 0 }];
    const scenes = [{ nodes: [0] }];
    expect(changed({ scenes, nodes: chain(60, (n) => [n + 1, n + 1]) })).toThrow("several places");
    expect(changed({ scenes, nodes: [{ children: [1] }, { children: [0], mesh: 0 }] })).toThrow("inside itself");
    expect(changed({ scenes: [{ nodes: [0, 0] }], nodes: [{ mesh: 0 }] })).toThrow("several places");
    expect(changed({ scenes, nodes: chain(300, (n) => [n + 1]) })).toThrow("256 nodes deep");
    expect(changed({ scenes: [{ nodes: Array.from({ length: 30000 }, (_, n) => n) }], nodes: Array.from({ length: 30000 }, () => ({ mesh: 0 })) }))
      .toThrow("more than 20000 parts");
    const { meshes } = quad().document as { meshes: { primitives: object[] }[] };
    const many = Array.from({ length: 200 }, () => meshes[0]!.primitives[0]!);
    const nodes = Array.from({ length: 200 }, () => ({ mesh: 0 }));
    expect(changed({ scenes: [{ nodes: nodes.map((_, n) => n) }], nodes, meshes: [{ primitives: many }] })).toThrow("more than 20000 parts");
  });

  it("takes no more elements than a buffer has, nor more triangles than can be shown", () => {
    const counted = (which: number, count: unknown): (() => unknown) => () => readGltf(glb(quad((document) => {
      (document["accessors"] as { count: unknown }[])[which]!.count = count;
    })));
    expect(counted(2, 7)).toThrow("damaged");
    expect(counted(0, 1e9)).toThrow("more than 2000000 triangles");
    expect(counted(2, 1e300)).toThrow("damaged");
    expect(counted(1, -4)).toThrow("damaged");
    expect(counted(1, 3)).toThrow("damaged");
    expect(() => readGltf(glb(quad((document) => {
      (document["bufferViews"] as { byteStride?: number }[])[0]!.byteStride = 1;
    })))).toThrow("damaged");
  });

  it("takes the nodes that are in no other where there is no scene", () => {
    same(glb(quad((document) => {
      delete document["scenes"];
    })));
  });
});

describe("directions", () => {
  function weigh(vectors: Vector[], direction: Vector): Map<number, number> {
    const { index, weight } = interpolateDirection(buildTable(vectors), direction);
    const result = new Map<number, number>();
    index.forEach((each, k) => result.set(each, (result.get(each) ?? 0) + weight[k]!));
    return result;
  }

  it("gives a measured direction itself", () => {
    const vectors = hemisphere(24, 0);
    vectors.forEach((vector, i) => {
      expect(weigh(vectors, vector).get(i)).toBeCloseTo(1, 4);
      expect(interpolateDirection(buildTable(vectors), vector).height).toBeCloseTo(vector[2], 4);
    });
  });

  it("interpolates between, and goes on beyond the measured ones", () => {
    const vectors = hemisphere(24, 0);
    const between = weigh(vectors, [0.3, -0.2, Math.sqrt(1 - 0.13)]);
    expect([...between.values()].reduce((sum, each) => sum + each, 0)).toBeCloseTo(1, 5);
    expect(between.size).toBe(3);
    const horizon = weigh(vectors, [1, 0, 0]);
    expect([...horizon.values()].reduce((sum, each) => sum + each, 0)).toBeCloseTo(1, 5);
  });

  it("takes zeniths and azimuths on two axes", () => {
    const theta = { ...axis("theta", 3, "light", [60, 0, 30]), unit: "degrees" };
    const phi = { ...axis("phi", 4, "light", [10, 280, 100, 190]), unit: "degrees" };
    for (const axes of [[theta, phi], [phi, theta]]) { // azimuths are known by their name
      const lists = angleLists(axes, [0, 1]);
      expect(lists.map((list) => axes[list.axis]!.name)).toEqual(["theta", "phi"]);
      const at = anglesAt([Math.sin(Math.PI / 4) * Math.cos(-0.3), Math.sin(Math.PI / 4) * Math.sin(-0.3), Math.cos(Math.PI / 4)]);
      const [zenith, azimuth] = lists.map((list, n) => interpolateAngle(list, at[n]!)) as [ReturnType<typeof interpolateAngle>, ReturnType<typeof interpolateAngle>];
      expect(zenith.index).toEqual([2, 0]);
      expect(zenith.weight[0]).toBeCloseTo(0.5, 5);
      expect(azimuth.index).toEqual([1, 0]); // between 280 degrees and a turn after 10
      expect(azimuth.weight[1]).toBeCloseTo((80 - 0.3 * (180 / Math.PI)) / 90, 5);
    }
    expect(() => angleLists([axis("theta", 3, "light"), phi], [0, 1])).toThrow("no angles");
    expect(() => angleLists([axis("theta", 2, "light", [0, 60]), phi], [0, 1])).toThrow("above the surface");
  });

  it("takes angles and vectors, and assumes a spiral without", () => {
    const angles = { ...axis("light", 2, "light", [0, 0, 60, 90], 2), unit: "degrees" };
    expect(directionsOf(angles).vectors[1]!.map((each) => Number(each.toFixed(3)))).toEqual([0, 0.866, 0.5]);
    expect(directionsOf(axis("light", 5, "light")).assumed).toBe(true);
    expect(() => directionsOf(axis("light", 1, "light", [0, 0, -1], 3))).toThrow("no directions above the surface");
    expect(() => directionsOf(axis("light", 1, "light", [0.5], 0))).toThrow("no directions");
  });
});

describe("axes", () => {
  it("finds what each kind needs", () => {
    const axes = [axis("light", 4, "light"), axis("y", 8, "space"), axis("x", 8, "space"), axis("rgb", 3, "channel")];
    expect(layOut(axes, "svbrdf")).toEqual({ lights: [0], views: [], time: null, space: [1, 2], channel: 3, channels: [0, 1, 2] });
    const named = ["x", "y", "z", "t"].map((name, n) => axis(name, 5 + n, name === "t" ? "time" : "space"));
    expect(layOut(named, "volume").space).toEqual([2, 1, 0]);
    expect(asDrawn(named.map((each) => ({ ...each, name: `${each.name}1` })), [1, 0, 2])).toEqual([0, 1, 2]);
    expect(() => layOut(axes, "volume")).toThrow("3 axes of role space");
    expect(() => layOut(axes, "lightfield")).toThrow("role view");
    expect(shownChannels(31)).toEqual([30, 15, 0]);
    expect(timeSteps(1.25, 4)).toEqual({ frames: [1, 2], weight: 0.25 });
    expect(timeSteps(3, 4)).toEqual({ frames: [2, 3], weight: 1 });
    expect(spacing(axis("x", 3, "space", [0, 0.5, 1]))).toBe(0.5);
    expect(spacing(axis("x", 3, "space", [0, 0.5, 2]))).toBe(1);
  });

  it("places cameras, and weighs the nearest two each way", () => {
    const axes = [axis("view", 9, "view"), axis("y", 8, "space"), axis("x", 8, "space")];
    const cameras = findCameras(axes, layOut(axes, "lightfield"));
    expect(cameras.place[5]).toEqual([1, 2]);
    const aimed = aim(cameras, { row: 0.25, column: 2, focus: 2, aperture: 0 });
    expect(aimed).toEqual([{ camera: 2, weight: 0.75, shift: [-0.5, 0] }, { camera: 5, weight: 0.25, shift: [1.5, 0] }]);
    expect(aim(cameras, { row: 1, column: 1, focus: 0, aperture: 5 })).toHaveLength(9);
    const scattered = [axis("view", 3, "view", [0, 0, 0, 3, 3, 0], 2), ...axes.slice(1)];
    expect(findCameras(scattered, layOut(scattered, "lightfield")).place).toEqual([[0, 0], [0, 1], [1, 0]]);
  });
});

describe("pictures", () => {
  it("interpolates tables as NumPy does", () => {
    [[0, 0], [0.15, 0], [0.575, 0.175], [1, 0.35]].forEach(([share, value]) => {
      expect(interpolated([[0, 0], [0.15, 0], [1, 0.35]], share!)).toBeCloseTo(value!, 12);
    });
    const table = colourTable("grey", [[0, 0], [1, 1]]);
    expect(Array.from(table.subarray(4 * 255))).toEqual([1, 1, 1, 1]);
    expect(table[4 * 51]).toBeCloseTo(0.2, 6);
  });

  it("projects what the rays see", () => {
    const rays = cameraRays({ azimuth: 20, elevation: 30, distance: 3, fov: 38, target: [0, 0, 0] }, 1.5);
    const matrix = clipFromWorld(rays, 0.1, 100);
    const place = [0, 1, 2].map((c) => rays.eye[c]! + 2 * (rays.forward[c]! + 0.5 * rays.right[c]! - 0.25 * rays.up[c]!));
    const clip = [0, 1, 2, 3].map((row) => [...place, 1].reduce((sum, each, c) => sum + each * matrix[4 * c + row]!, 0));
    expect(clip[0]! / clip[3]!).toBeCloseTo(0.5, 5);
    expect(clip[1]! / clip[3]!).toBeCloseTo(-0.25, 5);
    expect(clip[2]! / clip[3]!).toBeGreaterThan(0);
  });
});

describe("windows", () => {
  it.each([[0, 0, 0, 0, 0, 1], [5, 5, 5, 5, 0, 5], [-3, -3, -3, -3, -3, 0], [1e9, 1e9, 1e9, 1e9, 0, 1e9], [2, 4, 1, 9, 2, 4]])(
    "of values %d to %d, of %d to %d, are from %d to %d", (low, high, least, most, from, to) => {
      const seen = shown("generic", [axis("a", 3, "other"), axis("b", 3, "other")]);
      const window = (of: "slice" | "volume"): { low: number; high: number } => startWindow(seen, { low, high, least, most }, of);
      expect(window("slice")).toEqual({ low: from, high: to });
      expect(Math.fround(window("volume").high)).toBeGreaterThan(Math.fround(window("volume").low));
    });

  it("end above their beginning in float32, too", () => {
    for (const [low, high] of [[0, 0], [1e9, 1e9 + 1], [-1e-9, -1e-9], [5, 4]] as const) {
      expect(Math.fround(windowEnd(low, high))).toBeGreaterThan(Math.fround(low));
    }
    expect(windowEnd(1, 1.5)).toBe(1.5);
  });

  it("reach all values that were seen, and beyond the window", () => {
    expect(windowBounds({ low: 0, high: 2, least: 0, most: 1000 })).toEqual([-1, 1000]);
    expect(windowBounds({ low: 0, high: 2, least: -5, most: 2 })).toEqual([-5, 3]);
    expect(windowBounds({ low: 7, high: 7, least: 7, most: 7 })).toEqual([0, 14]);
    expect(windowBounds({ low: 0, high: 2, least: 0, most: 2 }, 255), "and the white of the type").toEqual([-1, 255]);
  });
});
