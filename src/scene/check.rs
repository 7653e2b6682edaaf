//! `unbake check`: what the program understands of a scene, and everything that is wrong with it,
//! in one report.

use super::frame_account;
use super::recorded_light::{ClippedView, RecordedLight};
use super::{FrameAccount, LoadOptions, MeshClasses, RoomGrid, Scene, Split, View, find_rooms};
use crate::core::geometry::{Camera, Projection};
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::luminance;
use crate::core::parallel::sum_f64;
use crate::core::sampling::{AliasTable, KeyedRng};
use crate::core::stats::median;
use crate::core::trace::{EmbreeTracer, Hit, Ray, Tracer};
use crate::{Error, Result};
use glam::{Vec2, Vec3};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Everything `check` has to say. Problems make the scene unusable, warnings do not.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CheckReport {
    /// The folder or file checked.
    pub path: String,
    /// What makes the scene unusable; empty for a usable scene.
    pub problems: Vec<String>,
    /// What a user should know although the scene is usable.
    pub warnings: Vec<String>,
    /// What was understood; `None` if the scene could not be loaded at all.
    pub summary: Option<Summary>,
}

/// What was understood of a scene.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Summary {
    /// Training views.
    pub train_views: usize,
    /// Held-out views.
    pub test_views: usize,
    /// Image sizes and projections, with the number of views of each.
    pub images: Vec<ImageKind>,
    /// Every frame whose files could be read.
    pub frames: Vec<FrameAccount>,
    /// Views whose files could not be read: radiance and classes are those of the others.
    pub unread_views: usize,
    /// Light that the photographs do not hold; `None` where nothing is clipped.
    pub recorded_light: Option<RecordedLight>,
    /// Geometry.
    pub mesh: MeshSummary,
    /// Radiance of the training images, exposure applied.
    pub radiance: RadianceRange,
    /// Classes with their shares.
    pub classes: Vec<ClassShare>,
    /// What of the mesh the classes are named after, where no photograph has labels.
    pub mesh_classes: Option<&'static str>,
    /// Share of the labelled images' pixels (by solid angle) without a class.
    pub unlabelled_share: f64,
    /// Share of the labelled images (by solid angle) that shows geometry without a class.
    pub unlabelled_surface_share: f64,
    /// Share of the training cameras' rays (by solid angle) that hit no geometry.
    pub hole_share: f64,
    /// Share of the surface no training view sees.
    pub unseen_area_share: f64,
    /// Pixels of the training images per metre of what they show, at their middle distance; 0 if
    /// they show nothing.
    pub pixels_per_metre: f64,
    /// Rooms on the floor plan.
    pub rooms: Vec<RoomSummary>,
    /// Rooms come from the scene's own grid rather than being found.
    pub rooms_given: bool,
}

/// A size and projection that occurs among the images.
#[derive(Clone, Debug, Serialize)]
pub struct ImageKind {
    /// "panorama" or "pinhole".
    pub projection: &'static str,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Views of this kind.
    pub views: usize,
}

/// Geometry in figures.
#[derive(Clone, Debug, Default, Serialize)]
pub struct MeshSummary {
    /// Triangles with area.
    pub triangles: usize,
    /// Vertices.
    pub vertices: usize,
    /// Smallest coordinates, file units, y up.
    pub min: [f64; 3],
    /// Largest coordinates.
    pub max: [f64; 3],
    /// Surface in m².
    pub area: f64,
    /// Share of the atlas that charts cover.
    pub atlas_fill: f64,
    /// Texels per metre of surface in a 2048² atlas, on average.
    pub texels_per_metre: f64,
    /// What was found and mended on loading.
    pub details: super::MeshStats,
}

/// Luminance quantiles over training pixels.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct RadianceRange {
    /// Smallest.
    pub min: f32,
    /// Median.
    pub median: f32,
    /// Exceeded by one pixel in a thousand.
    pub p999: f32,
    /// Largest.
    pub max: f32,
    /// Pixels with a negative channel, which counts as 0.
    pub negative: usize,
    /// NaN or infinite pixels left out.
    pub not_finite: usize,
}

