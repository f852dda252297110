// A box of elements as a 3D texture, at a time that may lie between two frames: what a light field or a volume shows for
// as long as its time and level stay. Before it: the weighted decoder with picks 2 for time, 1 for all else.

struct GridFrame {
  width: u32, height: u32, depth: u32, first: u32,          // elements; the first slice of this dispatch
  x_axis: u32, y_axis: u32, time_axis: u32, unused: u32,    // 0xff: none
  x_first: u32, y_first: u32, x_step: u32, y_step: u32,     // which elements: each step-th from the first on
  time: vec4u,                                              // the two frames
  time_weight: vec4f,
}
@group(1) @binding(0) var<uniform> grid: GridFrame;
@group(1) @binding(1) var<storage, read> slots: array<vec4u>;  // two a slice: the index of every axis there
@group(1) @binding(2) var grid_out: texture_storage_3d<r32float, write>;

@compute @workgroup_size(8, 8, 1)
fn decode_grid(@builtin(global_invocation_id) id: vec3u) {
  let at = vec3u(id.xy, id.z + grid.first);
  if (at.x >= grid.width || at.y >= grid.height || at.z >= grid.depth) { return; }
  for (var axis = 0u; axis < AXES; axis++) {
    if (axis == grid.x_axis) {
      pick_one(axis, grid.x_first + at.x * grid.x_step);
    } else if (axis == grid.y_axis) {
      pick_one(axis, grid.y_first + at.y * grid.y_step);
    } else if (axis != grid.time_axis) {
      pick_one(axis, slots[2u * at.z + axis / 4u][axis % 4u]);
    }
  }
  if (grid.time_axis < AXES) {
    pick_count[grid.time_axis] = select(2u, 1u, grid.time_weight.y == 0.0);
    for (var k = 0u; k < pick_count[grid.time_axis]; k++) {
      pick(grid.time_axis, k, grid.time[k], grid.time_weight[k]);
    }
  }
  textureStore(grid_out, at, vec4f(f32(source_values(decode_picked(decoder.stages)))));
}
