// Volume renderer: rays through a box of values, decoded by grid.wgsl. Twin: render/volume.py. Spaces: world (z up, the
// box centred), box (0..1 along x, y, z), voxel (from the first voxel's centre), share (0..1 within the window).

struct VolumeFrame {
  width: u32, height: u32, mode: u32, most_steps: u32,   // MODE_
  eye: vec4f, right: vec4f, up: vec4f, forward: vec4f,
  half: vec3f, step: f32,                                // world
  clip_low: vec3f, iso: f32,                             // box; share
  clip_high: vec3f, unit: f32,                           // world length to which the table's opacity refers
  low: f32, high: f32, ambient: f32, specular: f32,      // values at share 0 and 1
  light: vec4f,                                          // world, unit vector towards it
  background: vec4f,
}
@group(1) @binding(0) var<uniform> volume: VolumeFrame;
@group(1) @binding(1) var<storage, read> transfer: array<vec4f>;  // 256 display colours with opacities, over shares 0..1
@group(1) @binding(2) var decoded: texture_3d<f32>;
@group(1) @binding(3) var radiance_out: texture_storage_2d<rgba32float, write>;

const MODE_EMISSION = 0u;
const MODE_SHADED = 1u;
const MODE_ISO = 2u;
const MODE_MAXIMUM = 3u;
const OPAQUE = 0.995;
const GLOSS = 24.0;
const FADE = 8.0;

// The value at a place in the box, trilinear, as a share of the window.
fn share_at(place: vec3f) -> f32 {
  let size = textureDimensions(decoded);
  let inside = clamp(place * vec3f(size) - 0.5, vec3f(0.0), vec3f(size - 1u));
  let low = vec3u(inside);
  let high = min(low + 1u, size - 1u);
  let t = inside - vec3f(low);
  let a = mix(textureLoad(decoded, low, 0).x, textureLoad(decoded, vec3u(high.x, low.yz), 0).x, t.x);
  let b = mix(textureLoad(decoded, vec3u(low.x, high.y, low.z), 0).x, textureLoad(decoded, vec3u(high.xy, low.z), 0).x, t.x);
  let c = mix(textureLoad(decoded, vec3u(low.xy, high.z), 0).x, textureLoad(decoded, vec3u(high.x, low.y, high.z), 0).x, t.x);
  let d = mix(textureLoad(decoded, vec3u(low.x, high.yz), 0).x, textureLoad(decoded, high, 0).x, t.x);
  return (mix(mix(a, b, t.y), mix(c, d, t.y), t.z) - volume.low) / (volume.high - volume.low);
}

// Gradient in world coordinates by central differences one voxel apart.
fn gradient_at(place: vec3f) -> vec3f {
  let voxel = 1.0 / vec3f(textureDimensions(decoded));
  let x = share_at(place + vec3f(voxel.x, 0.0, 0.0)) - share_at(place - vec3f(voxel.x, 0.0, 0.0));
  let y = share_at(place + vec3f(0.0, voxel.y, 0.0)) - share_at(place - vec3f(0.0, voxel.y, 0.0));
  let z = share_at(place + vec3f(0.0, 0.0, voxel.z)) - share_at(place - vec3f(0.0, 0.0, voxel.z));
  return vec3f(x, y, z) / (4.0 * volume.half * voxel);
}

fn transfer_at(share: f32) -> vec4f {
  let place = clamp(share, 0.0, 1.0) * 255.0;
  let low = u32(place);
  return mix(transfer[low], transfer[min(low + 1u, 255u)], place - f32(low));
}

// A colour lit from `volume.light`, two-sided; flat regions keep their colour.
fn lit(colour: vec3f, gradient: vec3f, ray: vec3f) -> vec3f {
  let steepness = length(gradient);
  if (steepness < 1e-6) { return colour; }
  let normal = gradient / steepness;
  let diffuse = abs(dot(normal, volume.light.xyz));
  let halfway = volume.light.xyz - ray;
  let glance = abs(dot(normal, halfway / max(length(halfway), 1e-6)));
  return colour * (volume.ambient + (1.0 - volume.ambient) * diffuse) + vec3f(volume.specular * pow(glance, GLOSS));
}

