// From radiance to display: exposure, a curve, sRGB, the background; side by side with, or minus, a second picture.
// Twin: render/tonemap.py and render/display.py.

struct DisplayFrame {
  width: u32, height: u32, mode: u32, flags: u32,        // MODE_, FLAG_
  exposure: f32, split: f32, gain: f32, curve: u32,      // split in pixels
  background: vec4f,                                     // display colour
}
@group(1) @binding(0) var<uniform> display: DisplayFrame;
@group(1) @binding(1) var picture_a: texture_2d<f32>;
@group(1) @binding(2) var picture_b: texture_2d<f32>;
@group(1) @binding(3) var<storage, read> heat: array<vec4f>;  // 256 colours of errors 0..1
@group(1) @binding(4) var display_out: texture_storage_2d<rgba8unorm, write>;

const MODE_SPLIT = 1u;
const MODE_HEAT = 2u;
const FLAG_SRGB = 1u;
const FLAG_PREMULTIPLIED = 2u;
const CURVE_REINHARD = 1u;
const CURVE_FILMIC = 2u;

fn curved(light: vec3f) -> vec3f {
  if (display.curve == CURVE_REINHARD) {
    let x = 4.0 * min(light, vec3f(1e30));
    return x / (1.0 + x);
  }
  if (display.curve == CURVE_FILMIC) {
    let x = min(light, vec3f(1e15));
    return x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14);
  }
  return light;
}

fn encoded(light: vec3f) -> vec3f {
  let curve = 1.055 * pow(max(light, vec3f(1e-8)), vec3f(1.0 / 2.4)) - 0.055;
  return select(curve, 12.92 * light, light <= vec3f(0.0031308));
}

fn shown(radiance: vec4f) -> vec3f {
  var light = clamp(curved(max(radiance.xyz * display.exposure, vec3f(0.0))), vec3f(0.0), vec3f(1.0));
  if ((display.flags & FLAG_SRGB) != 0u) { light = encoded(light); }
  if ((display.flags & FLAG_PREMULTIPLIED) == 0u) { light = light * radiance.w; }
  return light + (1.0 - radiance.w) * display.background.xyz;
}

@compute @workgroup_size(8, 8, 1)
fn show(@builtin(global_invocation_id) pixel: vec3u) {
  if (pixel.x >= display.width || pixel.y >= display.height) { return; }
  let a = textureLoad(picture_a, pixel.xy, 0);
  let b = textureLoad(picture_b, pixel.xy, 0);
  var colour = shown(a);
  if (display.mode == MODE_SPLIT) {
    let centre = f32(pixel.x) + 0.5;
    colour = select(shown(b), colour, centre < display.split);
    if (abs(centre - display.split) < 1.0) { colour = vec3f(1.0); }
  }
  if (display.mode == MODE_HEAT) {
    let error = abs(a.xyz - b.xyz) * display.exposure * display.gain;
    let share = clamp(max(error.x, max(error.y, error.z)), 0.0, 1.0);
    colour = mix(display.background.xyz, heat[u32(share * 255.0 + 0.5)].xyz, select(0.0, 1.0, max(a.w, b.w) > 0.0));
  }
  textureStore(display_out, pixel.xy, vec4f(colour, 1.0));
}
