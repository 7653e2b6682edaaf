//! What a reconstruction takes of main memory at most, told before it begins, and photographs reduced
//! until it fits: a run that cannot keep its promise is refused, not killed hours later.

use super::SolveOptions;
use crate::core::memory::written_bytes;
use crate::core::progress::Progress;
use crate::inverse::MOST_TERMS;
use crate::scene::Scene;
use crate::{Error, Result};
use std::fmt;

/// Libraries, threads and what every run has. Measured, as all that follow: `scripts/memory_growth`
/// fits the peaks of runs that differ in one thing; these are upper bounds of its slopes.
const PROGRAM: f64 = 170e6;
/// Bytes a triangle: the mesh with its tree of boxes, winding, neighbours.
const PER_TRIANGLE: f64 = 340.0;
/// Bytes a covered texel of the albedo texture: position, fused looks, materials.
const PER_ALBEDO_TEXEL: f64 = 270.0;
/// Bytes a covered texel of the irradiance texture, the filter's included.
const PER_IRRADIANCE_TEXEL: f64 = 700.0;
/// Bytes a texel of the roughness texture, covered or not.
const PER_ROUGHNESS_TEXEL: f64 = 9.0;
/// Bytes a pixel of the reduced photographs. Derived: radiance 12, reflected part 12, triangle 4,
/// distance 4, label 2, a byte each of masks, clean pixels, ceilings.
const PER_PIXEL: f64 = 37.0;
/// Bytes a pixel of photographs made for a screen takes more: lower bounds of the light.
const PER_CLIPPED_PIXEL: f64 = 4.0;
/// Bytes a pixel at an edge, and of the terms that tell of the texels it mixes.
const PER_EDGE_PIXEL: f64 = 20.0;
/// See [`PER_EDGE_PIXEL`].
const PER_EDGE_TERMS: f64 = 130.0;
/// Bytes of such a term, of which no more than [`MOST_TERMS`] are kept. Derived: from its fields.
const PER_TERM: f64 = 16.0;
/// Pixels at edges per column of a view: edges are lines, so that there are the more the finer a view is,
/// but not with its area.
const EDGE_PIXELS_PER_COLUMN: f64 = 60.0;
/// Looks at a point that is searched for roughness, on average.
const LOOKS: f64 = 4.0;
/// Bytes a look and level of roughness. Derived: two lobes, three channels and a noise each.
const PER_LEVEL: f64 = 2.0 * 16.0;

/// What is promised over what is expected. Measured: peaks of `scripts/memory_growth` lie within.
const MARGIN: f64 = 1.1;

/// Photographs are not reduced below so many rows. Derived: those that the alignment test itself looks
/// at; what it cannot see nobody should believe.
const FEWEST_ROWS: usize = 96;
/// The largest factor, that of `--photo-reduction`.
const MOST_REDUCED: usize = 64;

/// Bytes of main memory that a reconstruction takes at most, by cause.
#[derive(Clone, Copy, Debug, PartialEq)]
struct MemoryNeed {
    /// The program and its mesh.
    mesh: f64,
    /// Everything of the texels.
    textures: f64,
    /// What is looked at in search of roughness.
    highlights: f64,
    /// Everything of the photographs at their reduced size.
    photographs: f64,
    /// Photographs under decoding, at their full size.
    decoding: f64,
}

impl MemoryNeed {
    /// Of a scene, with textures as large as allowed and photographs reduced as `options` say.
    fn of(scene: &Scene, options: &SolveOptions) -> Self {
        let texels = |side: usize| (side as f64).powi(2);
        let points = 2.0 * (options.evidence_points * scene.classes.len().max(1)) as f64;
        let of_atlas = PER_ALBEDO_TEXEL * texels(options.albedo_size)
            + PER_IRRADIANCE_TEXEL * texels(options.irradiance_size);
        let decoding = scene.decoding();
        let at_once = decoding.at_once.min(scene.views.len()) as f64;
        Self {
            mesh: MARGIN * (PROGRAM + PER_TRIANGLE * scene.mesh.triangles.len() as f64),
            textures: MARGIN
                * (scene.mesh.covered_share() * of_atlas
                    + PER_ROUGHNESS_TEXEL * texels(options.roughness_size)),
            highlights: MARGIN * points * LOOKS * options.roughness_levels as f64 * PER_LEVEL,
            photographs: photographs(scene, options.photo_reduction),
            decoding: at_once * decoding.each as f64,
        }
    }

