//! The materials of a glTF file as the path tracer meets them.
//!
//! Base colour (texture, factor, vertex colour), roughness and metal as glTF 2.0 defines them:
//! metal has no diffuse part and mirrors its colour, paint's lies below its gloss. Alpha is coverage: `MASK`
//! cuts out, `BLEND` stops a share of the rays. `KHR_materials_transmission` makes panes.

use crate::core::brdf::{BaseColour, Reflectance};
use crate::core::formats::{
    Alpha, Border, GltfFile, GltfMaterial, GltfTexture, Picture8, Piece, TextureUse,
};
use crate::core::math::linear_from_srgb;
use crate::core::trace::{Coverage, Hit, Ray, number_of_ray};
use crate::error::Result;
use crate::render::{Surface, SurfaceModel};
use glam::{Vec2, Vec3, Vec4};
use std::collections::{BTreeMap, BTreeSet};

/// Pictures, materials, and what each traced triangle has of them.
pub(super) struct Looks {
    /// Of the file; the standard's default comes last.
    looks: Vec<GltfMaterial>,
    textures: BTreeMap<usize, GltfTexture>,
    pictures: BTreeMap<usize, Picture8>,
    /// Linear values of encoded ones.
    curve: Vec<f32>,
    triangles: Vec<Corners>,
    mean_emission: Vec<Vec3>,
}

/// What a triangle's corners have.
#[derive(Clone, Copy, Default)]
struct Corners {
    look: u32,
    base: [Vec2; 3],
    metal_roughness: [Vec2; 3],
    emissive: [Vec2; 3],
    transmission: [Vec2; 3],
    colour: [Vec4; 3],
}

/// What a texture's numbers are.
#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Srgb,
    Linear,
}

impl Looks {
    /// Reads the materials of a file and the pictures they use.
    ///
    /// # Errors
    /// A material or picture that cannot be used.
    pub(super) fn read(file: &GltfFile<'_>, notes: &mut BTreeSet<String>) -> Result<Self> {
        let mut looks = file.materials(notes)?;
        let (mut textures, mut pictures) = (BTreeMap::new(), BTreeMap::new());
        for look in &looks {
            let used = [
                &look.base.texture,
                &look.metal_roughness.texture,
                &look.emissive.texture,
                &look.transmission.texture,
            ];
            for used in used.into_iter().flatten() {
                let texture = file.texture(used.texture)?;
                if let std::collections::btree_map::Entry::Vacant(e) = pictures.entry(texture.image)
                {
                    e.insert(file.picture(texture.image)?);
                }
                textures.insert(used.texture, texture);
            }
        }
        looks.push(GltfMaterial::default());
        Ok(Self {
            looks,
            textures,
            pictures,
            curve: (0..256)
                .map(|b| linear_from_srgb(b as f32 / 255.0))
                .collect(),
            triangles: Vec::new(),
            mean_emission: Vec::new(),
        })
    }

    /// Adds a triangle of a piece: the next that is traced.
    pub(super) fn push(&mut self, piece: &Piece, triangle: usize) {
        let default = self.looks.len() - 1;
        let number = piece.material.filter(|m| *m < default).unwrap_or(default);
        let look = &self.looks[number];
        let corners = piece.triangles[triangle];
        let uv = |used: &Option<TextureUse>| {
            let set = used
                .as_ref()
                .and_then(|u| Some((u, piece.uvs.get(&u.uv.set)?)));
            set.map_or([Vec2::ZERO; 3], |(u, set)| {
                corners.map(|v| u.uv.sampled_at(set[v as usize]))
            })
        };
        let colours = piece.colours.as_ref();
        let corners = Corners {
            look: number as u32,
            base: uv(&look.base.texture),
            metal_roughness: uv(&look.metal_roughness.texture),
            emissive: uv(&look.emissive.texture),
            transmission: uv(&look.transmission.texture),
            colour: corners.map(|v| colours.map_or(Vec4::ONE, |c| c[v as usize])),
        };
        self.triangles.push(corners);
        let mean = self.mean_of(&corners);
        self.mean_emission.push(mean);
    }

