// A slice of any model as a picture: one decoded picture, or three as red, green and blue; pixels stay squares.

struct SliceFrame {
  width: u32, height: u32, channels: u32, values: u32,     // values 1: no colours, of whose differences errors would be
  rows: u32, columns: u32, scale: f32, unused_1: f32,      // pixels of the slice; of them per pixel of the frame
  offset_y: f32, offset_x: f32, low: f32, high: f32,       // slice pixel at the centre of the frame's first one; window
}
@group(1) @binding(0) var<uniform> frame_of_slice: SliceFrame;
@group(1) @binding(1) var<storage, read> colours: array<vec4f>;  // 256 display colours over the window
@group(1) @binding(2) var decoded: texture_3d<f32>;              // slices: channels
@group(1) @binding(3) var radiance_out: texture_storage_2d<rgba32float, write>;

fn share_of(value: f32) -> f32 {
  if (frame_of_slice.values == 1u) { return value; }
  return clamp((value - frame_of_slice.low) / (frame_of_slice.high - frame_of_slice.low), 0.0, 1.0);
}

@compute @workgroup_size(8, 8, 1)
fn shade_slice(@builtin(global_invocation_id) pixel: vec3u) {
  if (pixel.x >= frame_of_slice.width || pixel.y >= frame_of_slice.height) { return; }
  let start = vec2f(frame_of_slice.offset_x, frame_of_slice.offset_y);
  let place = floor(start + frame_of_slice.scale * vec2f(pixel.xy) + 0.5);
  var colour = vec4f(0.0);
  if (place.x >= 0.0 && place.y >= 0.0 && place.x < f32(frame_of_slice.columns) && place.y < f32(frame_of_slice.rows)) {
    let at = vec2u(place);
    let first = share_of(textureLoad(decoded, vec3u(at, 0u), 0).x);
    if (frame_of_slice.channels == 3u) {
      let second = share_of(textureLoad(decoded, vec3u(at, 1u), 0).x);
      colour = vec4f(first, second, share_of(textureLoad(decoded, vec3u(at, 2u), 0).x), 1.0);
    } else if (frame_of_slice.values == 1u) {
      colour = vec4f(vec3f(first), 1.0);
    } else {
      let entry = first * 255.0;
      let low = u32(entry);
      colour = vec4f(mix(colours[low].xyz, colours[min(low + 1u, 255u)].xyz, entry - f32(low)), 1.0);
    }
  }
  textureStore(radiance_out, pixel.xy, colour);
}
