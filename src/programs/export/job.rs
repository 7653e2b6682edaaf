//! `unbake export`: a solution in the formats of other programs.

use super::hulls::{COLLISION, ObjectHulls, collision_glb, object_hulls};
use super::levels::{MOST_LEVELS, levels};
use super::object_atlas::{AtlasKind, check_sizes, cut_out};
use super::objects::{ClassName, Split, objects, unlike};
use super::save::save;
use super::{UsdOptions, punctual_lights, write_mitsuba, write_usd};
use crate::core::formats::AsideFolder;
use crate::core::geometry::{Camera, Projection};
use crate::core::parallel::map_chunks;
use crate::error::{Error, Result};
use crate::render::NamedCamera;
use crate::solution::{
    GlbOptions, MeshPart, Solution, TextureFormat, objects_glb, png_textures, scene_glb,
};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::Path;

/// A format to export to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// glTF 2.0, binary.
    Glb,
    /// USD, text, with PNG textures.
    Usd,
    /// Mitsuba 3 scene.
    Mitsuba,
}

/// Options of `unbake export`.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
#[command(next_help_heading = "Export")]
pub struct ExportOptions {
    /// Formats to write, separated by commas.
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["glb", "usd", "mitsuba"])]
    pub format: Vec<Format>,
    /// Largest side of an embedded glTF texture, texels.
    #[arg(long, value_name = "TEXELS", default_value_t = Self::default().max_texture)]
    pub max_texture: usize,
    /// Add the lamps as lights beside their emissive surfaces, for engines that do not light by
    /// these: KHR_lights_punctual in glTF, rectangles, disks and spheres of UsdLux in USD.
    #[arg(long, alias = "punctual-lights")]
    #[serde(alias = "punctual-lights")]
    pub lights: bool,
    /// Add the irradiance to the glTF file as a lightmap on the second texture set (MOZ_lightmap).
    #[arg(long)]
    pub lightmap: bool,
    /// Divide the surfaces of the glTF and USD files into objects that stand for themselves, named
    /// by class: an object per class, or per connected piece of a class ("chair", "chair 2").
    #[arg(long, value_enum, default_value_t = Self::default().split)]
    pub split: Split,
    /// With --split, whether the glTF file's objects share the textures or each has its own, cut out of
    /// them texel by texel.
    #[arg(long, value_enum, default_value_t = Self::default().atlas)]
    pub atlas: AtlasKind,
    /// Add N coarser meshes to each object of the glTF file (MSFT_lod), each of half the triangles of
    /// the one before it and on the same textures.
    #[arg(long, value_name = "N", default_value_t = Self::default().lods)]
    pub lods: u32,
    /// Add convex bodies of each object, to collide by: scene_collision.glb beside the glTF file (nodes
    /// UCX_NAME_01, as Unreal reads them), meshes of UsdPhysics in the USD file.
    #[arg(long)]
    pub hulls: bool,
    /// Give the glTF file's vertices tangents (MikkTSpace), for normal maps of your own.
    #[arg(long)]
    pub tangents: bool,
    /// Write the glTF file's textures beside it too, as 8-bit PNG: scene_BaseColor.png,
    /// scene_ORM.png (occlusion, roughness, metal), scene_Emissive.png; where 8 bits would show as
    /// bands, scene_Roughness.png with 16. With --atlas per-object, NAME_BaseColor.png, ….
    #[arg(long)]
    pub textures: bool,
    /// With --lightings, side of the lightmaps in texels; 0 = as the irradiance texture, at most
    /// 512.
    #[arg(long, value_name = "TEXELS", default_value_t = Self::default().lightmap_size)]
    pub lightmap_size: usize,
    /// With --lightings, paths traced per texel of a lightmap and light that is baked.
    #[arg(long, value_name = "N", default_value_t = Self::default().lightmap_paths)]
    pub lightmap_paths: u32,
    /// Store the glTF file's textures as lossless WebP (EXT_texture_webp) instead of PNG.
    #[arg(long, conflicts_with = "ktx2")]
    pub webp: bool,
    /// Store the glTF file's textures as KTX2 of UASTC blocks with mipmaps (KHR_texture_basisu), which
    /// graphics cards keep compressed: 8 bits per texel, not lossless.
    #[arg(long)]
    pub ktx2: bool,
    /// Mitsuba: leave out specular reflection, so that its rendering must equal `unbake render
    /// --renderer path --diffuse-only --flat`.
    #[arg(long)]
    pub mitsuba_diffuse: bool,
}

