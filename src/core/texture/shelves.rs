//! Rectangles packed on shelves (Coffman et al. 1980): by descending height, each beside the one before
//! it, or on a new shelf where the row is full.

/// Where rectangles lie.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shelves {
    /// First column and row of each.
    pub corners: Vec<[usize; 2]>,
    /// Rows that they take, gaps included.
    pub height: usize,
}

/// Packs rectangles (width, height) into `width` columns with a gap around each. One that is wider than
/// that stands out to the right, alone on its shelf.
#[must_use]
pub fn shelves(sizes: &[[usize; 2]], width: usize, gap: usize) -> Shelves {
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse((sizes[i][1], sizes[i][0])), i));
    let mut corners = vec![[0, 0]; sizes.len()];
    let (mut x, mut y, mut height) = (gap, gap, 0);
    for i in order {
        let [w, h] = sizes[i];
        if x > gap && x + w + gap > width {
            (x, y, height) = (gap, y + height + gap, 0);
        }
        corners[i] = [x, y];
        x += w + gap;
        height = height.max(h);
    }
    Shelves {
        corners,
        height: y + height + gap,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_keep_their_gap_and_their_width() {
        let sizes: Vec<[usize; 2]> = (1..60).map(|k| [1 + k * 7 % 13, 1 + k * 5 % 11]).collect();
        for gap in [0, 2] {
            let Shelves { corners, height } = shelves(&sizes, 40, gap);
            let mut taken = vec![false; 40 * height];
            for ([x, y], [w, h]) in corners.iter().zip(&sizes) {
                assert!(*x >= gap && x + w + gap <= 40 && *y >= gap && y + h + gap <= height);
                for (i, j) in (0..w + gap).flat_map(|i| (0..h + gap).map(move |j| (i, j))) {
                    let cell = &mut taken[(y + j) * 40 + x + i];
                    assert!(!*cell);
                    *cell = true;
                }
            }
        }
        assert_eq!(shelves(&[], 4, 1).corners, Vec::<[usize; 2]>::new());
        assert_eq!(shelves(&[[9, 2], [1, 1]], 4, 0).corners, [[0, 0], [0, 2]]);
    }
}
