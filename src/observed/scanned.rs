//! A scan's surface: what it sends out is read from its own colours instead of from photographs. The
//! ground of `delight`, as `pipeline::observe` builds that of `solve`.

use super::{ClippedTexel, Contradictions, Fusion, Panes, Surface, TextureSizes, UNSEEN};
use crate::Result;
use crate::core::math::{Frame, luminance};
use crate::core::parallel::prelude::*;
use crate::core::sampling::{KeyedRng, square_to_cosine_hemisphere};
use crate::core::texture::{SurfacePoint, Texels};
use crate::core::trace::{EmbreeTracer, Hit, Ray, Tracer};
use crate::gbuffer::Orientation;
use crate::scene::{Scan, ScanColour};
use glam::Vec3;

/// Points of the surface from which a ray asks whether it leaves through a hole. Derived: a share of
/// a hundredth is known to a tenth of itself.
const RAYS: usize = 10_000;
/// Share of rays that leave through holes below which there are none. Derived: rays that slip
/// through cracks of float positions are a thousandth of that.
const HOLES: f32 = 1e-3;

/// A scan's surface, and the share of the light's directions in which nothing was scanned.
pub struct ScannedSurface<'a> {
    /// As if seen by one view everywhere.
    pub surface: Surface<'a>,
    /// Share of rays from the surface that meet none.
    pub holes: f32,
}

/// Lays a scan's colours on the texels of textures of these sizes.
///
/// # Errors
/// Embree's own.
pub fn scanned_surface(scan: &Scan, sizes: TextureSizes) -> Result<ScannedSurface<'_>> {
    let mesh = &scan.scene.mesh;
    let tracer = EmbreeTracer::new(mesh)?;
    let (lo, hi) = mesh.bounds();
    // as for photographs: well above the rounding of positions
    let offset = (hi - lo).length() * 1e-5;
    let orientation = Orientation::of_shape(mesh, &tracer, offset);
    let texels = Texels::rasterize(mesh, sizes.albedo, sizes.albedo);
    let colour = |p: &SurfacePoint| {
        let wide = width(scan, sizes.albedo, p.triangle);
        scan.colours.at(p.triangle as usize, p.u, p.v, wide)
    };
    let colours: Vec<Option<ScanColour>> = texels.point.par_iter().map(colour).collect();
    let class = |p: &SurfacePoint| {
        let of = scan.scene.mesh_classes.as_ref();
        of.map_or(0, |c| c.of_triangle[p.triangle as usize])
    };
    let labels: Vec<u16> = texels.point.iter().map(class).collect();
    let fusion = fusion_of(&colours, &labels, scan.colours.encoded);
    let triangles = mesh.triangles.len();
    let mut surface = Surface {
        scene: &scan.scene,
        tracer,
        panes: Panes::default(),
        views: Vec::new(),
        ceilings: Vec::new(),
        bounds: Vec::new(),
        shortfalls: Vec::new(),
        orientation,
        sizes,
        clipped: clipped_of(&colours, &texels, scan),
        texels,
        fusion,
        labels,
        back: vec![Vec3::ZERO; triangles],
        contradictions: Contradictions::default(),
        encoded: scan.colours.encoded,
        ambient: Vec3::ZERO,
        camera_masks: Vec::new(),
        offset,
        disagreement: 0.0,
    };
    let holes = share_of_holes(&surface);
    if holes > HOLES {
        surface.ambient = mean_radiance(&surface);
    }
    Ok(ScannedSurface { surface, holes })
}

/// Texels of the picture that a texel of an atlas of `side`² is wide, on triangle `t`.
fn width(scan: &Scan, side: usize, t: u32) -> f32 {
    let [a, b, c] = scan
        .scene
        .mesh
        .corner_uvs(t as usize)
        .map(|p| p * side as f32);
    let own = 0.5 * (b - a).perp_dot(c - a).abs();
    let ratio = (scan.colours.texels_of(t as usize) / own.max(f32::MIN_POSITIVE)).sqrt();
    if ratio.is_finite() { ratio } else { 1.0 }
}

/// What one view that sees everything would have found. Of colours made for a screen only those at
/// their ceiling are evidence of light: a room whose lamps are cut off seems to be lit by its own
/// walls, half of which are brighter than their mean.
fn fusion_of(colours: &[Option<ScanColour>], labels: &[u16], encoded: bool) -> Fusion {
    let of = |c: &Option<ScanColour>| c.map_or(Vec3::ZERO, |c| c.radiance);
    let radiance: Vec<Vec3> = colours.iter().map(of).collect();
    Fusion {
        peak: radiance.clone(),
        clean: colours
            .iter()
            .map(|c| c.is_some_and(|c| !c.clipped))
            .collect(),
        views: colours.iter().map(|c| u8::from(c.is_some())).collect(),
        label: (colours.iter().zip(labels))
            .map(|(c, l)| if c.is_some() { u32::from(*l) } else { UNSEEN })
            .collect(),
        floor: (colours.iter())
            .map(|c| match c {
                Some(c) if encoded && !c.clipped => 0.0,
                Some(c) => luminance(c.radiance),
                None => f32::INFINITY,
            })
            .collect(),
        radiance,
    }
}

/// Texels at the picture's ceiling, of which a lower bound is known.
fn clipped_of(colours: &[Option<ScanColour>], texels: &Texels, scan: &Scan) -> Vec<ClippedTexel> {
    let clipped = |(i, c): (usize, &Option<ScanColour>)| {
        c.filter(|c| c.clipped).map(|c| ClippedTexel {
            texel: i as u32,
            least: c.radiance,
            footprint: texels.area(&scan.scene.mesh, i).sqrt(),
        })
    };
    colours.iter().enumerate().filter_map(clipped).collect()
}

/// Share of cosine-distributed rays from points spread over the surface that meet none.
fn share_of_holes(surface: &Surface) -> f32 {
    let (mesh, texels) = (&surface.scene.mesh, &surface.texels);
    let step = (texels.len() / RAYS).max(1);
    let rays: Vec<Ray> = (0..texels.len())
        .step_by(step)
        .map(|i| {
            let t = texels.point[i].triangle as usize;
            let (u, v) = texels.ray_point(i);
            let (_, normal) = surface.normals(t, u, v);
            let mut rng = KeyedRng::new(0x401e, i as u64);
            let local = square_to_cosine_hemisphere([rng.next_f32(), rng.next_f32()]);
            let direction = Frame::from_normal(normal).world_from_local(local);
            Ray::new(
                mesh.position(t, u, v) + normal * surface.offset,
                direction,
                f32::INFINITY,
            )
        })
        .collect();
    let mut hits = vec![Hit::miss(); rays.len()];
    surface.tracer.closest(&rays, &mut hits);
    let missed = hits.iter().filter(|h| !h.is_hit()).count();
    missed as f32 / hits.len().max(1) as f32
}

/// Mean radiance by area.
fn mean_radiance(surface: &Surface) -> Vec3 {
    let (mut sum, mut whole) = (Vec3::ZERO, 0.0f32);
    for i in (0..surface.texels.len()).filter(|&i| surface.fusion.views[i] > 0) {
        let area = surface.texels.area(&surface.scene.mesh, i);
        sum += surface.fusion.radiance[i] * area;
        whole += area;
    }
    sum / whole.max(f32::MIN_POSITIVE)
}
