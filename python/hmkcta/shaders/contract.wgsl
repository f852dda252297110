// Frame contraction: the modes that stand still for a frame are summed into the cores once, so that each element needs
// only the rest. `FOLDED` has a bit for each such mode; LANES invocations share the work of a cell. There can be several
// sets of cores, one for each light, say, and FOLD_CHANNELS of a number: 3 where the colours' mode is folded.

@group(1) @binding(0) var<storage, read> fixed_rows: array<u32>;       // by set, channel and mode: count, rows, bits of weights
@group(1) @binding(1) var<storage, read> parents: array<u32>;          // by node: parent, number among its children
@group(1) @binding(2) var<storage, read_write> contracted_cores: array<u32>;  // by node: start of its cores; the cores

const MODE_ROWS = 32u;                     // the most rows of a mode
const FIXED_WORDS = 1u + 2u * MODE_ROWS;   // of a mode in `fixed_rows`

var<private> fold_rows: u32;                       // where the modes of the set and channel at hand begin in `fixed_rows`
var<private> fold_first: array<u32, ORDER>;        // where a mode begins in the two arrays below
var<private> fold_count: array<u32, ORDER>;
var<private> fold_weight: array<f32, FOLD_SUM>;
var<private> fold_index: array<u32, FOLD_SUM>;     // core index of each weight
var<private> ancestry: array<u32, STAGES>;         // the node, its parent, .., the root
var<private> generations: u32;

fn folded(n: u32) -> bool {
  return ((FOLDED >> n) & 1u) == 1u;
}

@compute @workgroup_size(64)
fn contract_frame(@builtin(global_invocation_id) place: vec3u, @builtin(num_workgroups) groups: vec3u) {
  let number = place.x + place.y * groups.x * 64u;
  if (number / LANES >= CELLS) {
    return;
  }
  let node = node_of_cell(SCALES + number / LANES);
  if (!open_node(node)) {
    return;
  }
  fold_rows = place.z * ORDER * FIXED_WORDS;
  find_ancestry(node);
  let cell = SCALES + number / LANES - word(node + 2u);
  var left = cell;
  for (var m = ORDER; m > 0u; m--) {
    cell_cluster[m - 1u] = left % node_clusters[m - 1u];
    left = left / node_clusters[m - 1u];
  }
  open_cell(node);
  var numbers = 1u;  // of the contracted core
  var terms = 1u;
  var first = 0u;
  for (var n = 0u; n < ORDER; n++) {
    fold_first[n] = first;
    fold_count[n] = 1u;
    if (folded(n)) {
      weigh_mode(n);
      first += fold_count[n];
      terms *= fold_count[n];
    } else {
      numbers *= node_rank[n];
    }
  }
  let set_first = (place.z / FOLD_CHANNELS) * SET_NUMBERS;
  let target_cell = set_first + contracted_cores[node / NODE_WORDS] + cell * numbers;
  for (var at = number % LANES; at < numbers; at += LANES) {
    contracted_cores[FOLD_CHANNELS * (target_cell + at) + place.z % FOLD_CHANNELS] = bitcast<u32>(contracted_number(at, terms));
  }
}

// One number of the contracted core: the sum over all combinations of the folded modes' weights.
fn contracted_number(at: u32, terms: u32) -> f32 {
  var rest = at;
  var base = cell_core;
  for (var m = ORDER; m > 0u; m--) {
    if (!folded(m - 1u)) {
      base += (rest % node_rank[m - 1u]) * node_stride[m - 1u];
      rest = rest / node_rank[m - 1u];
    }
  }
  var sum = 0.0;
  for (var term = 0u; term < terms; term++) {
    var weight = 1.0;
    var from_base = base;
    var digits = term;
    for (var n = 0u; n < ORDER; n++) {
      if (folded(n)) {
        let entry = fold_first[n] + digits % fold_count[n];
        digits = digits / fold_count[n];
        weight *= fold_weight[entry];
        from_base += fold_index[entry] * node_stride[n];
      }
    }
    sum += weight * coefficient(from_base);
  }
  return sum;
}

// The weights of a folded mode in the cell at hand: basis rows of its fixed rows added up, or the rows themselves.
fn weigh_mode(n: u32) {
  let first = fold_first[n];
  let mode = fold_rows + n * FIXED_WORDS;
  let rows = fixed_rows[mode];
  fold_count[n] = select(node_rank[n], rows, undecomposed(n));
  for (var r = 0u; r < fold_count[n]; r++) {
    fold_weight[first + r] = 0.0;
    fold_index[first + r] = r;
  }
  for (var i = 0u; i < rows; i++) {
    let row = fixed_rows[mode + 1u + i];
    let weight = bitcast<f32>(fixed_rows[mode + 1u + MODE_ROWS + i]);
    var position = row;
    if (!whole(n)) {
      position = place_in_node(n, row);
    }
    if (undecomposed(n)) {
      fold_weight[first + i] = select(weight, 0.0, position == LEAF);
      fold_index[first + i] = select(position, 0u, position == LEAF);
      continue;
    }
    if (position == LEAF) {
      continue;
    }
    for (var k = 0u; k < node_mixture[n]; k++) {
      if (word(node_rows[n] + position * (2u + node_mixture[n]) + 2u + k) == cell_cluster[n]) {
        let basis = basis_row(n, position, k);
        for (var r = 0u; r < node_rank[n]; r++) {
          fold_weight[first + r] += weight * coefficient(basis + r);
        }
      }
    }
  }
}

// The node that owns a cell, by the address of the cell's scale: scales lie in the order of the nodes.
fn node_of_cell(scale: u32) -> u32 {
  var low = 0u;
  var high = NODES;
  while (high - low > 1u) {
    let middle = (low + high) / 2u;
    if (word(middle * NODE_WORDS + 2u) <= scale) {
      low = middle;
    } else {
      high = middle;
    }
  }
  return low * NODE_WORDS;
}

fn find_ancestry(node: u32) {
  generations = 1u;
  ancestry[0] = node;
  while (ancestry[generations - 1u] != 0u) {
    ancestry[generations] = parents[2u * (ancestry[generations - 1u] / NODE_WORDS)];
    generations += 1u;
  }
}

// Where a row of the whole mode lies in the list of the node at hand; LEAF: it went to another part on the way.
fn place_in_node(n: u32, row: u32) -> u32 {
  var position = row;
  for (var up = generations - 1u; up > 0u; up--) {
    let parent = ancestry[up];
    var part = parents[2u * (ancestry[up - 1u] / NODE_WORDS) + 1u];
    for (var m = ORDER - 1u; m > n; m--) {
      part = part / word(parent + 3u + 5u * m);
    }
    let clusters = word(parent + 3u + 5u * n);
    if (clusters == 1u) {
      continue;
    }
    part = part % clusters;
    let record = row_record(parent, n, position);
    if (word(record) != part) {
      return LEAF;
    }
    position = word(record + 1u);
  }
  return position;
}