    /// With photographs reduced otherwise.
    fn reduced(self, scene: &Scene, reduction: usize) -> Self {
        Self {
            photographs: photographs(scene, reduction),
            ..self
        }
    }

    /// All in all. Photographs are decoded, a few at a time, before there are textures.
    fn bytes(&self) -> u64 {
        let passing = self.decoding.max(self.textures + self.highlights);
        (self.mesh + self.photographs + passing) as u64
    }
}

/// What the training views take, reduced by a factor.
fn photographs(scene: &Scene, reduction: usize) -> f64 {
    let r = reduction.max(1);
    let (mut pixels, mut edges) = (0.0, 0.0);
    for v in scene.train_views() {
        let (columns, rows) = ((v.camera.width / r).max(1), (v.camera.height / r).max(1));
        let clipped = f64::from(u8::from(v.account.is_display_referred()));
        pixels += (columns * rows) as f64 * (PER_PIXEL + clipped * PER_CLIPPED_PIXEL);
        edges += columns as f64 * EDGE_PIXELS_PER_COLUMN;
    }
    let of_edges =
        PER_EDGE_PIXEL * edges + (PER_EDGE_TERMS * edges).min(PER_TERM * MOST_TERMS as f64);
    MARGIN * (pixels + of_edges)
}

impl fmt::Display for MemoryNeed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let part = |bytes: f64| written_bytes(bytes as u64);
        write!(
            f,
            "{}: mesh {}, textures {}, highlights {}, photographs {}; {} while they are decoded",
            written_bytes(self.bytes()),
            part(self.mesh),
            part(self.textures),
            part(self.highlights),
            part(self.photographs),
            part(self.decoding)
        )
    }
}

