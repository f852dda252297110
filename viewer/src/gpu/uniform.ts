/**
 * Uniform buffers filled by name: the layout is read from the shader's own `struct`, so that nothing here has to
 * repeat it and a field that the shader does not have is an error.
 */

interface Field {
  offset: number;
  type: string; // u32, i32 or f32
  count: number; // numbers
  stride: number; // bytes from one element of an array to the next, or 0
}

const SCALARS = new Set(["u32", "i32", "f32"]);
const VECTORS: Record<string, [string, number]> = {
  vec2f: ["f32", 2], vec3f: ["f32", 3], vec4f: ["f32", 4], vec2u: ["u32", 2], vec3u: ["u32", 3], vec4u: ["u32", 4],
  mat4x4f: ["f32", 16],
};

interface Shape {
  align: number;
  size: number;
  fields: Map<string, Field>; // of a struct or an array by path: "lights[0].place"
}

function round(value: number, to: number): number {
  return Math.ceil(value / to) * to;
}

function structBody(shader: string, name: string): [string, string][] {
  const body = new RegExp(`struct\\s+${name}\\s*\\{([^}]*)\\}`).exec(shader)?.[1];
  if (body === undefined) {
    throw new Error(`the shader has no struct ${name}`);
  }
  const fields = body.replace(/\/\/[^\n]*/g, "").matchAll(/(?:@\w+(?:\([^)]*\))?\s*)*(\w+)\s*:\s*(array<\s*\w+\s*,\s*\d+\s*>|\w+)/g);
  return Array.from(fields, ([, field, type]) => [field ?? "", type ?? ""]);
}

function shapeOf(shader: string, type: string): Shape {
  const array = /^array<\s*(\w+)\s*,\s*(\d+)\s*>$/.exec(type);
  if (array !== null) {
    return arrayShape(shapeOf(shader, array[1]!), Number(array[2]));
  }
  const vector: [string, number] | undefined = SCALARS.has(type) ? [type, 1] : VECTORS[type];
  if (vector !== undefined) {
    const [scalar, count] = vector;
    const align = count === 1 ? 4 : count === 2 ? 8 : 16;
    return { align, size: 4 * count, fields: new Map([["", { offset: 0, type: scalar, count, stride: 0 }]]) };
  }
  const fields = new Map<string, Field>();
  let [at, align] = [0, 16];
  for (const [name, fieldType] of structBody(shader, type)) {
    const shape = shapeOf(shader, fieldType);
    at = round(at, shape.align);
    align = Math.max(align, shape.align);
    for (const [path, field] of shape.fields) {
      const joined = path === "" || path.startsWith("[") ? `${name}${path}` : `${name}.${path}`;
      fields.set(joined, { ...field, offset: at + field.offset });
    }
    at += shape.size;
  }
  return { align, size: round(at, align), fields };
}

function arrayShape(element: Shape, count: number): Shape {
  const stride = round(element.size, 16);
  const fields = new Map<string, Field>();
  for (let i = 0; i < count; i += 1) {
    for (const [path, field] of element.fields) {
      fields.set(`[${i}]${path === "" ? "" : `.${path}`}`, { ...field, offset: i * stride + field.offset });
    }
  }
  return { align: Math.max(16, element.align), size: stride * count, fields };
}

/** What a uniform holds, by field; arrays and structs within by path, `lights[0].place`. */
export type Values = Record<string, number | boolean | ArrayLike<number>>;

/** Bytes of a uniform by its struct in a shader. */
export class UniformLayout {
  private readonly shape: Shape;

  constructor(shader: string, private readonly name: string) {
    this.shape = shapeOf(shader, name);
  }

  get size(): number {
    return this.shape.size;
  }

  /** The bytes of some values; fields that are left out are 0. */
  pack(values: Values): ArrayBuffer {
    const bytes = new ArrayBuffer(this.size);
    for (const [path, value] of Object.entries(values)) {
      const field = this.shape.fields.get(path);
      const numbers = typeof value === "object" ? value : [Number(value)];
      if (field === undefined || numbers.length > field.count) {
        throw new Error(`${this.name} has no field ${path} of ${numbers.length} numbers`);
      }
      const types = { u32: Uint32Array, i32: Int32Array, f32: Float32Array };
      new types[field.type as keyof typeof types](bytes, field.offset, field.count).set(numbers);
    }
    return bytes;
  }
}
