//! What moves with the camera is no surface of the scene: tripod, operator, car roof, nadir cap
//! (an "ego mask" in data sets of driving).
//!
//! For every direction in camera coordinates the photographs are compared with what the *other*
//! views show of the surface that the mesh puts there: r = ln L − ln median L of the others. Where
//! a direction sees the scene, the r of the views scatter around 0; where something stands before
//! the lens, their median is far from 0 by more than chance explains. Exposures that differ from
//! view to view widen the scatter and leave the median. Called before exposure is taken out of the
//! views, which it would bend.

use crate::core::geometry::{Camera, Projection};
use crate::core::image::{CameraMask, Plane, Wrap};
use crate::core::math::luminance;
use crate::core::parallel;
use crate::core::stats::median;
use crate::core::trace::Hit;
use crate::gbuffer::{Observation, ObservedView, Observer, Orientation, wrap_of};

/// Columns of the grid of directions: cells of 1.4° in a panorama, finer than a tripod's head.
const COLUMNS: usize = 256;
/// Columns of the grid that tells whether there is anything to look for.
const FIRST_COLUMNS: usize = 64;
/// Views drawn per camera model. Derived: the median of so many, which lie 70 % from it in the
/// median, has a standard error of a third of [`CONTRADICTION`].
const MOST_VIEWS: usize = 32;
/// Views that must have been compared in a direction. Derived: so many independent views err to the
/// same side in one of 16 directions, and four neighbours do in one of 65,000.
const FEWEST_VIEWS: u32 = 5;
/// |median r| from which a direction contradicts the scene. Measured (`docs/lab/real-house.md`):
/// gloss and shadow of the camera leave up to 0.4 on the known scenes and the floors of a real
/// house, its tripod 2.5.
const CONTRADICTION: f32 = std::f32::consts::LN_2;
/// The same in standard errors of the median.
const SIGNIFICANT: f32 = 3.0;
/// Standard error of the median of n values over their median absolute deviation, times √n, for
/// a normal distribution. Derived: 1.4826 · √(π/2).
const MEDIAN_ERROR: f32 = 1.858;
/// Cells that hang together; fewer are chance.
const SMALLEST: usize = 4;
/// Rounds in which holes are closed.
const CLOSING: usize = 4;

/// What a kind of camera carries along.
#[derive(Clone, Debug)]
pub struct CameraRig {
    /// Its mask at the size of the photographs.
    pub mask: CameraMask,
    /// Views it was found in, and holds for.
    pub views: Vec<usize>,
    /// Median over the masked directions of ln photographed − ln expected luminance.
    pub contradiction: f32,
    /// Median over the masked directions of the number of views that were compared.
    pub compared: f32,
}

impl CameraRig {
    /// The evidence in words.
    #[must_use]
    pub fn evidence(&self) -> String {
        format!(
            "there {:.0} views show {:.2} times the light that other views see coming from the same surface",
            self.compared,
            self.contradiction.exp()
        )
    }
}

/// How the views of one camera contradict the scene in one direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Direction {
    /// Views with a prediction from other views.
    views: u32,
    /// Median over views of ln photographed − ln predicted luminance.
    contradiction: f32,
    /// Standard error of that median.
    error: f32,
}

impl Direction {
    fn is_no_scene(&self) -> bool {
        let c = self.contradiction.abs();
        self.views >= FEWEST_VIEWS && c > CONTRADICTION && c > SIGNIFICANT * self.error
    }
}

/// Finds what each kind of camera carries along; kinds that carry nothing are left out. `cameras`
/// are those of the observer's views at the size of the photographs.
#[must_use]
pub fn find_camera_rigs(
    observer: &Observer,
    orientation: &Orientation,
    cameras: &[&Camera],
) -> Vec<CameraRig> {
    groups(cameras)
        .into_iter()
        .filter_map(|views| {
            let first = directions(observer, orientation, &views, FIRST_COLUMNS);
            first.data.iter().find(|d| d.is_no_scene())?;
            let found = directions(observer, orientation, &views, COLUMNS);
            let camera = cameras[*views.first()?];
            let marked = regions(&found.map(Direction::is_no_scene), wrap_of(camera));
            rig(&found, &marked, camera, views)
        })
        .collect()
}

