// Light-field renderer: cameras' pictures, decoded by grid.wgsl, averaged with weights and shifted by the disparity in
// focus. Twin: render/lightfield.py. No decoder before it: moving the view point and the focus decodes nothing.

struct LightfieldFrame {
  width: u32, height: u32, cameras: u32, channels: u32,
  rows: u32, columns: u32, scale: f32, unused_0: f32,        // pixels of a camera; of them per pixel of the frame
  offset_y: f32, offset_x: f32, unused_1: f32, unused_2: f32,  // camera pixel at the centre of the frame's first pixel
}
@group(1) @binding(0) var<uniform> lightfield: LightfieldFrame;
@group(1) @binding(1) var<storage, read> cameras: array<vec4f>;  // weight, shift y, shift x, first slice
@group(1) @binding(2) var decoded: texture_3d<f32>;              // slices: camera * channels + channel
@group(1) @binding(3) var radiance_out: texture_storage_2d<rgba32float, write>;

// A slice between its pixels; beyond its border it goes on as it is there.
fn between_pixels(slice: u32, place: vec2f) -> f32 {
  let inside = clamp(place, vec2f(0.0), vec2f(f32(lightfield.columns - 1u), f32(lightfield.rows - 1u)));
  let low = vec2u(inside);
  let high = min(low + 1u, vec2u(lightfield.columns - 1u, lightfield.rows - 1u));
  let share = inside - vec2f(low);
  let top = mix(textureLoad(decoded, vec3u(low, slice), 0).x, textureLoad(decoded, vec3u(high.x, low.y, slice), 0).x, share.x);
  let bottom = mix(textureLoad(decoded, vec3u(low.x, high.y, slice), 0).x, textureLoad(decoded, vec3u(high, slice), 0).x, share.x);
  return mix(top, bottom, share.y);
}

@compute @workgroup_size(8, 8, 1)
fn shade_lightfield(@builtin(global_invocation_id) pixel: vec3u) {
  if (pixel.x >= lightfield.width || pixel.y >= lightfield.height) { return; }
  let place = vec2f(lightfield.offset_x, lightfield.offset_y) + lightfield.scale * vec2f(pixel.xy);
  let size = vec2f(f32(lightfield.columns), f32(lightfield.rows));
  var radiance = vec4f(0.0);
  if (all(place >= vec2f(-0.5)) && all(place <= size - 0.5)) {
    for (var n = 0u; n < lightfield.cameras; n++) {
      let camera = cameras[n];
      let first = u32(camera.w);
      let seen = place + camera.zy;
      var colour = vec3f(between_pixels(first, seen));
      if (lightfield.channels == 3u) {
        colour.y = between_pixels(first + 1u, seen);
        colour.z = between_pixels(first + 2u, seen);
      }
      radiance += vec4f(camera.x * colour, 0.0);
    }
    radiance.w = 1.0;
  }
  textureStore(radiance_out, pixel.xy, radiance);
}
