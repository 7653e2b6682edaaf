//! `export --lightings`: one reconstruction under many lightings, a glTF and a USD file with baked light
//! each; one without any light; and `manifest.json`, which says what was changed in each.

use super::area_light::area_lights;
use super::job::{ExportOptions, Exported, Format, shown_parts};
use super::light_mix::{LightMix, LightmapQuality, relit};
use super::lightings::{Lightings, NamedLighting};
use super::punctual::{point_light, punctual_lights, surface_light};
use super::save::save;
use super::usd_variants::{self, LitScene};
use crate::core::formats::AsideFolder;
use crate::core::geometry::{Mesh, clusters};
use crate::core::image::{Plane, RgbPlane};
use crate::core::progress::Progress;
use crate::core::texture::{Texels, fill_uncovered, fitted};
use crate::error::{Error, Result};
use crate::render::{EditableScene, Lighting, SurfaceModel};
use crate::solution::{
    GlbOptions, Lamp, LuminousPart, MeshPart, NamedImage, PunctualLight, Solution, lamp_gap,
    material_textures, scene_glb,
};
use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::path::Path;

/// File of the list of variants.
const MANIFEST: &str = "manifest.json";
/// The file without light.
const UNLIT: &str = "unlit.glb";
/// Largest side of a lightmap that is chosen where none is given (measured 2026-11-26, a synthetic
/// room: a bake of 256² texels at 64 paths takes 27 s of processor time, and four times that of the
/// double side; light is smooth).
const LARGEST: usize = 512;

/// `manifest.json` of an export of lightings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VariantList {
    /// What tells the solution from any other.
    pub generation: String,
    /// Key of the draws.
    pub seed: u64,
    /// Texels along each side of a lightmap, and paths per texel of a bake.
    pub lightmap: LightmapRecord,
    /// The file with materials alone: glTF, or USD where no glTF is written.
    pub unlit: String,
    /// The USD file that has all lightings as variants, where USD is written.
    pub usd: Option<String>,
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
    /// The glTF file, or the USD file where no glTF is written.
    pub file: String,
    /// The USD file, where USD is written.
    pub usd: Option<String>,
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
    /// Factor per channel on its light; 0 = off.
    pub factor: [f32; 3],
    /// Its power then, RGB.
    pub power: [f32; 3],
}

/// Intensity up to which a light is none: of a lamp whose radiance is 0 in single precision.
const DARK: f64 = f32::MIN_POSITIVE as f64;

/// The scene under a lighting.
struct Shown {
    solution: Solution,
    parts: Vec<MeshPart>,
    /// Whether surfaces stand elsewhere than in the solution.
    moved: bool,
    /// Lights without extent that the solution does not have.
    points: Vec<PunctualLight>,
    /// Luminous surfaces that it does not have.
    luminous: Vec<LuminousPart>,
}

/// What all variants share.
struct Workshop<'a> {
    exported: &'a Exported<'a>,
    options: &'a ExportOptions,
    mix: LightMix<'a>,
    emission: EmissionMap,
    surface: Texels,
    /// Textures of the materials, the same in every file.
    encoded: Vec<NamedImage>,
    parts: Vec<MeshPart>,
    /// The albedo as large as textures may be.
    albedo: Cow<'a, RgbPlane>,
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
    options.check_with_lightings()?;
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
        encoded: material_textures(solution, packing(options).packing())?,
        parts: shown_parts(exported, options),
        albedo: fitted(&solution.mesh, &solution.albedo, options.max_texture),
        mix,
    };
    let aside = AsideFolder::new(folder)?;
    let mut files = shop.write_unlit(aside.path())?;
    let unlit = files[0].clone();
    let mut variants = Vec::new();
    for (k, lighting) in lightings.list.iter().enumerate() {
        let (variant, written) = shop.write(aside.path(), k, lighting, progress)?;
        files.extend(written);
        variants.push(variant);
    }
    let usd = shop.writes(Format::Usd).then(|| {
        let names: Vec<&str> = variants.iter().map(|v| v.name.as_str()).collect();
        usd_variants::write_all(aside.path(), &names)
    });
    let usd = usd.transpose()?;
    files.extend(usd.clone());
    let list = VariantList {
        generation: solution.generation(),
        seed: lightings.seed,
        lightmap: LightmapRecord {
            side: quality.side,
            paths: quality.paths,
            shared_bakes: shop.mix.shared_bakes(),
            quantity: "irradiance".into(),
        },
        unlit,
        usd,
        variants,
    };
    let text =
        serde_json::to_vec_pretty(&list).map_err(|e| Error::Failed(format!("{MANIFEST}: {e}")))?;
    save(aside.path(), MANIFEST, &text)?;
    files.push(MANIFEST.to_owned());
    aside.publish(folder, &files)?;
    Ok(files)
}