impl Default for ExportOptions {
    fn default() -> Self {
        Self {
            format: vec![Format::Glb, Format::Usd, Format::Mitsuba],
            max_texture: 4096,
            lights: false,
            lightmap: false,
            split: Split::None,
            atlas: AtlasKind::Shared,
            lods: 0,
            hulls: false,
            tangents: false,
            textures: false,
            lightmap_size: 0,
            lightmap_paths: 64,
            webp: false,
            ktx2: false,
            mitsuba_diffuse: false,
        }
    }
}

/// Largest side of a lightmap, texels: that of the largest textures that graphics cards commonly
/// take (cited: WebGPU and Direct3D 11 grant 8192 and 16384).
const LARGEST_LIGHTMAP: usize = 16_384;

impl ExportOptions {
    /// How the glTF file's textures are stored.
    pub(super) fn texture_format(&self) -> TextureFormat {
        match (self.ktx2, self.webp) {
            (true, _) => TextureFormat::Ktx2,
            (false, true) => TextureFormat::WebP,
            (false, false) => TextureFormat::Png,
        }
    }

    /// Whether the numbers make sense.
    ///
    /// # Errors
    /// One is out of range.
    pub(super) fn check(&self) -> Result<()> {
        self.check_formats()?;
        if self.max_texture == 0 {
            return Err(Error::Usage("--max-texture must be at least 1".into()));
        }
        if self.lightmap_size > LARGEST_LIGHTMAP {
            return Err(Error::Usage(format!(
                "--lightmap-size {}: expected at most {LARGEST_LIGHTMAP} texels",
                self.lightmap_size
            )));
        }
        if self.atlas == AtlasKind::PerObject && self.split == Split::None {
            let wrong = "--atlas per-object needs objects: give --split classes or --split objects";
            return Err(Error::Usage(wrong.into()));
        }
        if self.webp && self.ktx2 {
            let wrong = "webp and ktx2 are both true; expected one of them at most";
            return Err(Error::Usage(wrong.into()));
        }
        if self.lods > MOST_LEVELS {
            return Err(Error::Usage(format!(
                "--lods {}: expected at most {MOST_LEVELS}",
                self.lods
            )));
        }
        if self.lightmap_paths == 0 {
            return Err(Error::Usage("--lightmap-paths must be at least 1".into()));
        }
        Ok(())
    }

    /// Refuses what is asked of files that are not written.
    fn check_formats(&self) -> Result<()> {
        let of = |format| self.format.contains(&format);
        let (glb, usd, mitsuba) = (of(Format::Glb), of(Format::Usd), of(Format::Mitsuba));
        let asked = [
            (self.lightmap, "--lightmap", glb, "glb"),
            (self.atlas == AtlasKind::PerObject, "--atlas", glb, "glb"),
            (self.lods > 0, "--lods", glb, "glb"),
            (self.tangents, "--tangents", glb, "glb"),
            (self.textures, "--textures", glb, "glb"),
            (self.webp, "--webp", glb, "glb"),
            (self.ktx2, "--ktx2", glb, "glb"),
            (self.lights, "--lights", glb || usd, "glb or usd"),
            (self.hulls, "--hulls", glb || usd, "glb or usd"),
            (
                self.split != Split::None,
                "--split",
                glb || usd,
                "glb or usd",
            ),
            (
                self.mitsuba_diffuse,
                "--mitsuba-diffuse",
                mitsuba,
                "mitsuba",
            ),
        ];
        match asked
            .iter()
            .find(|(asked, _, written, _)| *asked && !written)
        {
            None => Ok(()),
            Some((_, option, _, format)) => Err(Error::Usage(format!(
                "{option} is of --format {format}, which is not among those to write; add it, or leave out {option}"
            ))),
        }
    }

