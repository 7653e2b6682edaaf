//! A scan: a mesh with colours of its own and no photographs. Its colours are what its surface sent
//! out when it was scanned: pictures of its materials, one picture given by hand, or a colour per
//! vertex. Called by `unbake delight`.

use super::mesh_classes::{Named, mesh_classes};
use super::{LoadOptions, PreparedMesh, Scene, clipped_channels, prepare_mesh};
use crate::core::formats::{self, Look, RawMesh, SurfaceNames, Texture, TextureSource};
use crate::core::geometry::Mesh;
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::{linear_from_srgb, luminance};
use crate::core::texture::{MipChain, Texels, fill_uncovered};
use crate::{Error, Result};
use glam::{Vec2, Vec3};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Values of 8-bit files from here on are lower bounds (as for photographs).
const CEILING: f32 = 250.0 / 255.0;
/// Halvings of a picture for texels wider than its own.
const LEVELS: usize = 4;

/// How a scan is read.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
#[command(next_help_heading = "Scan")]
pub struct ScanOptions {
    /// Picture laid out by the mesh's texture coordinates, in the place of its own: OpenEXR or
    /// Radiance HDR (linear), PNG or JPEG (sRGB).
    #[arg(long, value_name = "FILE")]
    pub texture: Option<PathBuf>,
    /// Axis of the mesh that points up: y or z [default: y].
    #[arg(long, value_name = "AXIS", value_parser = ["y", "z"])]
    pub up: Option<String>,
}

/// A scan as a scene without views, and what its surface looks like.
pub struct Scan {
    /// Geometry and classes.
    pub scene: Scene,
    /// Colours.
    pub colours: ScanColours,
}

/// What the scan's surface sends out, by the file's triangles.
pub struct ScanColours {
    /// Corners of the file's triangles.
    triangles: Vec<[u32; 3]>,
    uvs: Vec<Vec2>,
    /// Per vertex of the file; empty = white.
    vertices: Vec<Vec3>,
    looks: Vec<ReadLook>,
    /// Index into `looks` per triangle of the file.
    look_of: Vec<u32>,
    file_triangle: Vec<u32>,
    /// Where the colours come from, for people.
    pub source: String,
    /// Whether they were made for a display: sRGB, whose brightest values are lower bounds.
    pub encoded: bool,
}

/// A material whose picture was read.
struct ReadLook {
    factor: Vec3,
    picture: Option<Picture>,
}

/// A picture, its halvings and what of it is at its ceiling.
struct Picture {
    colours: MipChain<Vec3>,
    clipped: Option<Plane<u8>>,
}

/// What one place of the surface looks like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanColour {
    /// Radiance sent out, linear RGB.
    pub radiance: Vec3,
    /// A lower bound: the picture is at its ceiling.
    pub clipped: bool,
}

impl Scan {
    /// Reads the mesh at `path` and its colours.
    ///
    /// # Errors
    /// If the mesh cannot be used, has no colours, or its pictures are missing or black.
    pub fn load(path: &Path, options: &ScanOptions, load: &LoadOptions) -> Result<Self> {
        let mut raw = formats::read_mesh(path)?;
        let mut notes = raw.oddities.look_notes.clone();
        notes.extend(only_light(&mut raw.colours, "vertices"));
        let z_up = options.up.as_deref() == Some("z");
        let (mut looks, source) = read_looks(path, &raw, options)?;
        notes.extend(source.notes.iter().cloned());
        let lit = |colours: &[Vec3]| colours.iter().any(|c| luminance(*c) > 0.0);
        let shows = |l: &ReadLook| match &l.picture {
            Some(p) => lit(&p.colours.base().data),
            None => raw.colours.is_empty() || lit(&raw.colours),
        };
        if !looks.iter().any(|l| lit(&[l.factor]) && shows(l)) {
            return Err(Error::input(
                path,
                "its colours are black: no light to take out; export it with its texture or vertex colours, or give the picture with --texture",
            ));
        }
        let load = LoadOptions {
            unwrap: load.unwrap || needs_atlas(&raw, looks.len()),
            ..load.clone()
        };
        let (triangles, uvs) = (raw.triangles.clone(), raw.picture_uvs().to_vec());
        let (vertices, names) = (raw.colours.clone(), raw.names.clone());
        let encoded = are_encoded(&source, &vertices);
        let look_of = look_of_triangles(&raw, &mut looks, &mut notes);
        check_placed(&raw, &looks, &look_of).map_err(|m| Error::input(path, m))?;
        let prepared = prepare_mesh(raw, path, z_up, &load)?;
        let colours = ScanColours {
            triangles,
            uvs,
            vertices,
            looks,
            look_of,
            file_triangle: prepared.file_triangle.clone(),
            source: source.text,
            encoded,
        };
        let mut scene = scene_of(prepared, &names, path, &load, z_up);
        scene.files.extend(source.files);
        let named = |note: String| format!("{}: {note}", path.display());
        scene.warnings.extend(notes.into_iter().map(named));
        Ok(Self { scene, colours })
    }
}

