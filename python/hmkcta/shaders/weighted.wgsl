// A weighted sum of elements, for interpolation: each mode has several weighted rows, and the sum goes over all their
// combinations. Rows that lie in one node and one cluster are added up before the core, so that most of the work is
// done once and not once a combination.
//
// The nodes that the combinations lie in form a tree. It is walked depth first; at every depth there is a mask a mode of
// the rows inside the node, and the node's children are the combinations of the parts these rows go to.

const OPEN = STAGES * ORDER;

var<private> row_weight: array<f32, ROWS>;
var<private> row_colour: array<Value, COLOUR_ROWS>;  // instead of `row_weight` in the mode with the colours
var<private> row_count: array<u32, ORDER>;
var<private> row_at: array<u32, STAGES * ROWS>;  // by depth: the row's place in the node's list
var<private> row_cluster: array<u32, ROWS>;      // the row's first cluster that is not below the cell's; LEAF: none
var<private> row_subset: array<u32, ROWS>;       // which of its subsets that is
var<private> inside: array<u32, OPEN>;           // by depth: rows of mode n inside the node
var<private> waiting: array<u32, OPEN>;          // by depth: those of them in parts that no child was entered for yet
var<private> node_at: array<u32, STAGES>;

// The rows of every mode, which are the combinations of its axes' picks, and their weights.
fn gather_rows() {
  row_colour[0] = Value(1.0);
  for (var n = 0u; n < ORDER; n++) {
    row_count[n] = 1u;
    row_at[ROW_FIRST[n]] = 0u;
    row_weight[ROW_FIRST[n]] = 1.0;
  }
  for (var axis = 0u; axis < AXES; axis++) {
    let n = AXIS_MODE[axis];
    let first = ROW_FIRST[n];
    let before = row_count[n];
    for (var left = pick_count[axis]; left > 0u; left--) {
      let j = left - 1u;  // the first index last, for it takes the place of the rows so far
      let offset = pick_index[axis * PICKS + j] * AXIS_STRIDE[axis];
      let weight = pick_weight[axis * PICKS + j];
      for (var i = 0u; i < before; i++) {
        row_at[first + j * before + i] = row_at[first + i] + offset;
        if (n != COLOUR) {
          row_weight[first + j * before + i] = row_weight[first + i] * weight;
        } else {
          row_colour[j * before + i] = row_colour[i] * select(Value(weight), channel(j), axis == COLOUR_AXIS);
        }
      }
    }
    row_count[n] = before * pick_count[axis];
  }
}

// The weighted sum, in the domain of the value transform.
fn decode_picked(stages: u32) -> Value {
  var sum = Value(0.0);
  gather_rows();
  for (var n = 0u; n < ORDER; n++) {
    if (row_count[n] == 0u) {
      return sum;
    }
    inside[n] = (2u << (row_count[n] - 1u)) - 1u;  // as many ones; 32 of them too
  }
  node_at[0] = 0u;
  var depth = 0u;
  var entered = true;
  loop {
    if (entered) {
      sum += visit(depth, stages);
    }
    entered = node_at[depth] != LEAF && enter_next_child(depth, entered);
    if (entered) {
      depth += 1u;
    } else if (depth == 0u) {
      break;
    } else {
      depth -= 1u;
    }
  }
  return sum;
}

// What the node at this depth adds; its rows wait for its children, if it has any.
fn visit(depth: u32, stages: u32) -> Value {
  let node = node_at[depth];
  var sum = Value(0.0);
  let full = open_node(node);
  if (full && !is_cut()) {
    sum = picked_node(node, depth);
  }
  if (!full || word(node) == LEAF || depth + 1u >= stages) {
    node_at[depth] = LEAF;
  }
  return sum;
}

// Goes on to the first combination of parts, or to the next, the last mode fastest; false: all have been entered.
fn enter_next_child(depth: u32, first: bool) -> bool {
  var n = 0u;
  if (!first) {
    n = ORDER - 1u;
    while (n > 0u && waiting[depth * ORDER + n] == 0u) {
      n -= 1u;
    }
    if (waiting[depth * ORDER + n] == 0u) {
      return false;
    }
  }
  var part = 0u;  // flat(part_1 .. part_N)
  for (var m = 0u; m < ORDER; m++) {
    if (first || m > n) {
      waiting[depth * ORDER + m] = inside[depth * ORDER + m];
    }
    let clusters = word(node_at[depth] + 3u + 5u * m);
    if (m >= n) {
      enter_part(depth, m, clusters);
    }
    part = part * clusters;
    if (!whole(m) && clusters > 1u) {
      part += word(row_record(node_at[depth], m, row_at[depth * ROWS + first_row(m, inside[(depth + 1u) * ORDER + m])]));
    }
  }
  node_at[depth + 1u] = word(node_at[depth]) + part * NODE_WORDS;
  return true;
}

