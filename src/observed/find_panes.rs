//! Which surfaces photographs look through: panes, glass doors, a door that the mesh has closed.
//!
//! An opaque surface shows every view about the same light, whatever lies behind it; a pane shows
//! each what it sees behind, which other views saw directly, weakened, and a little of what it
//! mirrors. Either way one light is foretold for every look at a point: what the other looks show,
//! or what lies behind times a constant of the surface, with Fresnel's share of what is mirrored.
//! The hypothesis that foretells better is the one; neither needs materials or irradiance. Called by
//! the pipeline's stage `panes`.

use super::panes::{Pane, Panes, behind, cosine};
use crate::core::brdf::{DIELECTRIC, fresnel};
use crate::core::geometry::{Mesh, pieces};
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::stats::{Mean, SURELY, median, median_colour};
use crate::core::trace::{Hit, Ray, Tracer};
use crate::gbuffer::{Observation, ObservedView, Observer};
use crate::scene::MeshClasses;
use glam::Vec3;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Points of a sheet that tell whether it is a pane, and how many of them a view gives at most: a
/// hundred tell a tenth of their spread, and no view is to speak for the others.
const POINTS: usize = 100;
const POINTS_OF_A_VIEW: usize = 12;
/// Fewest points that tell: their standard error is then known to a sixth (derived: 1/√(2 n)).
const FEWEST: usize = 20;
/// Share of light that a face does not reflect in looks that count: at more grazing ones models of
/// reflection differ, and hardly anything else is seen. Derived: within 62° of the normal.
const STEEP: f32 = 0.9;
/// Share of the looks' disagreement that what lies behind leaves at most: where it explains less
/// than half, something else is at work.
const MOST: f64 = 0.5;
/// Area of a pane's far side, which nobody sees, over that of the near one at most. Derived: the
/// same, and rims of half as much.
const FAR_SIDE: f32 = 1.5;
/// Distance of a pane's faces at most, metres: triple glazing, 5 cm, and as much for a mesh's errors.
const THICKEST: f32 = 0.1;
/// Finds the surfaces that the views look through rather than at. `tracer` is that of the whole
/// mesh, which the views were traced with.
#[must_use]
pub fn find_panes(
    observer: &Observer,
    tracer: &dyn Tracer,
    mesh_classes: Option<&MeshClasses>,
) -> Panes {
    let sheets = Sheets::of(observer, mesh_classes);
    let likely: Vec<LikelyPane> = (sheets.points(observer).par_iter())
        .enumerate()
        .filter_map(|(sheet, points)| {
            sheets.likely_pane(sheet as u32, &looks(&sheets, observer, tracer, points))
        })
        .collect();
    Panes::new(believed(likely))
}

/// Connected triangles of one class.
struct Sheet {
    class: u16,
    /// m².
    area: f32,
    /// Whether any view sees it.
    seen: bool,
}

/// A sheet that is rather a pane than not.
struct LikelyPane {
    pane: Pane,
    /// Whether beyond chance.
    is_sure: bool,
}

/// Those that are sure, and of a class that has such ones those that are more likely than not.
fn believed(likely: Vec<LikelyPane>) -> Vec<Pane> {
    let sure = likely.iter().filter(|l| l.is_sure);
    let of_glass: BTreeSet<u16> = sure.map(|l| l.pane.class).filter(|c| *c != 0).collect();
    (likely.into_iter())
        .filter(|l| l.is_sure || of_glass.contains(&l.pane.class))
        .map(|l| l.pane)
        .collect()
}

/// Parts of the surface that are panes or not as a whole.
struct Sheets {
    /// Index into `sheets` by triangle.
    of_triangle: Vec<u32>,
    sheets: Vec<Sheet>,
}

/// A point of a sheet and the view that it was drawn from.
struct Point {
    position: Vec3,
    triangle: u32,
    view: u32,
}

/// How well the looks at a point are foretold.
struct Foretold {
    position: Vec3,
    /// Median relative error of what the other looks show.
    as_opaque: f64,
    seen_through: Vec<SeenThrough>,
    /// Sheets that nobody sees and that rays behind the point passed.
    unseen: BTreeSet<u32>,
}

