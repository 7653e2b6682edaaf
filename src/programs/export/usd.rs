//! `scene.usda`: the reconstruction as text USD with `UsdPreviewSurface` and PNG textures beside
//! it. Every object is a mesh with a translation of its own below the scene's.

use super::area_light::area_lights;
use super::hulls::ObjectHulls;
use super::objects::unlike;
use super::save::save;
use super::usd_collision::hull_prims;
use super::usd_lights::{dome_prim, lamp_prim};
use super::usd_text::{identifier, list, quoted};
use crate::core::formats::{encode_grey8, encode_rgb8, srgb8_from_linear, write_rgb_float};
use crate::core::geometry::{Mesh, MeshCopy, Similarity};
use crate::core::image::{Plane, RgbPlane};
use crate::error::Result;
use crate::solution::{MeshPart, Solution, copies_among};
use glam::Vec3;
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;

/// Choices of the USD export.
#[derive(Clone, Copy, Debug, Default)]
pub struct UsdOptions<'a> {
    /// Objects, a mesh each; empty = all surfaces are one.
    pub parts: &'a [MeshPart],
    /// Convex bodies of the objects, to collide by.
    pub hulls: &'a [ObjectHulls],
    /// Lamps as lights of UsdLux, for renderers that do not light by emissive surfaces.
    pub lights: bool,
}

/// Name of the panorama around the scene.
const ENVIRONMENT: &str = "usd_environment.exr";

/// Writes `scene.usda` and its textures into `folder`; returns the names of the files.
///
/// # Errors
/// A file cannot be written.
pub fn write_usd(
    folder: &Path,
    solution: &Solution,
    options: UsdOptions<'_>,
) -> Result<Vec<String>> {
    write_usd_as("scene.usda", folder, solution, options)
}

