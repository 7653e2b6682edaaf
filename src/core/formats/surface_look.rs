//! What a file paints its triangles with: a picture or a colour per material, a colour per vertex.
//! Called by the readers of meshes, which note where pictures lie; `read_texture` reads them.

use super::{MOST_TEXT, read_input, without_mark};
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
    /// The file names a picture that cannot be read: why, and the way out. Only who wants the colours
    /// need mind.
    Unusable(String),
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

/// Median from which colours of vertices are of 0 to 255. Derived: a display's white is 1, and a
/// picture whose median is 4 of 255 (0.1 % of white) is black; light in physical units may be as
/// large, but then its lamps exceed 255.
const BYTES_FROM: f64 = 4.0;

/// What stands for white among colours of vertices that are written as numbers with a point: 1 by
/// the conventions of OBJ and PLY, but 255 where somebody wrote bytes; then a note says so.
pub(super) fn white_of(
    colours: impl Iterator<Item = [f64; 3]> + Clone,
    notes: &mut Vec<String>,
) -> f64 {
    let lit = |c: &f64| c.is_finite() && *c > 0.0;
    let most = colours.clone().flatten().filter(lit).fold(0.0, f64::max);
    if most <= BYTES_FROM || most > 255.0 {
        return 1.0;
    }
    let mut values: Vec<f64> = colours.flatten().filter(lit).collect();
    let middle = values.len() / 2;
    let (_, median, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let median = *median;
    if median < BYTES_FROM {
        return 1.0;
    }
    notes.push(format!(
        "the colours of its vertices go up to {most} with a median of {median}: taken as bytes of a display, 255 for white"
    ));
    255.0
}

/// A file beside the mesh or below it; `None` for any other place.
pub(super) fn beside(mesh: &Path, named: &str) -> Option<PathBuf> {
    let named = named.trim().replace('\\', "/");
    let inside = |c: Component<'_>| matches!(c, Component::Normal(_) | Component::CurDir);
    let fine = !named.is_empty() && Path::new(&named).components().all(inside);
    fine.then(|| mesh.with_file_name("").join(named))
}

/// A material library of an OBJ file.
#[derive(Debug, Default)]
pub(super) struct Library {
    /// Its materials by name.
    pub looks: BTreeMap<String, Look>,
    /// What had to be guessed, for people.
    pub notes: Vec<String>,
}

/// The materials of an OBJ file's `mtllib`: `Kd` and `map_Kd`, by name. A library that cannot be read
/// has none.
pub(super) fn read_mtl(mesh: &Path, named: &str) -> Library {
    let bytes = beside(mesh, named).and_then(|p| read_input(&p, MOST_TEXT).ok());
    let bytes = bytes.unwrap_or_default();
    let mut found = Library::default();
    let mut open: Option<String> = None;
    for line in String::from_utf8_lossy(without_mark(&bytes)).lines() {
        let line = line.trim();
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let look = open.as_ref().and_then(|name| found.looks.get_mut(name));
        match (word.to_ascii_lowercase().as_str(), look) {
            ("newmtl", _) => {
                let name = rest.trim().to_owned();
                open = Some(name.clone());
                let (factor, texture) = (Vec3::ONE, None);
                found.looks.insert(name, Look { factor, texture });
            }
            ("kd", Some(look)) => {
                let numbers: Vec<f32> = (rest.split_ascii_whitespace())
                    .filter_map(|n| n.parse().ok())
                    .collect();
                if let [r, g, b] = numbers[..] {
                    look.factor = Vec3::new(r, g, b);
                }
            }
            ("map_kd", Some(look)) => {
                look.texture = picture_file(mesh, without_options(rest), &mut found.notes);
            }
            _ => {}
        }
    }
    // writers leave Kd as they please where a picture holds the colour
    for look in found.looks.values_mut().filter(|l| l.texture.is_some()) {
        look.factor = Vec3::ONE;
    }
    found
}

/// The picture that a file names: at this place if it lies beside the mesh or below, else the file
/// of this name beside the mesh. Paths of the computer that wrote the file (`C:\scan\wall.png`)
/// and of folders that were not copied along are common; nothing else of this computer is read.
pub(super) fn picture_file(
    mesh: &Path,
    named: &str,
    notes: &mut Vec<String>,
) -> Option<TextureSource> {
    let named = named.trim().trim_matches('"').trim();
    if named.is_empty() {
        return None;
    }
    let forward = named.replace('\\', "/");
    let drive = forward.get(1..2) == Some(":");
    let stated = beside(mesh, named).filter(|_| !drive);
    let bare = forward.rsplit('/').next().unwrap_or_default();
    let bare_file = beside(mesh, bare);
    let there = |p: &Option<PathBuf>| p.as_ref().is_some_and(|p| p.exists());
    if stated != bare_file && !there(&stated) && there(&bare_file) {
        let note = format!("the picture {named} is taken from beside the mesh: {bare}");
        if !notes.contains(&note) {
            notes.push(note);
        }
        return bare_file.map(TextureSource::File);
    }
    // a file that is missing is named by whoever opens it
    Some(stated.map_or_else(
        || {
            TextureSource::Unusable(format!(
                "its picture {named} does not lie beside the mesh or below, and there is no {bare} beside the mesh: copy it there"
            ))
        },
        TextureSource::File,
    ))
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
    fn bytes_are_told_from_shares_of_white_and_from_light() {
        let white = |values: &[f64]| {
            let mut notes = Vec::new();
            let white = white_of(values.iter().map(|v| [*v, 0.0, f64::NAN]), &mut notes);
            assert_eq!(notes.len(), usize::from(white > 1.0), "{values:?}");
            white
        };
        assert_eq!(white(&[0.2, 0.7, 1.0]), 1.0);
        // overshoots of a filter, a lamp in a room
        assert_eq!(white(&[0.2, 0.7, 1.3]), 1.0);
        assert_eq!(white(&[0.3, 0.5, 0.4, 90.0]), 1.0);
        assert_eq!(white(&[20.0, 50.0, 3000.0]), 1.0);
        // uncoloured vertices do not make it light
        assert_eq!(white(&[0.0, 0.0, 0.0, 64.5, 128.0]), 255.0);
        assert_eq!(white(&[]), 1.0);
    }

    #[test]
    fn material_libraries_give_pictures_and_colours() {
        let dir = tempfile::tempdir().expect("folder");
        let text = "newmtl wall\nKd 0.5 0.25 1\nnewmtl scan\nKd 0 0 0\nmap_Kd -s 1 1 1 -clamp on my scan.jpg\n\
                    newmtl away\nmap_Kd ../../etc/passwd\nnewmtl ab\nmap_Kd /home/me/my scan.jpg\n\
                    newmtl win\nmap_kd \"C:\\\\x\\\\my scan.jpg\"\nnewmtl up\nmap_Kd ../t/my scan.jpg\n";
        std::fs::write(dir.path().join("m.mtl"), format!("\u{feff}{text}")).expect("written");
        std::fs::write(dir.path().join("my scan.jpg"), "").expect("picture");
        let mesh = dir.path().join("m.obj");
        let Library {
            looks: found,
            notes,
        } = read_mtl(&mesh, "m.mtl");
        assert_eq!(found["wall"].factor, Vec3::new(0.5, 0.25, 1.0));
        let picture = TextureSource::File(dir.path().join("my scan.jpg"));
        assert_eq!(found["scan"].texture.as_ref(), Some(&picture));
        assert_eq!(
            found["scan"].factor,
            Vec3::ONE,
            "the picture holds the colour"
        );
        let Some(TextureSource::Unusable(why)) = &found["away"].texture else {
            panic!("only what lies beside the mesh is read");
        };
        assert!(
            why.contains("../../etc/passwd") && why.contains("copy"),
            "{why}"
        );
        for moved in ["ab", "win", "up"] {
            assert_eq!(found[moved].texture.as_ref(), Some(&picture), "{moved}");
        }
        assert_eq!(notes.len(), 3, "{notes:?}");
        assert!(read_mtl(&mesh, "missing.mtl").looks.is_empty());
    }
}