/// A look at a point, and what lies behind it there.
struct SeenThrough {
    seen: Vec3,
    /// Radiance behind.
    behind: Vec3,
    /// Radiance from where the face mirrors the camera.
    mirrored: Vec3,
    /// Share of light that no face reflects.
    entering: f32,
    faces: i32,
}

impl Sheets {
    fn of(observer: &Observer, mesh_classes: Option<&MeshClasses>) -> Self {
        let class = mesh_classes.map_or_else(|| first_labels(observer), |m| m.of_triangle.clone());
        let mut number: BTreeMap<(u16, u32), u32> = BTreeMap::new();
        let mut sheets: Vec<Sheet> = Vec::new();
        let of_triangle: Vec<u32> = (class.iter().zip(pieces(observer.mesh)))
            .enumerate()
            .map(|(t, (&class, piece))| {
                let at = *number.entry((class, piece)).or_insert(sheets.len() as u32);
                if at as usize == sheets.len() {
                    sheets.push(Sheet {
                        class,
                        area: 0.0,
                        seen: false,
                    });
                }
                sheets[at as usize].area += observer.mesh.area(t);
                at
            })
            .collect();
        let seen: Vec<AtomicBool> = sheets.iter().map(|_| AtomicBool::new(false)).collect();
        observer.views.par_iter().for_each(|view| {
            let hits = view.buffer.triangle.data.iter();
            for t in hits.filter(|t| **t != Hit::MISS) {
                seen[of_triangle[*t as usize] as usize].store(true, Ordering::Relaxed);
            }
        });
        for (sheet, seen) in sheets.iter_mut().zip(seen) {
            sheet.seen = seen.into_inner();
        }
        Self {
            of_triangle,
            sheets,
        }
    }

    fn of_triangle(&self, t: u32) -> u32 {
        self.of_triangle[t as usize]
    }

    /// Whether a ray that looks behind one sheet passes another: a pane has two faces, which need not
    /// hang together, and of which views may see one alone; what has no label is no one thing.
    fn alike(&self, own: u32, other: u32) -> bool {
        let [one, two] = [own, other].map(|s| &self.sheets[s as usize]);
        own == other || one.class != 0 && one.class == two.class
    }

    /// Whether a sheet may be the far side of another, by area and as nobody sees it.
    fn may_be_far_side(&self, own: u32, other: u32) -> bool {
        let [one, two] = [own, other].map(|s| &self.sheets[s as usize]);
        !two.seen && two.area <= FAR_SIDE * one.area
    }

    /// Points of every sheet, evenly drawn from the clean pixels of each view.
    fn points(&self, observer: &Observer) -> Vec<Vec<Point>> {
        let of_view = |(v, view): (usize, &ObservedView)| {
            let usable = |i: &usize| {
                view.clean.data[*i]
                    && view.valid.as_ref().is_none_or(|valid| valid.data[*i])
                    && view.radiance.data[*i] != Vec3::ZERO
            };
            let triangles = &view.buffer.triangle.data;
            let sheet = |i: usize| self.of_triangle(triangles[i]) as usize;
            let all = || (0..triangles.len()).filter(usable);
            let mut count = vec![0usize; self.sheets.len()];
            all().for_each(|i| count[sheet(i)] += 1);
            let mut nth = vec![0usize; self.sheets.len()];
            let mut drawn = Vec::new();
            for i in all() {
                let s = sheet(i);
                // the middles of equal parts of the sheet's pixels
                let parts = POINTS_OF_A_VIEW.min(count[s]);
                let part = nth[s] * parts / count[s];
                if nth[s] == (2 * part + 1) * count[s] / (2 * parts) {
                    let (x, y) = (i % view.clean.width, i / view.clean.width);
                    drawn.push(Point {
                        position: view.buffer.position(x, y),
                        triangle: triangles[i],
                        view: v as u32,
                    });
                }
                nth[s] += 1;
            }
            drawn
        };
        let views: Vec<Vec<Point>> = (observer.views.par_iter().enumerate())
            .map(of_view)
            .collect();
        let mut points: Vec<Vec<Point>> = Vec::new();
        points.resize_with(self.sheets.len(), Vec::new);
        for point in views.into_iter().flatten() {
            points[self.of_triangle(point.triangle) as usize].push(point);
        }
        for of_sheet in points.iter_mut().filter(|p| p.len() > POINTS) {
            let step = of_sheet.len().div_ceil(POINTS);
            let mut n = 0;
            of_sheet.retain(|_| {
                n += 1;
                (n - 1) % step == 0
            });
        }
        points
    }