/// How textures are stored.
fn packing(options: &ExportOptions) -> GlbOptions {
    GlbOptions {
        max_texture: options.max_texture,
        textures: options.texture_format(),
        tangents: options.tangents,
        ..GlbOptions::default()
    }
}

impl Workshop<'_> {
    fn glb(&self, solution: &Solution, parts: Vec<MeshPart>, more: GlbOptions) -> Result<Vec<u8>> {
        let options = GlbOptions {
            lights: more.lights,
            lightmap: more.lightmap,
            luminous: more.luminous,
            parts,
            encoded: self.encoded.clone(),
            ..packing(self.options)
        };
        scene_glb(solution, &options)
    }

    fn writes(&self, format: Format) -> bool {
        self.options.format.contains(&format)
    }

    /// Materials alone: nothing shines, nothing is baked. Returns the files, the first of which has the
    /// scene.
    fn write_unlit(&self, folder: &Path) -> Result<Vec<String>> {
        let mut solution = self.exported.solution.clone();
        solution.emission.data.fill(Vec3::ZERO);
        let mut files = Vec::new();
        if self.writes(Format::Glb) {
            let glb = self.glb(&solution, self.parts.clone(), GlbOptions::default())?;
            save(folder, UNLIT, &glb)?;
            files.push(UNLIT.to_owned());
        }
        if self.writes(Format::Usd) {
            let usd = usd_variants::write_unlit(folder, &solution, &self.parts)?;
            files.extend(usd);
        }
        Ok(files)
    }

    /// Writes lighting `k`; returns the names of the files, too.
    fn write(
        &self,
        folder: &Path,
        k: usize,
        lighting: &NamedLighting,
        progress: &Progress,
    ) -> Result<(Variant, Vec<String>)> {
        let world = relit(lighting, self.exported.solution)?;
        let shown = self.shown(k, &world, progress)?;
        let lit = &shown.solution;
        let mut files = Vec::new();
        let bright = lit.environment.data.iter().any(|c| *c != Vec3::ZERO);
        let environment = bright.then(|| format!("{}_environment.exr", lighting.name));
        if let Some(name) = &environment {
            crate::core::formats::write_rgb_float(folder.join(name), &lit.environment)?;
            files.push(name.clone());
        }
        let mut scenes = Vec::new();
        if self.writes(Format::Glb) {
            let name = format!("{}.glb", lighting.name);
            save(folder, &name, &self.lit_glb(&shown)?)?;
            scenes.push(name);
        }
        let mut usd = None;
        if self.writes(Format::Usd) {
            let scene = LitScene {
                name: &lighting.name,
                lit,
                parts: &shown.parts,
                moved: shown.moved,
                lamps: match self.options.lights {
                    true => area_lights(lit),
                    false => Vec::new(),
                },
                points: shown.points,
                luminous: &shown.luminous,
                environment: environment.as_deref(),
                albedo: &self.albedo,
            };
            let written = scene.write(folder)?;
            usd = written.first().cloned();
            scenes.extend(written);
        }
        let variant = Variant {
            name: lighting.name.clone(),
            file: scenes[0].clone(),
            usd,
            environment,
            random: lighting.random,
            mixed: self.mix.is_mixed(k),
            lighting: lighting.lighting.clone(),
            lamps: self.lamps(k),
            mean_irradiance: self.mean(&lit.irradiance).to_array(),
        };
        files.extend(scenes);
        Ok((variant, files))
    }

    /// The glTF file of a lighting.
    fn lit_glb(&self, shown: &Shown) -> Result<Vec<u8>> {
        let lamps = match self.options.lights {
            true => punctual_lights(&shown.solution),
            false => Vec::new(),
        };
        let shining = lamps.into_iter().filter(|l| l.intensity > DARK);
        let glb = GlbOptions {
            lightmap: true,
            lights: shining.chain(shown.points.clone()).collect(),
            luminous: shown.luminous.clone(),
            ..GlbOptions::default()
        };
        self.glb(&shown.solution, shown.parts.clone(), glb)
    }

    /// What is shown under lighting `k`.
    fn shown(&self, k: usize, world: &EditableScene<'_>, progress: &Progress) -> Result<Shown> {
        let solution = self.lit(k, world, progress)?;
        let exported = Exported {
            solution: &solution,
            ..*self.exported
        };
        // (levels of detail hold places of their own)
        let moved = solution.mesh.positions != self.exported.solution.mesh.positions;
        let parts = match moved {
            false => self.parts.clone(),
            true => shown_parts(&exported, self.options),
        };
        let beyond = beyond_solution(world, solution.origin);
        Ok(Shown {
            points: self.points(&beyond, world, solution.origin),
            luminous: beyond.into_iter().map(|b| b.part).collect(),
            solution,
            parts,
            moved,
        })
    }

    /// The solution under lighting `k`.
    fn lit(&self, k: usize, world: &EditableScene<'_>, progress: &Progress) -> Result<Solution> {
        let mut lit = self.exported.solution.clone();
        lit.emission = self.emission.changed(&lit.emission, world);
        lit.irradiance = self.mix.lightmap(k, progress)?;
        lit.environment = world
            .environment_map()
            .map(|c| *c * world.environment_factor());
        lit.mesh = world.own_mesh();
        lit.lamps
            .iter_mut()
            .for_each(|lamp| as_it_stands(lamp, world, &self.exported.solution.mesh));
        Ok(lit)
    }

    /// What lighting `k` does to the solution's lamps.
    fn lamps(&self, k: usize) -> Vec<VariantLamp> {
        let factors = &self.mix.factors[k].lamps;
        let lamps = self.exported.solution.lamps.iter().zip(factors);
        lamps
            .map(|(lamp, factor)| VariantLamp {
                id: lamp.id,
                factor: factor.to_array(),
                power: (Vec3::from_array(lamp.power) * *factor).to_array(),
            })
            .collect()
    }

    /// Lights without extent that the solution does not have: added ones in any case, for added surfaces
    /// where they are wanted.
    fn points(
        &self,
        beyond: &[Beyond],
        world: &EditableScene<'_>,
        origin: DVec3,
    ) -> Vec<PunctualLight> {
        let mut lights = Vec::new();
        if self.options.lights {
            lights.extend(beyond.iter().map(|b| b.light.clone()));
            lights.retain(|l| l.intensity > DARK);
        }
        let added = (1..).zip(world.points());
        lights.extend(added.map(|(n, p)| point_light(&format!("added light {n}"), p, origin)));
        lights
    }

    /// Mean of a lightmap over the surfaces, by area.
    fn mean(&self, lightmap: &RgbPlane) -> Vec3 {
        let mesh = &self.exported.solution.mesh;
        let (mut sum, mut total) = (DVec3::ZERO, 0.0f64);
        for (i, &cell) in self.surface.cell.iter().enumerate() {
            let area = f64::from(self.surface.area(mesh, i));
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

/// Turns a lamp of the solution, whose surfaces lay in `before`, into what it is in a world: as
/// bright as they are, where they are.
fn as_it_stands(lamp: &mut Lamp, world: &EditableScene<'_>, before: &Mesh) {
    let (mut own, mut now, mut path) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
    for t in lamp.triangles.iter().map(|t| *t as usize) {
        let power = world.own_emission(t) * before.area(t);
        own += power;
        now += power * world.emission_factor(t);
        let shift = world.mesh().position(t, 0.0, 0.0) - before.position(t, 0.0, 0.0);
        path = if shift == Vec3::ZERO { path } else { shift };
    }
    let factor = now / own.max(Vec3::splat(f32::MIN_POSITIVE));
    lamp.power = (Vec3::from_array(lamp.power) * factor).to_array();
    lamp.radiance = (Vec3::from_array(lamp.radiance) * factor).to_array();
    lamp.centre = (DVec3::from_array(lamp.centre) + path.as_dvec3()).to_array();
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::programs::export::light_mix::tests::two_lamps;
    use serde_json::Value;
    use std::f32::consts::PI;

    const LIGHTINGS: &str = "[[lighting]]\nname = \"as it is\"\n\
        [[lighting]]\nname = \"dark\"\n[[lighting.lamp]]\noff = true\n[lighting.environment]\noff = true\n\
        [[lighting]]\nname = \"warm\"\n[[lighting.lamp]]\ngroup = 1\nscale = 0.5\ncolour = [1, 0.5, 0]\n\
        [[random]]\nname = \"r\"\ncount = 3\non = 0.5\n";

    /// Writes lightings of a solution; returns their manifest.
    fn written(folder: &Path, solution: &Solution, text: &str, lights: bool) -> VariantList {
        let path = folder.join("lightings.toml");
        std::fs::write(&path, text).expect("writes");
        let list = Lightings::read(&path, &solution.lamps, 4).expect("valid");
        let exported = Exported {
            solution,
            classes: &[],
            cameras: &[],
        };
        let options = ExportOptions {
            lightmap_size: 32,
            lightmap_paths: 16,
            lights,
            ..ExportOptions::default()
        };
        let to = folder.join("out");
        let files = export_lightings(&to, &exported, &list, &options, &Progress::silent());
        let files = files.expect("writes");
        assert!(files.iter().all(|f| to.join(f).is_file()), "{files:?}");
        let manifest = std::fs::read(to.join(MANIFEST)).expect("is there");
        serde_json::from_slice(&manifest).expect("a list")
    }

    fn root(folder: &Path, file: &str) -> Value {
        let bytes = std::fs::read(folder.join("out").join(file)).expect("is there");
        gltf::Gltf::from_slice(&bytes).expect("valid");
        let glb = gltf::binary::Glb::from_slice(&bytes).expect("container");
        serde_json::from_slice(&glb.json).expect("JSON")
    }

    #[test]
    fn every_lighting_has_its_files_and_its_values() {
        let folder = tempfile::tempdir().expect("temp");
        let solution = two_lamps();
        let list = written(folder.path(), &solution, LIGHTINGS, false);
        let names: Vec<&str> = list.variants.iter().map(|v| v.name.as_str()).collect();
        assert_eq!(
            names,
            ["as it is", "dark", "warm", "r_0000", "r_0001", "r_0002"]
        );
        assert_eq!((list.seed, list.lightmap.side), (4, 32));
        assert!(list.lightmap.shared_bakes > 0 && list.variants.iter().all(|v| v.mixed));
        let [own, dark, warm] = &list.variants[..3] else {
            panic!("three")
        };
        assert_eq!(dark.environment, None);
        assert_eq!(own.environment.as_deref(), Some("as it is_environment.exr"));
        assert_eq!(dark.mean_irradiance, [0.0; 3]);
        assert!(own.mean_irradiance[0] > warm.mean_irradiance[0]);
        assert_eq!(warm.lamps[0].factor, [0.5, 0.25, 0.0]);
        assert_eq!(warm.lamps[1].factor, [1.0; 3]);
        let power = solution.lamps[0].power;
        let expected = Vec3::from_array(power) * Vec3::new(0.5, 0.25, 0.0);
        assert_eq!(Vec3::from_array(warm.lamps[0].power), expected);

        // all share the materials
        let bytes = |file: &str| std::fs::read(folder.path().join("out").join(file)).expect("read");
        let options = ExportOptions::default();
        for image in material_textures(&solution, packing(&options).packing()).expect("encodes") {
            for file in [UNLIT, "dark.glb", "warm.glb"] {
                let file = bytes(file);
                assert!(file.windows(image.bytes.len()).any(|w| w == image.bytes));
            }
        }
        let texture = |file: &str, key: &str| {
            let m = &root(folder.path(), file)["materials"][0];
            (
                m.get("emissiveTexture").is_some(),
                m["extensions"][key]["intensity"].as_f64(),
            )
        };
        assert_eq!(texture(UNLIT, "MOZ_lightmap"), (false, None));
        assert_eq!(texture("dark.glb", "MOZ_lightmap"), (false, None));
        let (shines, intensity) = texture("as it is.glb", "MOZ_lightmap");
        assert!(shines && intensity.is_some_and(|i| i > f64::from(own.mean_irradiance[0])));
    }

    #[test]
    fn only_the_lamps_that_a_lighting_names_change_their_emission() {
        let solution = two_lamps();
        let mut world = EditableScene::new(&solution);
        let map = EmissionMap::of(&solution);
        assert_eq!(map.changed(&solution.emission, &world), solution.emission);
        let lamp = &solution.lamps[0];
        world.scale_emission(&lamp.triangles, Vec3::new(0.5, 0.0, 2.0));
        let changed = map.changed(&solution.emission, &world);
        let own = |p: &RgbPlane, l: &Lamp| {
            *p.nearest(
                solution.mesh.uv(l.triangles[0] as usize, 0.3, 0.3) * glam::Vec2::new(3.0, 1.0),
            )
        };
        let before = own(&solution.emission, lamp);
        assert_eq!(own(&changed, lamp), before * Vec3::new(0.5, 0.0, 2.0));
        let other = &solution.lamps[1];
        assert_eq!(own(&changed, other), own(&solution.emission, other));
    }

    /// A lamp that is added is in the file as what it is: its surface, or its intensity.
    #[test]
    fn added_lamps_are_written_with_their_light() {
        let folder = tempfile::tempdir().expect("temp");
        let solution = two_lamps();
        let at = (solution.origin + DVec3::new(0.0, 1.0, 0.5)).to_array();
        let text = format!(
            "[[lighting]]\nname = \"a\"\n[[lighting.lamp]]\noff = true\n\
             [[lighting.add]]\nkind = \"quad\"\nposition = {at:?}\ndirection = [0, -1, 0]\nsize = [0.4, 0.2]\nradiance = [8, 4, 2]\n\
             [[lighting.add]]\nkind = \"spot\"\nposition = {at:?}\ndirection = [0, -1, 0]\nangle = 30\nblend = 0.5\nintensity = [3, 3, 3]\n"
        );
        let list = written(folder.path(), &solution, &text, true);
        assert!(!list.variants[0].mixed && list.variants[0].mean_irradiance[0] > 0.0);
        let root = root(folder.path(), "a.glb");
        let material = &root["materials"][1];
        let strength = &material["extensions"]["KHR_materials_emissive_strength"];
        assert_eq!(strength["emissiveStrength"], 8.0);
        assert_eq!(
            material["emissiveFactor"],
            serde_json::json!([1.0, 0.5, 0.25])
        );
        let bounds = |b: &str| -> Vec<f64> {
            let mesh = &root["meshes"][1]["primitives"][0]["attributes"]["POSITION"];
            let accessor = &root["accessors"][mesh.as_u64().expect("an accessor") as usize];
            let list = accessor[b].as_array().expect("bounds");
            list.iter().filter_map(Value::as_f64).collect()
        };
        let (low, high) = (bounds("min"), bounds("max"));
        assert!((high[1] - 1.0).abs() < 1e-6 && (low[1] - 1.0).abs() < 1e-6);
        assert!(((high[0] - low[0]) * (high[2] - low[2]) - 0.08).abs() < 1e-6);
        let lights = root["extensions"]["KHR_lights_punctual"]["lights"].as_array();
        let lights = lights.expect("lights");
        // the solution's lamps are off and are no lights
        let names: Vec<&str> = lights.iter().filter_map(|l| l["name"].as_str()).collect();
        assert_eq!(names, ["added lamp 1", "added light 1"]);
        let intensity = lights[0]["intensity"].as_f64().expect("a number");
        // π · L · area over the whole sphere
        let expected = f64::from(PI) * 8.0 * 0.08 / (4.0 * f64::from(PI));
        assert!((intensity - expected).abs() < 1e-5, "{intensity}");
        assert_eq!(
            (lights[1]["type"].as_str(), lights[1]["intensity"].as_f64()),
            (Some("spot"), Some(3.0))
        );
    }

    #[test]
    fn a_lighting_that_cannot_be_applied_is_named() {
        let solution = two_lamps();
        let lighting = NamedLighting {
            name: "evening".into(),
            lighting: toml::from_str("[[lamp]]\ngroup = 9\noff = true\n").expect("valid"),
            random: false,
        };
        let e = relit(&lighting, &solution).err().expect("no lamp 9");
        let said = e.to_string();
        assert!(e.exit_code() == 2 && said.contains("evening") && said.contains("--list-lamps"));
    }
}
