// SVBRDF renderer: one invocation a pixel turns the G-buffer into radiance. Twin: render/svbrdf.py.
// Before it: the weighted decoder with picks 3 for light and view (2 for each of two axes of angles), 2 for y and x, 3 for
// channels; and the constants ANGLES (some directions lie on a grid of angles) and FIXED_LIGHT (those of each light are the
// same at all pixels, and its modes contracted). Spaces: world (z up), local (x along texel columns, z the normal), disk
// (stereographic projection of local directions), texel.

struct Light {
  place: vec4f,     // xyz: unit direction towards it (w = 0), or position (w = 1); world
  strength: vec4f,  // rgb, intensity included; of a fixed light, its height among the measured ones
  corners: vec4u,   // of a fixed light: measured directions around it, or two zeniths and two azimuths
  shares: vec4f,    // their weights
}
struct SvbrdfFrame {
  width: u32, height: u32, light_count: u32, flags: u32,  // FLAG_ bits
  eye: vec4f, right: vec4f, up: vec4f, forward: vec4f,    // world; the ray of ndc is forward + x right + y up
  rows: u32, columns: u32, y_axis: u32, x_axis: u32,      // texels
  channel_axis: u32, set_numbers: u32,  // the latter of the contracted cores of a light
  coded_white: f32, unused_0: u32,      // white of values that are sRGB-coded, 0: they are light
  channels: vec4u,     // index shown as red, green, blue
  stands: array<vec4u, 2>,  // where every axis stands that is not named above
  tables: array<vec4u, 2>,  // views, lights: first record, first grid word group, grid side, axis
  angles: array<vec4u, 4>,  // zeniths and azimuths of views, of lights: first entry, entries (0: none), axis
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
const FLAG_NEAREST_AZIMUTH = 8u;
const MOST_STEPS = 8u;
const LEAST_VIEW = 0.01;
const TURN = 6.283185307179586;
const VIEW = 0u;
const LIGHT = 1u;

// Weights of a triangle's corners at p in the disk.
fn barycentric(record: u32, p: vec2f) -> vec3f {
  let first = bitcast<vec4f>(directions[record + 2u]);
  let rest = bitcast<vec4f>(directions[record + 3u]);
  let w0 = first.x * p.x + first.y * p.y + first.z;
  let w1 = first.w * p.x + rest.x * p.y + rest.y;
  return vec3f(w0, w1, 1.0 - w0 - w1);
}

// Picks the measured directions around a local one: from its grid cell's triangle across edges to its own. Returns the
// height that they interpolate.
fn pick_directions(which: u32, direction: vec3f) -> f32 {
  let table = svbrdf.tables[which];
  if (ANGLES && svbrdf.angles[2u * which].y != 0u) {
    return pick_angles(which, direction);
  }
  if (table.w == NO_AXIS) {
    return direction.z;
  }
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
  pick_count[table.w] = 3u;
  for (var k = 0u; k < 3u; k++) {
    pick(table.w, k, head[k], weight[k]);
  }
  return dot(weight, vec3f(rest.z, rest.w, bitcast<f32>(head.w)));
}

// The same on a product grid: two zeniths and two azimuths.
fn pick_angles(which: u32, direction: vec3f) -> f32 {
  var height = 0.0;
  for (var part = 0u; part < 2u; part++) {
    let list = svbrdf.angles[2u * which + part];
    var angle = atan2(length(direction.xy), direction.z);
    if (part == 1u) {
      angle = atan2(direction.y, direction.x);
      angle = select(angle, angle + TURN, angle < 0.0);
    }
    var low = list.x;
    var high = list.x + list.y - 1u;
    while (high - low > 1u) {
      let middle = (low + high) / 2u;
      if (bitcast<f32>(directions[middle].x) <= angle) { low = middle; } else { high = middle; }
    }
    let first = bitcast<f32>(directions[low].x);
    let gap = max(bitcast<f32>(directions[high].x) - first, 1e-6);
    let share = clamp((angle - first) / gap, 0.0, 1.0);
    pick_count[list.z] = 2u;
    pick(list.z, 0u, directions[low].y, 1.0 - share);
    pick(list.z, 1u, directions[high].y, share);
    if (part == 0u) {
      height = cos(clamp(angle, bitcast<f32>(directions[list.x].x), bitcast<f32>(directions[list.x + list.y - 1u].x)));
    } else if ((svbrdf.flags & FLAG_NEAREST_AZIMUTH) != 0u) {
      pick_one(list.z, select(directions[low].y, directions[high].y, share >= 0.5));
    }
  }
  return height;
}

// Picks the directions of a light that the host has found, the same for all pixels.
fn pick_fixed(number: u32) {
  let light = svbrdf.lights[number];
  let grid = svbrdf.angles[2u * LIGHT].y != 0u;
  for (var k = 0u; k < select(3u, 4u, grid); k++) {
    let axis = select(svbrdf.tables[LIGHT].w, svbrdf.angles[2u * LIGHT + k / 2u].z, grid);
    pick_count[axis] = select(3u, 2u, grid);
    pick(axis, select(k, k % 2u, grid), light.corners[k], light.shares[k]);
  }
}

// Light of sRGB-coded values.
fn as_light(values: vec3f) -> vec3f {
  if (svbrdf.coded_white == 0.0) { return values; }
  let share = max(values / svbrdf.coded_white, vec3f(0.0));
  let curve = pow((share + 0.055) / 1.055, vec3f(2.4));
  return select(curve, share / 12.92, share <= vec3f(0.04045)) * svbrdf.coded_white;
}

// Place in texels of a coordinate in repeats, every other repeat mirrored. Directions are not: at the border between two
// repeats the same texel would then be lit from two sides, and the border would show.
fn texel_place(coordinate: f32, count: u32) -> f32 {
  let repeat = floor(coordinate);
  let odd = (i32(repeat) & 1) == 1;
  let within = select(coordinate - repeat, 1.0 - (coordinate - repeat), odd);
  return clamp(within * f32(count) - 0.5, 0.0, f32(count - 1u));
}

// Picks all axes but those of directions, for a place in texels.
fn pick_others(place: vec2f) {
  for (var axis = 0u; axis < AXES; axis++) {
    pick_one(axis, svbrdf.stands[axis / 4u][axis % 4u]);
    if (axis == svbrdf.x_axis || axis == svbrdf.y_axis) {
      let along = select(place.y, place.x, axis == svbrdf.x_axis);
      let count = select(svbrdf.rows, svbrdf.columns, axis == svbrdf.x_axis);
      if ((svbrdf.flags & FLAG_NEAREST) != 0u) {
        pick_one(axis, min(u32(along + 0.5), count - 1u));
      } else {  // bilinear
        let first = min(u32(along), u32(max(i32(count) - 2, 0)));
        pick_count[axis] = 2u;
        pick(axis, 0u, first, 1.0 - (along - f32(first)));
        pick(axis, 1u, min(first + 1u, count - 1u), along - f32(first));
      }
    } else if (axis == svbrdf.channel_axis) {
      pick_count[axis] = 3u;
      for (var c = 0u; c < 3u; c++) {
        pick(axis, c, svbrdf.channels[c], 1.0);
      }
    }
  }
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

  pick_others(vec2f(x, y));
  var radiance = vec3f(0.0);
  for (var n = 0u; n <= svbrdf.light_count; n++) {  // the eye, then the lights: compilers put the text of a call in its place
    var local = view;
    var strength = vec3f(0.0);
    if (n > 0u) {
      let light = svbrdf.lights[n - 1u];
      var towards = light.place.xyz;
      strength = light.strength.xyz;
      if (light.place.w != 0.0) {
        let offset = light.place.xyz - place;
        let square = max(dot(offset, offset), 1e-8);
        towards = offset / sqrt(square);
        strength = strength / square;
      }
      local = to_local * towards;
      if (local.z <= 0.0) { continue; }
    }
    var height = 0.0;
    if (FIXED_LIGHT && n > 0u) {
      height = svbrdf.lights[n - 1u].strength.w;
      pick_fixed(n - 1u);
      frame_first = (n - 1u) * svbrdf.set_numbers;
    } else {
      height = pick_directions(min(n, LIGHT), local);
    }
    if (n == 0u) { continue; }
    var scale = min(1.0, local.z / max(height, 1e-6));
    if ((svbrdf.flags & FLAG_COSINE) != 0u) { scale = local.z; }
    radiance += scale * strength * as_light(vec3f(source_values(decode_picked(decoder.stages))));
  }
  textureStore(radiance_out, pixel.xy, vec4f(radiance, 1.0));
}