    /// The sheet as a pane, if what lies behind foretells looks better than they each other at most of
    /// its points and it is possible.
    fn likely_pane(&self, sheet: u32, looks: &[Foretold]) -> Option<LikelyPane> {
        if looks.len() < FEWEST {
            return None;
        }
        let tint = tint(looks)?;
        let places: Vec<Vec3> = looks.iter().map(|l| l.position).collect();
        let through: Vec<f64> = (looks.iter())
            .map(|l| through_error(&l.seen_through, tint))
            .collect();
        // counted, not averaged: a look past an edge is off by any amount
        let explained: Vec<f64> = (looks.iter().zip(through))
            .map(|(l, through)| f64::from(u8::from(through < MOST * l.as_opaque)))
            .collect();
        let explained = Mean::over(&places, &explained);
        let gain = explained.value - 0.5;
        let share = |l: &SeenThrough| luminance(l.share()).clamp(0.0, 1.0);
        let shares: Vec<f64> = (looks.iter())
            .filter_map(|l| median(l.seen_through.iter().map(share).collect()))
            .map(f64::from)
            .collect();
        // models of reflection differ by about what a face reflects
        let error = (Mean::over(&places, &shares).error as f32).hypot(DIELECTRIC.x);
        let passed = looks.iter().flat_map(|l| &l.seen_through);
        let passed = median(passed.map(|l| luminance(l.passed())).collect())?;
        let possible = passed <= 1.0 + SURELY * error;
        if gain <= 0.0 || !possible {
            return None;
        }
        let mut parts: BTreeSet<u32> = looks.iter().flat_map(|l| l.unseen.clone()).collect();
        parts.insert(sheet);
        let triangles = (0..self.of_triangle.len() as u32)
            .filter(|t| parts.contains(&self.of_triangle[*t as usize]))
            .collect();
        let pane = Pane {
            class: self.sheets[sheet as usize].class,
            triangles,
            tint: tint.min(Vec3::ONE),
            tint_error: error,
        };
        let is_sure = gain >= f64::from(SURELY) * explained.error;
        Some(LikelyPane { pane, is_sure })
    }
}

/// The label of the first clean pixel that sees each triangle; 0 where none does.
fn first_labels(observer: &Observer) -> Vec<u16> {
    let key = |_| AtomicU64::new(u64::MAX);
    let first: Vec<AtomicU64> = observer.mesh.triangles.par_iter().map(key).collect();
    observer.views.par_iter().enumerate().for_each(|(v, view)| {
        let Some(labels) = &view.labels else {
            return;
        };
        let (w, h) = (view.clean.width, view.clean.height);
        for i in (0..w * h).filter(|i| view.clean.data[*i]) {
            let label = *labels.at_pixel_of((w, h), (i % w, i / w));
            let key = ((v * w * h + i) as u64) << 16 | u64::from(label);
            first[view.buffer.triangle.data[i] as usize].fetch_min(key, Ordering::Relaxed);
        }
    });
    // the low bits are the label
    let label = |key: AtomicU64| match key.into_inner() {
        u64::MAX => 0,
        key => (key & 0xffff) as u16,
    };
    first.into_iter().map(label).collect()
}

impl SeenThrough {
    /// Radiance that the faces reflect.
    fn reflected(&self) -> Vec3 {
        self.mirrored * (1.0 - self.entering)
    }

    /// Share of the light that passes all faces.
    fn passed(&self) -> Vec3 {
        (self.seen - self.reflected()).max(Vec3::ZERO) / self.behind
    }

