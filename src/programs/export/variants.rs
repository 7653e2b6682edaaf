//! `export --lightings`: one reconstruction under many lightings, a glTF file with a baked lightmap
//! each; one without any light; and `manifest.json`, which says what was changed in each.

use super::job::{ExportOptions, Exported};
use super::light_mix::{LightMix, LightmapQuality, relit};
use super::lightings::{Lightings, NamedLighting};
use super::objects::objects;
use super::punctual::{point_light, punctual_lights, surface_light};
use crate::core::geometry::clusters;
use crate::core::image::{Plane, RgbPlane};
use crate::core::progress::Progress;
use crate::core::texture::{Texels, fill_uncovered};
use crate::error::{Error, Result};
use crate::render::{EditableScene, Lighting, SurfaceModel};
use crate::solution::{
    AsideFolder, GlbOptions, Lamp, LuminousPart, PunctualLight, Solution, lamp_gap, scene_glb,
};
use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// File of the list of variants.
const MANIFEST: &str = "manifest.json";
/// The file without light.
const UNLIT: &str = "unlit.glb";
/// Largest side of a lightmap that is chosen where none is given: light is smooth, and a file holds
/// one beside its other textures (measured: a bake of 1024² texels takes as long as a draft of the
/// reconstruction).
const LARGEST: usize = 1024;

/// `manifest.json` of an export of lightings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VariantList {
    /// What tells the solution from any other.
    pub generation: String,
    /// Key of the draws.
    pub seed: u64,
    /// Texels along each side of a lightmap, and paths per texel of a bake.
    pub lightmap: LightmapRecord,
    /// The file with materials alone.
    pub unlit: String,
    /// The lightings, in the order of their file.
    pub variants: Vec<Variant>,
}

/// How lightmaps were baked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LightmapRecord {
    /// Texels along each side.
    pub side: usize,
    /// Paths per texel and bake.
    pub paths: u32,
    /// Bakes that lightings are mixed of.
    pub shared_bakes: usize,
    /// What a lightmap's linear texel · intensity is.
    pub quantity: String,
}

/// A lighting and its files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Variant {
    /// Name.
    pub name: String,
    /// The glTF file.
    pub file: String,
    /// The panorama around it; `None` where no light comes from outside.
    pub environment: Option<String>,
    /// Whether it was drawn at random.
    pub random: bool,
    /// Whether its lightmap is mixed of shared bakes; it was baked by itself otherwise.
    pub mixed: bool,
    /// What was changed, as `relight --lights` reads it.
    pub lighting: Lighting,
    /// The solution's lamps as they are then.
    pub lamps: Vec<VariantLamp>,
    /// Mean irradiance of the lightmap over the surfaces, RGB.
    pub mean_irradiance: [f32; 3],
}

/// A lamp of the solution under a lighting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VariantLamp {
    /// Its number in `lights.json`.
    pub id: usize,
    /// Factor per channel on its light; 0 = off, or moved.
    pub factor: [f32; 3],
    /// Its power then, RGB.
    pub power: [f32; 3],
}

/// What all variants share.
struct Workshop<'a> {
    exported: &'a Exported<'a>,
    options: &'a ExportOptions,
    mix: LightMix<'a>,
    emission: EmissionMap,
    surface: Texels,
}

