//! A Mitsuba 3 scene: meshes as PLY, textures as EXR, one XML file.
//!
//! Mitsuba has no BSDF with this program's specular lobe: `principled` with the same base colour
//! and roughness looks alike, but is not the same. Its `metallic` parts the base colour as ours
//! does: metal has no diffuse lobe and reflects its base colour at normal incidence. Panes are
//! `thindielectric`, tinted by the base colour, as far as light goes through them. With
//! `diffuse_only` both programs describe exactly the same light, and must agree within their noise.

use super::save::save;
use crate::core::formats::{write_plane_float, write_rgb_float};
use crate::core::geometry::{Camera, Mesh, Projection};
use crate::core::image::{Plane, RgbPlane};
use crate::error::{Error, Result};
use crate::render::{EditableScene, NamedCamera};
use crate::solution::Solution;
use glam::Vec3;
use std::borrow::Cow;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// The files written so far, besides `mitsuba.xml`.
struct Written<'a> {
    folder: &'a Path,
    names: Vec<String>,
}

impl Written<'_> {
    /// Notes a file and says where it goes.
    fn place(&mut self, name: &str) -> PathBuf {
        self.names.push(name.to_owned());
        self.folder.join(name)
    }

    fn rgb(&mut self, name: &str, plane: &RgbPlane) -> Result<()> {
        write_rgb_float(self.place(name), plane)
    }

    fn bytes(&mut self, name: &str, bytes: &[u8]) -> Result<()> {
        self.place(name);
        save(self.folder, name, bytes)
    }
}

/// Writes `mitsuba.xml` and what it refers to into `folder`; returns the names of the files.
///
/// # Errors
/// A file cannot be written.
pub fn write_mitsuba(
    folder: &Path,
    solution: &Solution,
    cameras: &[NamedCamera],
    diffuse_only: bool,
) -> Result<Vec<String>> {
    let mut files = Written {
        folder,
        names: vec!["mitsuba.xml".to_owned()],
    };
    files.rgb("mitsuba_albedo.exr", &base_colour(solution, diffuse_only))?;
    write_plane_float(files.place("mitsuba_roughness.exr"), &solution.roughness)?;
    let metallic = solution.metallic.as_ref().filter(|_| !diffuse_only);
    if let Some(plane) = metallic {
        write_plane_float(files.place("mitsuba_metallic.exr"), plane)?;
    }
    let shapes = write_shapes(&mut files, solution, diffuse_only)?;
    let environment = write_environment(&mut files, &solution.environment)?;
    let mut xml =
        String::from("<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<scene version=\"3.0.0\">\n");
    let _ = writeln!(
        xml,
        "  <!-- positions are relative to {} -->",
        solution.origin
    );
    xml.push_str("  <default name=\"spp\" value=\"64\"/>\n  <integrator type=\"path\">\n    <integer name=\"max_depth\" value=\"65\"/>\n  </integrator>\n");
    let opaque = material(diffuse_only, metallic.is_some());
    match &solution.transmission {
        Some(share) => {
            write_plane_float(files.place("mitsuba_transmission.exr"), share)?;
            xml.push_str(&with_panes(&opaque));
        }
        None => {
            let _ = write!(
                xml,
                "  <bsdf type=\"twosided\" id=\"material\">\n{opaque}  </bsdf>\n"
            );
        }
    }
    xml.push_str(&shapes);
    xml.push_str(environment);
    for c in cameras {
        xml.push_str(&sensor(&c.name, &c.camera)?);
    }
    xml.push_str("</scene>\n");
    save(folder, "mitsuba.xml", xml.as_bytes())?;
    Ok(files.names)
}

/// Writes the meshes, what emits apart from the rest, and the emission; returns their elements.
fn write_shapes(
    files: &mut Written<'_>,
    solution: &Solution,
    diffuse_only: bool,
) -> Result<String> {
    let world = EditableScene::new(solution);
    let mesh = &solution.mesh;
    let (lamps, rest): (Vec<u32>, Vec<u32>) =
        (0..mesh.triangles.len() as u32).partition(|&t| world.emits(t as usize));
    let mut shapes = String::new();
    for (name, triangles) in [("surfaces", &rest), ("lamps", &lamps)] {
        if triangles.is_empty() {
            continue;
        }
        let ply = format!("mitsuba_{name}.ply");
        files.bytes(&ply, &ply_bytes(mesh, triangles))?;
        let _ = writeln!(
            shapes,
            "  <shape type=\"ply\" id=\"{name}\">\n    <string name=\"filename\" value=\"{ply}\"/>"
        );
        // lamps shine to the side of their winding, whatever their vertex normals say
        if diffuse_only || name == "lamps" {
            shapes.push_str("    <boolean name=\"face_normals\" value=\"true\"/>\n");
        }
        shapes.push_str("    <ref id=\"material\" name=\"bsdf\"/>\n");
        if name == "lamps" {
            shapes.push_str("    <emitter type=\"area\">\n");
            shapes.push_str(&bitmap("radiance", "mitsuba_emission.exr", "nearest", 6));
            shapes.push_str("    </emitter>\n");
        }
        shapes.push_str("  </shape>\n");
    }
    if !lamps.is_empty() {
        files.rgb("mitsuba_emission.exr", &solution.emission)?;
    }
    Ok(shapes)
}

