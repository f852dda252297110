// Weighted sums of elements: for each of `decoded`'s Values, PICKS weighted indices of every source axis.

@group(1) @binding(0) var<storage, read> wanted: array<u32>;   // by sum, axis, pick: the index, the weight's bits
@group(1) @binding(1) var<storage, read_write> decoded: array<f32>;

@compute @workgroup_size(64)
fn decode_sums(@builtin(global_invocation_id) place: vec3u, @builtin(num_workgroups) groups: vec3u) {
  let number = place.x + place.y * groups.x * 64u;
  if (number * CHANNELS >= arrayLength(&decoded)) {
    return;
  }
  for (var axis = 0u; axis < AXES; axis++) {
    pick_count[axis] = AXIS_PICKS[axis];
    for (var k = 0u; k < AXIS_PICKS[axis]; k++) {
      let at = ((number * AXES + axis) * PICKS + k) * 2u;
      pick(axis, k, wanted[at], bitcast<f32>(wanted[at + 1u]));
    }
  }
  let value = vec3f(source_values(decode_picked(decoder.stages)));
  for (var c = 0u; c < CHANNELS; c++) {
    decoded[number * CHANNELS + c] = value[c];
  }
}
