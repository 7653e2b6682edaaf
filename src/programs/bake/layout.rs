//! Where each surface lies on the lightmap: the file's own coordinates where they serve, else an
//! own atlas of the whole scene, in which every copy of a mesh has its own place.

use super::options::{BakeOptions, MOST_SIDE};
use super::scene::BakeScene;
use crate::core::geometry::Mesh;
use crate::error::{Error, Result};
use crate::scene::{atlas_overlap, unwrap_mesh};
use glam::Vec2;
use serde::Serialize;

/// Set of texture coordinates of the lightmap.
pub(super) const SET: u32 = 1;
/// Share of the texels that several triangles may claim, or of the area that may have none, in
/// coordinates that serve: rounding at the borders of charts.
const ROUNDING: f64 = 1e-3;
/// Side at which overlaps are counted.
const OVERLAP_SIDE: usize = 2048;
/// Layouts tried for the texels per metre asked for: a bound. Measured: with three and without
/// brackets a room of 942 charts got 12 texels per metre instead of 20, with this 20
/// (`bake --texels-per-metre 20`, 2026-11-26).
const MOST_LAYOUTS: usize = 8;
/// Coordinates this far outside [0, 1] are rounding.
const SLACK: f32 = 1e-4;

/// How a lightmap is laid out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Layout {
    /// Texels along each side.
    pub size: usize,
    /// Whose texture coordinates: `file` or `own`.
    pub coordinates: &'static str,
    /// Texels per metre of surface, on average.
    pub texels_per_metre: f32,
    /// Connected pieces, of an own layout.
    pub charts: Option<u32>,
}

/// Gives a scene's mesh its place on the lightmap.
///
/// # Errors
/// The surface cannot be unwrapped.
pub(super) fn lay_out(scene: &mut BakeScene, options: &BakeOptions) -> Result<Layout> {
    let area: f64 = (0..scene.mesh.triangles.len())
        .map(|t| f64::from(scene.mesh.area(t)))
        .sum();
    if !options.unwrap
        && let Some(mesh) = with_own_uvs(scene)
    {
        let share: f64 = (0..mesh.triangles.len())
            .map(|t| f64::from(mesh.chart_area(t)))
            .sum();
        // side² · share texels over the area
        let per_side = (share / area).sqrt() as f32;
        let wanted = (options.texels_per_metre / per_side).ceil().max(16.0) as u32;
        let size = options.size.unwrap_or_else(|| wanted.min(MOST_SIDE));
        scene.mesh = mesh;
        return Ok(Layout {
            size: size as usize,
            coordinates: "file",
            texels_per_metre: per_side * size as f32,
            charts: None,
        });
    }
    let (mesh, layout) = unwrapped(&scene.mesh, area, options)?;
    scene.mesh = mesh;
    Ok(layout)
}

/// An own atlas: at the side asked for, or at that which gives the texels per metre asked for.
fn unwrapped(mesh: &Mesh, area: f64, options: &BakeOptions) -> Result<(Mesh, Layout)> {
    let make = |side: u32| {
        unwrap_mesh(mesh, side, options.unwrap_padding)
            .map_err(|e| Error::Failed(format!("bake: {e}")))
    };
    // (as if charts filled two thirds)
    let guess = (1.5 * area).sqrt() * f64::from(options.texels_per_metre);
    let fitting = |side: f64| (side.min(f64::from(MOST_SIDE)) as u32).clamp(64, MOST_SIDE);
    let mut side = options.size.unwrap_or(fitting(guess).next_multiple_of(4));
    let mut made = make(side)?;
    // margins take the same number of texels at every side: at twice the side, more than twice the
    // texels per metre. Between a side too small and one too large the next is in proportion
    let (mut small, mut large) = (None, None);
    for _ in 0..MOST_LAYOUTS {
        let off = made.1.texels_per_metre / options.texels_per_metre;
        if options.size.is_some() || (0.97..1.03).contains(&off) {
            break;
        }
        let bound = if off < 1.0 { &mut small } else { &mut large };
        *bound = Some([side as f32, off]);
        let better = match (small, large) {
            (Some([a, below]), Some([b, above])) => {
                a + (b - a) * ((1.0 - below) / (above - below)).clamp(0.1, 0.9)
            }
            _ => side as f32 / off.clamp(0.25, 4.0),
        };
        let better = fitting(f64::from(better)).next_multiple_of(4);
        if better == side {
            break;
        }
        side = better;
        made = make(side)?;
    }
    let (mesh, stats) = made;
    let layout = Layout {
        size: side as usize,
        coordinates: "own",
        texels_per_metre: stats.texels_per_metre,
        charts: Some(stats.charts),
    };
    Ok((mesh, layout))
}

/// The mesh with the file's coordinates of the lightmap, if all surfaces have some, each its own.
fn with_own_uvs(scene: &BakeScene) -> Option<Mesh> {
    if scene.pieces.iter().any(|p| !p.uvs.contains_key(&SET)) {
        return None;
    }
    // corner by corner: flat pieces have vertices that the file has not
    let mut mesh = Mesh::default();
    for (t, place) in scene.places.iter().enumerate() {
        let piece = &scene.pieces[place.piece];
        let uvs = &piece.uvs[&SET];
        for (corner, v) in piece.triangles[place.triangle].into_iter().enumerate() {
            let of_mesh = scene.mesh.triangles[t][corner] as usize;
            let uv = uvs[v as usize].map(|x| x as f32);
            mesh.positions.push(scene.mesh.positions[of_mesh]);
            mesh.normals.push(scene.mesh.normals[of_mesh]);
            mesh.uvs.push(Vec2::from_array(uv));
        }
        let next = 3 * t as u32;
        mesh.triangles.push([next, next + 1, next + 2]);
    }
    let inside = |uv: &Vec2| uv.min_element() >= -SLACK && uv.max_element() <= 1.0 + SLACK;
    if !mesh.uvs.iter().all(inside) {
        return None;
    }
    let (mut without, mut whole) = (0.0, 0.0);
    for t in 0..mesh.triangles.len() {
        let area = f64::from(mesh.area(t));
        whole += area;
        without += if mesh.chart_area(t) > 0.0 { 0.0 } else { area };
    }
    let (covered, shared) = atlas_overlap(&mesh, OVERLAP_SIDE);
    let serves = shared as f64 <= ROUNDING * covered as f64 && without <= ROUNDING * whole;
    serves.then_some(mesh)
}