    /// Share of the light that passes one face of what it does not reflect.
    fn share(&self) -> Vec3 {
        (self.passed() / self.entering).powf(1.0 / self.faces as f32)
    }

    /// What shows if each face lets `tint` pass.
    fn foretold(&self, tint: Vec3) -> Vec3 {
        self.behind * self.entering * tint.powf(self.faces as f32) + self.reflected()
    }
}

/// The points whose looks are foretold both ways.
fn looks(
    sheets: &Sheets,
    observer: &Observer,
    tracer: &dyn Tracer,
    points: &[Point],
) -> Vec<Foretold> {
    if points.len() < FEWEST {
        return Vec::new();
    }
    let (mut seen, mut there) = (Vec::new(), Vec::new());
    let point = |p: &Point| {
        let camera = observer.views[p.view as usize].buffer.camera.position;
        let normal = facing(observer.mesh, p.triangle, p.position - camera);
        observer.observe(p.position, normal, &mut seen);
        seen.retain(|o| o.clean);
        let opaque: Vec<f32> = (0..seen.len()).map(|k| left_out_error(&seen, k)).collect();
        let own = sheets.of_triangle(p.triangle);
        let mut unseen = BTreeSet::new();
        let passes = |t: u32| {
            let sheet = sheets.of_triangle(t);
            let passes = sheets.alike(own, sheet)
                || sheets.may_be_far_side(own, sheet) && is_close_behind(observer.mesh, p, t);
            if passes && !sheets.sheets[sheet as usize].seen {
                unseen.insert(sheet);
            }
            passes
        };
        let mut around = Around {
            observer,
            tracer,
            passes,
            there: &mut there,
        };
        let seen_through: Vec<SeenThrough> = (seen.iter())
            .filter_map(|look| around.look(p, look))
            .collect();
        let enough = seen.len() >= 2 && !seen_through.is_empty();
        enough.then(|| Foretold {
            position: p.position,
            as_opaque: median(opaque).unwrap_or(0.0).into(),
            seen_through,
            unseen,
        })
    };
    points.iter().filter_map(point).collect()
}

/// The unit normal of a triangle on the side that a ray comes from.
fn facing(mesh: &Mesh, triangle: u32, direction: Vec3) -> Vec3 {
    let normal = mesh.face_normal(triangle as usize);
    if normal.dot(direction) > 0.0 {
        -normal
    } else {
        normal
    }
}

/// Whether a triangle lies behind a point as the far face of one pane: parallel and near.
fn is_close_behind(mesh: &Mesh, point: &Point, triangle: u32) -> bool {
    let normal = mesh.face_normal(point.triangle as usize);
    let [corner, ..] = mesh.corners(triangle as usize);
    let parallel = normal.dot(mesh.face_normal(triangle as usize)).abs() > STEEP;
    parallel && normal.dot(corner - point.position).abs() <= THICKEST
}

/// What lies behind a point and what it mirrors, by views that see that directly.
struct Around<'a, P> {
    observer: &'a Observer<'a>,
    tracer: &'a dyn Tracer,
    /// Whether rays pass a triangle.
    passes: P,
    there: &'a mut Vec<Observation>,
}

