//! Rows of one clustered mode cut into tiles whose rows belong to the same few cluster subsets.

/// Up to `WIDTH` rows and the union of their cluster subsets, ascending.
pub struct Tile {
    pub rows: Vec<u32>,
    pub subsets: Vec<u16>,
}

/// Tiles of `width` rows of the memberships `[I_n, K_n]`, ascending subsets each.
///
/// Rows with the same subsets fill tiles; what is left of each shares tiles where that saves some.
pub fn tiles(members: &[u16], mixture: usize, width: usize) -> Vec<Tile> {
    let pattern = |row: u32| &members[row as usize * mixture..][..mixture];
    let mut rows: Vec<u32> = (0..(members.len() / mixture) as u32).collect();
    rows.sort_by_key(|&row| pattern(row));
    let (mut full, mut rest): (Vec<Tile>, Vec<Tile>) = (vec![], vec![]);
    for group in rows.chunk_by(|&a, &b| pattern(a) == pattern(b)) {
        for rows in group.chunks(width) {
            let mut subsets = pattern(rows[0]).to_vec();
            subsets.sort_unstable();
            let tile = Tile { rows: rows.to_vec(), subsets };
            if rows.len() == width { full.push(tile) } else { rest.push(tile) }
        }
    }
    while let Some(mut tile) = rest.pop() {
        while let Some(at) = best_partner(&tile, &rest, width) {
            let other = rest.remove(at);
            tile.subsets = union(&tile.subsets, &other.subsets);
            tile.rows.extend(other.rows);
        }
        full.push(tile);
    }
    full
}

/// The tile that fits beside this one's rows with the fewest more subsets; None if two tiles cost no more than one.
fn best_partner(tile: &Tile, others: &[Tile], width: usize) -> Option<usize> {
    let cost = |other: &Tile| union(&tile.subsets, &other.subsets).len();
    let fits = |other: &Tile| {
        tile.rows.len() + other.rows.len() <= width && cost(other) < tile.subsets.len() + other.subsets.len()
    };
    (0..others.len()).filter(|&at| fits(&others[at])).min_by_key(|&at| cost(&others[at]))
}

fn union(a: &[u16], b: &[u16]) -> Vec<u16> {
    let mut all = [a, b].concat();
    all.sort_unstable();
    all.dedup();
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_is_in_one_tile_with_its_subsets() {
        let members: Vec<u16> = (0..50u16).flat_map(|i| [i * 7 % 3, 3 + i % 2]).collect();
        let all = tiles(&members, 2, 8);
        let mut rows: Vec<u32> = all.iter().flat_map(|tile| tile.rows.clone()).collect();
        rows.sort_unstable();
        assert_eq!(rows, (0..50).collect::<Vec<u32>>());
        for tile in &all {
            assert!(tile.rows.len() <= 8);
            let inside = |row: &u32| members[*row as usize * 2..][..2].iter().all(|k| tile.subsets.contains(k));
            assert!(tile.rows.iter().all(inside));
        }
        assert!(all.len() <= 10, "{}", all.len());
    }

    #[test]
    fn strangers_keep_apart() {
        assert_eq!(tiles(&[0, 1, 2, 3], 2, 8).len(), 2);
        assert_eq!(tiles(&[0, 1, 1, 2], 2, 8).len(), 1);
    }
}