/// [`write_usd`] under another name than `scene.usda`.
pub(super) fn write_usd_as(
    file: &str,
    folder: &Path,
    solution: &Solution,
    options: UsdOptions<'_>,
) -> Result<Vec<String>> {
    let peak = peak(&solution.emission);
    let mut files = vec![file, "usd_albedo.png", "usd_roughness.png"];
    save(
        folder,
        "usd_albedo.png",
        &encode_light(&solution.albedo, 1.0)?,
    )?;
    let grey = |p: &Plane<f32>| {
        let byte = |x: &f32| (x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        let bytes: Vec<u8> = p.data.iter().map(byte).collect();
        encode_grey8(p.width, p.height, &bytes)
    };
    save(folder, "usd_roughness.png", &grey(&solution.roughness)?)?;
    if let Some(metallic) = &solution.metallic {
        save(folder, "usd_metallic.png", &grey(metallic)?)?;
        files.push("usd_metallic.png");
    }
    if let Some(transmission) = &solution.transmission {
        save(
            folder,
            "usd_opacity.png",
            &grey(&transmission.map(|t| 1.0 - t))?,
        )?;
        files.push("usd_opacity.png");
    }
    if peak > 0.0 {
        save(
            folder,
            "usd_emission.png",
            &encode_light(&solution.emission, peak)?,
        )?;
        files.push("usd_emission.png");
    }
    if is_lit_from_outside(solution) {
        write_rgb_float(folder.join(ENVIRONMENT), &solution.environment)?;
        files.push(ENVIRONMENT);
    }
    save(folder, file, text(solution, peak, options).as_bytes())?;
    Ok(files.into_iter().map(str::to_owned).collect())
}

/// The largest channel of a plane.
pub(super) fn peak(light: &RgbPlane) -> f32 {
    let largest = light.data.iter().map(|v| v.max_element());
    largest.fold(0.0f32, f32::max)
}

/// A plane as a PNG picture in sRGB whose 255 is `white`.
pub(super) fn encode_light(plane: &RgbPlane, white: f32) -> Result<Vec<u8>> {
    let shares = plane.data.iter().map(|v| (*v / white).to_array());
    let bytes: Vec<u8> = shares.flat_map(|v| v.map(srgb8_from_linear)).collect();
    encode_rgb8(plane.width, plane.height, &bytes)
}

pub(super) fn is_lit_from_outside(solution: &Solution) -> bool {
    solution.environment.data.iter().any(|c| *c != Vec3::ZERO)
}

/// The text of the file: meshes, lights and the material.
fn text(solution: &Solution, peak: f32, options: UsdOptions<'_>) -> String {
    let o = solution.origin;
    let mut s = format!("{HEADER}def Xform \"scene\"\n{{\n");
    let _ = writeln!(
        s,
        "    double3 xformOp:translate = ({}, {}, {})",
        o.x, o.y, o.z
    );
    s.push_str("    uniform token[] xformOpOrder = [\"xformOp:translate\"]\n\n");
    let lights = if options.lights {
        area_lights(solution)
    } else {
        Vec::new()
    };
    let mut taken = taken_names();
    taken.extend(lights.iter().map(|l| identifier(&l.name)));
    let names = prim_names(options.parts, &mut taken);
    for mesh in mesh_prims(&solution.mesh, options.parts, names) {
        mesh.write(&mut s);
        if let Some(object) = options.hulls.iter().find(|h| h.name == mesh.name) {
            hull_prims(&mut s, object, &mesh.prim, &mut taken);
        }
    }
    lights.iter().for_each(|light| lamp_prim(&mut s, light));
    if is_lit_from_outside(solution) {
        dome_prim(&mut s, ENVIRONMENT);
    }
    let metallic = solution.metallic.as_ref().map(|_| "usd_metallic.png");
    let opacity = solution.transmission.as_ref().map(|_| "usd_opacity.png");
    material_prim(&mut s, peak, metallic, opacity);
    s.push_str("}\n");
    s
}

/// What every file begins with.
pub(super) const HEADER: &str =
    "#usda 1.0\n(\n    defaultPrim = \"scene\"\n    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\n";
/// The material of the reconstructed surfaces.
const MATERIAL: &str = "material";

/// Names that no mesh may have.
pub(super) fn taken_names() -> BTreeSet<String> {
    [MATERIAL, "environment"].map(str::to_owned).into()
}

/// A mesh of the file.
pub(super) struct MeshPrim<'a> {
    /// Its name in the file.
    pub prim: String,
    /// The object's name.
    pub name: &'a str,
    /// Where it stands; its vertices are relative to that.
    pub pivot: Vec3,
    pub mesh: Cow<'a, Mesh>,
    /// The name of its material.
    pub material: &'a str,
    /// Of a copy, whose copy it is.
    pub copy: Option<UsdCopy>,
}

/// What a mesh is a copy of.
pub(super) struct UsdCopy {
    /// The other's name in the file.
    of: String,
    /// What takes the other's vertices to its own.
    placed: Similarity,
}

/// The object that all surfaces are where they are not divided.
const WHOLE: &str = "surfaces";

/// The names of the meshes: of the parts', or of one.
pub(super) fn prim_names(parts: &[MeshPart], taken: &mut BTreeSet<String>) -> Vec<String> {
    let mut prim = |name: &str| unlike(&identifier(name), '_', taken);
    match parts {
        [] => vec![prim(WHOLE)],
        parts => parts.iter().map(|part| prim(&part.name)).collect(),
    }
}

