// The image: all tables and float16 coefficients of a model in one flat array of words (docs/rendering.md).
// A node is named by the address of its record, the root's being 0; rows are counted in the node's own list.

struct Decoder {
  stages: u32,  // how many stages of the tree to walk down
  scale: f32,   // of the value transform, in source values
  limit: f32,   // decoded numbers above it would leave float32 as source values
}
@group(0) @binding(0) var<uniform> decoder: Decoder;

const LEAF = 0xffffffffu;

// The node at hand, mode by mode; an undecomposed mode has K = 0, a cut K = R = 0 in all modes.
var<private> node_clusters: array<u32, ORDER>;  // C_n
var<private> node_mixture: array<u32, ORDER>;   // K_n
var<private> node_rank: array<u32, ORDER>;      // R_n
var<private> node_stride: array<u32, ORDER>;    // of mode n in a core
var<private> node_numbers: u32;                 // of a core
var<private> node_others: array<u32, ORDER>;    // PC_-n, the combinations of the other modes' subsets
var<private> node_rows: array<u32, ORDER>;      // address of the row records
var<private> node_basis: array<u32, ORDER>;     // half address of the basis

// The cell at hand: the cluster c = (c_1..c_N) of the paper's equation 2.
var<private> cell_cluster: array<u32, ORDER>;    // c_n
var<private> cell_others: array<u32, ORDER>;     // flat(c_-n)
var<private> cell_core: u32;                     // address of its core
var<private> cell_scale: f32;

// The cell's weights of every mode: a basis row, or one for each row of an undecomposed mode.
// Those of mode n begin at WEIGHT_FIRST[n].
var<private> cell_count: array<u32, ORDER>;      // how many
var<private> cell_index: array<u32, RANK_SUM>;   // core index of each number of a mode that is undecomposed somewhere
var<private> cell_weight: array<f32, RANK_SUM>;
var<private> cell_colour: array<Value, COLOUR_RANKS>;  // instead of `cell_weight` in the mode with the colours

// A float16 number by its half address.
fn coefficient(at: u32) -> f32 {
  return unpack2x16float(word(at >> 1u))[at & 1u];
}

// Whether mode n is undecomposed in the node at hand: in all nodes, or by its record.
fn undecomposed(n: u32) -> bool {
  return ((UNDECOMPOSED >> n) & 1u) == 1u || (mixed(n) && node_mixture[n] == 0u);
}

// Whether mode n is undecomposed in some nodes and decomposed in others.
fn mixed(n: u32) -> bool {
  return ((MIXED >> n) & 1u) == 1u;
}

// Whether rows of mode n keep their places all the way down the tree.
fn whole(n: u32) -> bool {
  return ((WHOLE >> n) & 1u) == 1u;
}

// Whether the node at hand adds nothing, but has children.
fn is_cut() -> bool {
  return CUTS && node_rank[0] == 0u;
}

fn contracted(n: u32) -> bool {
  return ((CONTRACTED >> n) & 1u) == 1u;
}

// Address of the record of a row: [part, local, cluster_0 .. cluster_{K-1}]. There is none where C = 1 and K = 0.
fn row_record(node: u32, n: u32, row: u32) -> u32 {
  let mode = node + 3u + 5u * n;
  return word(mode + 3u) + row * (2u + word(mode + 1u));
}

// Makes a node the one at hand; false: it has shape zero and adds nothing.
fn open_node(node: u32) -> bool {
  if (word(node + 3u) == 0u) {
    return false;
  }
  var cells = 1u;
  var stride = 1u;
  for (var left = ORDER; left > 0u; left--) {
    let n = left - 1u;
    let mode = node + 3u + 5u * n;
    node_clusters[n] = word(mode);
    node_mixture[n] = word(mode + 1u);
    node_rank[n] = word(mode + 2u);
    node_rows[n] = word(mode + 3u);
    node_basis[n] = word(mode + 4u);
    node_stride[n] = stride;
    cells *= node_clusters[n];
    stride *= select(node_rank[n], 1u, contracted(n));
  }
  node_numbers = stride;
  for (var n = 0u; n < ORDER; n++) {
    node_others[n] = cells / node_clusters[n];
  }
  return true;
}

// Makes the cell with the clusters in `cell_cluster` the one at hand.
fn open_cell(node: u32) {
  var before: array<u32, ORDER>;  // flat(c_1 .. c_{n-1})
  var cell = 0u;
  for (var n = 0u; n < ORDER; n++) {
    before[n] = cell;
    cell = cell * node_clusters[n] + cell_cluster[n];
  }
  var after = 1u;
  var tail = 0u;  // flat(c_{n+1} .. c_N)
  for (var left = ORDER; left > 0u; left--) {
    let n = left - 1u;
    cell_others[n] = before[n] * after + tail;
    tail += cell_cluster[n] * after;
    after *= node_clusters[n];
  }
  cell_core = node_core(node) + cell * node_numbers;
  cell_scale = bitcast<f32>(word(word(node + 2u) + cell));
}

// Half address of the R_n numbers of a row's k-th subset, for the cell at hand.
fn basis_row(n: u32, row: u32, k: u32) -> u32 {
  return node_basis[n] + ((row * node_mixture[n] + k) * node_others[n] + cell_others[n]) * node_rank[n];
}

// Notes the core index of a number of a mode that is decomposed here and undecomposed elsewhere.
fn keep_index(n: u32, e: u32) {
  if (mixed(n)) {
    cell_index[WEIGHT_FIRST[n] + e] = e;
  }
}

// Sets a weight of mode n in the cell at hand.
fn set_weight(n: u32, e: u32, weight: f32) {
  if (n == COLOUR) {
    cell_colour[e] = Value(weight);
  } else {
    cell_weight[WEIGHT_FIRST[n] + e] = weight;
  }
}