/// Writes the lightings into `folder`, all or nothing; returns the file names.
///
/// # Errors
/// A lighting cannot be applied; a file cannot be written.
pub fn export_lightings(
    folder: &Path,
    exported: &Exported<'_>,
    lightings: &Lightings,
    options: &ExportOptions,
    progress: &Progress,
) -> Result<Vec<String>> {
    let solution = exported.solution;
    options.check()?;
    let e = &solution.irradiance;
    let quality = LightmapQuality {
        side: match options.lightmap_size {
            0 => e.width.max(e.height).clamp(1, LARGEST),
            side => side,
        },
        paths: options.lightmap_paths,
        seed: lightings.seed,
    };
    let mix = LightMix::new(solution, &lightings.list, quality, progress)?;
    let shop = Workshop {
        exported,
        options,
        emission: EmissionMap::of(solution),
        surface: Texels::rasterize(&solution.mesh, quality.side, quality.side),
        mix,
    };
    let aside = AsideFolder::new(folder)?;
    let mut files = vec![UNLIT.to_owned()];
    shop.write_unlit(aside.path())?;
    let mut variants = Vec::new();
    for (k, lighting) in lightings.list.iter().enumerate() {
        let variant = shop.write(aside.path(), k, lighting, progress)?;
        files.push(variant.file.clone());
        files.extend(variant.environment.clone());
        variants.push(variant);
    }
    let list = VariantList {
        generation: solution.generation(),
        seed: lightings.seed,
        lightmap: LightmapRecord {
            side: quality.side,
            paths: quality.paths,
            shared_bakes: shop.mix.shared_bakes(),
            quantity: "irradiance".into(),
        },
        unlit: UNLIT.into(),
        variants,
    };
    let text =
        serde_json::to_vec_pretty(&list).map_err(|e| Error::Failed(format!("{MANIFEST}: {e}")))?;
    save(aside.path(), MANIFEST, &text)?;
    files.push(MANIFEST.to_owned());
    aside.publish(folder, &files)?;
    Ok(files)
}

fn save(folder: &Path, name: &str, bytes: &[u8]) -> Result<()> {
    let path = folder.join(name);
    std::fs::write(&path, bytes).map_err(|e| Error::io(&path, e))
}

impl Workshop<'_> {
    fn glb(&self, solution: &Solution, more: GlbOptions) -> Result<Vec<u8>> {
        let options = GlbOptions {
            max_texture: self.options.max_texture,
            webp: self.options.webp,
            parts: objects(solution, self.options.split, self.exported.classes),
            ..more
        };
        scene_glb(solution, &options)
    }

    /// Materials alone: nothing shines, nothing is baked.
    fn write_unlit(&self, folder: &Path) -> Result<()> {
        let mut solution = self.exported.solution.clone();
        solution.emission.data.fill(Vec3::ZERO);
        save(folder, UNLIT, &self.glb(&solution, GlbOptions::default())?)
    }

    /// Writes lighting `k`.
    fn write(
        &self,
        folder: &Path,
        k: usize,
        lighting: &NamedLighting,
        progress: &Progress,
    ) -> Result<Variant> {
        let origin = self.exported.solution.origin;
        let world = relit(lighting, self.exported.solution)?;
        let factors = &self.mix.factors[k].lamps;
        let mut lit = self.exported.solution.clone();
        lit.emission = self.emission.changed(&lit.emission, &world);
        lit.irradiance = self.mix.lightmap(k, progress)?;
        lit.environment = world
            .environment_map()
            .map(|c| *c * world.environment_factor());
        for (lamp, factor) in lit.lamps.iter_mut().zip(factors) {
            lamp.power = (Vec3::from_array(lamp.power) * *factor).to_array();
            lamp.radiance = (Vec3::from_array(lamp.radiance) * *factor).to_array();
        }
        let lamps: Vec<VariantLamp> = lit
            .lamps
            .iter()
            .zip(factors)
            .map(|(lamp, factor)| VariantLamp {
                id: lamp.id,
                factor: factor.to_array(),
                power: lamp.power,
            })
            .collect();
        let beyond = beyond_solution(&world, origin);
        let file = format!("{}.glb", lighting.name);
        let glb = GlbOptions {
            lightmap: true,
            lights: self.lights(&lit, &beyond, &world, origin),
            luminous: beyond.into_iter().map(|b| b.part).collect(),
            ..GlbOptions::default()
        };
        save(folder, &file, &self.glb(&lit, glb)?)?;
        let bright = lit.environment.data.iter().any(|c| *c != Vec3::ZERO);
        let environment = bright.then(|| format!("{}_environment.exr", lighting.name));
        if let Some(name) = &environment {
            crate::core::formats::write_rgb_float(folder.join(name), &lit.environment)?;
        }
        Ok(Variant {
            name: lighting.name.clone(),
            file,
            environment,
            random: lighting.random,
            mixed: self.mix.is_mixed(k),
            lighting: lighting.lighting.clone(),
            lamps,
            mean_irradiance: self.mean(&lit.irradiance).to_array(),
        })
    }

    /// Lights without extent: added ones in any case, for surfaces where they are wanted.
    fn lights(
        &self,
        lit: &Solution,
        beyond: &[Beyond],
        world: &EditableScene<'_>,
        origin: DVec3,
    ) -> Vec<PunctualLight> {
        let mut lights = Vec::new();
        if self.options.lights {
            lights = punctual_lights(lit);
            lights.extend(beyond.iter().map(|b| b.light.clone()));
            lights.retain(|l| l.intensity > f64::from(f32::MIN_POSITIVE));
        }
        let added = (1..).zip(world.points());
        lights.extend(added.map(|(n, p)| point_light(&format!("added light {n}"), p, origin)));
        lights
    }

    /// Mean of a lightmap over the surfaces, by area.
    fn mean(&self, lightmap: &RgbPlane) -> Vec3 {
        let mesh = &self.exported.solution.mesh;
        let (mut sum, mut total) = (DVec3::ZERO, 0.0f64);
        for (p, &cell) in self.surface.point.iter().zip(&self.surface.cell) {
            let area = f64::from(self.surface.texel_area(mesh, p.triangle as usize));
            sum += lightmap.data[cell as usize].as_dvec3() * area;
            total += area;
        }
        (sum / total.max(f64::MIN_POSITIVE)).as_vec3()
    }
}

