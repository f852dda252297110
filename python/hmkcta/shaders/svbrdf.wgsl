// SVBRDF renderer: one invocation a pixel turns the G-buffer into radiance. Twin: render/svbrdf.py.
// Before it: the weighted decoder with picks 3 for light and view, 2 for y and x, 3 for channels. Spaces: world (z up),
// local (x along texel columns, z the normal), disk (stereographic projection of local directions), texel.

struct Light {
  place: vec4f,     // xyz: unit direction towards it (w = 0), or position (w = 1); world
  strength: vec4f,  // rgb, intensity included
}
struct SvbrdfFrame {
  width: u32, height: u32, light_count: u32, flags: u32,  // FLAG_ bits
  eye: vec4f, right: vec4f, up: vec4f, forward: vec4f,    // world; the ray of ndc is forward + x right + y up
  rows: u32, columns: u32, unused_0: u32, unused_1: u32,  // texels
  light_table: vec4u,  // first record, first grid word group, grid side, axis
  view_table: vec4u,
  y_axis: u32, x_axis: u32, channel_axis: u32, unused_2: u32,
  channels: vec4u,     // index shown as red, green, blue
  stands: array<vec4u, 2>,  // where every axis stands that is not named above
  lights: array<Light, 8>,
}
@group(1) @binding(0) var<uniform> svbrdf: SvbrdfFrame;
@group(1) @binding(1) var<storage, read> directions: array<vec4u>;
@group(1) @binding(2) var seen_surface: texture_2d<f32>;  // u, v, distance, 1
@group(1) @binding(3) var seen_normal: texture_2d<f32>;
@group(1) @binding(4) var seen_tangent: texture_2d<f32>;  // xyz, handedness
@group(1) @binding(5) var radiance_out: texture_storage_2d<rgba32float, write>;

const NO_AXIS = 0xffu;
const NO_NEIGHBOUR = 0xffffffffu;
const FLAG_Y_UP = 1u;
const FLAG_COSINE = 2u;   // the file's values lack the cosine
const FLAG_NEAREST = 4u;  // texels are not interpolated: the modes would need too many rows
const MOST_STEPS = 8u;
const LEAST_VIEW = 0.01;

struct Weights { corners: vec3u, weight: vec3f, height: f32 }

// Weights of a triangle's corners at p in the disk.
fn barycentric(record: u32, p: vec2f) -> vec3f {
  let first = bitcast<vec4f>(directions[record + 2u]);
  let rest = bitcast<vec4f>(directions[record + 3u]);
  let w0 = first.x * p.x + first.y * p.y + first.z;
  let w1 = first.w * p.x + rest.x * p.y + rest.y;
  return vec3f(w0, w1, 1.0 - w0 - w1);
}

// Measured directions around a local one: from its grid cell's triangle across edges to its own.
fn interpolate_direction(table: vec4u, direction: vec3f) -> Weights {
  let p = direction.xy / (1.0 + max(direction.z, 0.0));
  let side = table.z;
  let cell = min(vec2u(max((p + 1.0) * (0.5 * f32(side)), vec2f(0.0))), vec2u(side - 1u));
  let at = cell.y * side + cell.x;
  var record = table.x + 4u * directions[table.y + at / 4u][at % 4u];
  var weight = barycentric(record, p);
  for (var walked = 0u; walked < MOST_STEPS; walked++) {
    let least = min(weight.x, min(weight.y, weight.z));
    let edge = select(select(2u, 1u, weight.y == least), 0u, weight.x == least);
    let across = directions[record + 1u][edge];
    if (least >= 0.0 || across == NO_NEIGHBOUR) { break; }
    record = table.x + 4u * across;
    weight = barycentric(record, p);
  }
  weight = max(weight, vec3f(0.0));
  weight = weight / (weight.x + weight.y + weight.z);
  let head = directions[record];
  let rest = bitcast<vec4f>(directions[record + 3u]);
  return Weights(head.xyz, weight, dot(weight, vec3f(rest.z, rest.w, bitcast<f32>(head.w))));
}

// Place in texels of a coordinate in repeats, every other repeat mirrored. Directions are not: at the border between two
// repeats the same texel would then be lit from two sides, and the border would show.
fn texel_place(coordinate: f32, count: u32) -> f32 {
  let repeat = floor(coordinate);
  let odd = (i32(repeat) & 1) == 1;
  let within = select(coordinate - repeat, 1.0 - (coordinate - repeat), odd);
  return clamp(within * f32(count) - 0.5, 0.0, f32(count - 1u));
}

