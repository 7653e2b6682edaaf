//! Wavefront OBJ geometry. Polygons are triangulated; v is flipped, because OBJ counts it from the
//! bottom of the image.
//!
//! Only what surface needs is read: `v` (with colours where they follow), `vt`, `vn`, `f`, `o`, `g`,
//! `usemtl` as names of parts and their borders, and colours and pictures from `mtllib`. Comments, lines, points and curves do not matter, nor do their bytes. Source:
//! "Object Files (.obj)", Appendix B1 of the Advanced Visualizer manual.

use super::polygon;
use super::raw_mesh::{NameKind, Part, RawMesh};
use super::surface_look::{Look, of_display, read_mtl, white_of};
use super::without_mark;
use crate::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// A mesh of an OBJ file from its bytes; its material library is looked up beside `path`.
///
/// # Errors
/// A line is malformed, or names what is not there: the message names the line.
pub fn mesh_from_obj(bytes: &[u8], path: &Path) -> Result<RawMesh> {
    // names may be in any encoding; numbers are ASCII
    let text = String::from_utf8_lossy(without_mark(bytes));
    let mut reader = Reader {
        path: path.to_path_buf(),
        ..Reader::default()
    };
    let mut lines = text.lines().enumerate();
    let mut whole = String::new();
    while let Some((number, line)) = lines.next() {
        let mut line = line;
        // a backslash at the end continues the line
        if line.trim_end().ends_with('\\') {
            whole.clear();
            whole.push_str(line.trim_end().trim_end_matches('\\'));
            for (_, next) in lines.by_ref() {
                let next = next.trim_end();
                whole.push(' ');
                whole.push_str(next.trim_end_matches('\\'));
                if !next.ends_with('\\') {
                    break;
                }
            }
            line = &whole;
        }
        reader
            .line(line)
            .map_err(|e| Error::input(path, format!("line {}: {e}", number + 1)))?;
    }
    reader.close();
    if reader.parts.is_empty() {
        return Err(Error::input(
            path,
            "no faces; export the mesh with its triangles",
        ));
    }
    reader.settle_colours();
    let mut mesh = RawMesh::from_parts(reader.parts, path)?;
    mesh.oddities.look_notes = reader.notes;
    Ok(mesh)
}

/// Position, texture coordinate and normal of a corner, by their places in the file.
type Corner = (u32, Option<u32>, Option<u32>);

/// What has been read so far.
#[derive(Default)]
struct Reader {
    path: PathBuf,
    positions: Vec<DVec3>,
    /// Of display, from 0 to 1 as a rule; as long as `positions` where every vertex has one.
    colours: Vec<[f64; 3]>,
    materials: BTreeMap<String, Look>,
    /// What had to be guessed of colours, for people.
    notes: Vec<String>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    parts: Vec<Part>,
    /// The material and the object or group that faces belong to from here on.
    material: Option<String>,
    object: Option<String>,
    open: Open,
    face: Vec<Corner>,
}

/// The part under way.
#[derive(Default)]
struct Open {
    vertices: HashMap<Corner, u32>,
    corners: Vec<Corner>,
    triangles: Vec<[u32; 3]>,
}

/// The name on a line: "#" belongs to it ("Material #25" is 3ds Max's own) unless blanks around it
/// make it the start of a comment.
fn name_in(rest: &str) -> String {
    let words = rest.split_ascii_whitespace();
    words
        .take_while(|w| *w != "#")
        .collect::<Vec<_>>()
        .join(" ")
}

type Reading<T> = std::result::Result<T, String>;

