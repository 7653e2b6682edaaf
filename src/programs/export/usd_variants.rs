//! Lit variants in USD: `unlit.usda` has surfaces and materials; `NAME.usda` refers to it and adds the
//! light of one lighting; `scene.usda` offers them all as the variant set `lighting` of one prim.
//!
//! A lighting's own variant set `shown` says how its light gets onto the surfaces: `traced` has lamps
//! for renderers that follow light, `baked` has none and surfaces that send out what they were
//! reckoned to, A · E/π and what they emit, for programs that do not.

use super::area_light::AreaLight;
use super::objects::unlike;
use super::save::save;
use super::usd::{
    HEADER, MeshPrim, UsdOptions, colour_texture, encode_light, is_lit_from_outside, mesh_prims,
    peak, prim_names, taken_names, write_usd_as,
};
use super::usd_lights::{dome_prim, lamp_prim, point_prim};
use super::usd_text::{identifier, quoted};
use crate::core::formats::write_rgb_half;
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::parallel::prelude::*;
use crate::error::Result;
use crate::solution::{LuminousPart, MeshPart, PunctualLight, Solution};
use glam::Vec2;
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;

/// The file without light, to which all others refer.
pub(super) const UNLIT: &str = "unlit.usda";
/// The file of all lightings.
const ALL: &str = "scene.usda";

/// A lighting of a solution.
pub(super) struct LitScene<'a> {
    /// The lighting's name.
    pub name: &'a str,
    /// The solution under it.
    pub lit: &'a Solution,
    /// Its objects, as those of `unlit.usda`.
    pub parts: &'a [MeshPart],
    /// Whether they stand elsewhere than there.
    pub moved: bool,
    /// Lamps as lights; none where surfaces that emit are light enough.
    pub lamps: Vec<AreaLight>,
    /// Lights without extent.
    pub points: Vec<PunctualLight>,
    /// Luminous surfaces that `unlit.usda` does not have.
    pub luminous: &'a [LuminousPart],
    /// The panorama's file, where light comes from outside.
    pub environment: Option<&'a str>,
    /// The albedo as large as the baked texture is to be.
    pub albedo: &'a RgbPlane,
}

/// Writes `unlit.usda` and its textures; returns their names. `solution` shines nowhere.
///
/// # Errors
/// A file cannot be written.
pub(super) fn write_unlit(
    folder: &Path,
    solution: &Solution,
    parts: &[MeshPart],
) -> Result<Vec<String>> {
    let mut dark = solution.clone();
    dark.environment = Plane::filled(1, 1, glam::Vec3::ZERO);
    let options = UsdOptions {
        parts,
        ..UsdOptions::default()
    };
    write_usd_as(UNLIT, folder, &dark, options)
}

/// Writes `scene.usda`, which has every lighting of `names`; returns its name.
///
/// # Errors
/// The file cannot be written.
pub(super) fn write_all(folder: &Path, names: &[&str]) -> Result<String> {
    let mut taken = BTreeSet::from(["unlit".to_owned()]);
    let mut variants: Vec<(String, String)> = names
        .iter()
        .map(|name| {
            let variant = unlike(&identifier(name), '_', &mut taken);
            (variant, format!("{name}.usda"))
        })
        .collect();
    variants.push(("unlit".to_owned(), UNLIT.to_owned()));
    let mut s = format!(
        "{HEADER}def Xform \"scene\" (\n    variants = {{\n        string lighting = \"{}\"\n    }}\n    \
         prepend variantSets = \"lighting\"\n)\n{{\n    variantSet \"lighting\" = {{\n",
        variants[0].0
    );
    for (variant, file) in &variants {
        let _ = writeln!(
            s,
            "        \"{variant}\" (\n            prepend references = @./{file}@</scene>\n        ) {{\n        }}"
        );
    }
    s.push_str("    }\n}\n");
    save(folder, ALL, s.as_bytes())?;
    Ok(ALL.to_owned())
}