    /// Refuses what lightings cannot have: each is a glTF or USD file on the scene's atlas.
    pub(super) fn check_with_lightings(&self) -> Result<()> {
        self.check()?;
        let asked = [
            (
                !self.format.iter().any(|f| *f != Format::Mitsuba),
                "--format mitsuba",
            ),
            (self.atlas == AtlasKind::PerObject, "--atlas per-object"),
            (self.hulls, "--hulls"),
            (self.textures, "--textures"),
        ];
        match asked.iter().find(|(asked, _)| *asked) {
            None => Ok(()),
            Some((_, option)) => Err(Error::Usage(format!(
                "--lightings writes a glTF and a USD file per lighting, with its light on the scene's atlas; it does not go with {option}"
            ))),
        }
    }
}

/// What is exported.
pub struct Exported<'a> {
    /// The reconstruction.
    pub solution: &'a Solution,
    /// Names of its classes, as far as they are known.
    pub classes: &'a [ClassName],
    /// Cameras that go with it.
    pub cameras: &'a [NamedCamera],
}

/// Writes the wanted formats and `cameras.json` into `folder`, all or nothing; returns the file
/// names.
///
/// # Errors
/// A file cannot be written.
pub fn export(
    folder: &Path,
    exported: &Exported<'_>,
    options: &ExportOptions,
) -> Result<Vec<String>> {
    options.check()?;
    let Exported {
        solution, cameras, ..
    } = *exported;
    let parts = shown_parts(exported, options);
    let hulls = collision_bodies(solution, &parts, options);
    let aside = AsideFolder::new(folder)?;
    let mut files = Vec::new();
    for format in &options.format {
        files.extend(match format {
            Format::Glb => write_glb(aside.path(), solution, &parts, options)?,
            Format::Usd => {
                let usd = UsdOptions {
                    parts: &parts,
                    hulls: &hulls,
                    lights: options.lights,
                };
                write_usd(aside.path(), solution, usd)?
            }
            Format::Mitsuba => {
                write_mitsuba(aside.path(), solution, cameras, options.mitsuba_diffuse)?
            }
        });
    }
    if options.hulls && options.format.contains(&Format::Glb) {
        save(aside.path(), COLLISION, &collision_glb(solution, &hulls)?)?;
        files.push(COLLISION.to_owned());
    }
    let text = format!("{:#}\n", camera_file(cameras, solution.origin));
    save(aside.path(), "cameras.json", text.as_bytes())?;
    files.push("cameras.json".into());
    files.sort();
    files.dedup();
    aside.publish(folder, &files)?;
    Ok(files)
}

/// The objects that the glTF and USD files divide the surfaces into, with their levels of detail;
/// empty = all surfaces are one. Levels of objects with textures of their own are not here.
pub(super) fn shown_parts(exported: &Exported<'_>, options: &ExportOptions) -> Vec<MeshPart> {
    let solution = exported.solution;
    let mut parts = objects(solution, options.split, exported.classes);
    if options.lods == 0 || options.atlas == AtlasKind::PerObject {
        return parts;
    }
    if parts.is_empty() {
        parts.push(MeshPart::whole("surfaces", &solution.mesh));
    }
    let panes = solution.pane_triangles();
    for part in &mut parts {
        part.levels = levels(part, &solution.mesh, panes.as_deref(), options.lods);
    }
    parts
}

/// Objects with textures of their own.
struct OwnAtlases {
    /// Solutions of their triangles alone.
    objects: Vec<Solution>,
    /// The parts of these, with their levels of detail.
    parts: Vec<MeshPart>,
}

impl OwnAtlases {
    fn of(solution: &Solution, parts: &[MeshPart], lods: u32) -> Result<Self> {
        check_sizes(solution)?;
        let objects = map_chunks(parts.len(), 1, |k| cut_out(solution, &parts[k.start]));
        let own = |(part, object): (&MeshPart, &Solution)| {
            let whole = MeshPart::whole(&part.name, &object.mesh);
            let mut own = MeshPart {
                pivot: part.pivot,
                ..whole
            };
            own.levels = levels(&own, &object.mesh, object.pane_triangles().as_deref(), lods);
            own
        };
        Ok(Self {
            parts: parts.iter().zip(&objects).map(own).collect(),
            objects,
        })
    }

