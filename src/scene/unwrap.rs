//! An atlas for meshes that bring none.

use crate::core::geometry::Mesh;
use glam::{Vec2, Vec3};
use std::collections::BTreeMap;

/// What unwrapping produced.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct UnwrapStats {
    /// Connected pieces of the atlas.
    pub charts: u32,
    /// Surface area over atlas area in texels.
    pub fill: f32,
    /// Texels per metre at the resolution asked for.
    pub texels_per_metre: f32,
}

/// Largest side an atlas is laid out for.
const MAX_SIDE: u32 = 16_384;

/// Cuts and flattens `mesh` into one square atlas for `resolution`² texels with `padding` texels
/// around every chart.
///
/// Vertices along chart borders are duplicated; triangles keep their order. The same mesh gives the
/// same atlas for any number of threads.
///
/// # Errors
/// If the mesh cannot be flattened into an atlas of that size.
pub fn unwrap_mesh(
    mesh: &Mesh,
    resolution: u32,
    padding: u32,
) -> Result<(Mesh, UnwrapStats), String> {
    let representative = weld(mesh);
    let positions: Vec<[f32; 3]> = mesh.positions.iter().map(|p| p.to_array()).collect();
    let indices: Vec<u32> = mesh
        .triangles
        .iter()
        .flatten()
        .map(|&v| representative[v as usize])
        .collect();
    let mut options = uvunwrap::Options {
        padding,
        // on a furnished room of 132 k triangles: rows 0.5 s and 39 % filled, nested shapes 11 s
        // and 60 %
        packing: uvunwrap::Packing::Fast,
        ..uvunwrap::Options::default()
    };
    let input = uvunwrap::MeshInput::new(&positions, &indices);
    let mut page = resolution.clamp(16, MAX_SIDE);
    let atlas = loop {
        options.density = uvunwrap::Density::Auto { page_size: page };
        match uvunwrap::generate(std::slice::from_ref(&input), &options) {
            Ok(atlas) if atlas.page_count <= 1 => break atlas,
            Ok(_) if page < MAX_SIDE => page = (2 * page).min(MAX_SIDE),
            Ok(atlas) => {
                return Err(format!(
                    "{} charts do not fit one atlas; simplify the mesh",
                    atlas.chart_count
                ));
            }
            // many tiny charts: their padding alone overfills the page, a finer page has room for
            // it
            Err(uvunwrap::Error::ChartTooLarge { .. }) if page < MAX_SIDE => {
                page = (2 * page).min(MAX_SIDE)
            }
            Err(e) => {
                return Err(format!(
                    "no atlas could be made ({e}); unwrap the mesh in a modelling program"
                ));
            }
        }
    };
    let made = &atlas.meshes[0];
    // pages may be cropped in height: texture space is square
    let scale =
        Vec2::new(atlas.width as f32, atlas.height as f32) / atlas.width.max(atlas.height) as f32;
    let out = Mesh {
        positions: made
            .vertices
            .iter()
            .map(|v| mesh.positions[v.xref as usize])
            .collect(),
        normals: made
            .vertices
            .iter()
            .map(|v| mesh.normals[v.xref as usize])
            .collect(),
        uvs: made
            .vertices
            .iter()
            .map(|v| Vec2::from_array(v.uv) * scale)
            .collect(),
        triangles: made
            .indices
            .chunks_exact(3)
            .map(|t| [t[0], t[1], t[2]])
            .collect(),
    };
    let texels_per_metre =
        atlas.texels_per_unit * resolution as f32 / atlas.width.max(atlas.height) as f32;
    let stats = UnwrapStats {
        charts: atlas.chart_count,
        fill: atlas.utilization,
        texels_per_metre,
    };
    Ok((out, stats))
}

/// For every vertex the first one with the same position and normal: an abandoned atlas' seams must
/// not cut the new charts, while sharp edges (two normals) may.
fn weld(mesh: &Mesh) -> Vec<u32> {
    let mut first = BTreeMap::new();
    let bits = |v: Vec3| v.to_array().map(|x| (x + 0.0).to_bits()); // + 0.0 joins -0 and 0
    let key = |i: usize| (bits(mesh.positions[i]), bits(mesh.normals[i]));
    (0..mesh.positions.len())
        .map(|i| *first.entry(key(i)).or_insert(i as u32))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::atlas_overlap;
    use super::*;
    use crate::core::sampling::KeyedRng;

    /// A closed ball of `rows` × `columns` quads.
    fn ball(rows: u32, columns: u32, scale: f32) -> Mesh {
        let mut mesh = Mesh::default();
        for r in 0..=rows {
            for c in 0..columns {
                let (a, b) = (
                    std::f32::consts::PI * r as f32 / rows as f32,
                    std::f32::consts::TAU * c as f32 / columns as f32,
                );
                mesh.positions
                    .push(scale * Vec3::new(a.sin() * b.cos(), a.cos(), a.sin() * b.sin()));
            }
        }
        for r in 0..rows {
            for c in 0..columns {
                let (a, b) = (r * columns + c, r * columns + (c + 1) % columns);
                mesh.triangles
                    .extend([[a, b, b + columns], [a, b + columns, a + columns]]);
            }
        }
        mesh.triangles.retain(|t| {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
            (b - a).cross(c - a).length() > 1e-6 * scale * scale
        });
        mesh.compute_normals();
        mesh
    }

    #[test]
    fn charts_never_overlap_at_any_scale() {
        for scale in [1e-3, 1.0, 1e4] {
            let mesh = ball(12, 24, scale);
            let (out, stats) = unwrap_mesh(&mesh, 512, 2).expect("unwrapped");
            assert_eq!(out.triangles.len(), mesh.triangles.len());
            let (covered, shared) = atlas_overlap(&out, 512);
            assert_eq!(shared, 0, "{scale}");
            assert!(
                covered > 512 * 512 / 4 && stats.fill > 0.25,
                "{covered} {stats:?}"
            );
            for t in 0..mesh.triangles.len() {
                assert_eq!(
                    mesh.corners(t),
                    out.corners(t),
                    "triangles keep order and place"
                );
            }
            assert!(
                out.uvs
                    .iter()
                    .all(|t| t.min_element() >= 0.0 && t.max_element() <= 1.0)
            );
        }
    }

    #[test]
    fn a_soup_of_tiny_triangles_gets_an_atlas() {
        let mut rng = KeyedRng::new(7, 0);
        let mut mesh = Mesh::default();
        for t in 0..3000u32 {
            let mut p = || Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32());
            let centre = p() * 10.0;
            mesh.positions
                .extend([centre, centre + p() * 0.1, centre + p() * 0.1]);
            mesh.triangles.push([3 * t, 3 * t + 1, 3 * t + 2]);
        }
        mesh.compute_normals();
        let (out, stats) = unwrap_mesh(&mesh, 64, 2)
            .expect("unwrapped although 64² texels cannot hold the padding");
        assert_eq!(
            atlas_overlap(&out, 2048).1,
            0,
            "{stats:?} {:?}",
            atlas_overlap(&out, 2048)
        );
    }

    #[test]
    fn the_atlas_has_the_same_bits_for_any_thread_count() {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("pool");
            pool.install(|| {
                unwrap_mesh(&ball(10, 20, 1.0), 256, 2)
                    .expect("unwrapped")
                    .0
            })
        };
        assert_eq!(run(1), run(3));
    }
}