/// A class and how much of the scene it takes.
#[derive(Clone, Debug, Serialize)]
pub struct ClassShare {
    /// Id in the label images.
    pub id: u16,
    /// Name.
    pub name: String,
    /// Declared to emit light.
    pub is_light: bool,
    /// Share of the labelled views' solid angle.
    pub pixel_share: f64,
    /// Share of the seen surface's area, by the majority of rays on each triangle.
    pub mesh_share: f64,
}

/// A room in figures.
#[derive(Clone, Debug, Serialize)]
pub struct RoomSummary {
    /// Id in the grid.
    pub id: u16,
    /// Floor plan area in m², walls to their middle included.
    pub area: f64,
    /// Training cameras in it.
    pub train_views: usize,
}

/// Rays traced per view for coverage and class shares.
const RAYS_PER_VIEW: usize = 20_000;
/// Pixels per texel, along a side, from which an atlas of 2048² is too coarse. Derived: the largest
/// atlas has 8192².
const COARSER: f64 = 4.0;
/// Surface points tested for being seen.
const SURFACE_POINTS: usize = 20_000;
/// Pixels per image that enter the radiance quantiles.
const PIXELS_PER_VIEW: usize = 50_000;

impl CheckReport {
    /// Whether `solve` would accept the scene.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        self.problems.is_empty()
    }

    /// 0 for a usable scene, 2 otherwise.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        if self.is_usable() { 0 } else { 2 }
    }
}

/// Loads a scene, reads every pixel of it, and reports what is there and what is wrong.
#[must_use]
pub fn check(path: impl AsRef<Path>, options: &LoadOptions) -> CheckReport {
    let (mut report, scene) = load_for_check(path, options);
    if let Some(scene) = scene {
        check_scene(&scene, &mut report);
    }
    report
}

/// The first half of [`check`]: the scene if it can be loaded, or a report of why not.
#[must_use]
pub fn load_for_check(
    path: impl AsRef<Path>,
    options: &LoadOptions,
) -> (CheckReport, Option<Scene>) {
    let path = path.as_ref();
    let mut report = CheckReport {
        path: path.display().to_string(),
        ..CheckReport::default()
    };
    match Scene::load(path, options) {
        Ok(scene) => {
            report.warnings.clone_from(&scene.warnings);
            (report, Some(scene))
        }
        Err(e) => {
            report.problems = messages(&e);
            (report, None)
        }
    }
}

/// The second half of [`check`]: reads every pixel of a loaded scene.
pub fn check_scene(scene: &Scene, report: &mut CheckReport) {
    match EmbreeTracer::new(&scene.mesh) {
        Ok(tracer) => check_loaded(scene, &tracer, report),
        Err(e) => report.problems.push(e.to_string()),
    }
}

fn messages(e: &Error) -> Vec<String> {
    match e {
        Error::Inputs(all) => all.iter().flat_map(messages).collect(),
        e => vec![e.to_string()],
    }
}

