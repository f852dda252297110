/** The metadata JSON of the file (`docs/format.md`, section 5): every field, type and range. */

import { asInteger, asList, asMap, asNumber, asObject, asOneOf, asText, checkSizes } from "./fields";
import { DTYPES, type Dtype, parseShape, product } from "./header";
import type { Json } from "./json";
import { type Limits, checkLimit } from "./limits";
import { fault } from "./reasons";

/** The number types that core and basis numbers may have, by the version of the file. */
export const NUMBER_TYPES: Record<Version, readonly Dtype[]> = {
  "1.0": ["F16"], "1.1": ["F16", "I8"], "1.2": ["F16", "I8"], "1.4": ["F16", "I8"],
};
const VERSIONS = ["1.0", "1.1", "1.2", "1.4"] as const;
export type Version = (typeof VERSIONS)[number];
const KINDS = ["svbrdf", "lightfield", "volume", "generic"] as const;
const ROLES = ["space", "view", "light", "time", "channel", "other"] as const;
const SCHEMES = ["most", "least", "uniform"] as const;
const SOURCE_DTYPES = ["bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64",
  "float16", "float32", "float64"] as const;
const FIELDS = ["version", "source_dtype", "axes", "organisation", "levels", "undecomposed", "kind", "transform",
  "quality", "source", "writer", "seed", "arrays"] as const;
const MAX_U32 = 2 ** 32 - 1;
export const MAX_COORD_DIMENSIONS = 16;

/** Value transforms that decoders undo, each with the names of its constants. */
const TRANSFORMS: Record<TransformName, readonly string[]> = {
  identity: [], log1p: ["scale"], asinh: ["scale"], sqrt: [],
};
export type TransformName = "identity" | "log1p" | "asinh" | "sqrt";
export type FileKind = (typeof KINDS)[number];
export type Role = (typeof ROLES)[number];

/** Coordinates of an axis: `width` numbers an index (0: plain numbers). */
export interface Coords {
  values: Float64Array | Float32Array;
  width: number;
}

export interface Axis {
  name: string;
  size: number;
  role: Role;
  coords: Coords | null;
  unit: string;
}

/** The largest C, K, R of any node of a level. */
export interface LevelBounds {
  clusters: number[];
  mixture: number[];
  ranks: number[];
  scheme: string;
}

export interface LevelQuality {
  snrDb: number;
  rmse: number;
  maxAbsError: number;
}

export interface Transform {
  name: TransformName;
  scale: number;
}

export interface Metadata {
  sourceDtype: string;
  axes: Axis[];
  organisation: string[][];
  modeSizes: number[];
  levels: LevelBounds[];
  undecomposed: number[];
  kind: FileKind;
  transform: Transform;
  quality: LevelQuality[];
  writer: string;
}

/** What the metadata says of an array; `info` is null where tables are short. */
export interface ArrayRecord {
  info: { dtype: Dtype; shape: number[] } | null;
  crc32: number;
}

/** Whether files of the version leave out what follows from other arrays (`short.ts`). */
export function isShort(version: Version): boolean {
  return version === "1.2" || version === "1.4";
}

/** Whether levels of the version may be packed (`rice.ts`). */
export function mayPack(version: Version): boolean {
  return version === "1.4";
}

/** Metadata as parsed: `coords` names the coordinate arrays by axis number, which the axes still lack. */
export interface Parsed {
  metadata: Metadata;
  version: Version;
  records: Map<string, ArrayRecord>;
  coords: Map<number, string>;
}

/** Check the JSON object of a file and return what it says. */
export function parseMetadata(value: Json, limits: Limits): Parsed {
  const root = "hmkcta";
  checkSizes(value, root, limits);
  const version = asMap(value, root).get("version");
  if (typeof version === "string" && !VERSIONS.some((known) => known === version)) {
    throw fault("version-unknown", `${root}.version`, version, VERSIONS.join(" or "), "use a viewer that is as new as the file");
  }
  const fields = asObject(value, root, FIELDS);
  const known = asOneOf(fields.version, `${root}.version`, VERSIONS);
  const { axes, coords } = parseAxes(fields.axes, `${root}.axes`, limits);
  const organisation = parseOrganisation(fields.organisation, `${root}.organisation`, axes, limits);
  const size = new Map(axes.map((axis) => [axis.name, axis.size]));
  const modeSizes = organisation.map((mode) => product(mode.map((name) => size.get(name) ?? 0)));
  const undecomposed = parseUndecomposed(fields.undecomposed, `${root}.undecomposed`, modeSizes.length);
  const levels = parseLevels(fields.levels, `${root}.levels`, modeSizes, undecomposed, limits);
  const metadata: Metadata = {
    axes, organisation, modeSizes, levels, undecomposed,
    sourceDtype: asOneOf(fields.source_dtype, `${root}.source_dtype`, SOURCE_DTYPES),
    kind: asOneOf(fields.kind, `${root}.kind`, KINDS),
    transform: parseTransform(fields.transform, `${root}.transform`),
    quality: parseQuality(fields.quality, `${root}.quality`, levels.length),
    writer: (asMap(fields.source, `${root}.source`), asText(fields.writer, `${root}.writer`)),
  };
  asInteger(fields.seed, `${root}.seed`);
  return { metadata, version: known, records: parseRecords(fields.arrays, `${root}.arrays`, known), coords };
}

