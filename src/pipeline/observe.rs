//! The first stage: the training views are read, the exposure of each is taken out, and what they
//! see is fused on the atlas.

use super::SolveOptions;
use super::decisions::choose_sizes;
use super::panes::{Cleared, clear_panes};
use crate::Result;
use crate::core::geometry::Camera;
use crate::core::image::{CameraMask, Plane, RgbPlane};
use crate::core::progress::Progress;
use crate::core::stats::MAD_SCALE;
use crate::core::texture::{SurfacePoint, Texels};
use crate::core::trace::EmbreeTracer;
use crate::gbuffer::{ObservedView, Observer, Orientation, ViewBuffer};
use crate::observed::{
    Contradictions, Fusion, Panes, Surface, balance_views, complete_labels, find_camera_rigs,
    fuse_radiance, leave_out_clipped_sky,
};
use crate::scene::{EIGHT_BIT, MeshClasses, Scene, Shortfall, View, all_black, all_masked};
use glam::Vec3;
use std::time::Instant;

/// Reads the training views and fuses what they see.
///
/// # Errors
/// Unreadable or unusable images and labels.
pub fn observe<'a>(
    scene: &'a Scene,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Surface<'a>> {
    let whole = EmbreeTracer::new(&scene.mesh)?;
    let mut read = read_views(scene, &whole, options, progress)?;
    let Cleared { tracer, panes } = clear_panes(scene, whole, &mut read.views, options, progress)?;
    let mut views = read.views;
    let (lo, hi) = scene.mesh.bounds();
    // a tenth of a millimetre in a ten-metre room, well above the rounding of positions
    let offset = (hi - lo).length() * 1e-5;
    let orientation = Orientation::find(
        &scene.mesh,
        &views.iter().map(|v| &v.buffer).collect::<Vec<_>>(),
        &tracer,
        offset,
    );
    report_orientation(&orientation, scene.mesh.triangles.len(), progress);
    leave_out_clipped_sky(&mut views, &read.ceilings);
    let camera_masks = mask_rigs(scene, &mut views, &orientation, options, progress);
    let balanced = balance_views(scene, &mut views, &orientation, options.exposure, progress);
    let observer = Observer {
        mesh: &scene.mesh,
        views: &views,
    };
    let sizes = choose_sizes(&observer, &orientation, options, progress);
    let texels = Texels::rasterize(&scene.mesh, sizes.albedo, sizes.albedo);
    let begin = Instant::now();
    let mut fusion = options.checkpoints.reuse("radiance", progress, || {
        progress.stage("radiance", texels.len() as u64, |p| {
            fuse_radiance(&observer, &orientation, &texels, p)
        })
    });
    // beside a pane's edge views see its frame
    panes.texels(&texels).for_each(|(i, _)| fusion.forget(i));
    if let Some(budget) = &options.budget {
        budget.fused(begin.elapsed().as_secs_f64());
    }
    // contradicted texels state their disagreement as their own error
    let mut contradictions = Contradictions::default();
    let mut disagreement = MAD_SCALE * balanced.disagreement;
    if balanced.rough {
        contradictions = find_contradictions(&observer, &orientation, &texels, scene, progress);
        disagreement = contradictions.agreed;
    }
    contradictions.settle(&mut fusion.radiance);
    let labels = texel_labels(scene, &texels, &fusion, &panes);
    let back = back_radiance(scene, &views, &orientation);
    Ok(Surface {
        scene,
        tracer,
        panes,
        views,
        ceilings: read.ceilings,
        bounds: Vec::new(),
        shortfalls: read.shortfalls,
        orientation,
        sizes,
        texels,
        fusion,
        labels,
        back,
        contradictions,
        clipped: Vec::new(),
        encoded: read.encoded,
        ambient: Vec3::ZERO,
        camera_masks,
        offset,
        disagreement,
    })
}

/// The class of every texel: the mesh's own, or what the views vote for; panes have been looked
/// through since they had theirs.
fn texel_labels(scene: &Scene, texels: &Texels, fusion: &Fusion, panes: &Panes) -> Vec<u16> {
    if let Some(of) = &scene.mesh_classes {
        let class = |p: &SurfacePoint| of.of_triangle[p.triangle as usize];
        return texels.point.iter().map(class).collect();
    }
    let mut labels = complete_labels(&scene.mesh, texels, fusion);
    panes
        .texels(texels)
        .for_each(|(i, pane)| labels[i] = pane.class);
    labels
}

