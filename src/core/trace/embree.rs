//! The tracer of the program: Embree behind [`Tracer`].
//!
//! Batches above [`BATCH`] rays are split into fixed chunks over rayon's threads, so that callers
//! may pass a whole image; chunk borders depend on the number of rays alone, and so do the answers.

use super::{Hit, Ray, Tracer};
use crate::core::geometry::Mesh;
use crate::core::parallel::prelude::*;
use crate::ffi::embree::{self, PacketWidth, TriangleScene};
use crate::ffi::ray::is_usable;
use crate::{Error, Result};
use std::sync::atomic::{AtomicU64, Ordering};

/// Rays per foreign call: large enough to hide its cost, small enough to balance two threads or two
/// hundred. A multiple of the packet width.
pub const BATCH: usize = 4096;

/// A mesh in Embree.
pub struct EmbreeTracer {
    scene: TriangleScene,
    skipped: usize,
}

impl EmbreeTracer {
    /// Builds the acceleration structure of `mesh`.
    ///
    /// Triangles with a corner that is not finite (or beyond 1e12) are never hit ([`Self::skipped`]
    /// counts them), nor are those of zero area. An empty mesh is never hit. A vertex index out of
    /// range is an error.
    ///
    /// # Errors
    /// If a vertex index is out of range, or Embree is missing or refuses the scene.
    pub fn new(mesh: &Mesh) -> Result<Self> {
        Self::without(mesh, |_| false)
    }

    /// As [`Self::new`], with triangles that `left_out` tells of never hit either.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn without(mesh: &Mesh, left_out: impl Fn(u32) -> bool) -> Result<Self> {
        let count = mesh.positions.len();
        if let Some((t, tri)) = mesh
            .triangles
            .iter()
            .enumerate()
            .find(|(_, tri)| tri.iter().any(|&i| i as usize >= count))
        {
            return Err(Error::Failed(format!(
                "mesh: triangle {t} names vertices {tri:?} but there are {count}"
            )));
        }
        let usable = |i: u32| is_usable(mesh.positions[i as usize]);
        // A corner that is not finite spoils bounding boxes: such a triangle collapses to one
        // finite point, and keeps its number. With no finite vertex at all there is nothing to hit.
        let positions: Vec<[f32; 3]> = mesh
            .positions
            .iter()
            .map(|&p| if is_usable(p) { p.to_array() } else { [0.0; 3] })
            .collect();
        let mut skipped = 0;
        let triangles: Vec<[u32; 3]> = (mesh.triangles.iter().zip(0..))
            .map(|(&tri, t)| {
                let good = tri.iter().all(|&i| usable(i));
                skipped += usize::from(!good);
                if good && !left_out(t) {
                    tri
                } else {
                    [tri[0]; 3]
                }
            })
            .collect();
        let scene = TriangleScene::build(&positions, &triangles).map_err(Error::Native)?;
        Ok(Self { scene, skipped })
    }

    /// Triangles that can never be hit because a corner is not finite.
    #[must_use]
    pub fn skipped(&self) -> usize {
        self.skipped
    }

    /// The scene below, for benchmarks of the bare loop.
    #[must_use]
    pub fn scene(&self) -> &TriangleScene {
        &self.scene
    }
}

impl Tracer for EmbreeTracer {
    fn closest(&self, rays: &[Ray], hits: &mut [Hit]) {
        assert_eq!(rays.len(), hits.len(), "one hit per ray");
        TRACED.fetch_add(rays.len() as u64, Ordering::Relaxed);
        if rays.len() <= BATCH {
            return self.scene.closest(rays, hits);
        }
        rays.par_chunks(BATCH)
            .zip(hits.par_chunks_mut(BATCH))
            .with_max_len(1)
            .for_each(|(r, h)| self.scene.closest(r, h));
    }

    fn occluded(&self, rays: &[Ray], occluded: &mut [u8]) {
        assert_eq!(rays.len(), occluded.len(), "one flag per ray");
        TRACED.fetch_add(rays.len() as u64, Ordering::Relaxed);
        let width = PacketWidth::Eight;
        if rays.len() <= BATCH {
            return self.scene.occluded(rays, occluded, width);
        }
        rays.par_chunks(BATCH)
            .zip(occluded.par_chunks_mut(BATCH))
            .with_max_len(1)
            .for_each(|(r, o)| self.scene.occluded(r, o, width));
    }
}

/// Rays this process has traced: for reports only, no computation depends on it.
static TRACED: AtomicU64 = AtomicU64::new(0);

/// Number of rays that this process has traced through Embree so far.
#[must_use]
pub fn rays_traced() -> u64 {
    TRACED.load(Ordering::Relaxed)
}

/// The Embree in use: run-time version and, where it differs, the headers it was built with.
#[must_use]
pub fn embree_version() -> String {
    match embree::library_version() {
        Ok(v) if v == embree::HEADER_VERSION => v,
        Ok(v) => format!("{v} (built with headers {})", embree::HEADER_VERSION),
        Err(e) => format!("unusable: {e}"),
    }
}