/// A luminous surface that the solution does not have: a lamp that was moved or added.
struct Beyond {
    part: LuminousPart,
    /// The same as a light without extent.
    light: PunctualLight,
}

/// Luminous surfaces beyond the solution's, lamp by lamp.
fn beyond_solution(world: &EditableScene<'_>, origin: DVec3) -> Vec<Beyond> {
    let mesh = world.mesh();
    let bright = |t: &u32| world.mean_emission(*t as usize) != Vec3::ZERO;
    let triangles: Vec<u32> = world
        .beyond_solution()
        .map(|t| t as u32)
        .filter(bright)
        .collect();
    let mut out = Vec::new();
    for (n, triangles) in (1..).zip(clusters(mesh, &triangles, lamp_gap(mesh))) {
        let name = format!("added lamp {n}");
        let (mut area, mut flux) = (0.0f32, Vec3::ZERO);
        let (mut centre, mut normals) = (Vec3::ZERO, Vec3::ZERO);
        for &t in &triangles {
            let t = t as usize;
            area += mesh.area(t);
            flux += mesh.area(t) * world.mean_emission(t);
            centre += mesh.area(t) * mesh.position(t, 1.0 / 3.0, 1.0 / 3.0);
            normals += mesh.double_area_normal(t);
        }
        let whole = area.max(f32::MIN_POSITIVE);
        let lamp = Lamp {
            centre: ((centre / whole).as_dvec3() + origin).to_array(),
            area,
            radiance: (flux / whole).to_array(),
            ..Lamp::default()
        };
        out.push(Beyond {
            light: surface_light(&name, &lamp, normals),
            part: LuminousPart {
                name,
                mesh: mesh.part(&triangles),
                radiance: flux / whole,
            },
        });
    }
    out
}

/// Which triangle decides what a texel of the emission emits.
struct EmissionMap {
    texels: Texels,
}

impl EmissionMap {
    fn of(solution: &Solution) -> Self {
        let e = &solution.emission;
        Self {
            texels: Texels::rasterize(&solution.mesh, e.width, e.height),
        }
    }

    /// The emission under changed light: each texel has the factor of its triangle; texels between
    /// charts, and those that a lamp shares with what does not emit, that of the lamp beside them.
    fn changed(&self, emission: &RgbPlane, world: &EditableScene<'_>) -> RgbPlane {
        let mut factor = Plane::filled(emission.width, emission.height, Vec3::ZERO);
        let mut known = Plane::filled(emission.width, emission.height, false);
        for (p, &cell) in self.texels.point.iter().zip(&self.texels.cell) {
            let t = p.triangle as usize;
            if world.emits(t) {
                factor.data[cell as usize] = world.emission_factor(t);
                known.data[cell as usize] = true;
            }
        }
        let mut out = emission.clone();
        let factor = fill_uncovered(&factor, &known);
        for (e, f) in out.data.iter_mut().zip(&factor.data) {
            if *e != Vec3::ZERO {
                *e *= *f;
            }
        }
        out
    }
}