/// The meshes of all surfaces, those of the parts, or one, under the names of [`prim_names`].
pub(super) fn mesh_prims<'a>(
    mesh: &'a Mesh,
    parts: &'a [MeshPart],
    prims: Vec<String>,
) -> Vec<MeshPrim<'a>> {
    if parts.is_empty() {
        // all surfaces as one keep their vertices' order
        let whole = prims.into_iter().map(|prim| MeshPrim {
            prim,
            name: WHOLE,
            pivot: Vec3::ZERO,
            mesh: Cow::Borrowed(mesh),
            material: MATERIAL,
            copy: None,
        });
        return whole.collect();
    }
    let meshes: Vec<Cow<'_, Mesh>> = (parts.iter())
        .map(|part| Cow::Owned(part.mesh(mesh)))
        .collect();
    let copies = copies_among(&meshes, mesh);
    let of =
        |(((part, mesh), copy), prim): (((&'a MeshPart, _), Option<MeshCopy>), &String)| MeshPrim {
            prim: prim.clone(),
            name: &part.name,
            pivot: part.pivot,
            mesh,
            material: MATERIAL,
            copy: copy.map(|c| UsdCopy {
                of: prims[c.of].clone(),
                placed: c.placed,
            }),
        };
    let all = parts.iter().zip(meshes).zip(copies).zip(&prims);
    all.map(of).collect()
}

impl MeshPrim<'_> {
    /// Appends it, bound to its material; a copy refers to what it is a copy of and has its own places in the
    /// atlas.
    pub(super) fn write(&self, s: &mut String) {
        match &self.copy {
            Some(copy) => self.write_copy(s, copy),
            None => self.write_whole(s, "def"),
        }
    }

    fn write_copy(&self, s: &mut String, UsdCopy { of, placed }: &UsdCopy) {
        let (p, q) = (self.pivot + placed.translation, placed.rotation);
        let _ = writeln!(
            s,
            "    def Mesh \"{}\" (\n        customData = {{\n            string name = {}\n        }}\n        prepend references = </scene/{of}>\n    )\n    {{\n        \
             double3 xformOp:translate = ({}, {}, {})\n        quatf xformOp:orient = ({}, {}, {}, {})\n        float3 xformOp:scale = ({scale}, {scale}, {scale})\n        \
             uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:orient\", \"xformOp:scale\"]",
            self.prim,
            quoted(self.name),
            p.x,
            p.y,
            p.z,
            q.w,
            q.x,
            q.y,
            q.z,
            scale = placed.scale,
        );
        texture_coordinates(s, &self.mesh);
        s.push_str("    }\n\n");
    }

    /// Appends all of it; `specifier` is `def`, or `over` where a file below has it.
    pub(super) fn write_whole(&self, s: &mut String, specifier: &str) {
        let _ = writeln!(
            s,
            "    {specifier} Mesh \"{}\" (\n        customData = {{\n            string name = {}\n        }}\n        prepend apiSchemas = [\"MaterialBindingAPI\"]\n    )\n    {{",
            self.prim,
            quoted(self.name)
        );
        let p = self.pivot;
        if p != Vec3::ZERO || specifier == "over" {
            let _ = writeln!(
                s,
                "        double3 xformOp:translate = ({}, {}, {})\n        uniform token[] xformOpOrder = [\"xformOp:translate\"]",
                p.x, p.y, p.z
            );
        }
        geometry(s, &self.mesh);
        let _ = writeln!(
            s,
            "        rel material:binding = </scene/{}>\n    }}\n",
            self.material
        );
    }
}

/// Appends what a mesh consists of.
fn geometry(s: &mut String, mesh: &Mesh) {
    s.push_str("        uniform bool doubleSided = 1\n        uniform token subdivisionScheme = \"none\"\n");
    let (lo, hi) = mesh.bounds();
    let _ = writeln!(
        s,
        "        float3[] extent = [({}, {}, {}), ({}, {}, {})]",
        lo.x, lo.y, lo.z, hi.x, hi.y, hi.z
    );
    list(
        s,
        "int[] faceVertexCounts",
        mesh.triangles.iter().map(|_| "3".to_owned()),
        "",
    );
    list(
        s,
        "int[] faceVertexIndices",
        mesh.triangles.iter().flatten().map(u32::to_string),
        "",
    );
    let vector = |v: &Vec3| format!("({}, {}, {})", v.x, v.y, v.z);
    list(s, "point3f[] points", mesh.positions.iter().map(vector), "");
    list(
        s,
        "normal3f[] normals",
        mesh.normals.iter().map(vector),
        " (\n            interpolation = \"vertex\"\n        )",
    );
    texture_coordinates(s, mesh);
}

fn texture_coordinates(s: &mut String, mesh: &Mesh) {
    // USD counts texture rows from below
    let uv = mesh
        .uvs
        .iter()
        .map(|uv| format!("({}, {})", uv.x, 1.0 - uv.y));
    list(
        s,
        "texCoord2f[] primvars:st",
        uv,
        " (\n            interpolation = \"vertex\"\n        )",
    );
}