/// Makes light of colours: what is below 0 is 0, what is no number is black. Says how many were neither.
fn only_light(colours: &mut [Vec3], of: &str) -> Option<String> {
    let mut count = 0usize;
    for c in colours {
        let light = match c.is_finite() {
            true => c.max(Vec3::ZERO),
            false => Vec3::ZERO,
        };
        count += usize::from(*c != light);
        *c = light;
    }
    (count > 0).then(|| {
        format!("{count} {of} have colours that are no light (below 0, or no numbers): taken as black there")
    })
}

/// Index into `looks` per triangle: its material's, or the only one. Where that is a picture, parts
/// with neither material nor texture coordinates cannot have it: they are white.
fn look_of_triangles(
    raw: &RawMesh,
    looks: &mut Vec<ReadLook>,
    notes: &mut Vec<String>,
) -> Vec<u32> {
    if looks.len() != 1 {
        return raw.look_of_triangle.clone();
    }
    let mut look_of = vec![0; raw.triangles.len()];
    if looks[0].picture.is_none() || raw.oddities.without_uvs.is_empty() {
        return look_of;
    }
    let own = (look_of.iter_mut()).zip(&raw.look_of_triangle);
    let bare = (own.zip(&raw.triangles))
        .filter(|((_, look), corners)| **look == SurfaceNames::NONE && !is_placed(raw, corners))
        .map(|((look, _), _)| *look = 1)
        .count();
    if bare > 0 {
        looks.push(ReadLook {
            factor: Vec3::ONE,
            picture: None,
        });
        notes.push(format!(
            "{bare} triangles have neither a material nor texture coordinates: taken as white"
        ));
    }
    look_of
}

/// Whether all corners have texture coordinates.
fn is_placed(raw: &RawMesh, corners: &[u32; 3]) -> bool {
    let uvs = raw.picture_uvs();
    let known = |i: &u32| uvs.get(*i as usize).is_some_and(|t| !t.is_nan());
    corners.iter().all(known)
}

/// Every triangle with a picture has texture coordinates.
fn check_placed(
    raw: &RawMesh,
    looks: &[ReadLook],
    look_of: &[u32],
) -> std::result::Result<(), String> {
    let painted = |look: &u32| (looks.get(*look as usize)).is_some_and(|l| l.picture.is_some());
    let lost = (look_of.iter().zip(&raw.triangles))
        .filter(|(look, corners)| painted(look) && !is_placed(raw, corners))
        .count();
    if lost == 0 {
        return Ok(());
    }
    Err(format!(
        "{lost} triangles have a picture and no texture coordinates to lay it on by; parts without: {}. Unwrap them in a modelling \
         program, or give them a material without a picture",
        raw.oddities.without_uvs.join(", ")
    ))
}