// Takes the waiting rows of mode n that go to the same of `clusters` parts as the first of them down to the next depth.
fn enter_part(depth: u32, n: u32, clusters: u32) {
  let here = depth * ROWS;
  let left = waiting[depth * ORDER + n];
  var group = 0u;
  if (whole(n) || clusters == 1u) {
    group = left;
    for (var rows = left; rows != 0u; rows &= rows - 1u) {
      let i = first_row(n, rows);
      row_at[here + ROWS + i] = row_at[here + i];
    }
  } else {
    let part = word(row_record(node_at[depth], n, row_at[here + first_row(n, left)]));
    for (var rows = left; rows != 0u; rows &= rows - 1u) {
      let i = first_row(n, rows);
      let record = row_record(node_at[depth], n, row_at[here + i]);
      if (word(record) == part) {
        group |= 1u << (i - ROW_FIRST[n]);
        row_at[here + ROWS + i] = word(record + 1u);
      }
    }
  }
  waiting[depth * ORDER + n] = left & ~group;
  inside[(depth + 1u) * ORDER + n] = group;
}

// The first row of a mask of mode n.
fn first_row(n: u32, mask: u32) -> u32 {
  return ROW_FIRST[n] + firstTrailingBit(mask);
}

// The cluster subsets, numbered up to 31, that a row of the node at hand is a member of, as bits.
fn subset_bits(n: u32, row: u32) -> u32 {
  if (undecomposed(n)) {
    return 1u;
  }
  let subsets = node_rows[n] + row * (2u + node_mixture[n]) + 2u;
  var bits = 0u;
  for (var k = 0u; k < node_mixture[n]; k++) {
    bits |= 1u << word(subsets + k);
  }
  return bits;
}

// What the node at hand adds, whatever its ranks: the sum over the clusters that any row inside is a member of.
fn picked_value(node: u32, depth: u32) -> Value {
  for (var n = 0u; n < ORDER; n++) {
    cell_cluster[n] = next_cluster(depth, n, 0u);
  }
  var sum = Value(0.0);
  var more = true;
  while (more) {
    open_cell(node);
    for (var n = 0u; n < ORDER; n++) {
      weigh_rows(depth, n);
    }
    sum += cell_scale * contract_core(depth);
    more = false;
    for (var left = ORDER; left > 0u && !more; left--) {
      let n = left - 1u;
      cell_cluster[n] = next_cluster(depth, n, cell_cluster[n] + 1u);
      more = cell_cluster[n] != LEAF;
      if (!more) {
        cell_cluster[n] = next_cluster(depth, n, 0u);
      }
    }
  }
  return sum;
}

// Goes to the lowest cluster subset of mode n, not below `least`, that a row inside the node is a member of, and notes
// the first such subset of each row. LEAF: there is none.
fn next_cluster(depth: u32, n: u32, least: u32) -> u32 {
  if (undecomposed(n)) {
    return select(LEAF, 0u, least == 0u);
  }
  var lowest = LEAF;
  for (var rows = inside[depth * ORDER + n]; rows != 0u; rows &= rows - 1u) {
    let i = first_row(n, rows);
    let subsets = node_rows[n] + row_at[depth * ROWS + i] * (2u + node_mixture[n]) + 2u;
    var k = 0u;  // subsets of a row ascend
    while (k < node_mixture[n] && word(subsets + k) < least) {
      k += 1u;
    }
    row_subset[i] = k;
    row_cluster[i] = LEAF;
    if (k < node_mixture[n]) {
      row_cluster[i] = word(subsets + k);
      lowest = min(lowest, row_cluster[i]);
    }
  }
  return lowest;
}

// The basis rows of mode n in the cell at hand, weighted and added up, go to `cell_weight`.
fn weigh_rows(depth: u32, n: u32) {
  cell_count[n] = 0u;
  if (contracted(n)) {
    return;
  }
  if (undecomposed(n)) {
    for (var rows = inside[depth * ORDER + n]; rows != 0u; rows &= rows - 1u) {
      let i = first_row(n, rows);
      set_weight(n, cell_count[n], 0.0);
      add_weight(n, cell_count[n], i, 1.0);
      cell_index[WEIGHT_FIRST[n] + cell_count[n]] = row_at[depth * ROWS + i];
      cell_count[n] += 1u;
    }
    return;
  }
  cell_count[n] = node_rank[n];
  for (var r = 0u; r < node_rank[n]; r++) {
    set_weight(n, r, 0.0);
    keep_index(n, r);
  }
  for (var rows = inside[depth * ORDER + n]; rows != 0u; rows &= rows - 1u) {
    let i = first_row(n, rows);
    if (row_cluster[i] == cell_cluster[n]) {
      let basis = basis_row(n, row_at[depth * ROWS + i], row_subset[i]);
      for (var r = 0u; r < node_rank[n]; r++) {
        add_weight(n, r, i, coefficient(basis + r));
      }
    }
  }
}

// Adds a number times the weight of row i to a weight of mode n in the cell at hand.
fn add_weight(n: u32, e: u32, i: u32, number: f32) {
  if (n == COLOUR) {
    cell_colour[e] += row_colour[i - ROW_FIRST[n]] * number;
  } else {
    cell_weight[WEIGHT_FIRST[n] + e] += row_weight[i] * number;
  }
}