function parseAxes(value: Json, where: string, limits: Limits): { axes: Axis[]; coords: Map<number, string> } {
  const items = asList(value, where);
  checkLimit("axes-limit", where, items.length, limits.axes);
  const axes: Axis[] = [];
  const coords = new Map<number, string>();
  for (const [n, item] of items.entries()) {
    const path = `${where}[${n}]`;
    const fields = asObject(item, path, ["name", "size", "role", "coords", "unit"]);
    const name = asText(fields.name, `${path}.name`);
    const size = asInteger(fields.size, `${path}.size`, 1, MAX_U32);
    const role = asOneOf(fields.role, `${path}.role`, ROLES);
    const unit = asText(fields.unit, `${path}.unit`);
    let inline: Coords | null = null;
    if (typeof fields.coords === "string") {
      coords.set(n, asOneOf(fields.coords, `${path}.coords`, [`coords/${name}`]));
    } else {
      inline = parseCoords(fields.coords, `${path}.coords`, size);
    }
    checkAxisName(name, `${path}.name`, axes);
    axes.push({ name, size, role, coords: inline, unit });
  }
  checkLimit("elements-limit", where, product(axes.map((axis) => axis.size)), limits.elements);
  return { axes, coords };
}

function checkAxisName(name: string, where: string, others: Axis[]): void {
  if (name === "" || /[+,/=\p{Cc}\p{Cf}\p{Cs}\p{Co}\p{Z}]/u.test(name)) {
    throw fault("field-value", where, name, "a word without + , / = or space");
  }
  if (others.some((axis) => axis.name === name)) {
    throw fault("field-value", where, name, "names that differ");
  }
}

/** Inline coordinates: a list of numbers, or of equally long lists of numbers, one an index. */
function parseCoords(value: Json, where: string, size: number): Coords | null {
  if (value === null) {
    return null;
  }
  const items = asList(value, where, size);
  const first = items[0];
  if (!Array.isArray(first)) {
    return { values: Float64Array.from(items, (item, n) => asNumber(item as Json, `${where}[${n}]`)), width: 0 };
  }
  const width = first.length;
  if (width < 1 || width > MAX_COORD_DIMENSIONS) {
    throw fault("field-value", where, `${width} numbers an index`, `1 to ${MAX_COORD_DIMENSIONS}`);
  }
  const rows = items.map((item, n) =>
    asList(item, `${where}[${n}]`, width).map((number) => asNumber(number, `${where}[${n}]`)));
  return { values: Float64Array.from(rows.flat()), width };
}

function parseOrganisation(value: Json, where: string, axes: Axis[], limits: Limits): string[][] {
  const modes = asList(value, where);
  checkLimit("order-limit", where, modes.length, limits.order);
  const organisation = modes.map((mode, n) =>
    asList(mode, `${where}[${n}]`).map((name) => asText(name, `${where}[${n}]`)));
  if (organisation.length === 0 || organisation.some((mode) => mode.length === 0)) {
    throw fault("field-value", where, organisation.length > 0 ? "a mode without axes" : "no modes",
      "axes in each mode");
  }
  const listed = organisation.flat();
  const known = axes.map((axis) => axis.name);
  if (JSON.stringify([...listed].sort()) !== JSON.stringify([...known].sort())) {
    throw fault("organisation", where, organisation.map((mode) => mode.join("+")).join(", "),
      `each of ${known.join(", ")} exactly once`);
  }
  return organisation;
}

function parseUndecomposed(value: Json, where: string, order: number): number[] {
  const modes = asList(value, where).map((mode) => asInteger(mode, where, 0, order - 1));
  if (modes.some((mode, n) => n > 0 && mode <= (modes[n - 1] ?? 0))) {
    throw fault("field-value", where, modes.join(", "), "mode numbers that differ, ascending");
  }
  return modes;
}