// Where a ray is inside the clipped box: distances at which it enters and leaves.
fn box_span(origin: vec3f, ray: vec3f) -> vec2f {
  let low = (2.0 * volume.clip_low - 1.0) * volume.half;
  let high = (2.0 * volume.clip_high - 1.0) * volume.half;
  let safe = select(ray, vec3f(1e-9), abs(ray) < vec3f(1e-9));
  let one = (low - origin) / safe;
  let two = (high - origin) / safe;
  let enter = min(one, two);
  let leave = max(one, two);
  return vec2f(max(max(enter.x, max(enter.y, enter.z)), 0.0), min(leave.x, min(leave.y, leave.z)));
}

fn box_place(origin: vec3f, ray: vec3f, distance: f32) -> vec3f {
  return (origin + distance * ray) / (2.0 * volume.half) + 0.5;
}

// Emission and absorption, front to back: premultiplied colour and opacity.
fn march(origin: vec3f, ray: vec3f, span: vec2f) -> vec4f {
  var sum = vec4f(0.0);
  for (var k = 0u; k < volume.most_steps; k++) {
    let distance = span.x + (f32(k) + 0.5) * volume.step;
    if (distance >= span.y || sum.w > OPAQUE) { break; }
    let place = box_place(origin, ray, distance);
    let found = transfer_at(share_at(place));
    if (found.w <= 0.0) { continue; }
    var colour = found.xyz;
    if (volume.mode == MODE_SHADED) { colour = lit(colour, gradient_at(place), ray); }
    let alpha = 1.0 - pow(1.0 - min(found.w, 0.9999), volume.step / volume.unit);
    sum += (1.0 - sum.w) * alpha * vec4f(colour, 1.0);
  }
  return sum;
}

// The largest share on the ray; what is next to nothing lets the background through.
fn brightest(origin: vec3f, ray: vec3f, span: vec2f) -> vec4f {
  var most = 0.0;
  for (var k = 0u; k < volume.most_steps; k++) {
    let distance = span.x + (f32(k) + 0.5) * volume.step;
    if (distance >= span.y) { break; }
    most = max(most, share_at(box_place(origin, ray, distance)));
  }
  return vec4f(transfer_at(most).xyz, 1.0) * min(FADE * most, 1.0);
}

// The first crossing of the iso value, refined linearly between two steps.
fn surface(origin: vec3f, ray: vec3f, span: vec2f) -> vec4f {
  var before = share_at(box_place(origin, ray, span.x));
  if (before >= volume.iso) { return vec4f(lit(transfer_at(volume.iso).xyz, gradient_at(box_place(origin, ray, span.x)), ray), 1.0); }
  var last = span.x;
  for (var k = 1u; k <= volume.most_steps; k++) {
    let distance = min(span.x + f32(k) * volume.step, span.y);
    let share = share_at(box_place(origin, ray, distance));
    if (share >= volume.iso) {
      let crossing = mix(last, distance, (volume.iso - before) / (share - before));
      let place = box_place(origin, ray, crossing);
      return vec4f(lit(transfer_at(volume.iso).xyz, gradient_at(place), ray), 1.0);
    }
    if (distance >= span.y) { break; }
    before = share;
    last = distance;
  }
  return vec4f(0.0);
}

@compute @workgroup_size(8, 8, 1)
fn shade_volume(@builtin(global_invocation_id) pixel: vec3u) {
  if (pixel.x >= volume.width || pixel.y >= volume.height) { return; }
  let ndc = vec2f((f32(pixel.x) + 0.5) * 2.0 / f32(volume.width) - 1.0, 1.0 - (f32(pixel.y) + 0.5) * 2.0 / f32(volume.height));
  let ray = normalize(volume.forward.xyz + ndc.x * volume.right.xyz + ndc.y * volume.up.xyz);
  let span = box_span(volume.eye.xyz, ray);
  var colour = vec4f(0.0);
  if (span.y > span.x) {
    switch volume.mode {
      case MODE_ISO: { colour = surface(volume.eye.xyz, ray, span); }
      case MODE_MAXIMUM: { colour = brightest(volume.eye.xyz, ray, span); }
      default: { colour = march(volume.eye.xyz, ray, span); }
    }
  }
  textureStore(radiance_out, pixel.xy, colour);
}