/// Writes the panorama around the scene; returns its element, none if it is black.
fn write_environment(files: &mut Written<'_>, environment: &RgbPlane) -> Result<&'static str> {
    if environment.data.iter().all(|c| *c == Vec3::ZERO) {
        return Ok("");
    }
    files.rgb("mitsuba_environment.exr", &turned(environment))?;
    Ok(
        "  <emitter type=\"envmap\">\n    <string name=\"filename\" value=\"mitsuba_environment.exr\"/>\n  </emitter>\n",
    )
}

/// What the albedo's file holds: for the diffuse part alone, the albedo of that.
fn base_colour(solution: &Solution, diffuse_only: bool) -> Cow<'_, RgbPlane> {
    let albedo = &solution.albedo;
    match &solution.metallic {
        Some(metallic) if diffuse_only => Cow::Owned(Plane {
            width: albedo.width,
            height: albedo.height,
            data: std::iter::zip(&albedo.data, &metallic.data)
                .map(|(a, m)| *a * (1.0 - m))
                .collect(),
        }),
        _ => Cow::Borrowed(albedo),
    }
}

/// The BSDF element that both meshes share.
fn material(diffuse_only: bool, has_metal: bool) -> String {
    if diffuse_only {
        return format!(
            "    <bsdf type=\"diffuse\">\n{}    </bsdf>\n",
            bitmap("reflectance", "mitsuba_albedo.exr", "bilinear", 6)
        );
    }
    let metallic = if has_metal {
        bitmap("metallic", "mitsuba_metallic.exr", "bilinear", 6)
    } else {
        String::new()
    };
    format!(
        "    <bsdf type=\"principled\">\n{}{}{metallic}      <float name=\"specular\" value=\"0.5\"/>\n    </bsdf>\n",
        bitmap("base_color", "mitsuba_albedo.exr", "bilinear", 6),
        bitmap("roughness", "mitsuba_roughness.exr", "nearest", 6)
    )
}

/// Index of refraction at which the two faces of a thin pane reflect as much as one lobe of this
/// program: 2R/(1 + R) = F0 = 0.04 with R = ((n − 1)/(n + 1))². Derived.
const PANE_INDEX: f32 = 1.3333;

/// The opaque material, and a pane by the share of light that goes through.
fn with_panes(opaque: &str) -> String {
    format!(
        "  <bsdf type=\"blendbsdf\" id=\"material\">\n{}    <bsdf type=\"twosided\">\n{opaque}    </bsdf>\n    \
         <bsdf type=\"thindielectric\">\n      <float name=\"int_ior\" value=\"{PANE_INDEX}\"/>\n      \
         <float name=\"ext_ior\" value=\"1\"/>\n{}    </bsdf>\n  </bsdf>\n",
        bitmap("weight", "mitsuba_transmission.exr", "bilinear", 4),
        bitmap(
            "specular_transmittance",
            "mitsuba_albedo.exr",
            "bilinear",
            6
        )
    )
}

fn bitmap(name: &str, file: &str, filter: &str, indent: usize) -> String {
    let pad = " ".repeat(indent);
    format!(
        "{pad}<texture type=\"bitmap\" name=\"{name}\">\n{pad}  <string name=\"filename\" value=\"{file}\"/>\n\
         {pad}  <string name=\"filter_type\" value=\"{filter}\"/>\n{pad}  <string name=\"wrap_mode\" value=\"clamp\"/>\n\
         {pad}  <boolean name=\"raw\" value=\"true\"/>\n{pad}</texture>\n"
    )
}

/// Mitsuba's panoramas begin half a turn away from ours.
fn turned(map: &RgbPlane) -> RgbPlane {
    let half = map.width / 2;
    Plane {
        width: map.width,
        height: map.height,
        data: (0..map.data.len())
            .map(|i| map[((i % map.width + half) % map.width, i / map.width)])
            .collect(),
    }
}