function parseLevels(value: Json, where: string, sizes: number[], undecomposed: number[], limits: Limits
): LevelBounds[] {
  const items = asList(value, where);
  if (items.length === 0) {
    throw fault("field-value", where, "no levels", "1 level and more");
  }
  checkLimit("levels-limit", where, items.length, limits.levels);
  return items.map((item, l) => {
    const path = `${where}[${l}]`;
    const fields = asObject(item, path, ["C", "K", "R", "scheme"]);
    const numbers = (key: "C" | "K" | "R"): number[] =>
      asList(fields[key], `${path}.${key}`, sizes.length).map((number) => asInteger(number, `${path}.${key}`));
    const [clusters, mixture, ranks] = [numbers("C"), numbers("K"), numbers("R")];
    const bounds = { clusters, mixture, ranks, scheme: asOneOf(fields.scheme, `${path}.scheme`, SCHEMES) };
    checkBounds(bounds, path, sizes, undecomposed, limits);
    return bounds;
  });
}

/** Limits of a level; the arrays are held against these bounds later. */
function checkBounds(bounds: LevelBounds, where: string, sizes: number[], undecomposed: number[], limits: Limits
): void {
  sizes.forEach((size, n) => {
    checkLimit("clusters-limit", `${where}.C`, bounds.clusters[n] ?? 0, limits.clusters);
    checkLimit("mixture-limit", `${where}.K`, bounds.mixture[n] ?? 0, limits.mixture);
    checkLimit("rank-limit", `${where}.R`, bounds.ranks[n] ?? 0, undecomposed.includes(n) ? size : limits.rank);
  });
  checkLimit("level-cost-limit", where, levelCost(bounds, undecomposed), limits.level_cost);
}

/** Multiply-adds of one element at a level, in a node of the largest K and R. */
export function levelCost({ mixture, ranks }: LevelBounds, undecomposed: number[]): number {
  return product(mixture.map((k, n) => (undecomposed.includes(n) ? 1 : k * ranks[n]!)));
}

function parseTransform(value: Json, where: string): Transform {
  const name = asMap(value, where).get("name");
  if (typeof name === "string" && !(name in TRANSFORMS && Object.hasOwn(TRANSFORMS, name))) {
    throw fault("transform-unknown", `${where}.name`, name, Object.keys(TRANSFORMS).join(", "),
      "use a viewer that is as new as the file");
  }
  const known = typeof name === "string" ? (name as TransformName) : undefined;
  const fields = asObject(value, where, ["name", ...(known === undefined ? [] : TRANSFORMS[known])]);
  asText(fields["name"] ?? null, `${where}.name`);
  const scale = "scale" in fields ? asNumber(fields["scale"] ?? null, `${where}.scale`) : 1;
  if (scale <= 0) {
    throw fault("field-value", `${where}.scale`, `${scale}`, "a number above 0");
  }
  return { name: known ?? "identity", scale };
}

function parseQuality(value: Json, where: string, levels: number): LevelQuality[] {
  return asList(value, where, levels).map((item, n) => {
    const path = `${where}[${n}]`;
    const fields = asObject(item, path, ["snr_db", "rmse", "max_abs_error"]);
    const rmse = asNumber(fields.rmse, `${path}.rmse`, 0);
    const maxAbsError = asNumber(fields.max_abs_error, `${path}.max_abs_error`, 0);
    const exact = fields.snr_db === null;
    if (exact !== (rmse === 0 && maxAbsError === 0)) {
      throw fault("field-value", `${path}.snr_db`, exact ? "null" : "a number", "null if and only if both errors are 0");
    }
    return { snrDb: exact ? Infinity : asNumber(fields.snr_db, `${path}.snr_db`), rmse, maxAbsError };
  });
}

function parseRecords(value: Json, where: string, version: Version): Map<string, ArrayRecord> {
  const records = new Map<string, ArrayRecord>();
  for (const [name, item] of asMap(value, where)) {
    const path = `${where}.${name}`;
    if (isShort(version)) {
      records.set(name, { info: null, crc32: asInteger(item, path, 0, MAX_U32) });
      continue;
    }
    const fields = asObject(item, path, ["dtype", "shape", "crc32"]);
    const info = {
      dtype: asOneOf(fields.dtype, `${path}.dtype`, DTYPES), shape: parseShape(fields.shape, `${path}.shape`),
    };
    records.set(name, {
      info, crc32: asInteger(fields.crc32, `${path}.crc32`, 0, MAX_U32),
    });
  }
  return records;
}
