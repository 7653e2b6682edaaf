//! `scene.usda`: the reconstruction as text USD with `UsdPreviewSurface` and PNG textures beside
//! it.

use crate::core::formats::{encode_grey8, encode_rgb8, srgb8_from_linear};
use crate::core::geometry::Mesh;
use crate::core::image::Plane;
use crate::error::{Error, Result};
use crate::solution::Solution;
use glam::Vec3;
use std::fmt::Write;
use std::path::Path;

/// Writes `scene.usda` and its textures into `folder`; returns the names of the files.
///
/// # Errors
/// A file cannot be written.
pub fn write_usd(folder: &Path, solution: &Solution) -> Result<Vec<String>> {
    let peak = solution
        .emission
        .data
        .iter()
        .map(|v| v.max_element())
        .fold(0.0f32, f32::max);
    let mut files = vec!["scene.usda", "usd_albedo.png", "usd_roughness.png"];
    let save = |name: &str, bytes: &[u8]| {
        std::fs::write(folder.join(name), bytes).map_err(|e| Error::io(folder.join(name), e))
    };
    let rgb = |p: &Plane<Vec3>, scale: f32| {
        let bytes: Vec<u8> = p
            .data
            .iter()
            .flat_map(|v| (*v * scale).to_array().map(srgb8_from_linear))
            .collect();
        encode_rgb8(p.width, p.height, &bytes)
    };
    save("usd_albedo.png", &rgb(&solution.albedo, 1.0)?)?;
    let r = &solution.roughness;
    let grey: Vec<u8> = r
        .data
        .iter()
        .map(|r| (r.clamp(0.0, 1.0) * 255.0 + 0.5) as u8)
        .collect();
    save(
        "usd_roughness.png",
        &encode_grey8(r.width, r.height, &grey)?,
    )?;
    if peak > 0.0 {
        save("usd_emission.png", &rgb(&solution.emission, 1.0 / peak)?)?;
        files.push("usd_emission.png");
    }
    save("scene.usda", text(solution, peak).as_bytes())?;
    Ok(files.into_iter().map(str::to_owned).collect())
}

/// The text of the file: a mesh and its material.
fn text(solution: &Solution, peak: f32) -> String {
    let o = solution.origin;
    let mut s = String::from(
        "#usda 1.0\n(\n    defaultPrim = \"scene\"\n    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\ndef Xform \"scene\"\n{\n",
    );
    let _ = writeln!(
        s,
        "    double3 xformOp:translate = ({}, {}, {})",
        o.x, o.y, o.z
    );
    s.push_str("    uniform token[] xformOpOrder = [\"xformOp:translate\"]\n\n");
    mesh_prim(&mut s, &solution.mesh);
    material_prim(&mut s, peak);
    s.push_str("}\n");
    s
}

/// The mesh, bound to the material.
fn mesh_prim(s: &mut String, mesh: &Mesh) {
    s.push_str("    def Mesh \"surfaces\" (\n        prepend apiSchemas = [\"MaterialBindingAPI\"]\n    )\n    {\n");
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
    s.push_str("        rel material:binding = </scene/material>\n    }\n\n");
}

/// The material with its textures; emissive if `peak`, the largest emission, is above 0.
fn material_prim(s: &mut String, peak: f32) {
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
    s.push_str("            float inputs:metallic = 0\n            float inputs:ior = 1.5\n            token outputs:surface\n        }\n");
    s.push_str("\n        def Shader \"st\"\n        {\n            uniform token info:id = \"UsdPrimvarReader_float2\"\n");
    s.push_str("            string inputs:varname = \"st\"\n            float2 outputs:result\n        }\n");
    texture(
        s,
        "albedo",
        "usd_albedo.png",
        "sRGB",
        "float3 outputs:rgb",
        1.0,
    );
    texture(
        s,
        "roughness",
        "usd_roughness.png",
        "raw",
        "float outputs:r",
        1.0,
    );
    if peak > 0.0 {
        texture(
            s,
            "emission",
            "usd_emission.png",
            "sRGB",
            "float3 outputs:rgb",
            peak,
        );
    }
    s.push_str("    }\n");
}

fn list(s: &mut String, name: &str, items: impl Iterator<Item = String>, metadata: &str) {
    let _ = write!(s, "        {name} = [");
    for (i, item) in items.enumerate() {
        if i > 0 {
            s.push_str(if i % 64 == 0 { ",\n" } else { ", " });
        }
        s.push_str(&item);
    }
    let _ = writeln!(s, "]{metadata}");
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
    fn every_vertex_and_texture_is_there_and_braces_close() {
        let folder = tempfile::tempdir().expect("temp");
        let solution = small_solution();
        let files = write_usd(folder.path(), &solution).expect("writes");
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