fn sensor(name: &str, camera: &Camera) -> Result<String> {
    let Projection::Pinhole(lens) = camera.projection else {
        return Err(Error::Usage(format!(
            "camera {name}: Mitsuba has no panoramas; give pinhole cameras or --fov DEGREES"
        )));
    };
    let fov = 2.0
        * (0.5 * f64::from(camera.width as f32 / lens.fl_x))
            .atan()
            .to_degrees();
    let m = camera.world_from_camera;
    // x to the left, z forward
    let (x, y, z, p) = (-m.x_axis, m.y_axis, -m.z_axis, camera.position);
    let rows: Vec<String> = (0..3)
        .map(|k| format!("{} {} {} {}", x[k], y[k], z[k], p[k]))
        .collect();
    let shift = |c: f32, side: usize, sign: f32| sign * (c / side as f32 - 0.5);
    Ok(format!(
        "  <sensor type=\"perspective\" id=\"{name}\">\n    <float name=\"fov\" value=\"{fov}\"/>\n    \
         <string name=\"fov_axis\" value=\"x\"/>\n    <float name=\"near_clip\" value=\"0.001\"/>\n    \
         <float name=\"principal_point_offset_x\" value=\"{}\"/>\n    <float name=\"principal_point_offset_y\" value=\"{}\"/>\n    \
         <transform name=\"to_world\">\n      <matrix value=\"{} 0 0 0 1\"/>\n    </transform>\n    \
         <film type=\"hdrfilm\">\n      <integer name=\"width\" value=\"{}\"/>\n      <integer name=\"height\" value=\"{}\"/>\n      \
         <string name=\"pixel_format\" value=\"rgb\"/>\n      <rfilter type=\"box\"/>\n    </film>\n    \
         <sampler type=\"independent\">\n      <integer name=\"sample_count\" value=\"$spp\"/>\n    </sampler>\n  </sensor>\n",
        shift(lens.cx, camera.width, 1.0),
        shift(lens.cy, camera.height, 1.0),
        rows.join(" "),
        camera.width,
        camera.height
    ))
}

/// Binary PLY of some triangles with only the vertices they use.
fn ply_bytes(mesh: &Mesh, triangles: &[u32]) -> Vec<u8> {
    let mesh = mesh.part(triangles);
    let mut out = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\nproperty float u\nproperty float v\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.positions.len(),
        mesh.triangles.len()
    )
    .into_bytes();
    for i in 0..mesh.positions.len() {
        let (p, n, uv) = (mesh.positions[i], mesh.normals[i], mesh.uvs[i]);
        for x in [p.x, p.y, p.z, n.x, n.y, n.z, uv.x, uv.y] {
            out.extend(x.to_le_bytes());
        }
    }
    for corners in &mesh.triangles {
        out.push(3);
        corners.iter().for_each(|i| out.extend(i.to_le_bytes()));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solution::tests::small_solution;

    #[test]
    fn the_scene_names_only_files_that_exist_and_its_meshes_read_back() {
        let folder = tempfile::tempdir().expect("temp");
        let mut solution = small_solution();
        solution.emission.data.fill(Vec3::ONE);
        let files = write_mitsuba(folder.path(), &solution, &[], true).expect("writes");
        let xml = std::fs::read_to_string(folder.path().join("mitsuba.xml")).expect("reads");
        assert!(files.iter().all(|f| folder.path().join(f).is_file()));
        assert!(
            files
                .iter()
                .skip(1)
                .filter(|f| *f != "mitsuba_roughness.exr")
                .all(|f| xml.contains(f.as_str())),
            "{xml}"
        );
        let back = crate::core::formats::read_mesh(&folder.path().join("mitsuba_lamps.ply"))
            .expect("reads");
        assert_eq!(back.positions.len(), solution.mesh.positions.len());
    }

    #[test]
    fn metal_is_a_texture_of_the_bsdf_and_no_diffuse_light() {
        let folder = tempfile::tempdir().expect("temp");
        let mut solution = small_solution();
        let write = |solution: &Solution, diffuse_only: bool| {
            write_mitsuba(folder.path(), solution, &[], diffuse_only).expect("writes");
            std::fs::read_to_string(folder.path().join("mitsuba.xml")).expect("reads")
        };
        assert!(!write(&solution, false).contains("metallic"));
        let mut metallic = solution.albedo.map(|_| 0.0);
        metallic.data[77] = 1.0;
        solution.metallic = Some(metallic);
        let albedo = || {
            let path = folder.path().join("mitsuba_albedo.exr");
            crate::core::formats::read_rgb(path).expect("reads")
        };
        let xml = write(&solution, false);
        assert!(xml.contains("name=\"metallic\"") && xml.contains("mitsuba_metallic.exr"));
        assert!(folder.path().join("mitsuba_metallic.exr").is_file());
        assert_eq!(albedo(), solution.albedo);
        assert!(!write(&solution, true).contains("metallic"));
        assert_eq!(albedo().data[77], Vec3::ZERO);
        assert_eq!(albedo().data[78], solution.albedo.data[78]);
        assert!(!xml.contains("thindielectric") && xml.contains("twosided\" id=\"material"));
        solution.transmission = Some(solution.albedo.map(|_| 1.0));
        let xml = write(&solution, false);
        assert!(xml.contains("thindielectric") && xml.contains("blendbsdf\" id=\"material"));
        assert!(folder.path().join("mitsuba_transmission.exr").is_file());
        let r = ((PANE_INDEX - 1.0) / (PANE_INDEX + 1.0)).powi(2);
        assert!(
            (2.0 * r / (1.0 + r) - 0.04).abs() < 1e-4,
            "F0 of both faces"
        );
    }

    #[test]
    fn panoramas_turn_by_half() {
        let map = Plane {
            width: 4,
            height: 1,
            data: (0..4).map(|i| Vec3::splat(i as f32)).collect(),
        };
        assert_eq!(
            turned(&map).data.iter().map(|c| c.x).collect::<Vec<_>>(),
            [2.0, 3.0, 0.0, 1.0]
        );
    }
}
