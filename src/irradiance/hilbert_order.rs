//! The order in which the rays of one point are traced: neighbours in direction side by side, so
//! that they meet the same nodes and triangles while these are at hand (a seventh more closest hits
//! per second, a fifth more occlusion queries; docs/lab/rays.md).

/// Sorts points of the unit square along a Hilbert curve through square cells.
pub(crate) struct HilbertOrder {
    /// Cells along a side.
    side: usize,
    /// Place of each cell on the curve, row by row.
    place: Vec<u32>,
}

/// Cells along a side at most: size of work.
const MAX_SIDE: usize = 64;

impl HilbertOrder {
    /// For about `count` points at a time: one a cell.
    pub(crate) fn new(count: usize) -> Self {
        let side = ((count as f64).sqrt().ceil() as usize)
            .next_power_of_two()
            .min(MAX_SIDE);
        let cells = (0..side * side)
            .map(|i| place_on_curve(side as u32, [(i % side) as u32, (i / side) as u32]));
        Self {
            side,
            place: cells.collect(),
        }
    }

    /// Writes the points' numbers in order; points of one cell keep theirs. Coordinates in [0, 1).
    pub(crate) fn order(&self, [u, v]: [&[f32]; 2], out: &mut Vec<u32>) {
        let cells = self.place.len();
        let along = |x: f32| ((x * self.side as f32) as usize).min(self.side - 1);
        let place = |k: usize| self.place[along(v[k]) * self.side + along(u[k])] as usize;
        // counting sort: `out` holds the order, and behind it where each cell's points begin
        let n = u.len();
        out.clear();
        out.resize(n + cells + 1, 0);
        let (order, begin) = out.split_at_mut(n);
        for k in 0..n {
            begin[place(k) + 1] += 1;
        }
        let mut sum = 0;
        for b in begin.iter_mut() {
            sum += *b;
            *b = sum;
        }
        for k in 0..n {
            let b = &mut begin[place(k)];
            order[*b as usize] = k as u32;
            *b += 1;
        }
        out.truncate(n);
    }
}

/// How far along the Hilbert curve through `side`² cells, a power of two, a cell lies (Hilbert
/// 1891; the quadrants in turn).
fn place_on_curve(side: u32, [mut x, mut y]: [u32; 2]) -> u32 {
    let (mut place, mut half) = (0, side / 2);
    while half > 0 {
        let (right, up) = (u32::from(x & half > 0), u32::from(y & half > 0));
        place += half * half * ((3 * right) ^ up);
        if up == 0 {
            if right == 1 {
                (x, y) = (side - 1 - x, side - 1 - y);
            }
            (x, y) = (y, x);
        }
        half /= 2;
    }
    place
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::KeyedRng;

    #[test]
    fn the_curve_visits_every_cell_once_and_steps_to_neighbours() {
        for side in [1, 2, 8, 32] {
            let mut cells: Vec<(u32, [u32; 2])> = (0..side * side)
                .map(|i| [i % side, i / side])
                .map(|cell| (place_on_curve(side, cell), cell))
                .collect();
            cells.sort_unstable();
            assert!(
                cells.iter().zip(0..).all(|((place, _), i)| *place == i),
                "side {side}"
            );
            let step = |a: [u32; 2], b: [u32; 2]| a[0].abs_diff(b[0]) + a[1].abs_diff(b[1]);
            assert!(
                cells.windows(2).all(|w| step(w[0].1, w[1].1) == 1),
                "side {side}"
            );
        }
    }

    #[test]
    fn the_order_holds_every_point_once_cell_by_cell() {
        let mut rng = KeyedRng::new(1, 2);
        for n in [0, 1, 7, 300, 9000] {
            let mut draw = || (0..n).map(|_| rng.next_f32()).collect::<Vec<_>>();
            let (u, v) = (draw(), draw());
            let (sweep, mut order) = (HilbertOrder::new(n), vec![99]);
            sweep.order([&u, &v], &mut order);
            let side = sweep.side as f32;
            let place = |k: &u32| {
                let cell = [u[*k as usize], v[*k as usize]].map(|x| (x * side) as u32);
                (place_on_curve(sweep.side as u32, cell), *k)
            };
            let places: Vec<_> = order.iter().map(place).collect();
            assert!(places.is_sorted());
            order.sort_unstable();
            assert!(order.iter().copied().eq(0..n as u32), "{n} points");
        }
    }
}