impl LitScene<'_> {
    /// Writes `NAME.usda` and its textures; returns their names, the scene's first.
    ///
    /// # Errors
    /// A file cannot be written.
    pub(super) fn write(&self, folder: &Path) -> Result<Vec<String>> {
        let name = self.name;
        let mut files = vec![format!("{name}.usda")];
        let strongest = peak(&self.lit.emission);
        let emission = (strongest > 0.0).then(|| format!("{name}_emission.png"));
        if let Some(file) = &emission {
            save(folder, file, &encode_light(&self.lit.emission, strongest)?)?;
        }
        let baked = format!("{name}_baked.exr");
        write_rgb_half(folder.join(&baked), &sent_out(self.lit, self.albedo))?;
        let text = self.text(emission.as_deref().map(|e| (e, strongest)), &baked);
        save(folder, &files[0], text.as_bytes())?;
        files.extend(emission);
        files.push(baked);
        Ok(files)
    }

    /// The text of `NAME.usda`; the file of the emission goes with what its 1 means.
    fn text(&self, emission: Option<(&str, f32)>, baked: &str) -> String {
        let mut s = format!(
            "{HEADER}def Xform \"scene\" (\n    customData = {{\n        string lighting = {}\n    }}\n    \
             prepend references = @./{UNLIT}@</scene>\n    variants = {{\n        string shown = \"traced\"\n    }}\n    \
             prepend variantSets = \"shown\"\n)\n{{\n",
            quoted(self.name)
        );
        let mut taken = taken_names();
        let names = prim_names(self.parts, &mut taken);
        if self.moved {
            for mesh in mesh_prims(&self.lit.mesh, self.parts, names) {
                mesh.write_whole(&mut s, "over");
            }
        }
        self.added_surfaces(&mut s, &mut taken);
        s.push_str("    variantSet \"shown\" = {\n        \"traced\" {\n");
        if let Some((file, strongest)) = emission {
            s.push_str(
                "    over \"material\"\n    {\n        over \"surface\"\n        {\n            \
                 color3f inputs:emissiveColor.connect = </scene/material/emission.outputs:rgb>\n        }\n",
            );
            colour_texture(&mut s, "emission", file, strongest);
            s.push_str("    }\n\n");
        }
        self.lights(&mut s, taken);
        s.push_str("        }\n        \"baked\" {\n");
        self.baked_material(&mut s, baked);
        s.push_str("        }\n    }\n}\n");
        s
    }

    fn lights(&self, s: &mut String, mut taken: BTreeSet<String>) {
        for lamp in &self.lamps {
            let name = unlike(&identifier(&lamp.name), '_', &mut taken);
            lamp_prim(
                s,
                &AreaLight {
                    name,
                    ..lamp.clone()
                },
            );
        }
        for point in &self.points {
            let name = unlike(&identifier(&point.name), '_', &mut taken);
            point_prim(s, &name, point, self.lit.origin);
        }
        if let Some(file) = self.environment.filter(|_| is_lit_from_outside(self.lit)) {
            dome_prim(s, file);
        }
    }

    /// Lamps that were added: surfaces with a material that only emits.
    fn added_surfaces(&self, s: &mut String, taken: &mut BTreeSet<String>) {
        for part in self.luminous {
            let prim = unlike(&identifier(&part.name), '_', taken);
            let material = unlike(&format!("{prim}_material"), '_', taken);
            let mesh = MeshPrim {
                prim,
                name: &part.name,
                pivot: glam::Vec3::ZERO,
                mesh: Cow::Borrowed(&part.mesh),
                material: &material,
                copy: None,
            };
            mesh.write_whole(s, "def");
            let l = part.radiance;
            let _ = writeln!(
                s,
                "    def Material \"{material}\"\n    {{\n        token outputs:surface.connect = </scene/{material}/surface.outputs:surface>\n\n        \
                 def Shader \"surface\"\n        {{\n            uniform token info:id = \"UsdPreviewSurface\"\n            \
                 color3f inputs:diffuseColor = (0, 0, 0)\n            color3f inputs:emissiveColor = ({}, {}, {})\n            \
                 token outputs:surface\n        }}\n    }}\n",
                l.x, l.y, l.z
            );
        }
    }

    /// The material whose surfaces send out the baked light and reflect none.
    fn baked_material(&self, s: &mut String, file: &str) {
        let opacity = match self.lit.transmission {
            Some(_) => {
                "            float inputs:opacity.connect = </scene/material/opacity.outputs:r>\n"
            }
            None => "",
        };
        let _ = write!(
            s,
            "    over \"material\"\n    {{\n        token outputs:surface.connect = </scene/material/lit.outputs:surface>\n\n        \
             def Shader \"lit\"\n        {{\n            uniform token info:id = \"UsdPreviewSurface\"\n            \
             color3f inputs:diffuseColor = (0, 0, 0)\n            \
             color3f inputs:emissiveColor.connect = </scene/material/baked.outputs:rgb>\n            \
             int inputs:useSpecularWorkflow = 1\n            color3f inputs:specularColor = (0, 0, 0)\n            \
             float inputs:roughness = 1\n{opacity}            token outputs:surface\n        }}\n"
        );
        colour_texture(s, "baked", file, 1.0);
        s.push_str("    }\n");
    }
}