/// [`check`] for a scene in memory and any tracer.
pub fn check_loaded(scene: &Scene, tracer: &dyn Tracer, report: &mut CheckReport) {
    let look = |v: &View| look_at(scene, v, tracer);
    let views = scene.decoding().map(&scene.views, look);
    let mut findings = Vec::new();
    for v in views {
        match v {
            Ok(f) => findings.push(f),
            Err(e) => report.problems.extend(messages(&e)),
        }
    }
    let mut summary = Summary {
        train_views: scene.train_views().count(),
        test_views: scene.test_views().count(),
        images: image_kinds(scene),
        mesh: mesh_summary(scene),
        radiance: radiance_range(&findings),
        unread_views: scene.views.len() - findings.len(),
        unseen_area_share: unseen_share(scene, tracer),
        rooms_given: scene.rooms.is_some(),
        mesh_classes: scene.mesh_classes.as_ref().map(MeshClasses::source),
        ..Summary::default()
    };
    summary.recorded_light = recorded_light(scene, &findings);
    summary.frames = findings.iter().map(|f| f.account.clone()).collect();
    let total: f64 = findings
        .iter()
        .filter(|f| f.train)
        .map(|f| f.solid_angle)
        .sum();
    summary.hole_share = findings
        .iter()
        .filter(|f| f.train)
        .map(|f| f.holes)
        .sum::<f64>()
        / total.max(f64::MIN_POSITIVE)
        + 0.0;
    (summary.classes, summary.unlabelled_share) = class_shares(scene, &findings);
    let labelled: f64 = findings
        .iter()
        .filter(|f| f.labelled)
        .map(|f| f.solid_angle)
        .sum();
    summary.unlabelled_surface_share = findings.iter().map(|f| f.unlabelled_surface).sum::<f64>()
        / labelled.max(f64::MIN_POSITIVE);
    let found;
    let grid = match &scene.rooms {
        Some(g) => g,
        None => {
            found = find_rooms(scene, tracer);
            &found
        }
    };
    summary.rooms = room_summaries(scene, grid);
    let sizes = findings.iter().filter(|f| f.train && f.pixel_size > 0.0);
    let size = median(sizes.map(|f| f.pixel_size).collect());
    summary.pixels_per_metre = size.map_or(0.0, |s| 1.0 / f64::from(s));
    // nothing is concluded from images that could not be read
    if summary.unread_views == 0 {
        warn(scene, &summary, &findings, &mut report.warnings);
    }
    let black = |f: &ViewFindings| f.luminances.iter().all(|&l| l <= 0.0);
    if !findings.is_empty() && findings.iter().filter(|f| f.train).all(black) {
        report.problems.push(super::all_black(scene).to_string());
    }
    report.summary = Some(summary);
}

/// What the training views lack of the light.
fn recorded_light(scene: &Scene, findings: &[ViewFindings]) -> Option<RecordedLight> {
    let views: Vec<&ClippedView> = (findings.iter().filter(|f| f.train))
        .map(|f| &f.clipped)
        .collect();
    RecordedLight::of(&views, |id| {
        scene.class(id).map_or(String::new(), |c| c.name.clone())
    })
}

/// What one view contributes.
struct ViewFindings {
    account: FrameAccount,
    stem: String,
    train: bool,
    labelled: bool,
    luminances: Vec<f32>,
    negative: usize,
    not_finite: usize,
    solid_angle: f64,
    holes: f64,
    unlabelled_surface: f64,
    class_angle: BTreeMap<u16, f64>,
    /// Side of a pixel on what the view shows, median, metres; 0 if it shows nothing.
    pixel_size: f32,
    /// What is at the ceiling.
    clipped: ClippedView,
    /// (triangle, class, rays).
    votes: BTreeMap<(u32, u16), u32>,
}

/// A regular lattice of rays in an image's aspect.
struct Lattice {
    columns: usize,
    rows: usize,
    /// Places in the image, row by row.
    pixels: Vec<Vec2>,
    rays: Vec<Ray>,
}

impl Lattice {
    fn of(camera: &Camera) -> Self {
        let rows = ((RAYS_PER_VIEW * camera.height / camera.width) as f32)
            .sqrt()
            .ceil()
            .max(1.0) as usize;
        let columns = RAYS_PER_VIEW.div_ceil(rows);
        let pixels: Vec<Vec2> = (0..rows * columns)
            .map(|i| {
                Vec2::new((i % columns) as f32 + 0.5, (i / columns) as f32 + 0.5)
                    / Vec2::new(columns as f32, rows as f32)
            })
            .map(|p| p * Vec2::new(camera.width as f32, camera.height as f32))
            .collect();
        let ray = |&p: &Vec2| Ray::new(camera.position, camera.direction(p), f32::INFINITY);
        Self {
            columns,
            rows,
            rays: pixels.iter().map(ray).collect(),
            pixels,
        }
    }
}