fn rig(
    found: &Plane<Direction>,
    marked: &Plane<bool>,
    camera: &Camera,
    views: Vec<usize>,
) -> Option<CameraRig> {
    let inside = |of: fn(&Direction) -> f32| -> Option<f32> {
        let marked = found.data.iter().zip(&marked.data);
        let chosen = marked.filter(|(d, m)| **m && d.is_no_scene());
        median(chosen.map(|(d, _)| of(d)).collect())
    };
    let contradiction = inside(|d| d.contradiction)?;
    let compared = inside(|d| d.views as f32)?;
    let (w, h) = (camera.width, camera.height);
    let data = (0..w * h)
        .map(|i| !marked.at_pixel_of((w, h), (i % w, i / w)))
        .collect();
    Some(CameraRig {
        mask: CameraMask {
            panorama: camera.projection == Projection::Equirectangular,
            visible: Plane {
                width: w,
                height: h,
                data,
            },
        },
        views,
        contradiction,
        compared,
    })
}

/// Indices of cameras of one kind and size.
fn groups(cameras: &[&Camera]) -> Vec<Vec<usize>> {
    let kind = |c: &Camera| {
        let panorama = c.projection == Projection::Equirectangular;
        (panorama, c.width, c.height)
    };
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (i, c) in cameras.iter().enumerate() {
        let same = |g: &&mut Vec<usize>| g.first().is_some_and(|j| kind(cameras[*j]) == kind(c));
        match groups.iter_mut().find(same) {
            Some(group) => group.push(i),
            None => groups.push(vec![i]),
        }
    }
    groups
}

/// Statistics of a grid of directions with at most `columns` columns.
fn directions(
    observer: &Observer,
    orientation: &Orientation,
    views: &[usize],
    columns: usize,
) -> Plane<Direction> {
    let size = views.first().map_or((0, 0), |v| {
        let image = &observer.views[*v].radiance;
        (image.width, image.height)
    });
    let width = columns.min(size.0);
    let height = (size.1 * width).div_ceil(size.0.max(1));
    let step = views.len().div_ceil(MOST_VIEWS).max(1);
    let rows = parallel::map_chunks(height, 1, |rows| {
        let (mut out, mut seen) = (Vec::with_capacity(width), Vec::new());
        for cell in rows.flat_map(|y| (0..width).map(move |x| (x, y))) {
            let ratios = views.iter().step_by(step).filter_map(|&v| {
                let image = &observer.views[v].radiance;
                let x = (2 * cell.0 + 1) * image.width / (2 * width);
                let y = (2 * cell.1 + 1) * image.height / (2 * height);
                against_others(observer, orientation, v, (x, y), &mut seen)
            });
            out.push(direction(ratios.collect()));
        }
        out
    });
    Plane {
        width,
        height,
        data: rows.into_iter().flatten().collect(),
    }
}

fn direction(ratios: Vec<f32>) -> Direction {
    let Some(centre) = median(ratios.clone()) else {
        return Direction::default();
    };
    let n = ratios.len();
    let spread = median(ratios.iter().map(|r| (r - centre).abs()).collect()).unwrap_or(0.0);
    Direction {
        views: n as u32,
        contradiction: centre,
        error: MEDIAN_ERROR * spread / (n as f32).sqrt(),
    }
}