/// The material with its textures, of metal and opacity where there are such files; emissive if
/// `peak`, the largest emission, is above 0.
fn material_prim(s: &mut String, peak: f32, metallic: Option<&str>, opacity: Option<&str>) {
    s.push_str("    def Material \"material\"\n    {\n");
    s.push_str(
        "        token outputs:surface.connect = </scene/material/surface.outputs:surface>\n\n",
    );
    s.push_str("        def Shader \"surface\"\n        {\n            uniform token info:id = \"UsdPreviewSurface\"\n");
    s.push_str(
        "            color3f inputs:diffuseColor.connect = </scene/material/albedo.outputs:rgb>\n",
    );
    s.push_str(
        "            float inputs:roughness.connect = </scene/material/roughness.outputs:r>\n",
    );
    if peak > 0.0 {
        s.push_str("            color3f inputs:emissiveColor.connect = </scene/material/emission.outputs:rgb>\n");
    }
    s.push_str(if metallic.is_some() {
        "            float inputs:metallic.connect = </scene/material/metallic.outputs:r>\n"
    } else {
        "            float inputs:metallic = 0\n"
    });
    if opacity.is_some() {
        s.push_str(
            "            float inputs:opacity.connect = </scene/material/opacity.outputs:r>\n",
        );
    }
    s.push_str(
        "            float inputs:ior = 1.5\n            token outputs:surface\n        }\n",
    );
    s.push_str("\n        def Shader \"st\"\n        {\n            uniform token info:id = \"UsdPrimvarReader_float2\"\n");
    s.push_str("            string inputs:varname = \"st\"\n            float2 outputs:result\n        }\n");
    colour_texture(s, "albedo", "usd_albedo.png", 1.0);
    let roughness = ("roughness", "usd_roughness.png");
    let metallic = metallic.map(|file| ("metallic", file));
    let opacity = opacity.map(|file| ("opacity", file));
    for (name, file) in std::iter::once(roughness).chain(metallic).chain(opacity) {
        texture(s, name, file, "raw", "float outputs:r", 1.0);
    }
    if peak > 0.0 {
        colour_texture(s, "emission", "usd_emission.png", peak);
    }
    s.push_str("    }\n");
}

/// Appends a picture in sRGB, or an EXR file, of colours; 1 is `scale`.
pub(super) fn colour_texture(s: &mut String, name: &str, file: &str, scale: f32) {
    let space = if file.ends_with(".exr") {
        "raw"
    } else {
        "sRGB"
    };
    texture(s, name, file, space, "float3 outputs:rgb", scale);
}

