//! Polygons into triangles: a fan where the polygon is convex, ear clipping where it is not.
//!
//! Meisters, "Polygons have Ears" (1975): every simple polygon has an ear, a corner whose triangle
//! lies inside and holds no other corner; it is cut off, and the rest is a polygon again. Called by
//! the readers of OBJ, PLY and USD.

use glam::{DVec2, DVec3};

/// Corners beyond which a polygon that is not convex is fanned all the same: clipping takes the
/// square of their number, and no modelling program writes such faces.
const MOST_CORNERS: usize = 2000;

/// Triangles of a polygon by the places of its corners in `corners`, in its winding.
#[must_use]
pub fn triangulate(corners: &[DVec3]) -> Vec<[usize; 3]> {
    let n = corners.len();
    let fan = || (1..n.saturating_sub(1)).map(|i| [0, i, i + 1]).collect();
    if !(4..=MOST_CORNERS).contains(&n) {
        return fan();
    }
    let flat = flattened(corners);
    let turn = |a: usize, b: usize, c: usize| (flat[b] - flat[a]).perp_dot(flat[c] - flat[b]);
    // rounding of a straight run of corners is no dent
    let size = flat
        .iter()
        .fold(0.0f64, |s, p| s.max((*p - flat[0]).length_squared()));
    let dent = |t: f64| t < -1e-9 * size;
    if !(0..n).any(|i| dent(turn(i, (i + 1) % n, (i + 2) % n))) {
        return fan();
    }
    let mut left: Vec<usize> = (0..n).collect();
    let mut out = Vec::with_capacity(n - 2);
    while left.len() > 3 {
        let m = left.len();
        let at = |i: usize| left[i % m];
        let ear = (0..m).find(|&i| {
            let (a, b, c) = (at(i), at(i + 1), at(i + 2));
            turn(a, b, c) > 0.0
                && !left.iter().any(|&p| {
                    p != a && p != b && p != c && inside(flat[p], [flat[a], flat[b], flat[c]])
                })
        });
        // a polygon that crosses itself may have none: any corner will do
        let i = ear.unwrap_or(0);
        out.push([at(i), at(i + 1), at(i + 2)]);
        left.remove((i + 1) % m);
    }
    out.push([left[0], left[1], left[2]]);
    out
}

/// The polygon seen along its normal (Newell's), counter-clockwise.
fn flattened(corners: &[DVec3]) -> Vec<DVec2> {
    let n = corners.len();
    let normal: DVec3 = (0..n)
        .map(|i| (corners[i] - corners[0]).cross(corners[(i + 1) % n] - corners[0]))
        .sum();
    let Some(normal) = normal.try_normalize() else {
        return vec![DVec2::ZERO; n];
    };
    let (x, y) = normal.any_orthonormal_pair();
    let place = |p: &DVec3| DVec2::new((*p - corners[0]).dot(x), (*p - corners[0]).dot(y));
    corners.iter().map(place).collect()
}

/// Whether `p` lies in the counter-clockwise triangle or on its border, its corners' places apart.
fn inside(p: DVec2, [a, b, c]: [DVec2; 3]) -> bool {
    if p == a || p == b || p == c {
        return false;
    }
    let side = |a: DVec2, b: DVec2| (b - a).perp_dot(p - a) >= 0.0;
    side(a, b) && side(b, c) && side(c, a)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(corners: &[DVec3]) -> f64 {
        let double = |t: &[usize; 3]| {
            let [a, b, c] = t.map(|i| corners[i]);
            (b - a).cross(c - a).length()
        };
        triangulate(corners).iter().map(double).sum::<f64>() * 0.5
    }

    #[test]
    fn convex_polygons_are_fans() {
        let square = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y];
        assert_eq!(triangulate(&square), [[0, 1, 2], [0, 2, 3]]);
        assert!(triangulate(&square[..2]).is_empty());
    }

    #[test]
    fn dents_are_cut_out_whichever_corner_comes_first() {
        let l = [
            (0.0, 0.0),
            (3.0, 0.0),
            (3.0, 1.0),
            (1.0, 1.0),
            (1.0, 4.0),
            (0.0, 4.0),
        ];
        for start in 0..6 {
            for turned in [false, true] {
                let mut corners: Vec<DVec3> = (0..6)
                    .map(|i| l[(start + i) % 6])
                    .map(|(x, y)| DVec3::new(x, 2.0, -y))
                    .collect();
                if turned {
                    corners.reverse();
                }
                assert!((area(&corners) - 6.0).abs() < 1e-12, "{start} {turned}");
            }
        }
    }

    #[test]
    fn nonsense_gives_triangles_all_the_same() {
        let crossing = [DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), DVec3::X, DVec3::Y];
        assert_eq!(triangulate(&crossing).len(), 2);
        assert_eq!(triangulate(&[DVec3::ZERO; 7]).len(), 5);
        let nan = [DVec3::splat(f64::NAN); 5];
        assert_eq!(triangulate(&nan).len(), 3);
    }
}