/// The scan as a scene without views.
fn scene_of(
    prepared: PreparedMesh,
    names: &[SurfaceNames],
    path: &Path,
    load: &LoadOptions,
    z_up: bool,
) -> Scene {
    let found = mesh_classes(&Named::prepared(&prepared, names), None, load.mesh_classes);
    let folder = path.parent().unwrap_or(Path::new("")).to_path_buf();
    let (classes, of_mesh) = found.map_or((Vec::new(), None), |f| (f.classes, Some(f.mesh)));
    let scene = Scene {
        mesh_classes: of_mesh,
        mesh_stats: prepared.stats,
        z_up,
        options: load.clone(),
        files: vec![path.to_path_buf()],
        ..Scene::from_parts(folder, prepared.origin, prepared.mesh, classes, Vec::new())
    };
    scene.with_mesh_warnings(path)
}

/// Whether texture coordinates of the file are no atlas: none, several materials' or repeating ones.
fn needs_atlas(raw: &RawMesh, looks: usize) -> bool {
    const SLACK: f32 = 1e-3;
    let inside = |t: &Vec2| t.min_element() >= -SLACK && t.max_element() <= 1.0 + SLACK;
    raw.uvs.is_empty() || looks > 1 || !raw.uvs.iter().all(inside)
}

/// Where colours come from.
struct Source {
    text: String,
    /// A picture is of 8 bits, made for a display.
    encoded_picture: bool,
    pictures: usize,
    /// The pictures' files.
    files: Vec<PathBuf>,
    /// What of the pictures is odd.
    notes: Vec<String>,
}

/// Whether the colours are of a display: those of an 8-bit picture, or of vertices none of which
/// is brighter than white.
fn are_encoded(source: &Source, vertices: &[Vec3]) -> bool {
    match source.pictures {
        0 => vertices.iter().all(|c| c.max_element() <= 1.0),
        _ => source.encoded_picture,
    }
}

/// The materials with their pictures: the one given by hand, those of the file (linear ones beside
/// them first), or none, where vertices have colours.
fn read_looks(
    path: &Path,
    raw: &RawMesh,
    options: &ScanOptions,
) -> Result<(Vec<ReadLook>, Source)> {
    let whole = |texture| Look {
        factor: Vec3::ONE,
        texture,
    };
    let looks: Vec<Look> = match &options.texture {
        Some(file) => vec![whole(Some(TextureSource::File(file.clone())))],
        None if raw.looks.iter().all(|l| l.texture.is_none()) => match linear_beside(path, None) {
            Some(file) => vec![whole(Some(TextureSource::File(file)))],
            None if !raw.colours.is_empty() || raw.looks.is_empty() => vec![whole(None)],
            None => raw.looks.clone(),
        },
        None => {
            let only = raw.looks.len() == 1;
            let linear = |l: &Look| Look {
                texture: l.texture.clone().map(|t| linear_twin(path, t, only)),
                ..l.clone()
            };
            raw.looks.iter().map(linear).collect()
        }
    };
    let textured = looks.iter().any(|l| l.texture.is_some());
    if !textured && raw.colours.is_empty() && raw.looks.is_empty() {
        return Err(Error::input(
            path,
            "neither a texture nor vertex colours: nothing to take the light out of; give the picture of its surface with --texture",
        ));
    }
    if textured && raw.picture_uvs().is_empty() {
        return Err(Error::input(
            path,
            "no texture coordinates, so that its picture cannot be laid on; export the mesh with them",
        ));
    }
    let (mut read, mut notes) = (BTreeMap::<TextureSource, Texture>::new(), Vec::new());
    for source in looks.iter().filter_map(|l| l.texture.clone()) {
        if let std::collections::btree_map::Entry::Vacant(entry) = read.entry(source.clone()) {
            let texture = formats::read_texture(path, &source);
            let mut texture = texture.map_err(|e| {
                e.advise(match source {
                    TextureSource::File(_) => {
                        "it is a picture of the mesh: keep it beside the mesh, or give it with --texture"
                    }
                    _ => "or give the picture of the surface with --texture",
                })
            })?;
            notes.extend(only_light(&mut texture.pixels.data, "pixels of a picture"));
            entry.insert(texture);
        }
    }
    let source = Source {
        encoded_picture: read.values().any(|t| t.encoded),
        pictures: read.len(),
        files: (read.keys())
            .filter_map(|s| match s {
                TextureSource::File(path) => Some(path.clone()),
                TextureSource::Embedded(_) | TextureSource::Unusable(_) => None,
            })
            .collect(),
        text: described(&looks, &read),
        notes,
    };
    let prepared = looks.iter().enumerate().map(|(k, look)| ReadLook {
        factor: look.factor,
        picture: look.texture.as_ref().and_then(|t| {
            let alone = looks.len() == 1;
            let uses = |l: &u32| alone || *l as usize == k;
            read.get(t).map(|t| Picture::new(t, raw, uses))
        }),
    });
    Ok((prepared.collect(), source))
}

