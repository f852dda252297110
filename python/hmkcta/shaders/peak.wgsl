// How many multiply-adds an adapter does at most: independent chains in registers, nothing read.

@group(0) @binding(0) var<storage, read_write> results: array<vec4f>;

const TURNS = 256u;

@compute @workgroup_size(64)
fn multiply_add(@builtin(global_invocation_id) place: vec3u, @builtin(num_workgroups) groups: vec3u) {
  let seed = f32(place.x) * 1e-9;
  var a = vec4f(seed, seed + 0.1, seed + 0.2, seed + 0.3);
  var b = a + 0.5;
  var c = a + 0.6;
  var d = a + 0.7;
  for (var turn = 0u; turn < TURNS; turn++) {
    a = fma(a, vec4f(0.999), vec4f(seed));
    b = fma(b, vec4f(0.998), vec4f(seed));
    c = fma(c, vec4f(0.997), vec4f(seed));
    d = fma(d, vec4f(0.996), vec4f(seed));
  }
  results[place.y * 64u * groups.x + place.x] = a + b + c + d;
}
