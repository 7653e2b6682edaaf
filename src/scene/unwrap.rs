//! An atlas for meshes that bring none.

use crate::core::geometry::{Mesh, vector_key};
use glam::Vec2;
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

/// Triangles around one vertex that may share a chart. Charts are tested for overlap pair by pair
/// where triangles crowd, so a fan of n takes n² tests; cut into slices of this many it takes 256 n.
/// Derived: far above the valence of any vertex that modelling leaves (a cylinder's cap has its
/// sides), so that no other mesh's charts change.
const MOST_IN_FAN: usize = 256;

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
    let atlas = one_page(&positions, &indices, resolution, padding)?;
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

/// Charts on one page, of `resolution`² texels or as many more as they need.
fn one_page(
    positions: &[[f32; 3]],
    indices: &[u32],
    resolution: u32,
    padding: u32,
) -> Result<uvunwrap::Atlas, String> {
    let slices = fan_slices(indices);
    let mut options = uvunwrap::Options {
        padding,
        // on a furnished room of 132 k triangles: rows 0.5 s and 39 % filled, nested shapes 11 s
        // and 60 %
        packing: uvunwrap::Packing::Fast,
        ..uvunwrap::Options::default()
    };
    let mut input = uvunwrap::MeshInput::new(positions, indices);
    // charts never cross from one material to another
    input.face_materials = slices.as_deref();
    let mut page = resolution.clamp(16, MAX_SIDE);
    loop {
        options.density = uvunwrap::Density::Auto { page_size: page };
        match uvunwrap::generate(std::slice::from_ref(&input), &options) {
            Ok(atlas) if atlas.page_count <= 1 => return Ok(atlas),
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
    }
}

/// For every vertex the first one with the same position and normal: an abandoned atlas' seams must
/// not cut the new charts, while sharp edges (two normals) may.
fn weld(mesh: &Mesh) -> Vec<u32> {
    let mut first = BTreeMap::new();
    let key = |i: usize| (vector_key(mesh.positions[i]), vector_key(mesh.normals[i]));
    (0..mesh.positions.len())
        .map(|i| *first.entry(key(i)).or_insert(i as u32))
        .collect()
}

/// For every triangle a number such that no vertex has more than [`MOST_IN_FAN`] triangles of one
/// number; neighbours in a fan keep together. `None` if no vertex has that many triangles.
fn fan_slices(indices: &[u32]) -> Option<Vec<u32>> {
    let vertices = indices.iter().max().map_or(0, |m| *m as usize + 1);
    let mut valence = vec![0usize; vertices];
    indices.iter().for_each(|&v| valence[v as usize] += 1);
    let mut fans: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (corner, &v) in indices.iter().enumerate() {
        if valence[v as usize] > MOST_IN_FAN {
            fans.entry(v).or_default().push((corner / 3) as u32);
        }
    }
    if fans.is_empty() {
        return None;
    }
    // (fan, slice) of every triangle, for all the fans it belongs to
    let mut of: Vec<Vec<(u32, u32)>> = vec![Vec::new(); indices.len() / 3];
    for (&centre, fan) in &fans {
        for (place, &t) in around(centre, fan, indices).iter().enumerate() {
            of[t as usize].push((centre, (place / MOST_IN_FAN) as u32));
        }
    }
    let mut numbers: BTreeMap<Vec<(u32, u32)>, u32> = BTreeMap::new();
    let number = of.into_iter().map(|key| {
        let next = numbers.len() as u32;
        *numbers.entry(key).or_insert(next)
    });
    Some(number.collect())
}

/// The triangles of a fan such that each follows the one it shares an edge with, where there is
/// one; else in the order of the file.
fn around(centre: u32, fan: &[u32], indices: &[u32]) -> Vec<u32> {
    // the two other corners, in the triangle's sense
    let others = |t: u32| -> [u32; 2] {
        let corners = &indices[3 * t as usize..3 * t as usize + 3];
        let at = corners.iter().position(|&v| v == centre).unwrap_or(0);
        [corners[(at + 1) % 3], corners[(at + 2) % 3]]
    };
    let mut by_first: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for &t in fan.iter().rev() {
        by_first.entry(others(t)[0]).or_default().push(t);
    }
    let mut done = std::collections::BTreeSet::new();
    let mut order = Vec::with_capacity(fan.len());
    for &start in fan {
        let mut next = Some(start);
        while let Some(t) = next.filter(|t| done.insert(*t)) {
            order.push(t);
            next = by_first.get_mut(&others(t)[1]).and_then(Vec::pop);
        }
    }
    order
}

#[cfg(test)]
mod tests {
    use super::super::atlas_overlap;
    use super::*;
    use crate::core::sampling::KeyedRng;
    use glam::Vec3;

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

    /// A cone of `n` triangles around its tip, in scrambled order of the file.
    fn cone(n: u32) -> Mesh {
        let mut mesh = Mesh::default();
        mesh.positions.push(Vec3::Y * 0.3);
        for i in 0..n {
            let a = std::f32::consts::TAU * i as f32 / n as f32;
            mesh.positions.push(Vec3::new(a.cos(), 0.0, a.sin()));
        }
        let stride = 7;
        for k in 0..n {
            let i = k * stride % n;
            mesh.triangles.push([0, 1 + (i + 1) % n, 1 + i]);
        }
        mesh.compute_normals();
        mesh
    }

    #[test]
    fn fans_are_cut_into_slices_of_neighbours() {
        assert_eq!(fan_slices(&[0, 1, 2, 0, 2, 3]), None);
        let n = 1000u32;
        let mesh = cone(n);
        let indices: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
        let numbers = fan_slices(&indices).expect("a fan");
        let mut sizes: BTreeMap<u32, usize> = BTreeMap::new();
        numbers
            .iter()
            .for_each(|k| *sizes.entry(*k).or_default() += 1);
        assert_eq!(sizes.values().sum::<usize>(), n as usize);
        assert!(sizes.values().all(|s| *s <= MOST_IN_FAN), "{sizes:?}");
        // by place around the tip, the numbers change four times only
        let mut by_place: Vec<(u32, u32)> =
            mesh.triangles.iter().map(|t| t[2]).zip(numbers).collect();
        by_place.sort_unstable();
        let changes = by_place.windows(2).filter(|w| w[0].1 != w[1].1).count();
        assert!(changes <= 4, "{changes}");
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