    /// Whether any of the triangles is not all there.
    pub(super) fn has_holes(&self) -> bool {
        self.any(|look| look.alpha != Alpha::Opaque)
    }

    fn any(&self, is: impl Fn(&GltfMaterial) -> bool) -> bool {
        let of = |c: &Corners| is(&self.looks[c.look as usize]);
        self.triangles.iter().any(of)
    }

    /// As what is seen through by eye: panes are not there.
    pub(super) fn without_panes(&self) -> WithoutPanes<'_> {
        WithoutPanes(self)
    }

    /// Whether anything emits.
    pub(super) fn shines(&self) -> bool {
        self.mean_emission.iter().any(|e| *e != Vec3::ZERO)
    }

    /// Whether the back of a triangle is no surface.
    pub(super) fn is_one_sided(&self, triangle: usize) -> bool {
        !self.look(triangle).double_sided
    }

    fn look(&self, triangle: usize) -> &GltfMaterial {
        &self.looks[self.triangles[triangle].look as usize]
    }

    /// Mean radiance that a triangle emits: of a texture by a grid about as fine as its texels.
    fn mean_of(&self, corners: &Corners) -> Vec3 {
        const MOST: usize = 32;
        let look = &self.looks[corners.look as usize];
        let factor = Vec3::from_array(look.emissive.factor);
        let Some(used) = look
            .emissive
            .texture
            .as_ref()
            .filter(|_| factor != Vec3::ZERO)
        else {
            return factor;
        };
        let picture = &self.pictures[&self.textures[&used.texture].image];
        let size = Vec2::new(picture.width as f32, picture.height as f32);
        let [a, b, c] = corners.emissive.map(|uv| uv * size);
        let extent = (b - a).abs().max((c - a).abs()).max_element();
        let n = if extent.is_finite() {
            (extent as usize).clamp(4, MOST)
        } else {
            4
        };
        let mut sum = Vec3::ZERO;
        for i in 0..n {
            for j in 0..n {
                // a square folded onto the triangle
                let (mut u, mut v) = ((i as f32 + 0.5) / n as f32, (j as f32 + 0.5) / n as f32);
                if u + v > 1.0 {
                    (u, v) = (1.0 - u, 1.0 - v);
                }
                let uv = between(corners.emissive, u, v);
                sum += self.texel(used, uv, Encoding::Srgb).truncate();
            }
        }
        factor * sum / (n * n) as f32
    }

    /// The texture at texture coordinates, bilinear unless the file wants the nearest texel.
    fn texel(&self, used: &TextureUse, uv: Vec2, encoding: Encoding) -> Vec4 {
        let texture = &self.textures[&used.texture];
        let picture = &self.pictures[&texture.image];
        if !uv.is_finite() {
            return Vec4::ONE;
        }
        let at = uv * Vec2::new(picture.width as f32, picture.height as f32);
        let value = |x: f32, y: f32| {
            let x = bordered(x as i64, picture.width, texture.border[0]);
            let y = bordered(y as i64, picture.height, texture.border[1]);
            let p = picture.rgba[y * picture.width + x];
            let colour = |b: u8| match encoding {
                Encoding::Srgb => self.curve[usize::from(b)],
                Encoding::Linear => f32::from(b) / 255.0,
            };
            Vec4::new(
                colour(p[0]),
                colour(p[1]),
                colour(p[2]),
                f32::from(p[3]) / 255.0,
            )
        };
        if texture.nearest {
            return value(at.x.floor(), at.y.floor());
        }
        let (low, part) = ((at - 0.5).floor(), at - 0.5 - (at - 0.5).floor());
        let row = |y: f32| value(low.x, y).lerp(value(low.x + 1.0, y), part.x);
        row(low.y).lerp(row(low.y + 1.0), part.y)
    }

    fn sampled(&self, used: &Option<TextureUse>, uv: Vec2, encoding: Encoding) -> Vec4 {
        used.as_ref()
            .map_or(Vec4::ONE, |u| self.texel(u, uv, encoding))
    }

    /// Base colour with alpha at barycentrics (u, v).
    fn base(&self, triangle: usize, u: f32, v: f32) -> Vec4 {
        let corners = &self.triangles[triangle];
        let base = &self.looks[corners.look as usize].base;
        let uv = between(corners.base, u, v);
        let [a, b, c] = corners.colour;
        let colour = a * (1.0 - u - v) + b * u + c * v;
        Vec4::from_array(base.factor) * self.sampled(&base.texture, uv, Encoding::Srgb) * colour
    }
}