/// ln of a pixel's luminance over what the other views show of the surface there.
fn against_others(
    observer: &Observer,
    orientation: &Orientation,
    view: usize,
    (x, y): (usize, usize),
    seen: &mut Vec<Observation>,
) -> Option<f32> {
    let own: &ObservedView = &observer.views[view];
    let t = own.buffer.triangle[(x, y)];
    if t == Hit::MISS || own.valid.as_ref().is_some_and(|v| !v[(x, y)]) {
        return None;
    }
    let normal = observer.mesh.face_normal(t as usize) * orientation.sign(t as usize);
    observer.observe(own.buffer.position(x, y), normal, seen);
    let others = seen.iter().filter(|o| o.view as usize != view);
    let log = |l: f32| l.max(f32::MIN_POSITIVE).ln();
    let expected = median(others.map(|o| log(luminance(o.radiance))).collect())?;
    Some(log(luminance(own.radiance[(x, y)])) - expected)
}

/// The marked regions without specks and holes, one cell wider.
fn regions(marked: &Plane<bool>, wrap: Wrap) -> Plane<bool> {
    let mut marked = without_specks(marked, wrap);
    for _ in 0..CLOSING {
        // half of the neighbours and one more; rows beyond a pole are none
        marked = by_neighbours(&marked, wrap, |own, marked, all| own || 2 * marked > all);
    }
    by_neighbours(&marked, wrap, |own, marked, _| own || marked > 0)
}

/// The eight neighbours of a cell that exist.
fn neighbours(
    (w, h): (usize, usize),
    wrap: Wrap,
    (x, y): (usize, usize),
) -> impl Iterator<Item = (usize, usize)> {
    (0..9).filter(|k| *k != 4).filter_map(move |k| {
        let (nx, ny) = ((x + k % 3).wrapping_sub(1), (y + k / 3).wrapping_sub(1));
        let nx = match wrap {
            Wrap::Repeat => (x + w + k % 3 - 1) % w,
            Wrap::Clamp => nx,
        };
        (nx < w && ny < h).then_some((nx, ny))
    })
}

fn by_neighbours(
    plane: &Plane<bool>,
    wrap: Wrap,
    rule: fn(bool, usize, usize) -> bool,
) -> Plane<bool> {
    let size = (plane.width, plane.height);
    let data = (0..size.0 * size.1).map(|i| {
        let (mut marked, mut all) = (0, 0);
        for n in neighbours(size, wrap, (i % size.0, i / size.0)) {
            marked += usize::from(plane[n]);
            all += 1;
        }
        rule(plane.data[i], marked, all)
    });
    Plane {
        width: size.0,
        height: size.1,
        data: data.collect(),
    }
}

