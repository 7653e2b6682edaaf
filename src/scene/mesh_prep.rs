//! From a file's mesh to a usable one: finite, with area, with unit normals and with one atlas,
//! relative to the scene's centre.

use super::unwrap::{UnwrapStats, unwrap_mesh};
use super::{LoadOptions, transforms::y_up_from_z_up};
use crate::core::formats::RawMesh;
use crate::core::geometry::{Mesh, triangle_normal, vector_key};
use crate::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use std::collections::BTreeMap;
use std::path::Path;

/// What was found and done while a mesh was made usable.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct MeshStats {
    /// Triangles in the file.
    pub file_triangles: usize,
    /// Triangles without area, kept out.
    pub degenerate: usize,
    /// Triangles that lay on another one with the same corners, merged with it: faces stored once
    /// per side. Only where the program makes the atlas.
    pub coincident: usize,
    /// Triangles with area whose texture coordinates have none: they get no texels.
    pub without_texels: usize,
    /// The file had no normals, or some were zero: they were computed from the faces.
    pub normals_computed: usize,
    /// Texels of a 2048² atlas covered by at least one triangle.
    pub covered_texels: usize,
    /// Texels of a 2048² atlas claimed by more than one triangle.
    pub overlapping_texels: usize,
    /// Parts without texture coordinates, where others have some.
    pub parts_without_uvs: usize,
    /// What the first of these is called.
    pub first_without_uvs: Option<String>,
    /// Share of the file's own atlas that several triangles claimed, if it was dropped for that.
    pub overlap_dropped: f64,
    /// Present if the program made the atlas itself.
    pub unwrapped: Option<UnwrapStats>,
}

/// A usable mesh.
#[derive(Clone, Debug)]
pub struct PreparedMesh {
    /// Geometry with one atlas, relative to `origin`.
    pub mesh: Mesh,
    /// File coordinates (y up) of the mesh's own origin.
    pub origin: DVec3,
    /// What was found and done.
    pub stats: MeshStats,
    /// The file's triangle of each triangle of `mesh`, with its corners in the same order.
    pub file_triangle: Vec<u32>,
}

/// Side of the atlas on which overlaps are counted.
const OVERLAP_SIDE: usize = 2048;
/// Share of an atlas that several triangles may claim before it is taken for several atlases in
/// one: a new one is made. Derived: overlaps of single charts (mirrored halves, decals) are a few
/// per cent; two atlases of equal size overlap in half.
const MOST_OVERLAP: f64 = 0.1;
/// Texture coordinates this far outside [0, 1] are rounding and clamped.
const UV_SLACK: f32 = 1e-3;
/// Faces meeting at a flatter angle share a computed normal; sharper edges stay sharp.
const CREASE_DEGREES: f32 = 40.0;

