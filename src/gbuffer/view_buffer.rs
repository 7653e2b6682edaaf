//! First hits of one view's pixel centres, traced once.

use crate::core::geometry::{Camera, DirectionGrid, Mesh, Projection};
use crate::core::image::{Plane, Wrap};
use crate::core::parallel::map_chunks;
use crate::core::parallel::prelude::*;
use crate::core::trace::{Hit, Ray, Tracer};
use glam::{Vec2, Vec3};

/// Two neighbouring hits lie on one surface if they leave each other's tangent plane by less than
/// this share of their distance (30°), and their normals agree to about 45°.
const SAME_SURFACE_SINE: f32 = 0.5;
pub(super) const SAME_SURFACE_COSINE: f32 = 0.7;

/// Rays through n × n places of the pixels of a view: one place per square of an n × n grid, and
/// one per n²-th of each side (`places_in_pixel`).
pub struct PixelRays {
    /// Whose pixels they go through.
    pub camera: Camera,
    /// Per place, row-major within the pixel.
    grids: Vec<DirectionGrid>,
}

impl PixelRays {
    /// Those of a camera.
    #[must_use]
    pub fn new(camera: &Camera, n: usize) -> Self {
        let grid = |place| DirectionGrid::new(camera, place);
        Self {
            camera: *camera,
            grids: places_in_pixel(n).into_iter().map(grid).collect(),
        }
    }

    /// How many there are per pixel, n².
    #[must_use]
    pub fn per_pixel(&self) -> usize {
        self.grids.len()
    }

    /// Rays through some pixels of row `y`, to infinity, pixel by pixel.
    #[must_use]
    pub fn of_row(&self, y: usize, columns: impl IntoIterator<Item = usize>) -> Vec<Ray> {
        let ray = |x: usize, grid: &DirectionGrid| {
            Ray::new(self.camera.position, grid.direction(x, y), f32::INFINITY)
        };
        columns
            .into_iter()
            .flat_map(|x| self.grids.iter().map(move |grid| ray(x, grid)))
            .collect()
    }
}

/// Rays from a camera along a row of its grid, to infinity.
fn row_rays(camera: &Camera, grid: &DirectionGrid, y: usize) -> impl Iterator<Item = Ray> {
    (0..camera.width).map(move |x| Ray::new(camera.position, grid.direction(x, y), f32::INFINITY))
}

/// Places in the unit square, one in each of n × n squares, of which no two share an n²-th of
/// either side (multi-jittered sampling, Chiu, Shirley and Wang 1994): edges of walls and frames lie
/// along rows and columns, where the n² centres of the squares would tell but n coverages apart. The
/// shifts within the squares follow the golden ratio's multiples, one way along rows and the other
/// along columns, so that slanted edges meet few rows either.
fn places_in_pixel(n: usize) -> Vec<Vec2> {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let multiple = |k: usize| (k as f64 * GOLDEN).fract();
    let rank = |k: usize| (0..n).filter(|i| multiple(*i) < multiple(k)).count() as f32;
    let ranks: Vec<f32> = (0..n).map(rank).collect();
    let side = n as f32;
    let along = |square: usize, shift: f32| (square as f32 + (shift + 0.5) / side) / side;
    (0..n * n)
        .map(|s| {
            let (i, j) = (s % n, s / n);
            Vec2::new(along(i, ranks[j]), along(j, ranks[n - 1 - i]))
        })
        .collect()
}

/// How a camera's image goes on beyond its left and right border.
#[must_use]
pub fn wrap_of(camera: &Camera) -> Wrap {
    match camera.projection {
        Projection::Equirectangular => Wrap::Repeat,
        Projection::Pinhole(_) => Wrap::Clamp,
    }
}

/// Triangle and distance at every pixel centre of a view, row-major.
#[derive(Clone, Debug)]
pub struct ViewBuffer {
    /// Camera at the buffer's size.
    pub camera: Camera,
    /// Triangle per pixel; [`Hit::MISS`] where no geometry is seen.
    pub triangle: Plane<u32>,
    /// Distance along the pixel's ray, metres; infinite for a miss.
    pub distance: Plane<f32>,
    /// Through the pixels' centres.
    directions: DirectionGrid,
}

