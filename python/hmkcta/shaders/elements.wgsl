// Scattered elements: one invocation decodes the elements of one entry of `wanted`, each a list of axis indices.

@group(1) @binding(0) var<storage, read> wanted: array<u32>;
@group(1) @binding(1) var<storage, read_write> decoded: array<f32>;

@compute @workgroup_size(64)
fn decode_elements(@builtin(global_invocation_id) place: vec3u, @builtin(num_workgroups) groups: vec3u) {
  let number = place.x + place.y * groups.x * 64u;
  if (number >= arrayLength(&decoded)) {
    return;
  }
  var index: array<u32, AXES>;
  for (var axis = 0u; axis < AXES; axis++) {
    index[axis] = wanted[number * AXES + axis];
  }
  decoded[number] = decode_element(index, decoder.stages);
}
