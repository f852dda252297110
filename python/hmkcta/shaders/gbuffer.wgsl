// What each pixel sees of a mesh, for svbrdf.wgsl: drawn by the rasteriser where frames must come fast. Twin:
// render/gbuffer.py, which Python uses, so that both of its render paths have the same silhouettes.

struct SurfaceFrame { clip_from_world: mat4x4f, eye: vec4f }
@group(0) @binding(0) var<uniform> surface_frame: SurfaceFrame;

struct SurfacePoint {
  @builtin(position) clip: vec4f,
  @location(0) place: vec3f,    // world
  @location(1) normal: vec3f,
  @location(2) tangent: vec4f,  // xyz, handedness
  @location(3) uv: vec2f,
}
struct Targets {
  @location(0) surface: vec4f,  // rgba32float: u, v, distance, 1
  @location(1) normal: vec4f,   // rgba16float
  @location(2) tangent: vec4f,  // rgba16float
}

@vertex
fn surface_vertex(@location(0) place: vec3f, @location(1) normal: vec3f, @location(2) tangent: vec4f, @location(3) uv: vec2f) -> SurfacePoint {
  return SurfacePoint(surface_frame.clip_from_world * vec4f(place, 1.0), place, normal, tangent, uv);
}

@fragment
fn surface_fragment(point: SurfacePoint) -> Targets {
  let offset = point.place - surface_frame.eye.xyz;
  // The back of a cloth is the same material. The triangle decides, for smooth normals turn away before it does.
  let flat = cross(dpdx(point.place), dpdy(point.place));
  let towards = dot(flat, point.normal) * dot(flat, offset);
  let normal = select(1.0, -1.0, towards > 0.0) * normalize(point.normal);
  return Targets(vec4f(point.uv, length(offset), 1.0), vec4f(normal, 0.0), point.tangent);
}
