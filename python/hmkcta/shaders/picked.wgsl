// Weighted sums of elements: for each of `decoded`'s Values, PICKS weighted indices of every source axis.

@group(1) @binding(0) var<storage, read> wanted: array<u32>;   // by sum, axis, pick: the index, then the Value's bits
@group(1) @binding(1) var<storage, read_write> decoded: array<f32>;

fn wanted_weight(at: u32) -> Value {
  var weight = vec3f();
  for (var c = 0u; c < CHANNELS; c++) {
    weight[c] = bitcast<f32>(wanted[at + c]);
  }
  return as_value(weight);
}

@compute @workgroup_size(64)
fn decode_sums(@builtin(global_invocation_id) place: vec3u, @builtin(num_workgroups) groups: vec3u) {
  let number = place.x + place.y * groups.x * 64u;
  if (number * CHANNELS >= arrayLength(&decoded)) {
    return;
  }
  pick_nothing();
  for (var axis = 0u; axis < AXES; axis++) {
    var picks: Picks;
    picks.count = AXIS_PICKS[axis];
    for (var i = 0u; i < picks.count; i++) {
      let at = ((number * AXES + axis) * PICKS + i) * (1u + CHANNELS);
      picks.index[i] = wanted[at];
      picks.weight[i] = wanted_weight(at + 1u);
    }
    pick_axis(axis, picks);
  }
  let value = vec3f(source_values(decode_picked(decoder.levels)));
  for (var c = 0u; c < CHANNELS; c++) {
    decoded[number * CHANNELS + c] = value[c];
  }
}