// Picks all axes for light and eye in the local frame and a place in texels; returns the height of the light among the
// measured ones. One loop for all axes, for compilers put every call's text in its place.
fn pick_all(local: vec3f, view: vec3f, place: vec2f) -> f32 {
  var height = local.z;
  pick_nothing();
  for (var axis = 0u; axis < AXES; axis++) {
    var picks: Picks;
    picks.count = 1u;
    picks.index[0] = svbrdf.stands[axis / 4u][axis % 4u];
    picks.weight[0] = Value(1.0);
    let lit = axis == svbrdf.light_table.w;
    if (lit || axis == svbrdf.view_table.w) {
      let found = interpolate_direction(select(svbrdf.view_table, svbrdf.light_table, lit), select(view, local, lit));
      picks.count = 0u;
      for (var k = 0u; k < 3u; k++) {  // beyond the measured directions corners are the same
        var at = 0u;
        while (at < picks.count && picks.index[at] != found.corners[k]) { at += 1u; }
        if (at == picks.count) {
          picks.index[at] = found.corners[k];
          picks.weight[at] = Value(0.0);
          picks.count += 1u;
        }
        picks.weight[at] += Value(found.weight[k]);
      }
      height = select(height, found.height, lit);
    } else if (axis == svbrdf.x_axis || axis == svbrdf.y_axis) {
      let along = select(place.y, place.x, axis == svbrdf.x_axis);
      let count = select(svbrdf.rows, svbrdf.columns, axis == svbrdf.x_axis);
      if ((svbrdf.flags & FLAG_NEAREST) != 0u) {
        picks.index[0] = min(u32(along + 0.5), count - 1u);
      } else {  // bilinear
        let first = min(u32(along), u32(max(i32(count) - 2, 0)));
        picks.count = 2u;
        picks.index[0] = first;
        picks.index[1] = min(first + 1u, count - 1u);
        picks.weight[0] = Value(1.0 - (along - f32(first)));
        picks.weight[1] = Value(along - f32(first));
      }
    } else if (axis == svbrdf.channel_axis) {
      picks.count = 3u;
      for (var c = 0u; c < 3u; c++) {
        picks.index[c] = svbrdf.channels[c];
        picks.weight[c] = as_value(vec3f(f32(c == 0u), f32(c == 1u), f32(c == 2u)));
      }
    }
    pick_axis(axis, picks);
  }
  return height;
}

@compute @workgroup_size(8, 8, 1)
fn shade_svbrdf(@builtin(global_invocation_id) pixel: vec3u) {
  if (pixel.x >= svbrdf.width || pixel.y >= svbrdf.height) { return; }
  let surface = textureLoad(seen_surface, pixel.xy, 0);
  if (surface.w == 0.0) {
    textureStore(radiance_out, pixel.xy, vec4f(0.0));
    return;
  }
  let x = texel_place(surface.x, svbrdf.columns);
  let y = texel_place(surface.y, svbrdf.rows);

  // Local frame in world coordinates.
  let normal = normalize(textureLoad(seen_normal, pixel.xy, 0).xyz);
  let tangent = textureLoad(seen_tangent, pixel.xy, 0);
  let along = normalize(tangent.xyz - dot(tangent.xyz, normal) * normal);
  let down = cross(normal, along) * tangent.w;
  let y_sign = select(1.0, -1.0, (svbrdf.flags & FLAG_Y_UP) != 0u);
  let to_local = transpose(mat3x3f(along, down * y_sign, normal));

  let ndc = vec2f((f32(pixel.x) + 0.5) * 2.0 / f32(svbrdf.width) - 1.0, 1.0 - (f32(pixel.y) + 0.5) * 2.0 / f32(svbrdf.height));
  let ray = normalize(svbrdf.forward.xyz + ndc.x * svbrdf.right.xyz + ndc.y * svbrdf.up.xyz);
  let place = svbrdf.eye.xyz + surface.z * ray;
  let seen_from = to_local * -ray;
  let view = normalize(vec3f(seen_from.xy, max(seen_from.z, LEAST_VIEW)));

  var radiance = vec3f(0.0);
  for (var n = 0u; n < svbrdf.light_count; n++) {
    let light = svbrdf.lights[n];
    var towards = light.place.xyz;
    var strength = light.strength.xyz;
    if (light.place.w != 0.0) {
      let offset = light.place.xyz - place;
      let square = max(dot(offset, offset), 1e-8);
      towards = offset / sqrt(square);
      strength = strength / square;
    }
    let local = to_local * towards;
    if (local.z <= 0.0) { continue; }
    let height = pick_all(local, view, vec2f(x, y));
    var scale = min(1.0, local.z / max(height, 1e-6));
    if ((svbrdf.flags & FLAG_COSINE) != 0u) { scale = local.z; }
    radiance += scale * strength * vec3f(source_values(decode_picked(decoder.levels)));
  }
  textureStore(radiance_out, pixel.xy, vec4f(radiance, 1.0));
}