/// Where colours come from, for people.
fn described(looks: &[Look], read: &BTreeMap<TextureSource, Texture>) -> String {
    let kind = |t: &Texture| if t.encoded { "sRGB" } else { "linear" };
    let of = |(source, t): (&TextureSource, &Texture)| {
        let name = match source {
            TextureSource::File(path) => path.display().to_string(),
            TextureSource::Embedded(k) => format!("image {k} of the mesh"),
            TextureSource::Unusable(_) => "no picture".into(),
        };
        format!(
            "{name} ({}×{}, {})",
            t.pixels.width,
            t.pixels.height,
            kind(t)
        )
    };
    match (read.len(), looks.len()) {
        (0, 1) => "colours of the vertices".into(),
        (0, n) => format!("colours of {n} materials"),
        (1..=3, _) => read.iter().map(of).collect::<Vec<_>>().join(", "),
        (n, _) => format!("{n} pictures"),
    }
}

/// A linear picture beside the mesh, or beside the picture that its file names.
fn linear_beside(mesh: &Path, named: Option<&Path>) -> Option<PathBuf> {
    let stems = [named, Some(mesh)];
    let mut files = (stems.into_iter().flatten())
        .flat_map(|stem| ["exr", "hdr"].map(|e| stem.with_extension(e)));
    files.find(|f| f.is_file())
}

/// The linear twin of a picture, where one lies beside it; beside the mesh only if it is the only one.
fn linear_twin(mesh: &Path, source: TextureSource, only: bool) -> TextureSource {
    let named = match &source {
        TextureSource::File(path) => Some(path.as_path()),
        TextureSource::Embedded(_) | TextureSource::Unusable(_) => None,
    };
    let beside = if only {
        mesh
    } else {
        named.unwrap_or(Path::new(""))
    };
    linear_beside(beside, named).map_or(source, TextureSource::File)
}

impl Picture {
    /// A picture with its halvings; what no triangle uses is filled from what lies near, so that
    /// charts do not take over the background's colour.
    fn new(texture: &Texture, raw: &RawMesh, uses: impl Fn(&u32) -> bool) -> Self {
        let of_picture = |t: usize| raw.look_of_triangle.get(t).is_none_or(&uses);
        let uvs = raw.picture_uvs();
        let inside = |c: &[u32; 3]| {
            let uv = |i: &u32| uvs.get(*i as usize);
            c.iter().all(|i| {
                uv(i).is_some_and(|t| t.cmpge(Vec2::ZERO).all() && t.cmple(Vec2::ONE).all())
            })
        };
        let triangles: Vec<[u32; 3]> = (raw.triangles.iter().enumerate())
            .filter(|(t, c)| of_picture(*t) && inside(c))
            .map(|(_, c)| *c)
            .collect();
        let image = &texture.pixels;
        let charts = Mesh {
            positions: raw.positions.iter().map(|p| p.as_vec3()).collect(),
            uvs: uvs.to_vec(),
            triangles,
            ..Mesh::default()
        };
        let texels = Texels::rasterize(&charts, image.width, image.height);
        let used = texels.scatter(&vec![true; texels.len()], false);
        let whole: RgbPlane = match texels.is_empty() {
            true => image.clone(),
            false => fill_uncovered(image, &used),
        };
        Self {
            colours: MipChain::new(whole, LEVELS),
            clipped: clipped_channels(image, texture.encoded.then_some(linear_ceiling())),
        }
    }

    fn size(&self) -> Vec2 {
        let base = self.colours.base();
        Vec2::new(base.width as f32, base.height as f32)
    }
}

fn linear_ceiling() -> f32 {
    linear_from_srgb(CEILING)
}