impl ViewBuffer {
    /// Traces one ray through every pixel centre.
    #[must_use]
    pub fn trace(camera: &Camera, tracer: &dyn Tracer) -> Self {
        let (w, h) = (camera.width, camera.height);
        let directions = DirectionGrid::new(camera, Vec2::splat(0.5));
        let mut triangle = Plane::filled(w, h, Hit::MISS);
        let mut distance = Plane::filled(w, h, f32::INFINITY);
        triangle
            .data
            .par_chunks_mut(w)
            .zip(distance.data.par_chunks_mut(w))
            .enumerate()
            .for_each(|(y, (tri, dist))| {
                let rays: Vec<Ray> = row_rays(camera, &directions, y).collect();
                let mut hits = vec![Hit::miss(); w];
                tracer.closest(&rays, &mut hits);
                for (x, hit) in hits.iter().enumerate() {
                    tri[x] = hit.triangle;
                    dist[x] = hit.t;
                }
            });
        Self {
            camera: *camera,
            triangle,
            distance,
            directions,
        }
    }

    /// What lies beyond the left and right border of an image of this view.
    #[must_use]
    pub fn wrap(&self) -> Wrap {
        wrap_of(&self.camera)
    }

    /// Rays through the centres of the pixels of row `y`, to infinity.
    pub fn row_rays(&self, y: usize) -> impl Iterator<Item = Ray> + '_ {
        row_rays(&self.camera, &self.directions, y)
    }

    /// Unit world direction through a pixel's centre.
    #[must_use]
    pub fn direction(&self, x: usize, y: usize) -> Vec3 {
        self.directions.direction(x, y)
    }

    /// World position seen at a pixel; meaningless for a miss.
    #[must_use]
    pub fn position(&self, x: usize, y: usize) -> Vec3 {
        self.camera.position + self.direction(x, y) * self.distance[(x, y)]
    }

    /// What `tell` says of the pixels that meet geometry, given the triangle and the pixel's column and
    /// row: each with its triangle, in the pixels' order whatever the number of threads, so that sums
    /// have the same bits.
    pub fn told_by_pixels<T: Send>(
        &self,
        tell: impl Fn(usize, (usize, usize)) -> Option<T> + Sync + Send,
    ) -> impl Iterator<Item = (usize, T)> {
        let width = self.triangle.width;
        let of_pixel = |at: (usize, usize)| {
            let t = self.triangle[at];
            let met = (t != Hit::MISS).then_some(t as usize)?;
            Some((met, tell(met, at)?))
        };
        let rows = map_chunks(self.triangle.height, 1, |rows| {
            rows.flat_map(|y| (0..width).map(move |x| (x, y)))
                .filter_map(&of_pixel)
                .collect::<Vec<_>>()
        });
        rows.into_iter().flatten()
    }

    /// Pixels whose eight neighbours all see the same smooth surface and carry the same label:
    /// their radiance is that of one surface, not a mixture across an edge.
    #[must_use]
    pub fn clean_pixels(&self, mesh: &Mesh, labels: Option<&Plane<u16>>) -> Plane<bool> {
        let (w, h) = (self.triangle.width, self.triangle.height);
        let mut clean = Plane::filled(w, h, false);
        clean
            .data
            .par_chunks_mut(w)
            .enumerate()
            .for_each(|(y, row)| {
                for (x, out) in row.iter_mut().enumerate() {
                    *out = self.is_clean(mesh, labels, (x, y));
                }
            });
        clean
    }

    /// Whether a pixel is one of [`Self::clean_pixels`].
    #[must_use]
    pub fn is_clean(
        &self,
        mesh: &Mesh,
        labels: Option<&Plane<u16>>,
        (x, y): (usize, usize),
    ) -> bool {
        let t = self.triangle[(x, y)];
        if t == Hit::MISS {
            return false;
        }
        let (w, h) = (self.triangle.width as i64, self.triangle.height as i64);
        let size = (self.triangle.width, self.triangle.height);
        let label_at = |x: usize, y: usize| labels.map(|l| *l.at_pixel_of(size, (x, y)));
        let own_label = label_at(x, y);
        let mut own: Option<(Vec3, Vec3)> = None;
        for (dx, dy) in [
            (-1, -1),
            (0, -1),
            (1, -1),
            (-1, 0),
            (1, 0),
            (-1, 1),
            (0, 1),
            (1, 1),
        ] {
            let (mut nx, ny) = (x as i64 + dx, y as i64 + dy);
            if self.wrap() == Wrap::Repeat {
                nx = nx.rem_euclid(w);
            }
            if nx < 0 || nx >= w || ny < 0 || ny >= h {
                continue;
            }
            let (nx, ny) = (nx as usize, ny as usize);
            if label_at(nx, ny) != own_label {
                return false;
            }
            let other = self.triangle[(nx, ny)];
            if other == t {
                continue;
            }
            if other == Hit::MISS {
                return false;
            }
            let (p, n) =
                *own.get_or_insert_with(|| (self.position(x, y), mesh.face_normal(t as usize)));
            let (q, m) = (self.position(nx, ny), mesh.face_normal(other as usize));
            let step = q - p;
            let reach = SAME_SURFACE_SINE * step.length();
            if n.dot(m).abs() < SAME_SURFACE_COSINE
                || n.dot(step).abs() > reach
                || m.dot(step).abs() > reach
            {
                return false;
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::KeyedRng;

    /// Root mean square error of the share of the unit square on one side of random lines at an
    /// angle, told by `places`; the truth from 400² places.
    fn coverage_error(places: &[Vec2], angle: f32) -> f32 {
        let normal = Vec2::from_angle(angle);
        let fine: Vec<Vec2> = (0..160_000)
            .map(|i| Vec2::new((i % 400) as f32 + 0.5, (i / 400) as f32 + 0.5) / 400.0)
            .collect();
        let share = |of: &[Vec2], d: f32| {
            let side = |p: &&Vec2| normal.dot(**p - Vec2::splat(0.5)) < d;
            of.iter().filter(side).count() as f32 / of.len() as f32
        };
        let mut rng = KeyedRng::new(3, 1);
        let lines: Vec<f32> = (0..100).map(|_| rng.next_f32() - 0.5).collect();
        let square = |d: &f32| (share(places, *d) - share(&fine, *d)).powi(2);
        (lines.iter().map(square).sum::<f32>() / lines.len() as f32).sqrt()
    }

    #[test]
    fn places_in_a_pixel_fill_squares_rows_and_columns_evenly() {
        assert_eq!(places_in_pixel(1), [Vec2::splat(0.5)]);
        for n in 2..=8usize {
            let places = places_in_pixel(n);
            let sorted = |key: &dyn Fn(&Vec2) -> usize| {
                let mut keys: Vec<usize> = places.iter().map(key).collect();
                keys.sort_unstable();
                keys
            };
            let all: Vec<usize> = (0..n * n).collect();
            let cell = |x: f32, of: usize| (x * of as f32) as usize;
            assert_eq!(sorted(&|p| cell(p.x, n) + n * cell(p.y, n)), all);
            assert_eq!(sorted(&|p| cell(p.x, n * n)), all);
            assert_eq!(sorted(&|p| cell(p.y, n * n)), all);
        }
    }

    #[test]
    fn edges_along_rows_are_told_far_more_finely_than_by_a_grid_and_others_as_well_on_average() {
        let n = 6;
        let places = places_in_pixel(n);
        let grid: Vec<Vec2> = (0..n * n)
            .map(|i| Vec2::new((i % n) as f32 + 0.5, (i / n) as f32 + 0.5) / n as f32)
            .collect();
        let angles: Vec<f32> = (0..16)
            .map(|k| k as f32 * std::f32::consts::PI / 16.0)
            .collect();
        let errors =
            |of: &[Vec2]| -> Vec<f32> { angles.iter().map(|a| coverage_error(of, *a)).collect() };
        let (own, its) = (errors(&places), errors(&grid));
        for straight in [0, 8] {
            assert!(own[straight] < 0.25 * its[straight], "{own:?} {its:?}");
        }
        let worst = |e: &[f32]| e.iter().copied().fold(0.0, f32::max);
        let square = |e: &[f32]| e.iter().map(|e| e * e).sum::<f32>();
        assert!(worst(&own) < 0.7 * worst(&its), "{own:?} {its:?}");
        assert!(square(&own) < 0.8 * square(&its), "{own:?} {its:?}");
    }
}