    /// What the files of the objects' textures begin with: their names, as file systems take them.
    fn file_names(&self) -> Vec<String> {
        let mut taken = BTreeSet::from(["scene".to_owned()]);
        let plain = |c: char| {
            let fine = c.is_alphanumeric() || " -_".contains(c);
            if fine { c } else { '_' }
        };
        let name = |part: &MeshPart| {
            let name: String = part.name.chars().map(plain).collect();
            unlike(&name, '_', &mut taken)
        };
        self.parts.iter().map(name).collect()
    }
}

/// The convex bodies of the objects, where they are wanted.
fn collision_bodies(
    solution: &Solution,
    parts: &[MeshPart],
    options: &ExportOptions,
) -> Vec<ObjectHulls> {
    match parts {
        _ if !options.hulls => Vec::new(),
        [] => {
            let whole = MeshPart::whole("surfaces", &solution.mesh);
            object_hulls(&solution.mesh, &[whole])
        }
        parts => object_hulls(&solution.mesh, parts),
    }
}

/// Writes `scene.glb` and, where wanted, its textures; returns the names of the files.
fn write_glb(
    folder: &Path,
    solution: &Solution,
    parts: &[MeshPart],
    options: &ExportOptions,
) -> Result<Vec<String>> {
    let own = match options.atlas {
        AtlasKind::Shared => None,
        AtlasKind::PerObject => Some(OwnAtlases::of(solution, parts, options.lods)?),
    };
    let glb = GlbOptions {
        max_texture: options.max_texture,
        lights: if options.lights {
            punctual_lights(solution)
        } else {
            Vec::new()
        },
        lightmap: options.lightmap,
        textures: options.texture_format(),
        tangents: options.tangents,
        parts: own.as_ref().map_or(parts, |o| &o.parts).to_vec(),
        ..GlbOptions::default()
    };
    let bytes = match &own {
        Some(own) => objects_glb(solution, &own.objects, &glb)?,
        None => scene_glb(solution, &glb)?,
    };
    let mut files = vec!["scene.glb".to_owned()];
    save(folder, &files[0], &bytes)?;
    let textured = match &own {
        _ if !options.textures => Vec::new(),
        Some(own) => own.file_names().into_iter().zip(&own.objects).collect(),
        None => vec![("scene".to_owned(), solution)],
    };
    for (name, textured) in textured {
        for image in png_textures(textured, options.max_texture)? {
            let file = format!("{name}_{}.png", image.name);
            save(folder, &file, &image.bytes)?;
            files.push(file);
        }
    }
    Ok(files)
}

