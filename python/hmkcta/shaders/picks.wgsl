// Weighted indices of every axis, for interpolation: `decode_picked` sums over all their combinations. Pick k of an axis
// stands at axis * PICKS + k. Where there are three channels, the picks of COLOUR_AXIS are red, green and blue.

var<private> pick_count: array<u32, AXES>;
var<private> pick_index: array<u32, AXES * PICKS>;
var<private> pick_weight: array<f32, AXES * PICKS>;

fn pick(axis: u32, k: u32, index: u32, weight: f32) {
  pick_index[axis * PICKS + k] = index;
  pick_weight[axis * PICKS + k] = weight;
}

// An axis that stands still.
fn pick_one(axis: u32, index: u32) {
  pick_count[axis] = 1u;
  pick(axis, 0u, index, 1.0);
}