fn look_at(scene: &Scene, view: &View, tracer: &dyn Tracer) -> Result<ViewFindings> {
    let radiance = scene.load_radiance_with_stats(view);
    let labels = scene.load_labels(view);
    let mask = scene.load_mask(view);
    // report every file's problem, not only the first
    let mut errors: Vec<Error> = Vec::new();
    let mut keep = |e: Error| errors.push(e);
    let radiance = radiance.map_err(&mut keep).ok();
    let labels = labels.map_err(&mut keep).ok();
    let mask = mask.map_err(&mut keep).ok();
    let (Some((image, stats)), Some(labels), Some(mask), true) =
        (radiance, labels, mask, errors.is_empty())
    else {
        return Err(Error::Inputs(errors));
    };
    let camera = &view.camera;
    let Lattice {
        columns,
        rows,
        pixels,
        rays,
    } = Lattice::of(camera);
    let mut hits = vec![Hit::miss(); rays.len()];
    tracer.closest(&rays, &mut hits);
    let of_mesh = |m: &MeshClasses| {
        m.of_hits(&Plane {
            width: columns,
            height: rows,
            data: hits.iter().map(|h| h.triangle).collect(),
        })
    };
    let labels = labels.or_else(|| scene.mesh_classes.as_ref().map(of_mesh));
    let account = frame_account::account(scene, view, (&stats, mask.as_ref(), labels.as_ref()))?;
    let mut f = ViewFindings {
        account,
        stem: view.stem.clone(),
        train: view.split == Split::Train,
        labelled: labels.is_some(),
        luminances: subsampled(&image),
        negative: stats.negative,
        not_finite: stats.not_finite,
        solid_angle: 0.0,
        holes: 0.0,
        unlabelled_surface: 0.0,
        class_angle: BTreeMap::new(),
        pixel_size: 0.0,
        clipped: ClippedView::default(),
        votes: BTreeMap::new(),
    };
    let ceiling = scene.ceiling_bits(view, (&image, &stats))?;
    f.clipped = clipped_view(
        view,
        ceiling.as_ref(),
        labels.as_ref(),
        (&pixels, &rays, &hits),
    );
    let seen = pixels.iter().zip(&hits).filter(|(_, h)| h.is_hit());
    let sizes = seen.map(|(&p, h)| h.t * camera.pixel_solid_angle(p).sqrt());
    f.pixel_size = median(sizes.collect()).unwrap_or(0.0);
    for (&p, hit) in pixels.iter().zip(&hits) {
        let angle = f64::from(camera.pixel_solid_angle(p));
        f.solid_angle += angle;
        if !hit.is_hit() {
            f.holes += angle;
        }
        if let Some(labels) = &labels {
            let scale = Vec2::new(
                labels.width as f32 / camera.width as f32,
                labels.height as f32 / camera.height as f32,
            );
            let id = *labels.nearest(p * scale);
            *f.class_angle.entry(id).or_default() += angle;
            if hit.is_hit() {
                f.unlabelled_surface += if id == 0 { angle } else { 0.0 };
                *f.votes.entry((hit.triangle, id)).or_default() += 1;
            }
        }
    }
    Ok(f)
}

/// What rays through pixels find at the file's ceiling: nothing where it has none.
fn clipped_view(
    view: &View,
    ceiling: Option<&Plane<u8>>,
    labels: Option<&Plane<u16>>,
    (pixels, rays, hits): (&[Vec2], &[Ray], &[Hit]),
) -> ClippedView {
    let camera = &view.camera;
    let size = Vec2::new(camera.width as f32, camera.height as f32);
    let mut out = ClippedView {
        stem: view.stem.clone(),
        ..ClippedView::default()
    };
    for ((&p, ray), hit) in pixels.iter().zip(rays).zip(hits) {
        let angle = f64::from(camera.pixel_solid_angle(p));
        out.whole += angle;
        if ceiling.is_some_and(|c| *at(c, p, size) != 0) {
            let class = labels.map_or(0, |l| *at(l, p, size));
            let place = || Vec3::from(ray.origin) + Vec3::from(ray.direction) * hit.t;
            out.add(angle, hit.is_hit().then(place), class);
        }
    }
    out
}

/// What `plane` has where a camera of `size` pixels has pixel `p`.
fn at<T>(plane: &Plane<T>, p: Vec2, size: Vec2) -> &T {
    plane.nearest(p * Vec2::new(plane.width as f32, plane.height as f32) / size)
}