/// What surfaces of an `albedo` A send out under their irradiance E: A · E/π, metals as if they were
/// diffuse, and their emission.
fn sent_out(lit: &Solution, albedo: &RgbPlane) -> RgbPlane {
    let Plane { width, height, .. } = *albedo;
    let at = |plane: &RgbPlane, uv: Vec2| {
        let size = Vec2::new(plane.width as f32, plane.height as f32);
        plane.bilinear(uv * size, Wrap::Clamp)
    };
    let value = |i: usize| {
        let cell = Vec2::new((i % width) as f32, (i / width) as f32);
        let uv = (cell + 0.5) / Vec2::new(width as f32, height as f32);
        let diffuse = albedo.data[i] * at(&lit.irradiance, uv) / std::f32::consts::PI;
        diffuse + at(&lit.emission, uv)
    };
    let all = 0..width * height;
    Plane {
        width,
        height,
        data: all.into_par_iter().map(value).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::formats::read_rgb;
    use crate::core::texture::fitted;
    use crate::programs::export::light_mix::tests::two_lamps;
    use glam::Vec3;

    fn read(folder: &Path, file: &str) -> String {
        std::fs::read_to_string(folder.join(file)).expect("is there")
    }

    /// What a lighting's file refers to is there, braces close, lamps are in `traced` alone, and the baked
    /// texture is A · E/π and what shines.
    #[test]
    fn a_lighting_refers_to_the_unlit_scene_and_adds_its_light() {
        let folder = tempfile::tempdir().expect("temp");
        let mut lit = two_lamps();
        lit.irradiance.data.fill(Vec3::new(2.0, 4.0, 6.0));
        let scene = LitScene {
            name: "an evening",
            lit: &lit,
            parts: &[],
            moved: false,
            lamps: crate::programs::export::area_lights(&lit),
            points: Vec::new(),
            luminous: &[],
            environment: Some("an evening_environment.exr"),
            albedo: &fitted(&lit.mesh, &lit.albedo, 8),
        };
        let files = scene.write(folder.path()).expect("writes");
        assert_eq!(files.len(), 3);
        assert!(files.iter().all(|f| folder.path().join(f).is_file()));
        let text = read(folder.path(), "an evening.usda");
        assert_eq!(text.matches('{').count(), text.matches('}').count());
        assert!(text.contains("@./unlit.usda@</scene>"));
        let (traced, baked) = text.split_once("\"baked\" {").expect("two variants");
        assert!(traced.contains("DomeLight") && traced.matches("Light \"").count() == 3);
        assert!(!baked.contains("Light") && baked.contains("an evening_baked.exr"));
        let plane = read_rgb(folder.path().join("an evening_baked.exr")).expect("reads");
        assert_eq!((plane.width, plane.height), (8, 8));
        // the first column lies on the dark surface: A = 0.5
        let expected = 0.5 * Vec3::new(2.0, 4.0, 6.0) / std::f32::consts::PI;
        assert!(
            (plane.data[0] - expected).abs().max_element() < 2e-3,
            "{}",
            plane.data[0]
        );
        assert!(plane.data[4].x > 5.0, "a lamp shines: {}", plane.data[4]);
    }

    /// All lightings are variants, under names that USD takes, each once.
    #[test]
    fn all_lightings_are_variants_of_one_file() {
        let folder = tempfile::tempdir().expect("temp");
        let names = ["as it is", "as_it_is", "0 dark"];
        write_all(folder.path(), &names).expect("writes");
        let text = read(folder.path(), ALL);
        assert_eq!(text.matches('{').count(), text.matches('}').count());
        for name in names {
            assert_eq!(text.matches(&format!("@./{name}.usda@</scene>")).count(), 1);
        }
        for variant in ["\"as_it_is\" (", "\"_0_dark\" (", "\"unlit\" ("] {
            assert_eq!(text.matches(variant).count(), 1, "{variant}: {text}");
        }
    }
}
