//! What radiance arrives along a ray: the TBL on the surface it hits, or the environment if it hits
//! none.
//!
//! All levels lie in one array of packed texels, so that finding a texel and reading it are two
//! steps: a batch of rays computes its addresses first, and the memory then answers many of them at
//! once.

use super::Environment;
use super::packed_texels::{PackedTexels, Tiles};
use crate::core::geometry::Mesh;
use crate::core::image::{Plane, RgbPlane};
use crate::core::trace::Hit;
use crate::ffi::simd::{floor_to_index, prefetch};
use crate::gbuffer::Orientation;
use glam::{Vec2, Vec3};

/// Prefiltered copies of the TBL beyond the full resolution: footprints up to 8 texels; coarser
/// ones would mix charts.
const MIP_LEVELS: usize = 4;

/// The level that holds the radiance of emissive texels, unfiltered, for emissive triangles.
const FULL: usize = MIP_LEVELS;

/// Per-triangle constants of a lookup, one cache line.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
struct Lookup {
    uv: Vec2,
    uv_edge1: Vec2,
    uv_edge2: Vec2,
    /// Unit normal on the side the cameras see.
    normal: Vec3,
    /// Texels of the TBL per metre.
    density: f32,
    /// [`FULL`] if any texel of the triangle emits, else 0.
    least_level: u32,
}

/// One resolution of the TBL.
#[derive(Clone, Copy, Debug, Default)]
struct Level {
    size: Vec2,
    /// Last column, last row.
    last: Vec2,
    tiles: Tiles,
}

impl Level {
    /// Address of the texel at a place of the texture.
    #[inline(always)]
    fn address(&self, uv: Vec2) -> u32 {
        let p = uv * self.size;
        self.tiles.address(
            floor_to_index(p.x, self.last.x),
            floor_to_index(p.y, self.last.y),
        )
    }
}

/// Incident radiance along traced rays.
#[derive(Clone, Debug)]
pub struct LightField {
    /// One per triangle, and a last one for rays that hit none.
    lookups: Vec<Lookup>,
    /// Black; reflected radiance with emissive texels filled from their surroundings, level by
    /// level; emitted radiance with all others filled; the far sides.
    texels: PackedTexels,
    levels: [Level; MIP_LEVELS + 1],
    /// Where the mean radiance of each triangle's side away from the cameras' main side begins;
    /// zero where nobody saw it.
    back: u32,
    /// Directions without geometry.
    pub environment: Environment,
    /// Whether cones look up prefiltered radiance; a single texel otherwise.
    pub prefilter: bool,
}

/// What the surfaces of a scene send out.
#[derive(Clone, Debug)]
pub struct SurfaceRadiance<'a> {
    /// Radiance of the sides that cameras see, over the atlas, filled outside charts.
    pub radiance: RgbPlane,
    /// Texels that emit, in a plane of the same size.
    pub emissive: Plane<bool>,
    /// Triangles that emit (empty = none).
    pub emissive_triangles: &'a [bool],
    /// Mean radiance of each triangle's far side (empty = black).
    pub back: Vec<Vec3>,
}

impl SurfaceRadiance<'_> {
    /// Surfaces that only reflect, black on their far sides.
    #[must_use]
    pub fn reflected(radiance: RgbPlane) -> Self {
        Self {
            emissive: radiance.map(|_| false),
            radiance,
            emissive_triangles: &[],
            back: Vec::new(),
        }
    }
}