impl<P: FnMut(u32) -> bool> Around<'_, P> {
    /// That of one look at a point of a triangle.
    fn look(&mut self, point: &Point, look: &Observation) -> Option<SeenThrough> {
        let Observer { mesh, views } = *self.observer;
        let camera = views[look.view as usize].buffer.camera.position;
        let direction = (point.position - camera).normalize();
        let (mut faces, mut entering) = (0, 1.0);
        let ray = Ray::new(camera, direction, f32::INFINITY);
        let hit = behind(self.tracer, ray, |t| {
            let passes = (self.passes)(t);
            if passes {
                faces += 1;
                entering *= 1.0 - fresnel(cosine(mesh, t, direction).min(1.0));
            }
            passes
        });
        if faces == 0 || entering < STEEP.powi(faces) {
            return None;
        }
        let behind_it = self.radiance(&ray, &hit)?;
        // so near behind that this very look would be one at it
        if self.there.iter().any(|o| o.view == look.view) {
            return None;
        }
        let normal = facing(mesh, point.triangle, direction);
        let back = direction.reflect(normal);
        let ray = Ray {
            // beyond the rounding of positions
            t_near: 1e-4 * hit.t,
            ..Ray::new(point.position, back, f32::INFINITY)
        };
        let hit = behind(self.tracer, ray, &mut self.passes);
        (luminance(behind_it) > 0.0).then_some(SeenThrough {
            seen: look.radiance,
            behind: behind_it,
            mirrored: self.radiance(&ray, &hit)?,
            entering,
            faces,
        })
    }

    /// The median of what views see of what a ray hit, on the side it came from.
    fn radiance(&mut self, ray: &Ray, hit: &Hit) -> Option<Vec3> {
        if !hit.is_hit() {
            return None;
        }
        let direction = Vec3::from(ray.direction);
        let normal = facing(self.observer.mesh, hit.triangle, direction);
        let position = Vec3::from(ray.origin) + direction * hit.t;
        self.observer.observe(position, normal, self.there);
        let clean = self.there.iter().filter(|o| o.clean);
        median_colour(&clean.map(|o| o.radiance).collect::<Vec<_>>())
    }
}

/// Relative error of a luminance that was foretold, [0, 1].
fn relative_error(seen: Vec3, foretold: Vec3) -> f32 {
    let (seen, foretold) = (luminance(seen), luminance(foretold));
    let larger = seen.max(foretold).max(f32::MIN_POSITIVE);
    (seen - foretold).abs() / larger
}

/// Error of look `k` foretold by the mean of the others.
fn left_out_error(seen: &[Observation], k: usize) -> f32 {
    let others = seen.iter().enumerate().filter(|(j, _)| *j != k);
    let sum: Vec3 = others.map(|(_, o)| o.radiance).sum();
    relative_error(seen[k].radiance, sum / (seen.len().max(2) - 1) as f32)
}

/// Median error of looks foretold by what lies behind.
fn through_error(looks: &[SeenThrough], tint: Vec3) -> f64 {
    let error = |l: &SeenThrough| relative_error(l.seen, l.foretold(tint));
    let errors = looks.iter().map(error).collect();
    median(errors).unwrap_or(0.0).into()
}