/// Cameras in the form of `transforms.json`, in the coordinates of the scene's file.
#[must_use]
pub fn camera_file(cameras: &[NamedCamera], origin: DVec3) -> Value {
    let frame = |c: &NamedCamera| {
        let Camera {
            width,
            height,
            world_from_camera: m,
            position,
            ..
        } = c.camera;
        let p = position.as_dvec3() + origin;
        let row = |k: usize| {
            [
                f64::from(m.x_axis[k]),
                f64::from(m.y_axis[k]),
                f64::from(m.z_axis[k]),
                p[k],
            ]
        };
        let mut out = json!({
            "file_path": format!("{}.exr", c.name),
            "w": width,
            "h": height,
            "camera_model": "EQUIRECTANGULAR",
            "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
        });
        if let Projection::Pinhole(l) = c.camera.projection {
            out["camera_model"] = json!("OPENCV");
            for (key, value) in [
                ("fl_x", l.fl_x),
                ("fl_y", l.fl_y),
                ("cx", l.cx),
                ("cy", l.cy),
                ("k1", l.k[0]),
                ("k2", l.k[1]),
                ("p1", l.p[0]),
                ("p2", l.p[1]),
            ] {
                out[key] = json!(value);
            }
        }
        out
    };
    json!({"frames": cameras.iter().map(frame).collect::<Vec<Value>>()})
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::trace::EmbreeTracer;
    use crate::render::{read_cameras, viewpoints};
    use crate::solution::tests::small_solution;

    /// Options that contradict each other, or are out of range, are refused by name.
    #[test]
    fn wrong_options_are_refused() {
        let base = ExportOptions::default;
        let wrong = [
            (ExportOptions { lods: 9, ..base() }, "--lods 9"),
            (
                ExportOptions {
                    webp: true,
                    ktx2: true,
                    ..base()
                },
                "ktx2",
            ),
            (
                ExportOptions {
                    atlas: AtlasKind::PerObject,
                    ..base()
                },
                "--split",
            ),
        ];
        for (options, named) in wrong {
            let e = options.check().expect_err(named);
            assert!(e.exit_code() == 2 && e.to_string().contains(named), "{e}");
        }
        assert!(base().check().is_ok());
    }

    /// Each object has its textures, its material and its files.
    #[test]
    fn objects_have_textures_of_their_own() {
        let folder = tempfile::tempdir().expect("temp");
        let mut solution = small_solution();
        solution.labels.data.fill(3);
        solution.labels.data[..128].fill(4);
        let names = [(3, "chair/a"), (4, "rug")].map(|(id, name)| ClassName {
            id,
            name: name.into(),
        });
        let exported = Exported {
            solution: &solution,
            classes: &names,
            cameras: &[],
        };
        let options = ExportOptions {
            format: vec![Format::Glb],
            split: Split::Classes,
            atlas: AtlasKind::PerObject,
            textures: true,
            tangents: true,
            ..ExportOptions::default()
        };
        let files = export(folder.path(), &exported, &options).expect("exports");
        for name in ["chair_a_BaseColor.png", "rug_BaseColor.png", "rug_ORM.png"] {
            assert!(files.iter().any(|f| f == name), "{name}: {files:?}");
        }
        let bytes = std::fs::read(folder.path().join("scene.glb")).expect("there");
        let gltf = gltf::Gltf::from_slice(&bytes).expect("valid");
        let materials: Vec<_> = gltf.materials().filter_map(|m| m.name()).collect();
        assert_eq!(materials, ["chair/a reconstruction", "rug reconstruction"]);
        for (k, mesh) in gltf.meshes().enumerate() {
            let primitive = mesh.primitives().next().expect("a primitive");
            assert_eq!(primitive.material().index(), Some(k));
            let pbr = primitive.material().pbr_metallic_roughness();
            let base = pbr.base_color_texture().expect("a texture").texture();
            let image = base.source().name().expect("a name").to_owned();
            assert_eq!(image, format!("{}_BaseColor", mesh.name().expect("a name")));
        }
    }

    #[test]
    fn everything_is_written_and_the_cameras_read_back() {
        let folder = tempfile::tempdir().expect("temp");
        let mut solution = small_solution();
        for p in solution.mesh.positions.clone() {
            solution.mesh.positions.push(p + glam::Vec3::Y * 2.0);
            solution.mesh.normals.push(glam::Vec3::NEG_Y);
            solution.mesh.uvs.push(glam::Vec2::ZERO);
        }
        solution.mesh.triangles.extend([[4, 5, 6], [4, 6, 7]]);
        let tracer = EmbreeTracer::new(&solution.mesh).expect("embree");
        let cameras = viewpoints(&solution.mesh, &tracer, 2, 64, 48);
        assert!(!cameras.is_empty());
        let exported = Exported {
            solution: &solution,
            classes: &[],
            cameras: &cameras,
        };
        let options = ExportOptions {
            textures: true,
            ..ExportOptions::default()
        };
        let files = export(folder.path(), &exported, &options).expect("exports");
        for name in [
            "scene.glb",
            "scene.usda",
            "mitsuba.xml",
            "cameras.json",
            "scene_BaseColor.png",
            "scene_ORM.png",
            "scene_Emissive.png",
        ] {
            assert!(
                files.iter().any(|f| f == name) && folder.path().join(name).is_file(),
                "{name}"
            );
        }
        let back = read_cameras(&folder.path().join("cameras.json"), solution.origin, None)
            .expect("reads")
            .cameras;
        for (a, b) in back.iter().zip(&cameras) {
            assert_eq!(
                (a.name.as_str(), a.camera.projection),
                (b.name.as_str(), b.camera.projection)
            );
            assert!((a.camera.position - b.camera.position).length() < 1e-5);
        }
    }
}