impl LightField {
    /// Assembles the field of what surfaces send out and what comes from where there are none.
    #[must_use]
    pub fn new(
        mesh: &Mesh,
        orientation: &Orientation,
        surfaces: SurfaceRadiance<'_>,
        environment: Environment,
    ) -> Self {
        let SurfaceRadiance {
            radiance,
            emissive,
            emissive_triangles,
            back,
        } = surfaces;
        let size = Vec2::new(radiance.width as f32, radiance.height as f32);
        let mut lookups: Vec<Lookup> = (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = mesh.corner_uvs(t);
                let area = mesh.area(t);
                let texels = 0.5 * ((b - a) * size).perp_dot((c - a) * size).abs();
                Lookup {
                    uv: a,
                    uv_edge1: b - a,
                    uv_edge2: c - a,
                    normal: mesh.face_normal(t) * orientation.sign(t),
                    density: if area > 0.0 {
                        (texels / area).sqrt()
                    } else {
                        0.0
                    },
                    least_level: if emissive_triangles.get(t).copied().unwrap_or(false) {
                        FULL as u32
                    } else {
                        0
                    },
                }
            })
            .collect();
        lookups.push(Lookup::default());
        let mut texels = PackedTexels::new();
        let mut levels = [Level::default(); MIP_LEVELS + 1];
        let mut store = |plane: &RgbPlane, level: &mut Level| {
            *level = Level {
                size: Vec2::new(plane.width as f32, plane.height as f32),
                last: Vec2::new(plane.width as f32 - 1.0, plane.height as f32 - 1.0),
                tiles: texels.push_plane(plane),
            };
        };
        // a triangle also covers parts of texels that belong to its neighbours: a lamp must not
        // darken there, nor a wall shine
        let any = emissive.data.iter().any(|e| *e);
        let of = |keep: Plane<bool>| {
            if any {
                crate::core::texture::fill_uncovered(&radiance, &keep)
            } else {
                radiance.clone()
            }
        };
        store(&of(emissive.clone()), &mut levels[FULL]);
        let mut plane = of(emissive.map(|e| !e));
        for level in &mut levels[..MIP_LEVELS] {
            store(&plane, level);
            plane = plane.half();
        }
        let back: Vec<Vec3> = (0..mesh.triangles.len())
            .map(|t| back.get(t).copied().unwrap_or(Vec3::ZERO))
            .collect();
        let back = texels.push_list(&back);
        Self {
            lookups,
            texels,
            levels,
            back,
            environment,
            prefilter: true,
        }
    }

    /// Radiance arriving along `direction` from `hit`, averaged over a cone whose diameter at the
    /// hit is `spread · t` metres (0 = a point lookup). Emissive surfaces are never blurred.
    #[must_use]
    #[inline]
    pub fn arriving(&self, hit: &Hit, direction: Vec3, spread: f32) -> Vec3 {
        if hit.is_hit() {
            self.texel(self.address(hit, direction, spread).0)
        } else {
            self.environment.radiance(direction)
        }
    }

    /// Where the radiance of [`Self::arriving`] is stored, for [`Self::texel`], and the cosine
    /// between the ray and the surface's normal, negative from behind. A miss has the address of
    /// black.
    #[inline(always)]
    pub(crate) fn address(&self, hit: &Hit, direction: Vec3, spread: f32) -> (u32, f32) {
        let l = &self.lookups[(hit.triangle as usize).min(self.lookups.len() - 1)];
        let cosine = -l.normal.dot(direction);
        // the whole part of a logarithm is the exponent of the number
        let footprint = if self.prefilter {
            spread * hit.t * l.density
        } else {
            0.0
        };
        let blur = (footprint.max(1.0).to_bits() >> 23) as usize - 127;
        let level = blur.min(MIP_LEVELS - 1).max(l.least_level as usize);
        let front = self.at(l, level, hit.u, hit.v);
        let address = if cosine < 0.0 {
            self.back.wrapping_add(hit.triangle)
        } else {
            front
        };
        (
            if hit.is_hit() {
                address
            } else {
                PackedTexels::BLACK
            },
            cosine,
        )
    }

    #[inline(always)]
    fn at(&self, l: &Lookup, level: usize, u: f32, v: f32) -> u32 {
        self.levels[level].address(l.uv + l.uv_edge1 * u + l.uv_edge2 * v)
    }

    /// Tells the cache that [`Self::address`] will be asked for a hit on `triangle` soon.
    #[inline(always)]
    pub(crate) fn prefetch_triangle(&self, triangle: u32) {
        prefetch(&self.lookups, triangle as usize);
    }

    /// Tells the cache that [`Self::texel`] will be asked for soon.
    #[inline(always)]
    pub(crate) fn prefetch_texel(&self, address: u32) {
        self.texels.expect(address);
    }

    /// The radiance stored at an address.
    #[must_use]
    #[inline(always)]
    pub(crate) fn texel(&self, address: u32) -> Vec3 {
        self.texels.get(address)
    }

    /// Where the radiance is stored that an emitting or reflecting triangle sends out at a place of
    /// the texture: where a ray that hits it there finds it.
    #[inline(always)]
    pub(crate) fn sent_address(&self, uv: Vec2, emitting: bool) -> u32 {
        // both have the same size
        let (level, full) = (&self.levels[0], &self.levels[FULL]);
        level.address(uv).wrapping_add(if emitting {
            full.tiles.since(&level.tiles)
        } else {
            0
        })
    }

    /// Radiance that a triangle sends out at barycentrics (u, v).
    #[must_use]
    #[inline]
    pub fn emitted(&self, triangle: usize, u: f32, v: f32) -> Vec3 {
        let l = &self.lookups[triangle];
        self.texel(self.at(l, l.least_level as usize, u, v))
    }

    /// Whether any texel of triangle `t` emits.
    #[must_use]
    pub fn is_emissive(&self, t: usize) -> bool {
        self.lookups[t].least_level != 0
    }

    /// Unit normal of triangle `t` on the side the cameras see.
    #[must_use]
    #[inline]
    pub fn outward_normal(&self, t: usize) -> Vec3 {
        self.lookups[t].normal
    }
}