impl Reader {
    fn line(&mut self, line: &str) -> Reading<()> {
        let (keyword, rest) = line
            .trim_start()
            .split_once(|c: char| c.is_ascii_whitespace())
            .unwrap_or((line.trim(), ""));
        let mut words = rest
            .split('#')
            .next()
            .unwrap_or_default()
            .split_ascii_whitespace();
        match keyword {
            "v" => {
                let [x, y, z] = numbers(words.by_ref(), 3)?;
                self.positions.push(DVec3::new(x, y, z));
                let rest = words.map_while(|w| w.parse().ok());
                if let [r, g, b] = rest.collect::<Vec<f64>>()[..] {
                    self.colours.push([r, g, b]);
                }
            }
            "vt" => {
                // one number is a coordinate along a curve: v is 0
                let [u, v, _] = numbers(words, 1)?;
                self.uvs.push(Vec2::new(u as f32, (1.0 - v) as f32));
            }
            "vn" => {
                let [x, y, z] = numbers(words, 3)?;
                let unit = DVec3::new(x, y, z).normalize_or_zero();
                self.normals.push(unit.as_vec3());
            }
            "f" | "fo" => self.face(words)?,
            "mtllib" => {
                let library = read_mtl(&self.path, &name_in(rest));
                self.materials.extend(library.looks);
                self.notes.extend(library.notes);
            }
            "o" | "g" | "usemtl" => {
                self.close();
                let name = name_in(rest);
                let name = (!name.is_empty()).then_some(name);
                match keyword {
                    "usemtl" => self.material = name,
                    _ => self.object = name,
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn face<'a>(&mut self, words: impl Iterator<Item = &'a str>) -> Reading<()> {
        let mut face = std::mem::take(&mut self.face);
        face.clear();
        for word in words {
            face.push(self.corner(word)?);
        }
        if face.len() < 3 {
            return Err(format!("a face of {} corners", face.len()));
        }
        let places: Vec<DVec3> = face.iter().map(|c| self.positions[c.0 as usize]).collect();
        let vertices: Vec<u32> = face.iter().map(|c| self.open.vertex(*c)).collect();
        let triangles = polygon::triangulate(&places);
        self.open
            .triangles
            .extend(triangles.into_iter().map(|t| t.map(|i| vertices[i])));
        self.face = face;
        Ok(())
    }

    /// `position/uv/normal`, the last two optional; negative numbers count back from the last.
    fn corner(&self, word: &str) -> Reading<Corner> {
        let mut fields = word.split('/');
        let place = |field: &str, count: usize, what: &str| -> Reading<u32> {
            let n: i64 = field
                .parse()
                .map_err(|_| format!("\"{word}\" is no corner of a face"))?;
            let at = if n < 0 { count as i64 + n } else { n - 1 };
            let found = u32::try_from(at).ok().filter(|i| (*i as usize) < count);
            found.ok_or_else(|| format!("{what} {n} of {count} does not exist"))
        };
        let mut optional = |count: usize, what: &str| -> Reading<Option<u32>> {
            match fields.next() {
                None | Some("") => Ok(None),
                Some(field) => place(field, count, what).map(Some),
            }
        };
        let position = optional(self.positions.len(), "vertex")?;
        let uv = optional(self.uvs.len(), "texture coordinate")?;
        let normal = optional(self.normals.len(), "normal")?;
        let position = position.ok_or_else(|| format!("\"{word}\" is no corner of a face"))?;
        Ok((position, uv, normal))
    }

    /// Colours as written become linear, now that all of them are known.
    fn settle_colours(&mut self) {
        let bytes = 255.0 / white_of(self.colours.iter().copied(), &mut self.notes);
        let colours = self.parts.iter_mut().flat_map(|p| &mut p.colours).flatten();
        colours.for_each(|c| *c = of_display(c.as_dvec3().to_array().map(|c| bytes * c)));
    }

    /// Ends the part under way; its colours stay as written, and an attribute that some of its corners lack counts as absent.
    fn close(&mut self) {
        let open = std::mem::take(&mut self.open);
        if open.triangles.is_empty() {
            return;
        }
        let uvs = open.corners.iter().map(|c| Some(self.uvs[c.1? as usize]));
        let normals = open
            .corners
            .iter()
            .map(|c| Some(self.normals[c.2? as usize]));
        self.parts.push(Part {
            positions: open
                .corners
                .iter()
                .map(|c| self.positions[c.0 as usize])
                .collect(),
            normals: normals.collect(),
            uvs: uvs.collect(),
            triangles: open.triangles,
            names: {
                let material = self.material.clone().map(|n| (NameKind::Material, n));
                let object = self.object.clone().map(|n| (NameKind::Object, n));
                material.into_iter().chain(object).collect()
            },
            colours: (self.colours.len() == self.positions.len()).then(|| {
                let colour = |c: &Corner| DVec3::from(self.colours[c.0 as usize]).as_vec3();
                open.corners.iter().map(colour).collect()
            }),
            look: {
                let material = self.material.as_ref();
                material.and_then(|m| self.materials.get(m).cloned())
            },
        });
    }
}

impl Open {
    fn vertex(&mut self, corner: Corner) -> u32 {
        let next = self.corners.len() as u32;
        let index = *self.vertices.entry(corner).or_insert(next);
        if index == next {
            self.corners.push(corner);
        }
        index
    }
}

/// At least `least` numbers of up to three; the rest is 0.
fn numbers<'a>(words: impl Iterator<Item = &'a str>, least: usize) -> Reading<[f64; 3]> {
    let mut out = [0.0; 3];
    let mut n = 0;
    for (slot, word) in out.iter_mut().zip(words) {
        *slot = word.parse().map_err(|_| {
            let comma = word.contains(',');
            let why = if comma { " (decimal comma?)" } else { "" };
            format!("'{word}' is no number{why}")
        })?;
        n += 1;
    }
    if n < least {
        return Err(format!("{n} numbers where {least} are expected"));
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<RawMesh> {
        mesh_from_obj(text.as_bytes(), Path::new("q.obj"))
    }

    const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

    #[test]
    fn a_quad_with_uvs_is_triangulated_and_v_flipped() {
        let text = "v 10000.001 0 0\nv 10001 0 0\nv 10001 1 0\nv 10000 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 0.75\nf 1/1 2/2 3/3 4/4\n";
        let mesh = read(text).expect("readable");
        assert_eq!(mesh.triangles.len(), 2);
        assert_eq!(mesh.positions[0].x, 10000.001, "positions keep f64");
        assert_eq!(mesh.uvs[3], Vec2::new(0.0, 0.25));
        assert!(mesh.normals.is_empty());
    }

    #[test]
    fn names_keep_their_hashes_and_lose_comments() {
        let text = TRIANGLE.replace(
            "f 1 2 3",
            "usemtl Material #25\nf 1 2 3 # a comment\n  usemtl Holz_#1 # oak\nf 1 2 3\n#usemtl none\nf 1 2 3",
        );
        let mesh = read(&text).expect("readable");
        assert_eq!(mesh.triangles.len(), 3);
        let materials = mesh.names.iter().find(|n| n.kind == NameKind::Material);
        let materials = materials.expect("materials");
        assert_eq!(materials.names, ["Material #25", "Holz_#1"]);
        assert_eq!(materials.of_triangle, [0, 1, 1]);
    }

    #[test]
    fn what_is_no_surface_does_not_matter() {
        let plain = read(TRIANGLE).expect("readable");
        for text in [
            format!("\u{feff}{TRIANGLE}"),
            format!("{TRIANGLE}l 1 2 3 1\np 1\ncurv 0 1 1 2\n"),
            TRIANGLE.replace("f 1 2 3", "f 1 \\\n2 \\\n 3"),
            TRIANGLE.replace('\n', "\r\n"),
            format!("# caf\u{fffd}\nmtllib x.mtl\nusemtl caf\u{e9}\ns off\n{TRIANGLE}"),
            TRIANGLE.replace("f 1 2 3", "f -3 -2 -1"),
        ] {
            let named = read(&text).expect("readable");
            let bare = RawMesh {
                names: Vec::new(),
                ..named
            };
            assert_eq!(bare, plain, "{text:?}");
        }
        let mut latin = b"# caf\xe9\n".to_vec();
        latin.extend(TRIANGLE.as_bytes());
        assert_eq!(
            mesh_from_obj(&latin, Path::new("q.obj")).expect("read"),
            plain
        );
    }

    #[test]
    fn damage_is_an_error_that_names_its_line() {
        for (text, said) in [
            ("", "no faces"),
            ("f 1 2 3\n", "line 1: vertex 1 of 0"),
            ("v 0 0\nf 1 1 1\n", "line 1: 2 numbers"),
            ("v 0 0 0\nf 1 2 99999999999\n", "line 2: vertex 2 of 1"),
            ("v 0 0 0\nf -5 -6 -7\n", "line 2"),
            ("v a b c\n", "line 1: 'a' is no number"),
            ("v 4,5 0 0\n", "'4,5' is no number (decimal comma?)"),
            ("f\n", "a face of 0 corners"),
            ("v 0 0 0\nf 1/ 1/ 1/\nf 1//9 1 1", "line 3: normal 9 of 0"),
        ] {
            let e = read(text).expect_err(said);
            assert!(
                e.exit_code() == 2 && e.to_string().contains(said),
                "{text:?}: {e}"
            );
        }
    }

    #[test]
    fn faces_with_and_without_uvs_count_as_without() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\nf 1 2 3\n";
        let mesh = read(text).expect("readable");
        assert!(mesh.uvs.is_empty() && mesh.triangles.len() == 2);
    }

    #[test]
    fn colours_of_bytes_are_those_of_shares() {
        let coloured = |colour: &str| {
            let vertex = |p: &str| format!("v {p} {colour}\n");
            let text: String = ["0 0 0", "1 0 0", "0 1 0"].map(vertex).concat();
            read(&format!("{text}f 1 2 3\n")).expect("readable")
        };
        let (shares, bytes) = (coloured("0.2 0.4 0.6"), coloured("51 102 153"));
        let off = (shares.colours[0] - bytes.colours[0]).length();
        assert!(off < 1e-6 && shares.colours[0].x < 0.04, "{off}");
        assert_eq!(
            (
                shares.oddities.look_notes.len(),
                bytes.oddities.look_notes.len()
            ),
            (0, 1)
        );
    }

    #[test]
    fn dented_faces_keep_their_area() {
        let mesh = read("v 0 0 0\nv 4 0 0\nv 4 4 0\nv 3 1 0\nf 2 3 4 1\n").expect("readable");
        let area: f64 = mesh
            .triangles
            .iter()
            .map(|t| t.map(|i| mesh.positions[i as usize]))
            .map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length())
            .sum();
        assert!((area - 4.0).abs() < 1e-12, "{area}");
    }
}
