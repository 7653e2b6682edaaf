//! What a file paints its triangles with: a picture or a colour per material, a colour per vertex.
//! Called by the readers of meshes, which note where pictures lie; `read_texture` reads them.

use super::{MOST_TEXT, read_input};
use crate::core::math::linear_from_srgb;
use glam::Vec3;
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

/// Where a picture lies.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TextureSource {
    /// A file of its own.
    File(PathBuf),
    /// The image of this number in a glTF file.
    Embedded(usize),
}

/// A material, as far as its colour goes.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    /// Linear RGB that the picture is multiplied with, or the colour itself.
    pub factor: Vec3,
    /// Its picture, laid out by the mesh's texture coordinates.
    pub texture: Option<TextureSource>,
}

/// A colour of eight bits a channel, made for a display, as linear RGB.
pub(super) fn of_display(rgb: [f64; 3]) -> Vec3 {
    Vec3::from_array(rgb.map(|c| linear_from_srgb((c / 255.0) as f32)))
}

/// A file beside the mesh or below it; `None` for any other place.
pub(super) fn beside(mesh: &Path, named: &str) -> Option<PathBuf> {
    let named = named.trim().replace('\\', "/");
    let inside = |c: Component<'_>| matches!(c, Component::Normal(_) | Component::CurDir);
    let fine = !named.is_empty() && Path::new(&named).components().all(inside);
    fine.then(|| mesh.with_file_name("").join(named))
}

/// The materials of an OBJ file's `mtllib`: `Kd` and `map_Kd`, by name. A library that cannot be read
/// has none.
pub(super) fn read_mtl(mesh: &Path, named: &str) -> BTreeMap<String, Look> {
    let bytes = beside(mesh, named).and_then(|p| read_input(&p, MOST_TEXT).ok());
    let bytes = bytes.unwrap_or_default();
    let mut found: BTreeMap<String, Look> = BTreeMap::new();
    let mut open: Option<String> = None;
    for line in String::from_utf8_lossy(&bytes).lines() {
        let line = line.trim();
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let look = open.as_ref().and_then(|name| found.get_mut(name));
        match (word, look) {
            ("newmtl", _) => {
                let name = rest.trim().to_owned();
                open = Some(name.clone());
                let (factor, texture) = (Vec3::ONE, None);
                found.insert(name, Look { factor, texture });
            }
            ("Kd", Some(look)) => {
                let numbers: Vec<f32> = (rest.split_ascii_whitespace())
                    .filter_map(|n| n.parse().ok())
                    .collect();
                if let [r, g, b] = numbers[..] {
                    look.factor = Vec3::new(r, g, b);
                }
            }
            ("map_Kd", Some(look)) => {
                look.texture = beside(mesh, without_options(rest)).map(TextureSource::File);
            }
            _ => {}
        }
    }
    // writers leave Kd as they please where a picture holds the colour
    for look in found.values_mut().filter(|l| l.texture.is_some()) {
        look.factor = Vec3::ONE;
    }
    found
}

/// The file's name after the options of `map_Kd` ("-s 1 1 1 wall.png"); it may have spaces.
fn without_options(rest: &str) -> &str {
    let mut rest = rest.trim();
    while rest.starts_with('-') {
        let (_, mut after) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
        while let Some((word, more)) = after.trim_start().split_once(char::is_whitespace) {
            if word.parse::<f32>().is_err() && !matches!(word, "on" | "off") {
                break;
            }
            after = more;
        }
        rest = after.trim();
    }
    rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn material_libraries_give_pictures_and_colours() {
        let dir = tempfile::tempdir().expect("folder");
        let text = "newmtl wall\nKd 0.5 0.25 1\nnewmtl scan\nKd 0 0 0\nmap_Kd -s 1 1 1 -clamp on my scan.jpg\n\
                    newmtl away\nmap_Kd ../../etc/passwd\n";
        std::fs::write(dir.path().join("m.mtl"), text).expect("written");
        let mesh = dir.path().join("m.obj");
        let found = read_mtl(&mesh, "m.mtl");
        assert_eq!(found["wall"].factor, Vec3::new(0.5, 0.25, 1.0));
        let picture = TextureSource::File(dir.path().join("my scan.jpg"));
        assert_eq!(found["scan"].texture.as_ref(), Some(&picture));
        assert_eq!(
            found["scan"].factor,
            Vec3::ONE,
            "the picture holds the colour"
        );
        assert_eq!(
            found["away"].texture, None,
            "only what lies beside the mesh"
        );
        assert!(read_mtl(&mesh, "missing.mtl").is_empty());
    }
}