/// The training views as read, before anything is taken out of them.
struct ReadViews {
    views: Vec<ObservedView>,
    /// Channels at the sensor's ceiling per pixel; `None` where a view has no ceiling.
    ceilings: Vec<Option<Plane<u8>>>,
    /// What of the light the files may lack.
    shortfalls: Vec<Shortfall>,
    /// All of them are made for a screen.
    encoded: bool,
}

/// Reads the training views and traces what their pixels see.
fn read_views(
    scene: &Scene,
    tracer: &EmbreeTracer,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<ReadViews> {
    let train: Vec<&View> = scene.train_views().collect();
    let read = progress.stage("views", train.len() as u64, |p| {
        scene.decoding().map(&train, |view| {
            let read = read_view(scene, view, tracer, options);
            p.advance(1);
            read
        })
    });
    let (mut views, mut encoded) = (Vec::with_capacity(train.len()), true);
    let (mut ceilings, mut shortfalls) = (Vec::new(), Vec::new());
    for read in read {
        let read = read?;
        read.notes.into_iter().for_each(|n| progress.note(n));
        views.push(read.view);
        ceilings.push(read.ceiling);
        shortfalls.push(read.shortfall);
        encoded &= read.encoded;
    }
    let dark = |v: &ObservedView| v.radiance.data.iter().all(|p| *p == Vec3::ZERO);
    if views.iter().all(dark) {
        return Err(all_black(scene));
    }
    let masked = |v: &ObservedView| v.valid.as_ref().is_some_and(|m| !m.data.contains(&true));
    if views.iter().all(masked) {
        return Err(all_masked(scene));
    }
    Ok(ReadViews {
        views,
        ceilings,
        shortfalls,
        encoded,
    })
}

/// One view as read.
struct ReadView {
    view: ObservedView,
    /// Its pixels at the sensor's ceiling, if it has one.
    ceiling: Option<Plane<u8>>,
    shortfall: Shortfall,
    /// It is made for a screen.
    encoded: bool,
    /// What is to be told of it.
    notes: Vec<String>,
}

fn read_view(
    scene: &Scene,
    view: &View,
    tracer: &EmbreeTracer,
    options: &SolveOptions,
) -> Result<ReadView> {
    let (full, stats) = scene.load_radiance_with_stats(view)?;
    let mut notes = Vec::new();
    if stats.eight_bit {
        notes.push(format!("{}: {EIGHT_BIT}", view.stem));
    }
    let ceiling = scene
        .ceiling_bits(view, (&full, &stats))?
        .map(|c| blocks(&c, options.photo_reduction.max(1), |a, b| a | b));
    let radiance = reduced(full, options.photo_reduction);
    let buffer = ViewBuffer::trace(
        &view.camera.resized(radiance.width, radiance.height),
        tracer,
    );
    let of_mesh = |m: &MeshClasses| m.of_hits(&buffer.triangle);
    let labels = scene.load_labels(view)?;
    let labels = labels.or_else(|| scene.mesh_classes.as_ref().map(of_mesh));
    let shortfall = Shortfall::of(scene, view, &stats, labels.as_ref())?;
    let valid = scene
        .load_mask(view)?
        .map(|m| all_valid(&m, options.photo_reduction));
    let labels = labels.map(|l| thinned(l, radiance.width));
    let mut clean = buffer.clean_pixels(&scene.mesh, labels.as_ref());
    if let Some(at) = &ceiling {
        // a lower bound: used only where no other look is at hand
        clean
            .data
            .iter_mut()
            .zip(&at.data)
            .for_each(|(clean, clipped)| *clean &= *clipped == 0);
        let share = at.data.iter().filter(|c| **c != 0).count() as f64 / at.data.len() as f64;
        notes.push(format!(
            "{}: {:.2} % of the pixels are clipped",
            view.stem,
            100.0 * share
        ));
    }
    let observed = ObservedView {
        buffer,
        radiance,
        clean,
        labels,
        valid,
    };
    Ok(ReadView {
        view: observed,
        ceiling,
        shortfall,
        encoded: view.encoded_ceiling(&stats).is_some(),
        notes,
    })
}

/// Where the views contradict each other, and a note on the places.
fn find_contradictions(
    observer: &Observer,
    orientation: &Orientation,
    texels: &Texels,
    scene: &Scene,
    progress: &Progress,
) -> Contradictions {
    let mesh = &scene.mesh;
    let found = progress.stage("missing geometry", 1, |_| {
        Contradictions::find(observer, orientation, texels)
    });
    let places = found.places(mesh, texels, scene.origin);
    let list: Vec<String> = places
        .iter()
        .map(|m| {
            let p = m.place;
            format!("({:.1}, {:.1}, {:.1}): {:.1} m²", p.x, p.y, p.z, m.area)
        })
        .collect();
    progress.note(format!(
        "geometry is missing: on {:.0} % of the surface the views contradict each other; most at {}",
        100.0 * found.share(mesh, texels),
        list.join(", ")
    ));
    found
}

/// Masks what the cameras carry along in all training views.
fn mask_rigs(
    scene: &Scene,
    views: &mut [ObservedView],
    orientation: &Orientation,
    options: &SolveOptions,
    progress: &Progress,
) -> Vec<CameraMask> {
    let mesh = &scene.mesh;
    let cameras: Vec<&Camera> = scene.train_views().map(|v| &v.camera).collect();
    let rigs = progress.stage("what moves with the camera", 1, |_| {
        find_camera_rigs(&Observer { mesh, views }, orientation, &cameras)
    });
    for rig in &rigs {
        let visible = all_valid(&rig.mask.visible, options.photo_reduction);
        for v in &rig.views {
            let view = &mut views[*v];
            let valid = view.valid.get_or_insert_with(|| visible.map(|_| true));
            let both = valid.data.iter_mut().zip(&visible.data);
            both.for_each(|(valid, visible)| *valid &= visible);
        }
        progress.decide(
            "what moves with the camera",
            format!(
                "{:.1} % of the image masked",
                100.0 * rig.mask.masked_share()
            ),
            rig.evidence(),
            false,
        );
    }
    rigs.into_iter().map(|r| r.mask).collect()
}

/// Says how many triangles face against their winding, and how many are seen from both sides.
fn report_orientation(orientation: &Orientation, triangles: usize, progress: &Progress) {
    if orientation.flipped() > 0 {
        progress.note(format!(
            "{} of {triangles} triangles face the cameras against their winding; their normals are turned",
            orientation.flipped(),
        ));
    }
    if orientation.two_sided() > 0 {
        progress.note(format!(
            "{} of {triangles} triangles are seen from both sides: materials are those of the side seen more",
            orientation.two_sided(),
        ));
    }
}

/// A photograph at a `factor`-th of its size: means of blocks, those at the far edges cut off.
fn reduced(image: RgbPlane, factor: usize) -> RgbPlane {
    if factor <= 1 {
        return image;
    }
    let factor = within(&image, factor);
    let gain = 1.0 / (factor * factor) as f32;
    blocks(&image.map(|v| *v * gain), factor, |a, b| a + b)
}

/// Class ids no finer than photographs of so many columns need: those in the middle of each block.
fn thinned(labels: Plane<u16>, columns: usize) -> Plane<u16> {
    let factor = within(&labels, labels.width / columns.max(1));
    if factor <= 1 {
        return labels;
    }
    let (width, height) = (labels.width / factor, labels.height / factor);
    let middle = |i: usize| i * factor + factor / 2;
    Plane {
        width,
        height,
        data: (0..width * height)
            .map(|i| labels[(middle(i % width), middle(i / width))])
            .collect(),
    }
}

/// A mask at the size of [`reduced`]: a block may be used if all of it may.
fn all_valid(mask: &Plane<bool>, factor: usize) -> Plane<bool> {
    blocks(mask, factor, |a, b| a && b)
}

/// The factor, but no more than leaves one block.
fn within<T>(image: &Plane<T>, factor: usize) -> usize {
    factor.clamp(1, image.width.min(image.height).max(1))
}

/// Square blocks of pixels joined into one each; at least one block however large the factor.
fn blocks<T: Copy>(image: &Plane<T>, factor: usize, join: impl Fn(T, T) -> T) -> Plane<T> {
    let factor = within(image, factor);
    let (width, height) = (image.width / factor, image.height / factor);
    let block = |i: usize| {
        let (x, y) = (i % width * factor, i / width * factor);
        (1..factor * factor).fold(image[(x, y)], |sum, k| {
            join(sum, image[(x + k % factor, y + k / factor)])
        })
    };
    Plane {
        width,
        height,
        data: (0..width * height).map(block).collect(),
    }
}

/// Mean radiance per triangle of pixels among clean ones that see it from the side away from its
/// orientation; zero without any. A pixel at an edge mixes in what lies behind, and one beside it
/// still does where lens or renderer blur by more than a pixel: blinds before a bright sky would
/// shine with it. Of what is seen so only, the missing light predicts what it reflects.
fn back_radiance(scene: &Scene, views: &[ObservedView], orientation: &Orientation) -> Vec<Vec3> {
    let n = scene.mesh.triangles.len();
    let mut sum = vec![Vec3::ZERO; n];
    let mut count = vec![0u32; n];
    for v in views {
        let behind = |t: usize, (x, y): (usize, usize)| {
            if !among_clean(&v.clean, x, y) {
                return None;
            }
            let d = v.buffer.direction(x, y);
            let away = scene.mesh.face_normal(t).dot(d) * orientation.sign(t) > 0.0;
            away.then(|| v.radiance[(x, y)])
        };
        for (t, radiance) in v.buffer.told_by_pixels(behind) {
            sum[t] += radiance;
            count[t] += 1;
        }
    }
    sum.iter()
        .zip(&count)
        .map(|(s, c)| if *c > 0 { *s / *c as f32 } else { Vec3::ZERO })
        .collect()
}

/// Whether a pixel and all beside it are clean.
fn among_clean(clean: &Plane<bool>, x: usize, y: usize) -> bool {
    let rows = y.saturating_sub(1)..(y + 2).min(clean.height);
    rows.flat_map(|y| (x.saturating_sub(1)..(x + 2).min(clean.width)).map(move |x| (x, y)))
        .all(|at| clean[at])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::{Lens, Mesh, Projection};
    use crate::core::trace::Hit;

    #[test]
    fn a_reduced_photograph_keeps_its_brightness_even_beyond_its_size() {
        let image = Plane::filled(4, 2, Vec3::new(3.0, 2.0, 1.0));
        for (factor, size) in [(0, (4, 2)), (1, (4, 2)), (2, (2, 1)), (100, (2, 1))] {
            let small = reduced(image.clone(), factor);
            assert_eq!((small.width, small.height), size, "factor {factor}");
            assert!(
                small.data.iter().all(|v| *v == image.data[0]),
                "factor {factor}: {:?}",
                small.data[0]
            );
        }
    }

    /// Slats before a bright sky: what is seen of their far sides at edges is the sky's, and tells
    /// nothing; a pixel within tells.
    #[test]
    fn far_sides_do_not_shine_with_what_lies_behind_them() {
        // a wide and a narrow sheet, both seen from behind
        let mut mesh = Mesh::default();
        for (low, high) in [(-0.5f32, 0.5f32), (0.9, 0.92)] {
            let first = mesh.positions.len() as u32;
            for (x, y) in [(-1.0, low), (1.0, low), (1.0, high), (-1.0, high)] {
                mesh.positions.push(Vec3::new(x, y, -2.0));
                mesh.normals.push(Vec3::NEG_Z);
                mesh.uvs.push(glam::Vec2::ZERO);
            }
            mesh.triangles
                .extend([[first, first + 2, first + 1], [first, first + 3, first + 2]]);
        }
        let scene = Scene::from_parts(
            std::path::PathBuf::new(),
            glam::DVec3::ZERO,
            mesh,
            Vec::new(),
            Vec::new(),
        );
        let tracer = EmbreeTracer::new(&scene.mesh).expect("Embree");
        let side = 64;
        let camera = Camera {
            projection: Projection::Pinhole(Lens::centred(side, side, 90.0)),
            width: side,
            height: side,
            world_from_camera: glam::Mat3::IDENTITY,
            position: Vec3::ZERO,
        };
        let buffer = ViewBuffer::trace(&camera, &tracer);
        let clean = buffer.clean_pixels(&scene.mesh, None);
        // sheets of 0.1 before a sky of 10, half of either in pixels at edges
        let radiance = Plane {
            width: side,
            height: side,
            data: (0..side * side)
                .map(
                    |i| match (buffer.triangle.data[i] == Hit::MISS, clean.data[i]) {
                        (true, _) => Vec3::splat(10.0),
                        (false, true) => Vec3::splat(0.1),
                        (false, false) => Vec3::splat(5.0),
                    },
                )
                .collect(),
        };
        let seen = |t: u32| buffer.triangle.data.contains(&t);
        assert!((0..4).all(seen), "both sheets are in the picture");
        let view = ObservedView {
            buffer,
            radiance,
            clean,
            labels: None,
            valid: None,
        };
        let back = back_radiance(&scene, &[view], &Orientation::of_winding(4));
        let near = |t: usize, l: f32| (back[t] - Vec3::splat(l)).length() < 1e-6;
        assert!(near(0, 0.1) && near(1, 0.1), "wide: {back:?}");
        assert!(near(2, 0.0) && near(3, 0.0), "narrow: {back:?}");
    }
}