fn texture(s: &mut String, name: &str, file: &str, space: &str, output: &str, scale: f32) {
    let _ = write!(
        s,
        "\n        def Shader \"{name}\"\n        {{\n            uniform token info:id = \"UsdUVTexture\"\n            \
         asset inputs:file = @./{file}@\n            token inputs:sourceColorSpace = \"{space}\"\n            \
         token inputs:wrapS = \"clamp\"\n            token inputs:wrapT = \"clamp\"\n            \
         float4 inputs:scale = ({scale}, {scale}, {scale}, 1)\n            \
         float2 inputs:st.connect = </scene/material/st.outputs:result>\n            {output}\n        }}\n"
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solution::tests::small_solution;

    #[test]
    fn objects_stand_at_their_pivots_under_names_of_their_own() {
        let solution = small_solution();
        let part =
            |name: &str, t: u32| MeshPart::standing(name.to_owned(), &solution.mesh, vec![t]);
        let parts = [part("table \"a\"", 0), part("table_a_", 1), part("2nd", 1)];
        let options = UsdOptions {
            parts: &parts,
            ..UsdOptions::default()
        };
        let text = text(&solution, 0.0, options);
        assert_eq!(text.matches('{').count(), text.matches('}').count());
        for expected in [
            "def Mesh \"table__a_\"",
            "string name = \"table \\\"a\\\"\"",
            "def Mesh \"table_a_\"",
            "def Mesh \"_2nd\"",
        ] {
            assert!(text.contains(expected), "{expected}: {text}");
        }
        let lines = |key: &str| text.lines().filter(|l| l.contains(key)).collect::<Vec<_>>();
        assert!(text.contains("def DomeLight") && text.contains(ENVIRONMENT));
        // the scene's and three of its parts'
        assert_eq!(lines("xformOp:translate =").len(), 4);
        // each triangle has three corners and stands on its lower side
        for (points, extent) in lines("points =").iter().zip(lines("extent =")) {
            assert_eq!(points.matches('(').count(), 3);
            assert!(extent.contains("[(-1, 0, "), "{extent}");
        }
    }

    /// A copy refers to what it is a copy of, where it stands, and has its own places in the atlas alone.
    #[test]
    fn a_copy_refers_to_its_original() {
        let solution = small_solution();
        let part = |name: &str| MeshPart::standing(name.to_owned(), &solution.mesh, vec![0, 1]);
        let mut parts = [part("chair"), part("chair 2")];
        parts[1].pivot.y -= 0.5;
        let options = UsdOptions {
            parts: &parts,
            ..UsdOptions::default()
        };
        let text = text(&solution, 0.0, options);
        assert_eq!(text.matches('{').count(), text.matches('}').count());
        assert_eq!(text.matches("point3f[] points").count(), 1);
        assert_eq!(text.matches("primvars:st = ").count(), 2);
        let (_, copy) = text.split_once("def Mesh \"chair_2\"").expect("a copy");
        assert!(copy.contains("prepend references = </scene/chair>"));
        assert!(copy.contains("xformOp:scale = (1, 1, 1)"));
        // its vertices were half a metre above its pivot, and are not moved by the reference
        let (_, place) = copy.split_once("xformOp:translate = (").expect("a place");
        let numbers = place
            .split(&[',', ')'][..])
            .map_while(|n| n.trim().parse().ok());
        let at = Vec3::from_slice(&numbers.collect::<Vec<f32>>());
        assert!((at - parts[0].pivot).length() < 1e-6, "{at}");
    }

    #[test]
    fn metal_is_a_texture_where_there_is_any() {
        let folder = tempfile::tempdir().expect("temp");
        let mut solution = small_solution();
        let write = |solution: &Solution| {
            let files = write_usd(folder.path(), solution, UsdOptions::default()).expect("writes");
            let text = std::fs::read_to_string(folder.path().join("scene.usda")).expect("reads");
            (files, text)
        };
        let (files, text) = write(&solution);
        assert!(text.contains("inputs:metallic = 0\n"));
        assert!(!text.contains("opacity"));
        assert!(!files.contains(&"usd_metallic.png".to_owned()) && !text.contains("usd_metallic"));
        solution.metallic = Some(solution.albedo.map(|_| 1.0));
        solution.transmission = Some(solution.albedo.map(|_| 0.5));
        let (files, text) = write(&solution);
        assert!(files.contains(&"usd_metallic.png".to_owned()));
        assert!(folder.path().join("usd_metallic.png").is_file());
        assert!(text.contains("inputs:metallic.connect = </scene/material/metallic.outputs:r>"));
        assert!(text.contains("asset inputs:file = @./usd_metallic.png@"));
        assert!(files.contains(&"usd_opacity.png".to_owned()));
        assert!(text.contains("inputs:opacity.connect = </scene/material/opacity.outputs:r>"));
        assert!(text.contains("asset inputs:file = @./usd_opacity.png@"));
    }

    #[test]
    fn every_vertex_and_texture_is_there_and_braces_close() {
        let folder = tempfile::tempdir().expect("temp");
        let solution = small_solution();
        let files = write_usd(folder.path(), &solution, UsdOptions::default()).expect("writes");
        assert!(files.iter().all(|f| folder.path().join(f).is_file()));
        let text = std::fs::read_to_string(folder.path().join("scene.usda")).expect("reads");
        assert_eq!(text.matches('{').count(), text.matches('}').count());
        let points = text
            .lines()
            .find(|l| l.contains("points ="))
            .expect("points");
        assert_eq!(points.matches('(').count(), solution.mesh.positions.len());
        assert!(
            text.contains("inputs:scale = (12.5, 12.5, 12.5, 1)"),
            "emission keeps its strength"
        );
    }
}