/// The value of a triangle's corners at barycentrics (u, v).
fn between([a, b, c]: [Vec2; 3], u: f32, v: f32) -> Vec2 {
    a * (1.0 - u - v) + b * u + c * v
}

/// The texel of a row of `n` that stands for the `i`-th.
fn bordered(i: i64, n: usize, border: Border) -> usize {
    let n = n as i64;
    let found = match border {
        Border::Clamp => i.clamp(0, n - 1),
        Border::Repeat => i.rem_euclid(n),
        Border::Mirror => {
            let i = i.rem_euclid(2 * n);
            i.min(2 * n - 1 - i)
        }
    };
    found as usize
}

impl SurfaceModel for Looks {
    fn surface(&self, triangle: usize, u: f32, v: f32) -> Surface {
        let look = self.look(triangle);
        let corners = &self.triangles[triangle];
        let base = self.base(triangle, u, v).truncate();
        let mr = &look.metal_roughness;
        let uv = between(corners.metal_roughness, u, v);
        let texel = self.sampled(&mr.texture, uv, Encoding::Linear);
        let (metal, roughness) = (mr.factor[0] * texel.z, mr.factor[1] * texel.y);
        let mut transmission = look.transmission.factor;
        if transmission > 0.0 {
            let uv = between(corners.transmission, u, v);
            transmission *= self
                .sampled(&look.transmission.texture, uv, Encoding::Linear)
                .x;
        }
        let mut emission = Vec3::from_array(look.emissive.factor);
        if emission != Vec3::ZERO {
            let uv = between(corners.emissive, u, v);
            emission *= self
                .sampled(&look.emissive.texture, uv, Encoding::Srgb)
                .truncate();
        }
        Surface {
            base: BaseColour {
                colour: base,
                metallic: metal,
            },
            transmission,
            roughness,
            emission,
        }
    }

    fn mean_emission(&self, triangle: usize) -> Vec3 {
        self.mean_emission[triangle]
    }

    fn label(&self, _: usize) -> u16 {
        0
    }

    fn reflectance(&self) -> Reflectance {
        Reflectance::Smith
    }

    fn has_panes(&self) -> bool {
        self.any(|look| look.transmission.factor > 0.0)
    }

    fn is_layered(&self) -> bool {
        true
    }

    fn emits_forward_only(&self, triangle: usize) -> bool {
        self.is_one_sided(triangle)
    }
}

impl Coverage for Looks {
    fn stops(&self, ray: &Ray, hit: &Hit) -> bool {
        let triangle = hit.triangle as usize;
        let alpha = || self.base(triangle, hit.u, hit.v).w;
        match self.look(triangle).alpha {
            Alpha::Opaque => true,
            Alpha::Mask(cutoff) => alpha() >= cutoff,
            // (the number's lower half: its upper decides on what passes panes)
            Alpha::Blend => (4096.0 * number_of_ray(ray, hit)).fract() < alpha(),
        }
    }
}

/// A scene whose panes are open.
pub(super) struct WithoutPanes<'a>(&'a Looks);

impl Coverage for WithoutPanes<'_> {
    fn stops(&self, ray: &Ray, hit: &Hit) -> bool {
        self.0.look(hit.triangle as usize).transmission.factor == 0.0 && self.0.stops(ray, hit)
    }
}