impl ScanColours {
    /// The colour at barycentrics (u, v) of the mesh's triangle `t`, taken over `width` texels of
    /// its picture; `None` where the file says nothing of it.
    #[must_use]
    pub fn at(&self, t: usize, u: f32, v: f32, width: f32) -> Option<ScanColour> {
        let file = *self.file_triangle.get(t)? as usize;
        let corners = self.triangles.get(file)?.map(|i| i as usize);
        let look = self.looks.get(*self.look_of.get(file)? as usize)?;
        let weights = [1.0 - u - v, u, v];
        let mut out = ScanColour {
            radiance: look.factor,
            clipped: false,
        };
        if let Some(picture) = &look.picture {
            let uv: Vec2 = (0..3).map(|k| self.uvs[corners[k]] * weights[k]).sum();
            let uv = if uv.cmpge(Vec2::ZERO).all() && uv.cmple(Vec2::ONE).all() {
                uv
            } else {
                uv - uv.floor()
            };
            out.radiance *= match width < 1.5 {
                true => picture.colours.bilinear(uv),
                false => picture.colours.lookup(uv, width),
            };
            let clipped = picture.clipped.as_ref();
            out.clipped = clipped.is_some_and(|c| *c.nearest(uv * picture.size()) != 0);
        } else if !self.vertices.is_empty() {
            let colour: Vec3 = (0..3).map(|k| self.vertices[corners[k]] * weights[k]).sum();
            out.radiance *= colour;
            out.clipped = self.encoded && colour.max_element() >= linear_ceiling();
        }
        Some(out)
    }