/// By how much photographs are to be reduced so that the run fits into the memory that was
/// promised, or the machine's.
///
/// # Errors
/// It cannot fit into what was promised.
pub fn fitting_reduction(
    scene: &Scene,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<usize> {
    let asked = options.photo_reduction.max(1);
    let promised = scene.options.memory;
    if options.published.is_some() {
        return match promised {
            None => Ok(asked),
            Some(_) => Err(Error::Usage(
                "solve: --memory: what --quality paper takes cannot be told beforehand; leave one of them out".into(),
            )),
        };
    }
    let Some(limit) = scene.options.memory_limit() else {
        return Ok(asked);
    };
    let rows = scene.train_views().map(|v| v.camera.height).min();
    let most = match options.fit.photographs {
        true => (rows.unwrap_or(0) / FEWEST_ROWS).clamp(asked, MOST_REDUCED.max(asked)),
        false => asked,
    };
    let need = MemoryNeed::of(scene, options);
    let need_at = |reduction: usize| need.reduced(scene, reduction);
    let fitting = (asked..=most).find(|r| need_at(*r).bytes() <= limit);
    let of = written_bytes(limit);
    let Some(reduction) = fitting else {
        let need = need_at(most);
        if promised.is_none() {
            progress.note(format!(
                "memory: the machine's {of} may not suffice for {need}"
            ));
            return Ok(most);
        }
        let way_out = match options.fit.photographs {
            true => "lower --albedo-size and --irradiance-size, decimate the mesh, or allow more",
            false => "leave out --photo-reduction, or allow more",
        };
        return Err(Error::Usage(format!(
            "solve: --memory {of} does not suffice: with photographs reduced by {most} it takes up to {need}; {way_out}"
        )));
    };
    if reduction > asked {
        let why = format!("of {of}; else it would be {need}");
        let what = format!(
            "photographs reduced by {reduction}; at most {}",
            need_at(reduction)
        );
        progress.decide("memory", what, why, false);
    } else if promised.is_some() {
        let why = format!("of {of}");
        progress.decide("memory", format!("at most {need}"), why, false);
    }
    Ok(reduction)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::formats::ImageAccount;
    use crate::core::geometry::{Camera, Mesh, Projection};
    use crate::core::progress::{Decision, Observer};
    use crate::scene::{Split, View};
    use glam::{DVec3, Mat3, Vec2, Vec3};
    use std::path::PathBuf;
    use std::sync::{Arc, Mutex};

    const GIB: u64 = 1 << 30;

    /// Panoramas of so many columns of a mesh that fills half its atlas.
    fn scene(views: usize, columns: usize, memory: Option<u64>) -> Scene {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            normals: vec![Vec3::Z; 3],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::Y],
            triangles: vec![[0, 1, 2]],
        };
        let view = |i: usize| View {
            stem: i.to_string(),
            camera: Camera {
                projection: Projection::Equirectangular,
                width: columns,
                height: columns / 2,
                world_from_camera: Mat3::IDENTITY,
                position: Vec3::ZERO,
            },
            image_path: PathBuf::new(),
            label_path: None,
            mask_path: None,
            exposure_ev: 0.0,
            split: Split::Train,
            colour_space: None,
            account: ImageAccount::default(),
        };
        let views = (0..views).map(view).collect();
        let mut scene = Scene::from_parts(PathBuf::new(), DVec3::ZERO, mesh, Vec::new(), views);
        scene.options.memory = memory;
        scene
    }

    #[derive(Default)]
    struct Heard(Mutex<Vec<Decision>>);

    impl Observer for Heard {
        fn stage_started(&self, _: &str, _: u64) {}
        fn stage_advanced(&self, _: u64) {}
        fn stage_finished(&self) {}
        fn note(&self, _: &str) {}
        fn decided(&self, decision: &Decision) {
            self.0.lock().expect("no panic").push(decision.clone());
        }
    }

    fn options() -> SolveOptions {
        let mut options = SolveOptions::default();
        options.fit.photographs = true;
        options
    }

    fn reduction(scene: &Scene, options: &SolveOptions) -> Result<usize> {
        fitting_reduction(scene, options, &Progress::silent())
    }

    /// The capture of the largest cameras for rooms: no memory of a desk holds it at full size.
    #[test]
    fn photographs_are_reduced_no_more_than_memory_asks_for() {
        let of = |gib: u64| scene(100, 6720, Some(gib * GIB));
        let mut before = 1;
        for gib in [512, 64, 32, 16, 8, 6] {
            let scene = of(gib);
            let r = reduction(&scene, &options()).expect("fits");
            let need = |r: usize| {
                let reduced = SolveOptions {
                    photo_reduction: r,
                    ..options()
                };
                MemoryNeed::of(&scene, &reduced).bytes()
            };
            assert!(need(r) <= gib * GIB, "{gib} GiB, by {r}");
            assert!(r == 1 || need(r - 1) > gib * GIB, "{gib} GiB, by {r}");
            assert!(r >= before, "less memory, larger photographs");
            before = r;
        }
        assert_eq!(reduction(&of(512), &options()).ok(), Some(1));
        assert!(before > 2);
        // at full size the pixels alone: what is derived, and no more than the margin on top
        let full = MemoryNeed::of(&of(512), &options()).photographs;
        let pixels = 100.0 * 6720.0 * 3360.0;
        assert!((37.0..45.0).contains(&(full / pixels)), "{full}");
    }

    #[test]
    fn what_cannot_fit_is_refused_with_the_causes_and_a_way_out() {
        let told = |options: &SolveOptions, scene: &Scene| {
            let error = reduction(scene, options).expect_err("too little");
            error.to_string()
        };
        let small = scene(100, 6720, Some(GIB));
        let message = told(&options(), &small);
        for part in [
            "--memory 1.00 GiB",
            "textures",
            "photographs",
            "--albedo-size",
        ] {
            assert!(message.contains(part), "{message}");
        }
        // a size that was given is kept
        let exact = SolveOptions {
            photo_reduction: 2,
            fit: super::super::Fit::default(),
            ..options()
        };
        let message = told(&exact, &scene(100, 6720, Some(8 * GIB)));
        assert!(message.contains("leave out --photo-reduction"), "{message}");
        let paper = SolveOptions::preset(super::super::Quality::Paper);
        assert!(told(&paper, &small).contains("--quality paper"));
    }

    #[test]
    fn what_fits_stays_as_it_is_and_a_promise_is_told() {
        for (memory, told) in [(None, 0), (Some(64 * GIB), 1)] {
            let heard = Arc::new(Heard::default());
            let progress = Progress::new(heard.clone());
            let r = fitting_reduction(&scene(4, 64, memory), &options(), &progress);
            assert_eq!(r.ok(), Some(1));
            assert_eq!(heard.0.lock().expect("no panic").len(), told);
        }
        let preview = SolveOptions::preset(super::super::Quality::Preview);
        assert_eq!(reduction(&scene(4, 64, None), &preview).ok(), Some(4));
    }
}