/// Validates and completes a mesh.
///
/// # Errors
/// If no triangle of the mesh can be used, or it cannot be unwrapped.
pub fn prepare_mesh(
    mut raw: RawMesh,
    path: &Path,
    z_up: bool,
    options: &LoadOptions,
) -> Result<PreparedMesh> {
    let fail = |m: String| Error::input(path, m);
    let mut stats = MeshStats {
        file_triangles: raw.triangles.len(),
        parts_without_uvs: raw.oddities.without_uvs.len(),
        first_without_uvs: raw.oddities.without_uvs.first().cloned(),
        ..MeshStats::default()
    };
    check_faces(&raw).map_err(fail)?;
    if z_up {
        stand_up(&mut raw);
    }
    let used = used_vertices(&raw.triangles, raw.positions.len());
    check_finite(&raw, &used).map_err(fail)?;
    let origin = centre(&raw, &used).map_err(fail)?;

    let mut mesh = Mesh {
        positions: raw
            .positions
            .iter()
            .map(|p| (*p - origin).as_vec3())
            .collect(),
        normals: raw.normals,
        uvs: raw.uvs,
        triangles: raw.triangles,
    };
    let mut file_triangle: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    let kept: Vec<bool> = (0..mesh.triangles.len())
        .map(|t| has_area(&mesh, t))
        .collect();
    keep_triangles(&mut mesh, &mut file_triangle, &kept);
    stats.degenerate = stats.file_triangles - mesh.triangles.len();
    if mesh.triangles.is_empty() {
        return Err(fail(format!(
            "none of the {} triangles has an area; expected a surface in metres. Check the export",
            stats.file_triangles
        )));
    }
    if mesh.uvs.is_empty() || options.unwrap {
        let kept = first_of_coincident(&mesh);
        let before = mesh.triangles.len();
        keep_triangles(&mut mesh, &mut file_triangle, &kept);
        stats.coincident = before - mesh.triangles.len();
    }
    compact(&mut mesh);
    stats.normals_computed = complete_normals(&mut mesh);
    if !mesh.uvs.is_empty() && !options.unwrap {
        clamp_uvs(&mut mesh).map_err(fail)?;
        let (covered, shared) = atlas_overlap(&mesh, OVERLAP_SIDE);
        if shared as f64 > MOST_OVERLAP * covered as f64 {
            stats.overlap_dropped = shared as f64 / covered.max(1) as f64;
            mesh.uvs.clear();
        }
    }
    if mesh.uvs.is_empty() || options.unwrap {
        let (unwrapped, made) =
            unwrap_mesh(&mesh, options.unwrap_resolution, options.unwrap_padding).map_err(fail)?;
        mesh = unwrapped;
        stats.unwrapped = Some(made);
    }
    stats.without_texels = (0..mesh.triangles.len())
        .filter(|&t| {
            let [a, b, c] = mesh.corner_uvs(t);
            (b - a).perp_dot(c - a) == 0.0
        })
        .count();
    (stats.covered_texels, stats.overlapping_texels) = atlas_overlap(&mesh, OVERLAP_SIDE);
    Ok(PreparedMesh {
        mesh,
        origin,
        stats,
        file_triangle,
    })
}

/// Turns z up to y up.
fn stand_up(raw: &mut RawMesh) {
    let turn = y_up_from_z_up();
    raw.positions.iter_mut().for_each(|p| *p = turn * *p);
    let turn = turn.as_mat3();
    raw.normals.iter_mut().for_each(|n| *n = turn * *n);
}

/// Drops the triangles that are not marked.
fn keep_triangles(mesh: &mut Mesh, file_triangle: &mut Vec<u32>, kept: &[bool]) {
    fn retain<T>(list: &mut Vec<T>, kept: &[bool]) {
        let mut kept = kept.iter();
        list.retain(|_| kept.next().copied().unwrap_or(false));
    }
    retain(&mut mesh.triangles, kept);
    retain(file_triangle, kept);
}

/// Every face has three vertices that exist.
fn check_faces(raw: &RawMesh) -> std::result::Result<(), String> {
    if raw.triangles.is_empty() {
        return Err("no triangles; export the mesh with its faces".into());
    }
    let count = raw.positions.len();
    if let Some((t, i)) = raw
        .triangles
        .iter()
        .enumerate()
        .find_map(|(t, c)| c.iter().find(|&&i| i as usize >= count).map(|&i| (t, i)))
    {
        return Err(format!(
            "triangle {t} uses vertex {i}, but there are {count} vertices; export the mesh again"
        ));
    }
    Ok(())
}

/// The vertices in use have places.
fn check_finite(raw: &RawMesh, used: &[bool]) -> std::result::Result<(), String> {
    let count = raw.positions.len();
    let bad: Vec<usize> = (0..count)
        .filter(|&i| used[i] && !raw.positions[i].is_finite())
        .collect();
    if let Some(first) = bad.first() {
        return Err(format!(
            "{} of {count} vertices are NaN or infinite (first: vertex {first}); repair the mesh",
            bad.len()
        ));
    }
    Ok(())
}

fn used_vertices(triangles: &[[u32; 3]], count: usize) -> Vec<bool> {
    let mut used = vec![false; count];
    triangles
        .iter()
        .flatten()
        .for_each(|&i| used[i as usize] = true);
    used
}

/// Centre of the bounding box of the vertices in use.
fn centre(raw: &RawMesh, used: &[bool]) -> std::result::Result<DVec3, String> {
    let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (p, _) in raw.positions.iter().zip(used).filter(|(_, u)| **u) {
        lo = lo.min(*p);
        hi = hi.max(*p);
    }
    let size = (hi - lo).max_element();
    if lo.abs().max(hi.abs()).max_element() > 1e9 || size > 1e7 {
        return Err(format!(
            "the mesh spans {lo} to {hi}; expected a scene in metres (at most 10,000 km wide, within 1e9 m of the origin)"
        ));
    }
    Ok(0.5 * (lo + hi))
}