fn subsampled(image: &RgbPlane) -> Vec<f32> {
    // a stride that is odd walks through all columns of an image whose width is a power of two
    let step = (image.data.len() / PIXELS_PER_VIEW).max(1) | 1;
    image
        .data
        .iter()
        .step_by(step)
        .map(|&p| luminance(p))
        .collect()
}

fn image_kinds(scene: &Scene) -> Vec<ImageKind> {
    let mut kinds: BTreeMap<(&'static str, usize, usize), usize> = BTreeMap::new();
    for v in &scene.views {
        let projection = match v.camera.projection {
            Projection::Equirectangular => "panorama",
            Projection::Pinhole(_) => "pinhole",
        };
        *kinds
            .entry((projection, v.camera.width, v.camera.height))
            .or_default() += 1;
    }
    kinds
        .into_iter()
        .map(|((projection, width, height), views)| ImageKind {
            projection,
            width,
            height,
            views,
        })
        .collect()
}

fn mesh_summary(scene: &Scene) -> MeshSummary {
    let mesh = &scene.mesh;
    let (lo, hi) = mesh.bounds();
    let area = sum_f64(mesh.triangles.len(), |t| f64::from(mesh.area(t)));
    let covered = scene.mesh_stats.covered_texels as f64;
    MeshSummary {
        triangles: mesh.triangles.len(),
        vertices: mesh.positions.len(),
        min: (scene.origin + lo.as_dvec3()).to_array(),
        max: (scene.origin + hi.as_dvec3()).to_array(),
        area,
        atlas_fill: covered / (2048.0 * 2048.0),
        texels_per_metre: (covered / area.max(f64::MIN_POSITIVE)).sqrt(),
        details: scene.mesh_stats.clone(),
    }
}

fn radiance_range(findings: &[ViewFindings]) -> RadianceRange {
    let mut all: Vec<f32> = findings
        .iter()
        .filter(|f| f.train)
        .flat_map(|f| f.luminances.iter().copied())
        .collect();
    all.sort_by(f32::total_cmp);
    let quantile = |q: f64| {
        all.get((q * all.len().saturating_sub(1) as f64).round() as usize)
            .copied()
            .unwrap_or(0.0)
    };
    RadianceRange {
        min: quantile(0.0),
        median: quantile(0.5),
        p999: quantile(0.999),
        max: quantile(1.0),
        negative: findings.iter().map(|f| f.negative).sum(),
        not_finite: findings.iter().map(|f| f.not_finite).sum(),
    }
}

/// Pixel and mesh share of every class that is declared or occurs, and the unlabelled share.
fn class_shares(scene: &Scene, findings: &[ViewFindings]) -> (Vec<ClassShare>, f64) {
    let mut angle: BTreeMap<u16, f64> = BTreeMap::new();
    let mut votes: BTreeMap<u32, BTreeMap<u16, u32>> = BTreeMap::new();
    for f in findings {
        f.class_angle
            .iter()
            .for_each(|(id, a)| *angle.entry(*id).or_default() += a);
        f.votes
            .iter()
            .for_each(|((t, id), n)| *votes.entry(*t).or_default().entry(*id).or_default() += n);
    }
    let mut area: BTreeMap<u16, f64> = BTreeMap::new();
    for (t, ids) in &votes {
        if let Some((id, _)) = ids
            .iter()
            .max_by_key(|(id, n)| (**n, std::cmp::Reverse(**id)))
        {
            *area.entry(*id).or_default() += f64::from(scene.mesh.area(*t as usize));
        }
    }
    let total = |m: &BTreeMap<u16, f64>| m.values().sum::<f64>().max(f64::MIN_POSITIVE);
    let share = |m: &BTreeMap<u16, f64>, id: u16| m.get(&id).copied().unwrap_or(0.0) / total(m);
    let classes = scene
        .classes
        .iter()
        .map(|c| ClassShare {
            id: c.id,
            name: c.name.clone(),
            is_light: c.is_light,
            pixel_share: share(&angle, c.id),
            mesh_share: share(&area, c.id),
        })
        .collect();
    (classes, share(&angle, 0))
}

/// Share of the surface that no training view sees, by points spread evenly over the area.
fn unseen_share(scene: &Scene, tracer: &dyn Tracer) -> f64 {
    let mesh = &scene.mesh;
    let areas: Vec<f64> = (0..mesh.triangles.len())
        .map(|t| f64::from(mesh.area(t)))
        .collect();
    let Some(table) = AliasTable::new(&areas) else {
        return 0.0;
    };
    let (lo, hi) = mesh.bounds();
    let offset = 1e-4 * (hi - lo).length();
    let chunks = crate::core::parallel::map_chunks(SURFACE_POINTS, 1000, |range| {
        let mut open: Vec<(Vec3, Vec3)> = range
            .map(|i| {
                let mut rng = KeyedRng::new(0x5ee0, i as u64);
                let t = table.sample(rng.next_f32()).0;
                let (a, b) = (rng.next_f32().sqrt(), rng.next_f32());
                (mesh.position(t, a * (1.0 - b), a * b), mesh.face_normal(t))
            })
            .collect();
        for view in scene.train_views() {
            let camera = &view.camera;
            let (candidates, rays): (Vec<usize>, Vec<Ray>) = open
                .iter()
                .enumerate()
                .filter(|(_, (p, _))| camera.project(*p).is_some())
                .map(|(i, (p, n))| {
                    let to = camera.position - *p;
                    let start = *p + *n * (offset * to.dot(*n).signum());
                    let to = camera.position - start;
                    (i, Ray::new(start, to.normalize_or_zero(), to.length()))
                })
                .unzip();
            let mut occluded = vec![0u8; rays.len()];
            tracer.occluded(&rays, &mut occluded);
            let mut seen = vec![false; open.len()];
            candidates
                .iter()
                .zip(&occluded)
                .for_each(|(&i, &o)| seen[i] = o == 0);
            let mut i = 0;
            open.retain(|_| (!seen[i], i += 1).0);
        }
        open.len()
    });
    chunks.into_iter().sum::<usize>() as f64 / SURFACE_POINTS as f64
}

fn room_summaries(scene: &Scene, grid: &RoomGrid) -> Vec<RoomSummary> {
    let mut cells: BTreeMap<u16, usize> = BTreeMap::new();
    grid.cells
        .data
        .iter()
        .filter(|id| **id != 0)
        .for_each(|id| *cells.entry(*id).or_default() += 1);
    let cell = f64::from(grid.cell);
    let cameras = |id: u16| {
        scene
            .train_views()
            .filter(|v| grid.room_at(v.camera.position) == id)
            .count()
    };
    cells
        .into_iter()
        .map(|(id, n)| RoomSummary {
            id,
            area: n as f64 * cell * cell,
            train_views: cameras(id),
        })
        .collect()
}

fn warn(scene: &Scene, s: &Summary, findings: &[ViewFindings], warnings: &mut Vec<String>) {
    warnings.extend(frame_account::warnings(&s.frames));
    if s.radiance.negative > 0 {
        warnings.push(format!(
            "{} pixels have negative values, which count as 0",
            s.radiance.negative
        ));
    }
    if s.radiance.not_finite > 0 {
        warnings.push(format!(
            "{} pixels are NaN, and left out, or infinite, and taken for clipped light",
            s.radiance.not_finite
        ));
    }
    warn_of_photographs(findings, warnings);
    warn_of_views(scene, warnings);
    if s.train_views < 3 {
        warnings.push(format!(
            "{} training views: highlights cannot be told from paint; take at least 3 per room",
            s.train_views
        ));
    }
    if s.hole_share > 0.02 {
        warnings.push(format!(
            "{:.1} % of the camera rays hit no geometry; their light becomes a distant environment",
            100.0 * s.hole_share
        ));
    }
    if s.unseen_area_share > 0.25 {
        // (half the surface of closed bodies is turned away from any place)
        let cure = if s.unseen_area_share > 0.5 {
            ", and it takes that share of the atlas: remove ground planes and what lies outside the rooms from the mesh"
        } else {
            ""
        };
        warnings.push(format!(
            "{:.0} % of the surface is seen by no training view; its materials are filled in{cure}",
            100.0 * s.unseen_area_share
        ));
    }
    if s.mesh.texels_per_metre * COARSER < s.pixels_per_metre {
        warnings.push(format!(
            "the atlas has {:.1} texels per metre of surface (at 2048²) where the photographs show {:.0} pixels per metre: most of it goes to surface of which they show little ({:.0} m² in all)",
            s.mesh.texels_per_metre, s.pixels_per_metre, s.mesh.area
        ));
    }
    warn_of_labels(s, findings, warnings);
    for r in s.rooms.iter().filter(|r| r.train_views == 0) {
        warnings.push(format!(
            "room {} ({:.1} m²) holds no training camera",
            r.id, r.area
        ));
    }
}

/// Photographs that show nothing, and those that several frames have.
fn warn_of_photographs(findings: &[ViewFindings], warnings: &mut Vec<String>) {
    let mut same: BTreeMap<Vec<u32>, Vec<&str>> = BTreeMap::new();
    for f in findings {
        let stem = &f.stem;
        if f.luminances.iter().all(|&l| l <= 0.0) {
            warnings.push(format!(
                "{stem}: the image is black; its exposure or its file is wrong"
            ));
        } else if f.luminances.iter().all(|l| *l == f.luminances[0]) {
            warnings.push(format!(
                "{stem}: the image has one value everywhere; its file is wrong, or all of it is clipped"
            ));
        } else {
            let bits = f.luminances.iter().map(|l| l.to_bits()).collect();
            same.entry(bits).or_default().push(stem);
        }
    }
    for stems in same.values().filter(|stems| stems.len() > 1) {
        warnings.push(format!(
            "views {} have the same photograph; all of their poses but one are wrong, or it is there twice",
            enumerated(stems)
        ));
    }
}

/// Panoramas that stand at one place, a line for all that do.
fn warn_of_views(scene: &Scene, warnings: &mut Vec<String>) {
    let (lo, hi) = scene.mesh.bounds();
    let near = 1e-3 * (hi - lo).length();
    let mut open: Vec<&View> = (scene.views.iter())
        .filter(|v| v.camera.projection == Projection::Equirectangular)
        .collect();
    while !open.is_empty() {
        let place = open[0].camera.position;
        let here = |v: &&View| v.camera.position.distance(place) < near;
        let (together, others): (Vec<&View>, Vec<&View>) = open.into_iter().partition(here);
        open = others;
        if together.len() > 1 {
            let stems: Vec<&str> = together.iter().map(|v| v.stem.as_str()).collect();
            warnings.push(format!(
                "views {} stand at the same place and add little to one another",
                enumerated(&stems)
            ));
        }
    }
}

/// Names as a sentence has them, the first few of many.
fn enumerated(names: &[&str]) -> String {
    const SHOWN: usize = 6;
    match names {
        [] => String::new(),
        [one] => (*one).to_owned(),
        [few @ .., last] if names.len() <= SHOWN => format!("{} and {last}", few.join(", ")),
        many => format!(
            "{} and {} more",
            many[..SHOWN - 1].join(", "),
            many.len() + 1 - SHOWN
        ),
    }
}

/// Labels that are absent, and classes that no ray meets.
fn warn_of_labels(s: &Summary, findings: &[ViewFindings], warnings: &mut Vec<String>) {
    let labelled = findings.iter().filter(|f| f.labelled).count();
    if labelled == 0 {
        warnings.push(
            "no label images: surface is told apart by shape and look (solve --segments), and roughness is found less well"
                .into(),
        );
    } else if labelled < findings.len() {
        warnings.push(format!(
            "{} of {} views have no label image",
            findings.len() - labelled,
            findings.len()
        ));
    }
    if s.unlabelled_surface_share > 0.05 {
        warnings.push(format!(
            "{:.0} % of the labelled views' solid angle shows geometry without a class (label 0); such surfaces count as one unknown class",
            100.0 * s.unlabelled_surface_share
        ));
    }
    let absent: Vec<String> = s
        .classes
        .iter()
        .filter(|c| c.pixel_share == 0.0)
        .map(|c| format!("{} ({})", c.id, c.name))
        .collect();
    if labelled > 0 && !absent.is_empty() {
        warnings.push(format!("classes met by no ray: {}", absent.join(", ")));
    }
}
