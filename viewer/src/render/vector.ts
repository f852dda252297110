/** Vectors of three numbers, and the orbit camera (world: right-handed, z up). */

export type Vector = [number, number, number];

const RADIANS = Math.PI / 180;

/** Unit vector of an azimuth (from x towards y) and an elevation (from the xy plane towards z), in degrees. */
export function direction(azimuth: number, elevation: number): Vector {
  const [a, e] = [azimuth * RADIANS, elevation * RADIANS];
  return [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
}

export function cross(a: Vector, b: Vector): Vector {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

export function dot(a: Vector, b: Vector): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

export function scaled(a: Vector, by: number): Vector {
  return [a[0] * by, a[1] * by, a[2] * by];
}

export function sum(a: Vector, b: Vector): Vector {
  return [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
}

export function difference(a: Vector, b: Vector): Vector {
  return [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
}

export function normalised(a: Vector): Vector {
  return scaled(a, 1 / Math.max(Math.hypot(...a), 1e-12));
}

/** A camera on an orbit; `fov` is its vertical field of view in degrees. */
export interface Camera {
  azimuth: number;
  elevation: number;
  distance: number;
  fov: number;
  target: Vector;
}

/** Eye and image plane: the ray of (x, y), each in -1..1, is `forward + x right + y up`. */
export interface Rays {
  eye: Vector;
  right: Vector;
  up: Vector;
  forward: Vector;
}

/** The rays of a camera for pictures of an aspect (width over height); of upright ones `fov` is the width's. */
export function cameraRays(camera: Camera, aspect: number): Rays {
  const backward = direction(camera.azimuth, camera.elevation);
  const forward = scaled(backward, -1);
  const right = direction(camera.azimuth + 90, 0);
  const size = Math.tan((camera.fov * RADIANS) / 2) / Math.min(1, aspect);
  return {
    forward, eye: sum(camera.target, scaled(backward, camera.distance)),
    right: scaled(right, size * aspect), up: scaled(cross(right, forward), size),
  };
}

/** Clip from world coordinates by columns, as WebGPU takes it (depth 0..1). */
export function clipFromWorld(rays: Rays, near: number, far: number): Float32Array {
  const [x, y] = [scaled(rays.right, 1 / dot(rays.right, rays.right)), scaled(rays.up, 1 / dot(rays.up, rays.up))];
  const z = far / (far - near);
  const rows = [[...x, -dot(x, rays.eye)], [...y, -dot(y, rays.eye)],
    [...scaled(rays.forward, z), -z * (dot(rays.forward, rays.eye) + near)],
    [...rays.forward, -dot(rays.forward, rays.eye)]];
  return Float32Array.from({ length: 16 }, (_, i) => rows[i % 4]![Math.floor(i / 4)]!);
}