/// What passes one face, by the median look; `None` where a channel of all is dark.
fn tint(looks: &[Foretold]) -> Option<Vec3> {
    let channel = |c: usize| {
        let all = looks.iter().flat_map(|l| &l.seen_through);
        let lit = all.filter(|l| l.behind[c] > 0.0);
        median(lit.map(|l| l.share()[c]).collect())
    };
    Some(Vec3::new(channel(0)?, channel(1)?, channel(2)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::{Camera, Lens, Projection};
    use crate::core::image::Plane;
    use crate::core::trace::EmbreeTracer;
    use crate::gbuffer::ViewBuffer;
    use crate::scene::Scene;
    use glam::{DVec3, Mat3, Vec2};
    use std::f32::consts::{PI, TAU};
    use std::path::PathBuf;

    /// What passes a face of the tests' panes.
    const TINT: Vec3 = Vec3::new(0.9, 0.8, 0.7);
    /// Class of the sheet, and of the wall behind it.
    const SHEET: u16 = 2;
    const WALL: u16 = 1;
    /// The sheets' first triangle.
    const SHEETS: u32 = 4;

    /// What stands before the wall.
    #[derive(Clone, Copy, PartialEq)]
    enum Stands {
        /// A pane of so many faces.
        Pane(u32),
        /// A painting.
        Painting,
        /// A pane that the mesh has and nobody hung.
        Nothing,
    }

    /// Walls of 8 x 6 m at z = -4 and 3, and sheets of 1.2 x 1.2 m before the former, two triangles
    /// each.
    fn mesh(faces: u32) -> Mesh {
        let mut mesh = Mesh::default();
        let sheets = (0..faces).map(|k| (0.6, 0.6, -2.5 - 0.01 * k as f32));
        let walls = [(4.0, 3.0, -4.0), (4.0, 3.0, 3.0)];
        for (x, y, z) in walls.into_iter().chain(sheets) {
            let first = mesh.positions.len() as u32;
            for (a, b) in [(-x, -y), (x, -y), (x, y), (-x, y)] {
                mesh.positions.push(Vec3::new(a, b, z));
                mesh.normals.push(Vec3::Z);
                mesh.uvs.push(Vec2::ZERO);
            }
            mesh.triangles
                .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        mesh
    }

    /// Light of a surface with a pattern of 20 cm and one of 45 cm.
    fn pattern(p: Vec3, phase: f32) -> Vec3 {
        let wave = |x: f32, length: f32| 0.5 + 0.5 * (TAU * x / length).sin();
        let fine = wave(p.x + phase, 0.2) * wave(p.y - phase, 0.2);
        Vec3::new(0.2, 0.3, 0.4) + 0.6 * fine + 0.3 * wave(p.x + p.y + phase, 0.45)
    }

    fn views(mesh: &Mesh, tracer: &dyn Tracer, stands: Stands) -> Vec<ObservedView> {
        let (width, height) = (160, 120);
        let view = |k: usize| {
            let camera = Camera {
                projection: Projection::Pinhole(Lens::centred(width, height, 90.0)),
                width,
                height,
                // one half looks at the sheets, the other to the wall behind them
                world_from_camera: Mat3::from_rotation_y((k % 2) as f32 * PI),
                position: Vec3::new(0.45 * ((k / 2) as f32 - 3.0), 0.1 * (k % 3) as f32, 0.0),
            };
            let buffer = ViewBuffer::trace(&camera, tracer);
            let rays = (0..height).flat_map(|y| buffer.row_rays(y));
            let radiance = |ray: Ray| {
                let direction = Vec3::from(ray.direction);
                let (mut share, mut mirrored) = (Vec3::ONE, Vec3::ZERO);
                let hit = behind(tracer, ray, |t| {
                    let pane = t >= SHEETS && stands != Stands::Painting;
                    if pane && stands != Stands::Nothing {
                        let enters = 1.0 - fresnel(direction.z.abs());
                        let face = camera.position + direction * (-2.5 / direction.z);
                        let back = Vec3::new(direction.x, direction.y, -direction.z);
                        let wall = face + back * ((3.0 - face.z) / back.z);
                        mirrored += (1.0 - enters) * pattern(wall, 0.0);
                        share *= TINT * enters;
                    }
                    pane
                });
                let at = camera.position + direction * hit.t;
                match (hit.is_hit(), hit.triangle >= SHEETS) {
                    (false, _) => Vec3::ZERO,
                    (true, true) => pattern(at, 0.07),
                    (true, false) => share * pattern(at, 0.0) + mirrored,
                }
            };
            let radiance: Vec<Vec3> = rays.map(radiance).collect();
            let label = |t: &u32| match *t {
                Hit::MISS => 0,
                t if t < SHEETS => WALL,
                _ => SHEET,
            };
            let labels = buffer.triangle.map(label);
            ObservedView {
                clean: buffer.clean_pixels(mesh, Some(&labels)),
                radiance: Plane {
                    width,
                    height,
                    data: radiance,
                },
                labels: Some(labels),
                valid: None,
                buffer,
            }
        };
        (0..14).map(view).collect()
    }

    fn found(stands: Stands) -> (Scene, EmbreeTracer, Vec<ObservedView>, Panes) {
        let mesh = mesh(match stands {
            Stands::Pane(faces) => faces,
            _ => 1,
        });
        let tracer = EmbreeTracer::new(&mesh).expect("Embree");
        let views = views(&mesh, &tracer, stands);
        let observer = Observer {
            mesh: &mesh,
            views: &views,
        };
        let panes = find_panes(&observer, &tracer, None);
        let scene = Scene::from_parts(PathBuf::new(), DVec3::ZERO, mesh, Vec::new(), Vec::new());
        (scene, tracer, views, panes)
    }

    #[test]
    fn a_pane_is_found_with_its_tint_however_many_faces_it_has() {
        for faces in [1, 2] {
            let (_, _, _, panes) = found(Stands::Pane(faces));
            let seen: Vec<&Pane> = panes.panes.iter().collect();
            let [pane] = seen[..] else {
                panic!("{faces} faces: {panes:?}");
            };
            let all: Vec<u32> = (SHEETS..SHEETS + 2 * faces).collect();
            assert_eq!((pane.class, &pane.triangles), (SHEET, &all));
            let off = (pane.tint - TINT).abs().max_element();
            assert!(off < 0.03, "{faces} faces: {pane:?}");
            assert!(pane.tint_error < 0.05, "{pane:?}");
        }
    }

    #[test]
    fn a_painting_is_none_and_what_nobody_hung_lets_all_light_through() {
        let (_, _, _, panes) = found(Stands::Painting);
        assert!(panes.is_empty(), "{panes:?}");
        let (_, _, _, panes) = found(Stands::Nothing);
        let tint = panes.of(SHEETS).map(|p| p.tint).unwrap_or_default();
        assert!((tint - Vec3::ONE).abs().max_element() < 0.03, "{tint}");
        assert!(panes.of(0).is_none(), "the wall is there");
    }

    #[test]
    fn a_likely_pane_is_believed_where_another_of_its_class_is_sure() {
        let likely = |class: u16, is_sure: bool| LikelyPane {
            pane: Pane {
                class,
                triangles: vec![],
                tint: TINT,
                tint_error: 0.1,
            },
            is_sure,
        };
        let classes = |all: &[(u16, bool)]| -> Vec<u16> {
            let all = all.iter().map(|(c, sure)| likely(*c, *sure)).collect();
            believed(all).iter().map(|p| p.class).collect()
        };
        assert_eq!(classes(&[(2, false), (2, true), (3, false)]), [2, 2]);
        assert_eq!(classes(&[(0, false), (0, true)]), [0], "no label, no kin");
        assert!(classes(&[(2, false), (2, false)]).is_empty());
    }

    #[test]
    fn views_that_look_through_show_what_lies_behind_as_it_is() {
        let (scene, whole, mut views, panes) = found(Stands::Pane(1));
        let cleared = panes.cleared(&scene.mesh).expect("Embree");
        let mut through = 0;
        for view in &mut views {
            let before = view.clone();
            panes.look_through(view, &whole, &cleared, &scene);
            for i in 0..view.clean.data.len() {
                let was = before.buffer.triangle.data[i];
                let labels = view.labels.as_ref().expect("labels");
                if was == Hit::MISS || was < SHEETS {
                    assert_eq!(view.radiance.data[i], before.radiance.data[i]);
                    continue;
                }
                through += 1;
                let (x, y) = (i % view.clean.width, i / view.clean.width);
                let truth = pattern(view.buffer.position(x, y), 0.0);
                // what it mirrors cannot be told from what lies behind
                let off = (view.radiance.data[i] - truth).abs().max_element();
                assert!(off < 0.15, "{i}: {} for {truth}", view.radiance.data[i]);
                assert!(view.buffer.triangle.data[i] < SHEETS && !view.clean.data[i]);
                assert_eq!(labels.data[i], 0, "the wall is not of glass");
            }
        }
        assert!(through > 2000, "{through}");
    }

    /// Light that does not come through is not made up: of panes that are black in red, pixels say nothing.
    #[test]
    fn through_what_lets_no_light_pass_nothing_is_seen() {
        let (scene, tracer, mut views, mut panes) = found(Stands::Pane(1));
        assert!(!panes.panes.is_empty());
        panes.panes.iter_mut().for_each(|p| p.tint.x = 0.0);
        let cleared = panes.cleared(&scene.mesh).expect("Embree");
        let mut left_out = 0;
        for view in &mut views {
            let before = view.radiance.clone();
            panes.look_through(view, &tracer, &cleared, &scene);
            let all = view.radiance.map(|_| true);
            let valid = view.valid.as_ref().unwrap_or(&all);
            for (i, used) in valid.data.iter().enumerate() {
                assert_eq!(view.radiance.data[i], before.data[i]);
                left_out += usize::from(!used);
            }
        }
        assert!(left_out > 2000, "{left_out}");
    }
}