fn has_area(mesh: &Mesh, t: usize) -> bool {
    triangle_normal(mesh.corners(t)).is_some()
}

/// Marks one triangle of those with the same three corners, whatever their winding. Which side counts
/// is found from the views; two surfaces in one place would share rays and cut every chart into
/// single triangles.
fn first_of_coincident(mesh: &Mesh) -> Vec<bool> {
    let mut seen = std::collections::HashSet::new();
    (0..mesh.triangles.len())
        .map(|t| seen.insert(mesh.corner_key(t)))
        .collect()
}

/// Drops vertices no triangle uses, keeping the order.
fn compact(mesh: &mut Mesh) {
    let used = used_vertices(&mesh.triangles, mesh.positions.len());
    if used.iter().all(|&u| u) {
        return;
    }
    let mut target = vec![0u32; used.len()];
    for (next, (t, _)) in target
        .iter_mut()
        .zip(&used)
        .filter(|(_, u)| **u)
        .enumerate()
    {
        *t = next as u32;
    }
    let keep = |i: usize| used.get(i).copied().unwrap_or(false);
    let mut i = 0;
    mesh.positions.retain(|_| (keep(i), i += 1).0);
    i = 0;
    mesh.normals.retain(|_| (keep(i), i += 1).0);
    i = 0;
    mesh.uvs.retain(|_| (keep(i), i += 1).0);
    mesh.triangles
        .iter_mut()
        .for_each(|t| *t = t.map(|v| target[v as usize]));
}

/// Makes every normal a unit vector; returns how many vertices got a computed one.
fn complete_normals(mesh: &mut Mesh) -> usize {
    if mesh.normals.len() != mesh.positions.len() {
        split_at_creases(mesh);
        return mesh.positions.len();
    }
    let mut computed = None;
    let mut count = 0;
    for i in 0..mesh.normals.len() {
        let n = mesh.normals[i];
        mesh.normals[i] = match n.try_normalize().filter(|n| n.is_finite()) {
            Some(unit) => unit,
            None => {
                count += 1;
                let fallback: &Vec<Vec3> = computed.get_or_insert_with(|| {
                    let mut m = mesh.clone();
                    m.compute_normals();
                    m.normals
                });
                fallback[i]
            }
        };
    }
    count
}

/// Computes normals that are smooth over flat edges and sharp over creases, duplicating vertices
/// along creases.
///
/// A plain vertex mean would round off every corner of a room whose walls share vertices, and with
/// it the light on them.
fn split_at_creases(mesh: &mut Mesh) {
    let mut around: BTreeMap<[u32; 3], Vec<u32>> = BTreeMap::new();
    for (t, corners) in mesh.triangles.iter().enumerate() {
        for &v in corners {
            around
                .entry(vector_key(mesh.positions[v as usize]))
                .or_default()
                .push(t as u32);
        }
    }
    let double_areas: Vec<Vec3> = (0..mesh.triangles.len())
        .map(|t| mesh.double_area_normal(t))
        .collect();
    let limit = CREASE_DEGREES.to_radians().cos();
    let mut made: BTreeMap<(u32, [u32; 3]), u32> = BTreeMap::new();
    let (mut positions, mut normals, mut uvs) = (Vec::new(), Vec::new(), Vec::new());
    for t in 0..mesh.triangles.len() {
        let own = double_areas[t].normalize_or_zero();
        for k in 0..3 {
            let v = mesh.triangles[t][k];
            let p = mesh.positions[v as usize];
            let faces = &around[&vector_key(p)];
            // a vertex shared by thousands of faces (a fan's hub) would cost the square of that:
            // its own face must do
            let sum: Vec3 = if faces.len() > 256 {
                own
            } else {
                faces
                    .iter()
                    .map(|&f| double_areas[f as usize])
                    .filter(|n| n.normalize_or_zero().dot(own) >= limit)
                    .sum()
            };
            let normal = sum.normalize_or(own);
            let next = positions.len() as u32;
            let index = *made.entry((v, vector_key(normal))).or_insert(next);
            if index == next {
                positions.push(p);
                normals.push(normal);
                uvs.extend(mesh.uvs.get(v as usize));
            }
            mesh.triangles[t][k] = index;
        }
    }
    (mesh.positions, mesh.normals, mesh.uvs) = (positions, normals, uvs);
}