    /// Area of the mesh's triangle `t` in texels of its picture; where it has none, two texels an
    /// edge, so that what lies between vertices survives.
    #[must_use]
    pub fn texels_of(&self, t: usize) -> f32 {
        let Some(file) = self.file_triangle.get(t).map(|f| *f as usize) else {
            return 0.0;
        };
        let look = (self.look_of.get(file)).and_then(|l| self.looks.get(*l as usize));
        match look.and_then(|l| l.picture.as_ref()) {
            Some(p) => {
                let [a, b, c] = self.triangles[file].map(|i| self.uvs[i as usize] * p.size());
                0.5 * (b - a).perp_dot(c - a).abs()
            }
            None => 2.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of two triangles with a picture of four texels, in OBJ.
    fn square(dir: &Path, mtl: &str) -> PathBuf {
        let text = "mtllib m.mtl\nv 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 1 1 0 0 0 1\nv 0 1 0 0 0 1\n\
                    vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n";
        std::fs::write(dir.join("m.obj"), text).expect("mesh");
        std::fs::write(dir.join("m.mtl"), mtl).expect("materials");
        dir.join("m.obj")
    }

    fn load(path: &Path) -> Result<Scan> {
        Scan::load(path, &ScanOptions::default(), &LoadOptions::default())
    }

    #[test]
    fn a_linear_picture_goes_before_an_encoded_one_and_that_before_vertices() {
        let dir = tempfile::tempdir().expect("folder");
        let mesh = square(dir.path(), "newmtl a\nmap_Kd p.png\n");
        let colour = |s: &Scan| s.colours.at(0, 0.25, 0.25, 1.0).expect("known");
        let missing = load(&mesh).map(|_| ()).expect_err("no picture").to_string();
        assert!(
            missing.contains("p.png") && missing.contains("--texture"),
            "{missing}"
        );
        formats::write_png_rgb8(dir.path().join("p.png"), 2, 2, &[255; 12]).expect("picture");
        let scan = load(&mesh).expect("usable");
        assert!(scan.colours.encoded && colour(&scan).clipped);
        assert!((colour(&scan).radiance - Vec3::ONE).length() < 1e-6);
        let bright = Plane::filled(2, 2, Vec3::splat(7.0));
        formats::write_rgb_float(dir.path().join("p.exr"), &bright).expect("picture");
        let scan = load(&mesh).expect("usable");
        assert!(!scan.colours.encoded && !colour(&scan).clipped);
        assert_eq!(colour(&scan).radiance, Vec3::splat(7.0));
        let mesh = square(dir.path(), "");
        let scan = load(&mesh).expect("usable");
        let c = scan.colours.at(0, 0.0, 1.0, 1.0).expect("known").radiance;
        assert!(
            (c - Vec3::Z).length() < 1e-6,
            "{c}: the third corner is blue"
        );
    }

    /// The square with a lamp beside it that has a material and no texture coordinates.
    #[test]
    fn a_part_without_texture_coordinates_leaves_the_others_their_picture() {
        let dir = tempfile::tempdir().expect("folder");
        let red = "newmtl a\nmap_Kd /elsewhere/p.png\nnewmtl b\nKd 1 0 0\n";
        let mesh = square(dir.path(), red);
        let green = [0, 255, 0].repeat(4);
        formats::write_png_rgb8(dir.path().join("p.png"), 2, 2, &green).expect("picture");
        let text = std::fs::read_to_string(&mesh).expect("mesh");
        let lamp = "v 5 0 0\nv 6 0 0\nv 5 1 0\n";
        let with = |more: &str| {
            std::fs::write(&mesh, format!("{text}{lamp}{more}f 5 6 7\n")).expect("mesh");
            load(&mesh)
        };
        let scan = with("o lamp\nusemtl b\n").expect("usable");
        let colour = |t: usize| {
            let lamp = |t: &usize| scan.colours.file_triangle[*t] == 2;
            let is = (0..3).find(|k| lamp(k) == (t == 2)).expect("triangle");
            scan.colours
                .at(is, 0.25, 0.25, 1.0)
                .expect("known")
                .radiance
        };
        assert!((colour(0) - Vec3::Y).length() < 1e-6 && (colour(2) - Vec3::X).length() < 1e-6);
        let said = scan.scene.warnings.join("\n");
        assert!(
            said.contains("\"lamp\"") && said.contains("p.png"),
            "{said}"
        );
        let e = with("o lamp\n")
            .map(|_| ())
            .expect_err("the picture lies nowhere");
        assert!(
            e.exit_code() == 2 && e.to_string().contains("\"lamp\""),
            "{e}"
        );
    }

    #[test]
    fn a_mesh_without_colours_is_refused_with_a_way_out() {
        let dir = tempfile::tempdir().expect("folder");
        let path = dir.path().join("m.obj");
        std::fs::write(&path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").expect("mesh");
        let e = load(&path)
            .map(|_| ())
            .expect_err("nothing to take light out of");
        assert!(
            e.exit_code() == 2 && e.to_string().contains("--texture"),
            "{e}"
        );
    }

    /// A PLY of one triangle with colours of numbers.
    fn coloured(folder: &Path, colours: [&str; 3]) -> PathBuf {
        let path = folder.join("c.ply");
        let head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
            property float red\nproperty float green\nproperty float blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
        let [a, b, c] = colours;
        let text = format!("{head}0 0 0 {a}\n1 0 0 {b}\n0 1 0 {c}\n3 0 1 2\n");
        std::fs::write(&path, text).expect("mesh");
        path
    }

    #[test]
    fn colours_that_are_no_light_are_black_and_a_black_scan_is_refused() {
        let dir = tempfile::tempdir().expect("folder");
        let mesh = coloured(dir.path(), ["-1 0.5 0.5", "nan 1 1", "0.5 0.5 0.5"]);
        let scan = load(&mesh).expect("usable");
        let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)];
        for (u, v) in corners {
            let c = scan.colours.at(0, u, v, 1.0).expect("known").radiance;
            assert!(c.is_finite() && c.min_element() >= 0.0, "{c}");
        }
        let told = |w: &String| w.contains("2 vertices have colours that are no light");
        assert!(
            scan.scene.warnings.iter().any(told),
            "{:?}",
            scan.scene.warnings
        );
        for black in [["0 0 0"; 3], ["-1 0 -2"; 3]] {
            let mesh = coloured(dir.path(), black);
            let refused = load(&mesh).map(|_| ()).expect_err("black").to_string();
            assert!(
                refused.contains("black") && refused.contains("--texture"),
                "{refused}"
            );
        }
    }
}
