/** What the header of a file says (`docs/format.md`): every field, type and range. */

import { asInteger, asList, asMap, asNumber, asObject, asOneOf, asText, checkSizes } from "./fields";
import type { Json } from "./json";
import { type Limits, checkLimit } from "./limits";
import { fault } from "./reasons";
import { type LevelBounds, MAX_U32, type Stage, hasNumbers, parseStages } from "./stages";

export type { LevelBounds } from "./stages";

const KINDS = ["svbrdf", "lightfield", "volume", "generic"] as const;
const ROLES = ["space", "view", "light", "time", "channel", "other"] as const;
const SOURCE_DTYPES = ["bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64",
  "float16", "float32", "float64"] as const;
const COORDINATE_DTYPES = ["F32", "F64"] as const;
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

/** Coordinates that have a section of their own, of the axis with this number. */
export interface CoordSection {
  axis: number;
  dtype: (typeof COORDINATE_DTYPES)[number];
  width: number;
  numbers: number;
}

export interface Axis {
  name: string;
  size: number;
  role: Role;
  coords: Coords | null;
  unit: string;
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
  /** Of all stages of the tree, and of those that have numbers, the levels. */
  stages: LevelBounds[];
  levels: LevelBounds[];
  kind: FileKind;
  transform: Transform;
  quality: LevelQuality[]; // by level
  writer: string;
}

/** For each level how many stages it takes together with all levels before it. */
export function levelEnds({ stages, levels }: Metadata): number[] {
  return levels.map((level) => stages.indexOf(level) + 1);
}

/** Of a model of the levels 1 to `level`. */
export function upto(metadata: Metadata, level: number): Metadata {
  const { stages, levels, quality } = metadata;
  return {
    ...metadata, stages: stages.slice(0, levelEnds(metadata)[level - 1]), levels: levels.slice(0, level), quality: quality.slice(0, level),
  };
}

/** The header as parsed: the axes lack coordinates that have sections. */
export interface Parsed {
  metadata: Metadata;
  stages: Stage[];
  coords: CoordSection[];
}

/** Check the header of a file of `size` bytes and return what it says. */
export function parseMetadata(value: Json, size: number, limits: Limits): Parsed {
  const root = "header";
  checkSizes(value, root, limits);
  const fields = asObject(value, root, ["axes", "organisation", "dtype", "stages", "quality"],
    ["kind", "transform", "source", "writer", "seed"]);
  const { axes, coords } = parseAxes(fields.axes, `${root}.axes`, limits);
  const organisation = parseOrganisation(fields.organisation, `${root}.organisation`, axes.length, limits);
  const modeSizes = organisation.map((mode) => mode.reduce((rows, axis) => rows * axes[axis]!.size, 1));
  const sourceDtype = asOneOf(fields.dtype, `${root}.dtype`, SOURCE_DTYPES);
  const kind = fields.kind === undefined ? "generic" : asOneOf(fields.kind, `${root}.kind`, KINDS);
  const transform: Transform = fields.transform === undefined ? { name: "identity", scale: 1 }
    : parseTransform(fields.transform, `${root}.transform`);
  const stages = parseStages(fields.stages, `${root}.stages`, modeSizes, size, limits);
  const levels = stages.filter(hasNumbers);
  const quality = parseQuality(fields.quality, `${root}.quality`, levels.length);
  asMap(fields.source === undefined ? new Map() : fields.source, `${root}.source`);
  const writer = asText(fields.writer === undefined ? "" : fields.writer, `${root}.writer`);
  asInteger(fields.seed === undefined ? 0 : fields.seed, `${root}.seed`);
  return {
    stages, coords,
    metadata: {
      axes, modeSizes, stages, levels, sourceDtype, kind, transform, quality, writer,
      organisation: organisation.map((mode) => mode.map((axis) => axes[axis]!.name)),
    },
  };
}

function parseAxes(value: Json, where: string, limits: Limits): { axes: Axis[]; coords: CoordSection[] } {
  const items = asList(value, where);
  checkLimit("axes-limit", where, items.length, limits.axes);
  const axes: Axis[] = [];
  const coords: CoordSection[] = [];
  for (const [n, item] of items.entries()) {
    const path = `${where}[${n}]`;
    const fields = asObject(item, path, ["name", "size"], ["role", "unit", "coordinates"]);
    const name = asText(fields.name, `${path}.name`);
    const axis: Axis = {
      name, size: asInteger(fields.size, `${path}.size`, 1, MAX_U32), coords: null,
      role: fields.role === undefined ? "other" : asOneOf(fields.role, `${path}.role`, ROLES),
      unit: asText(fields.unit === undefined ? "" : fields.unit, `${path}.unit`),
    };
    const given = fields.coordinates;
    if (given instanceof Map) {
      coords.push(parseCoordSection(given, `${path}.coordinates`, n, axis.size));
    } else if (given !== undefined) {
      axis.coords = parseCoords(given, `${path}.coordinates`, axis.size);
    }
    checkAxisName(name, `${path}.name`, axes);
    axes.push(axis);
  }
  checkLimit("elements-limit", where, axes.reduce((all, { size }) => all * size, 1), limits.elements);
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

function parseCoordSection(value: Json, where: string, axis: number, size: number): CoordSection {
  const fields = asObject(value, where, ["dtype", "width"]);
  const dtype = asOneOf(fields.dtype, `${where}.dtype`, COORDINATE_DTYPES);
  const width = asInteger(fields.width, `${where}.width`, 0, MAX_COORD_DIMENSIONS);
  return { axis, dtype, width, numbers: size * Math.max(1, width) };
}

/** Inline coordinates: a list of numbers, or of equally long lists of numbers, one an index. */
function parseCoords(value: Json, where: string, size: number): Coords {
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

/** For each mode the numbers of its axes. */
function parseOrganisation(value: Json, where: string, axes: number, limits: Limits): number[][] {
  const modes = asList(value, where);
  checkLimit("order-limit", where, modes.length, limits.order);
  const organisation = modes.map((mode, n) =>
    asList(mode, `${where}[${n}]`).map((axis) => asInteger(axis, `${where}[${n}]`)));
  if (organisation.length === 0 || organisation.some((mode) => mode.length === 0)) {
    throw fault("field-value", where, organisation.length > 0 ? "a mode without axes" : "no modes", "axes in each mode");
  }
  const listed = organisation.flat().sort((a, b) => a - b);
  if (listed.length !== axes || listed.some((axis, n) => axis !== n)) {
    throw fault("organisation", where, organisation.map((mode) => mode.join("+")).join(", "), `each of 0 to ${axes - 1} exactly once`);
  }
  return organisation;
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