/// Brings texture coordinates into [0, 1] where only rounding left it, or says why the atlas cannot
/// be used.
fn clamp_uvs(mesh: &mut Mesh) -> std::result::Result<(), String> {
    if let Some(i) = mesh.uvs.iter().position(|t| !t.is_finite()) {
        return Err(format!(
            "vertex {i} has a NaN or infinite texture coordinate; export again, or pass --unwrap to let unbake make the atlas"
        ));
    }
    let outside = |t: &Vec2| t.min_element() < -UV_SLACK || t.max_element() > 1.0 + UV_SLACK;
    if let Some(i) = mesh.uvs.iter().position(outside) {
        let n = mesh.uvs.iter().filter(|t| outside(t)).count();
        return Err(format!(
            "{n} of {} texture coordinates lie outside [0, 1] (first: vertex {i} at {}): the texture repeats, so that places share texels. Expected one atlas; \
             unwrap the mesh, or pass --unwrap to let unbake do it",
            mesh.uvs.len(),
            mesh.uvs[i]
        ));
    }
    mesh.uvs
        .iter_mut()
        .for_each(|t| *t = t.clamp(Vec2::ZERO, Vec2::ONE));
    Ok(())
}

/// Texels of a `side`² atlas whose centre lies strictly inside at least one, and inside more than
/// one triangle.
///
/// Strictly inside, by a thousandth of a texel, so that triangles sharing an edge do not count as
/// overlapping.
#[must_use]
pub fn atlas_overlap(mesh: &Mesh, side: usize) -> (usize, usize) {
    const MARGIN: f64 = 1e-3;
    let mut hits = vec![0u8; side * side];
    for t in 0..mesh.triangles.len() {
        let corners = mesh.corner_uvs(t).map(|p| p.as_dvec2() * side as f64 - 0.5);
        let (lo, hi) = (
            corners[0].min(corners[1]).min(corners[2]),
            corners[0].max(corners[1]).max(corners[2]),
        );
        let (first, last) = (
            (lo.y + MARGIN).ceil().max(0.0) as usize,
            (hi.y - MARGIN).floor().min(side as f64 - 1.0),
        );
        if last.is_nan() || last < 0.0 {
            continue;
        }
        for row in first..=last as usize {
            let y = row as f64;
            let (mut x0, mut x1) = (f64::INFINITY, f64::NEG_INFINITY);
            for k in 0..3 {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                if (a.y <= y) != (b.y <= y) {
                    let x = a.x + (b.x - a.x) * ((y - a.y) / (b.y - a.y));
                    (x0, x1) = (x0.min(x), x1.max(x));
                }
            }
            let (begin, end) = (
                (x0 + MARGIN).ceil().max(0.0),
                (x1 - MARGIN).floor().min(side as f64 - 1.0),
            );
            if end >= begin {
                hits[row * side + begin as usize..=row * side + end as usize]
                    .iter_mut()
                    .for_each(|h| *h = h.saturating_add(1));
            }
        }
    }
    (
        hits.iter().filter(|&&h| h > 0).count(),
        hits.iter().filter(|&&h| h > 1).count(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::BOX_SIDES;

    /// A unit cube with shared corners and no normals, moved by `offset`.
    fn cube(offset: DVec3) -> RawMesh {
        let positions = (0..8)
            .map(|i| DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64) + offset)
            .collect();
        let triangles = BOX_SIDES
            .iter()
            .flat_map(|q: &[u32; 4]| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]])
            .collect();
        RawMesh {
            positions,
            triangles,
            ..RawMesh::default()
        }
    }

    fn prepare(raw: RawMesh) -> Result<(Mesh, DVec3, MeshStats)> {
        let options = LoadOptions {
            unwrap_resolution: 256,
            ..LoadOptions::default()
        };
        let p = prepare_mesh(raw, Path::new("m.obj"), false, &options)?;
        Ok((p.mesh, p.origin, p.stats))
    }

    #[test]
    fn faces_stored_once_per_side_are_merged() {
        let mut raw = cube(DVec3::ZERO);
        let turned: Vec<[u32; 3]> = raw.triangles.iter().map(|t| [t[1], t[0], t[2]]).collect();
        raw.triangles.extend(turned);
        let (mesh, _, stats) = prepare(raw).expect("usable");
        let (single, _, alone) = prepare(cube(DVec3::ZERO)).expect("usable");
        assert_eq!((mesh.triangles.len(), stats.coincident), (12, 12));
        assert_eq!(mesh, single, "the atlas is that of the single faces");
        assert_eq!(alone.coincident, 0);
    }

    #[test]
    fn computed_normals_keep_a_cube_sharp() {
        let (mesh, _, stats) = prepare(cube(DVec3::ZERO)).expect("usable");
        for t in 0..mesh.triangles.len() {
            for v in mesh.triangles[t] {
                assert!(mesh.normals[v as usize].dot(mesh.face_normal(t)) > 0.9999);
            }
        }
        assert!(stats.normals_computed > 0 && stats.unwrapped.is_some());
        assert_eq!(stats.overlapping_texels, 0);
    }

    #[test]
    fn ten_kilometres_away_the_relative_coordinates_are_the_same() {
        let (near, near_origin, _) = prepare(cube(DVec3::new(0.3, 0.2, 0.1))).expect("usable");
        let (far, far_origin, _) =
            prepare(cube(DVec3::new(10_000.3, 0.2, -9_999.9))).expect("usable");
        assert!((far_origin - near_origin - DVec3::new(1e4, 0.0, -1e4)).length() < 1e-9);
        for (a, b) in near.positions.iter().zip(&far.positions) {
            assert!((*a - *b).length() < 1e-6, "{a} {b}");
        }
        assert_eq!(near.triangles, far.triangles);
    }

    #[test]
    fn unusable_meshes_say_why() {
        let mut nan = cube(DVec3::ZERO);
        nan.positions[3].y = f64::NAN;
        let mut range = cube(DVec3::ZERO);
        range.triangles[2][1] = 99;
        let mut flat = cube(DVec3::ZERO);
        flat.positions
            .iter_mut()
            .for_each(|p| *p = DVec3::new(p.x, p.x, p.x));
        let mut tiled = cube(DVec3::ZERO);
        tiled.uvs = vec![Vec2::new(3.0, 0.5); 8];
        let mut huge = cube(DVec3::ZERO);
        huge.positions[0].x = 1e300;
        for (raw, expected) in [
            (nan, "vertex 3"),
            (range, "vertex 99"),
            (flat, "has an area"),
            (tiled, "--unwrap"),
            (huge, "metres"),
            (RawMesh::default(), "no triangles"),
        ] {
            let e = prepare(raw).expect_err(expected);
            assert!(
                e.to_string().starts_with("m.obj:")
                    && e.to_string().contains(expected)
                    && e.exit_code() == 2,
                "{e}"
            );
        }
    }

    #[test]
    fn degenerate_triangles_and_their_vertices_are_kept_out() {
        let mut raw = cube(DVec3::ZERO);
        raw.positions.push(DVec3::new(f64::NAN, 0.0, 0.0)); // unused
        raw.triangles.push([0, 0, 1]);
        raw.triangles.insert(0, [0, 7, 7]);
        let (mesh, origin, stats) = prepare(raw).expect("usable");
        assert_eq!((mesh.triangles.len(), stats.degenerate), (12, 2));
        assert_eq!(origin, DVec3::splat(0.5));
        assert!(
            mesh.positions
                .iter()
                .chain(&mesh.normals)
                .all(|p| p.is_finite())
        );
    }

    #[test]
    fn overlap_counts_shared_texels_but_not_shared_edges() {
        let uvs = vec![
            Vec2::ZERO,
            Vec2::new(0.5, 0.0),
            Vec2::new(0.5, 0.5),
            Vec2::new(0.0, 0.5),
        ];
        let mut mesh = Mesh {
            positions: vec![Vec3::ZERO; 4],
            normals: vec![Vec3::Y; 4],
            uvs,
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let (covered, shared) = atlas_overlap(&mesh, 64);
        assert!(
            (32 * 31..=32 * 32).contains(&covered) && shared == 0,
            "{covered} {shared}"
        );
        mesh.triangles.push([1, 3, 0]);
        assert!(atlas_overlap(&mesh, 64).1 > 400);
    }
}