fn without_specks(plane: &Plane<bool>, wrap: Wrap) -> Plane<bool> {
    let size = (plane.width, plane.height);
    let mut out = plane.map(|_| false);
    let mut done = out.clone();
    for i in 0..plane.data.len() {
        let (mut piece, mut next) = (Vec::new(), vec![(i % size.0, i / size.0)]);
        while let Some(at) = next.pop() {
            if plane[at] && !done[at] {
                done[at] = true;
                piece.push(at);
                next.extend(neighbours(size, wrap, at));
            }
        }
        if piece.len() >= SMALLEST {
            piece.into_iter().for_each(|at| out[at] = true);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::trace::EmbreeTracer;
    use crate::gbuffer::ViewBuffer;
    use crate::observed::surface_tests::box_scene;
    use glam::{Mat3, Vec2, Vec3};

    /// Panoramas from eight places in a painted box; `paint(camera, pixel, surface)` has the last
    /// word.
    fn views(paint: fn(&Camera, Vec2, f32) -> f32) -> Vec<ObservedView> {
        let scene = box_scene();
        let tracer = EmbreeTracer::new(&scene.mesh).expect("Embree");
        (0..8)
            .map(|i| {
                let k = i as f32;
                let camera = Camera {
                    projection: Projection::Equirectangular,
                    width: 256,
                    height: 128,
                    world_from_camera: Mat3::from_rotation_y(0.8 * k),
                    position: Vec3::new(0.7 + 0.35 * k, 1.3, 4.2 - 0.45 * k),
                };
                let buffer = ViewBuffer::trace(&camera, &tracer);
                let mut radiance = Plane::filled(256, 128, Vec3::ONE);
                for (j, out) in radiance.data.iter_mut().enumerate() {
                    let p = buffer.position(j % 256, j / 256);
                    let surface = 0.5 + 0.3 * (2.1 * p.x).sin() * (1.7 * p.z).cos() + 0.1 * p.y;
                    let pixel = Vec2::new((j % 256) as f32 + 0.5, (j / 256) as f32 + 0.5);
                    *out = Vec3::splat(paint(&camera, pixel, surface));
                }
                ObservedView {
                    clean: buffer.clean_pixels(&scene.mesh, None),
                    buffer,
                    radiance,
                    labels: None,
                    valid: None,
                }
            })
            .collect()
    }

    fn found(views: &[ObservedView]) -> Vec<CameraRig> {
        let scene = box_scene();
        let orientation = Orientation::vote(
            &scene.mesh,
            &views.iter().map(|v| &v.buffer).collect::<Vec<_>>(),
        );
        let cameras: Vec<&Camera> = views.iter().map(|v| &v.buffer.camera).collect();
        let observer = Observer {
            mesh: &scene.mesh,
            views,
        };
        find_camera_rigs(&observer, &orientation, &cameras)
    }

    /// A tripod's cap with a wavy rim, and a knob that stands free.
    fn is_rig(pixel: Vec2) -> bool {
        pixel.y > 114.0 + 4.0 * (pixel.x * 0.1).sin() || pixel.distance(Vec2::new(70.0, 96.0)) < 5.0
    }

    #[test]
    fn a_tripod_is_found_as_it_stands_and_the_scene_is_left_alone() {
        let views = views(|camera, pixel, surface| {
            // it mirrors a little of where it stands
            let glint = 0.02 + 0.01 * camera.position.x;
            if is_rig(pixel) { glint } else { surface }
        });
        let rigs = found(&views);
        assert_eq!(rigs.len(), 1);
        let (mut wrong, mut wide) = (0, 0);
        for (i, visible) in rigs[0].mask.visible.data.iter().enumerate() {
            let pixel = Vec2::new((i % 256) as f32 + 0.5, (i / 256) as f32 + 0.5);
            wrong += usize::from(*visible && is_rig(pixel));
            // the mask is wider by the next cell
            let near = (0..9).any(|k| {
                is_rig(pixel + Vec2::new(2.5 * (k % 3) as f32 - 2.5, 2.5 * (k / 3) as f32 - 2.5))
            });
            wide += usize::from(!*visible && !near);
        }
        assert!(wrong == 0 && wide == 0, "{wrong} missed, {wide} too many");
        assert_eq!(rigs[0].views.len(), 8);
        assert!(rigs[0].contradiction < -2.0 && rigs[0].compared >= 7.0);
    }

    #[test]
    fn neither_a_scene_nor_gloss_nor_a_cameras_shadow_is_a_rig() {
        assert!(found(&views(|_, _, surface| surface)).is_empty());
        // all views see the floor below them 30 % darker, and one has a hand before the lens
        let shadow = views(|camera, pixel, surface| {
            let hand = camera.position.x < 0.8 && pixel.x < 40.0;
            let below = if pixel.y > 100.0 { 0.7 } else { 1.0 };
            if hand { 0.01 } else { surface * below }
        });
        assert!(found(&shadow).is_empty());
    }

    #[test]
    fn specks_go_and_regions_grow_round_the_seam() {
        let mut plane = Plane::filled(16, 8, false);
        plane[(8, 2)] = true;
        for at in [(0, 6), (15, 6), (0, 7), (15, 7)] {
            plane[at] = true;
        }
        let grown = regions(&plane, Wrap::Repeat);
        assert!(!grown[(8, 2)] && grown[(0, 6)] && grown[(1, 5)] && grown[(14, 7)]);
        assert!(
            !regions(&plane, Wrap::Clamp).data.contains(&true),
            "two specks"
        );
        assert!(groups(&[]).is_empty());
    }
}
