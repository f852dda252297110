// One element of the tensor, as hmkcta/decode/scattered.py has it in NumPy.

// The element with these indices of the source axes, in source values. Indices must be in range.
fn decode_element(index: array<u32, AXES>, stages: u32) -> Value {
  var axis_index = index;
  var rows: array<u32, ORDER>;
  for (var axis = 0u; axis < AXES; axis++) {
    rows[AXIS_MODE[axis]] += axis_index[axis] * AXIS_STRIDE[axis];
  }
  return source_values(decode_rows(rows, stages));
}

// The element with these rows of the modes, in the domain of the value transform.
fn decode_rows(rows: array<u32, ORDER>, stages: u32) -> Value {
  var row = rows;
  var node = 0u;
  var value = Value(0.0);
  for (var stage = 0u; stage < stages; stage++) {
    if (!open_node(node)) {
      break;
    }
    if (!is_cut()) {
      value += node_value(node, stage, row);
    }
    let first_child = word(node);
    if (first_child == LEAF || stage + 1u == stages) {
      break;
    }
    var part = 0u;  // flat(part_1 .. part_N)
    for (var n = 0u; n < ORDER; n++) {
      part *= node_clusters[n];
      if (!whole(n) && node_clusters[n] > 1u) {
        let record = node_rows[n] + row[n] * (2u + node_mixture[n]);
        part += word(record);
        row[n] = word(record + 1u);
      }
    }
    node = first_child + part * NODE_WORDS;
  }
  return value;
}

// What the node at hand adds to the element: the sum over all choices of one cluster subset a mode.
fn node_value(node: u32, stage: u32, rows: array<u32, ORDER>) -> Value {
  var row = rows;
  var choice: array<u32, ORDER>;  // k_n
  var sum = Value(0.0);
  var more = true;
  while (more) {
    for (var n = 0u; n < ORDER; n++) {
      cell_cluster[n] = 0u;
      if (!undecomposed(n)) {
        cell_cluster[n] = word(node_rows[n] + row[n] * (2u + node_mixture[n]) + 2u + choice[n]);
      }
    }
    open_cell(node);
    for (var n = 0u; n < ORDER; n++) {
      if (undecomposed(n)) {
        cell_count[n] = 1u;
        set_weight(n, 0u, 1.0);
        cell_index[WEIGHT_FIRST[n]] = row[n];
      } else {
        let basis = basis_row(n, row[n], choice[n]);
        cell_count[n] = node_rank[n];
        for (var r = 0u; r < node_rank[n]; r++) {
          set_weight(n, r, coefficient(basis + r));
          keep_index(n, r);
        }
      }
    }
    sum += cell_scale * contract_core(stage);
    more = false;
    for (var left = ORDER; left > 0u && !more; left--) {
      choice[left - 1u] += 1u;
      more = choice[left - 1u] < node_mixture[left - 1u];
      if (!more) {
        choice[left - 1u] = 0u;
      }
    }
  }
  return sum;
}

// Inverse of the value transform, componentwise: hmkcta/transform.py. TRANSFORM: 0 identity,
// 1 log1p, 2 asinh, 3 sqrt; compilers leave out those of other models. The exponential functions are made of those of
// half the argument, one of which is scaled first: so none leaves float32 unless the result does.
fn source_values(value: Value) -> Value {
  switch TRANSFORM {
    case 1u: {
      let half = exp_less_one(0.5 * min(value, Value(decoder.limit)));
      return (half * decoder.scale) * (half + 2.0);
    }
    case 2u: {
      let half = exp_less_one(0.5 * min(abs(value), Value(decoder.limit)));
      let inverse = 1.0 / (half + 1.0);
      return sign(value) * ((0.5 * (half + half * inverse) * decoder.scale) * (half + 1.0 + inverse));
    }
    case 3u: {
      let root = clamp(value, Value(0.0), Value(decoder.limit));
      return root * root;
    }
    default: {
      return value;
    }
  }
}

// exp(x) - 1; near 0, where the difference would be little more than rounding, the first terms of its series.
fn exp_less_one(x: Value) -> Value {
  let series = 1.0 + x * (1.0 / 2.0 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x * (1.0 / 120.0 + x / 720.0))));
  return select(exp(x) - 1.0, x * series, abs(x) < Value(0.25));
}
