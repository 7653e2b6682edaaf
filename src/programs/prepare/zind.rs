//! Zillow Indoor Dataset (Cruz et al., CVPR 2021): panoramas, their poses on the floor plan, and
//! room layouts with doors, windows and openings.
//!
//! Conventions (`data_organization.md` of the data set; checked against the photographs): layouts
//! are in units of the camera's height above the floor, seen from above with x mirrored; the plan
//! is rotation · scale · layout + translation, in units of `scale_meters_per_coordinate`; openings
//! are triples (end, end, (lower, upper edge relative to the camera)). The world here is
//! (−x, y, height): z up, the floor at 0.

use super::account::Account;
use super::capture::{Capture, LabelledMesh, RoomOutline, Shot, Surface, Up};
use super::importer::{Importer, Located, PrepareOptions};
use super::lens::Optics;
use super::plan::{Opening, Shell, ShellClasses, extrude};
use crate::core::formats::read_input_text;
use crate::error::{Error, Result};
use crate::scene::Class;
use glam::{DMat4, DVec2, DVec4};
use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, Visitor};
use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

const FILE: &str = "zind_data.json";
const CLASSES: [&str; 5] = ["floor", "ceiling", "wall", "door", "window"];
const DOOR: u16 = 4;
const WINDOW: u16 = 5;
/// Two rooms' drawings of one door lie at most this far apart, metres: a thick inner wall and the
/// error of both drawings.
const DOORWAY_DEPTH: f64 = 0.4;

/// A JSON object in the order of the file.
struct InOrder<T>(Vec<(String, T)>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for InOrder<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Entries<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Entries<T> {
            type Value = InOrder<T>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }
            fn visit_map<A: MapAccess<'de>>(
                self,
                mut map: A,
            ) -> std::result::Result<Self::Value, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(InOrder(entries))
            }
        }
        deserializer.deserialize_map(Entries(PhantomData))
    }
}

#[derive(Deserialize)]
struct Data {
    #[serde(default)]
    scale_meters_per_coordinate: BTreeMap<String, Option<f64>>,
    merger: InOrder<Floor>,
}

/// Complete rooms → partial rooms → panoramas.
type Floor = InOrder<InOrder<InOrder<Pano>>>;

#[derive(Deserialize)]
struct Pano {
    #[serde(default)]
    label: String,
    #[serde(default)]
    is_primary: bool,
    ceiling_height: f64,
    #[serde(default = "one")]
    camera_height: f64,
    image_path: PathBuf,
    layout_raw: Option<Layout>,
    layout_complete: Option<Layout>,
    floor_plan_transformation: Placement,
}

fn one() -> f64 {
    1.0
}

#[derive(Deserialize)]
struct Layout {
    vertices: Vec<[f64; 2]>,
    #[serde(default)]
    doors: Vec<[f64; 2]>,
    #[serde(default)]
    windows: Vec<[f64; 2]>,
    #[serde(default)]
    openings: Vec<[f64; 2]>,
}

#[derive(Deserialize)]
struct Placement {
    translation: [f64; 2],
    rotation: f64,
    scale: f64,
}

/// A panorama's place in the world.
#[derive(Clone, Copy)]
struct Pose {
    /// Metres per layout unit: the camera's height.
    unit: f64,
    rotation: f64,
    position: DVec2,
}

impl Pose {
    fn new(place: &Placement, metres: f64) -> Self {
        let [x, y] = place.translation;
        Self {
            unit: place.scale * metres,
            rotation: place.rotation.to_radians(),
            position: DVec2::new(-x, y) * metres,
        }
    }

    /// A layout point in the world's plan.
    fn plan(&self, [x, y]: [f64; 2]) -> DVec2 {
        let (sin, cos) = self.rotation.sin_cos();
        DVec2::new(sin * y - cos * x, sin * x + cos * y) * self.unit + self.position
    }

    /// Camera-to-world: the panorama's middle looks along the layout's +y.
    fn world_from_camera(&self, camera_height: f64) -> DMat4 {
        let (sin, cos) = self.rotation.sin_cos();
        DMat4::from_cols(
            DVec4::new(cos, -sin, 0.0, 0.0),
            DVec4::new(0.0, 0.0, 1.0, 0.0),
            DVec4::new(-sin, -cos, 0.0, 0.0),
            self.position.extend(camera_height * self.unit).extend(1.0),
        )
    }
}

/// The importer.
pub struct Zind;

impl Importer for Zind {
    fn kind(&self) -> &'static str {
        "zind"
    }

    fn looks_like(&self) -> &'static str {
        "Zillow Indoor Dataset: a tour with zind_data.json and panos/"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        let expected =
            format!("no {FILE} here or in a folder of sample_tour/; give the folder of one tour");
        Located::new(path, tour(path), expected)
    }

    fn read(
        &self,
        located: &Located,
        options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        let folder = &located.start;
        let file = folder.join(FILE);
        let text = read_input_text(&file)?;
        let data: Data = serde_json::from_str(&text).map_err(|e| {
            Error::input(
                &file,
                format!("{e}; expected the annotation of a ZInD tour, download it again"),
            )
        })?;
        let (name, floor) = choose_floor(&data, options, &file, account)?;
        let metres = match data
            .scale_meters_per_coordinate
            .get(name)
            .copied()
            .flatten()
        {
            Some(m) if m.is_finite() && m > 0.0 => m,
            _ if options.scale.is_some() => 1.0,
            _ => {
                return Err(Error::input(
                    &file,
                    format!(
                        "scale_meters_per_coordinate.{name}: none known; give --scale METRES per coordinate (about 3.5 where the camera's scale is 0.4)"
                    ),
                ));
            }
        };
        read_floor(floor, metres, folder, &file, account)
    }
}

/// The folder of the tour: `path` itself, or the only one below it or its `sample_tour`.
fn tour(path: &Path) -> Option<PathBuf> {
    if path.join(FILE).is_file() {
        return Some(path.to_path_buf());
    }
    for folder in [path.to_path_buf(), path.join("sample_tour")] {
        let below: Vec<PathBuf> = std::fs::read_dir(folder)
            .into_iter()
            .flatten()
            .flatten()
            .map(|e| e.path())
            .filter(|p| p.join(FILE).is_file())
            .collect();
        if let [only] = below.as_slice() {
            return Some(only.clone());
        }
    }
    None
}

/// The storey asked for, else the one with most panoramas.
fn choose_floor<'a>(
    data: &'a Data,
    options: &PrepareOptions,
    file: &Path,
    account: &mut Account,
) -> Result<(&'a str, &'a Floor)> {
    let floors = &data.merger.0;
    let names: Vec<&str> = floors.iter().map(|f| f.0.as_str()).collect();
    let count = |f: &Floor| -> usize { panos(f).count() };
    let chosen = match &options.floor {
        Some(wanted) => floors.iter().find(|f| f.0 == *wanted).ok_or_else(|| {
            Error::Usage(format!(
                "--floor {wanted}: {} has {}",
                file.display(),
                names.join(", ")
            ))
        })?,
        None => floors
            .iter()
            .rev()
            .max_by_key(|f| count(&f.1))
            .ok_or_else(|| Error::input(file, "merger: no floors; download the tour again"))?,
    };
    for (name, floor) in floors.iter().filter(|f| f.0 != chosen.0) {
        account.ignored(format!(
            "storey {name} with {} panoramas (its height over {} is not known; --floor {name} takes it alone)",
            count(floor),
            chosen.0
        ));
    }
    Ok((&chosen.0, &chosen.1))
}

fn panos(floor: &Floor) -> impl Iterator<Item = &Pano> {
    floor
        .0
        .iter()
        .flat_map(|complete| &complete.1.0)
        .flat_map(|partial| &partial.1.0)
        .map(|pano| &pano.1)
}

/// A complete room's outline and openings in the world.
struct Room {
    shell: Shell,
    label: String,
}

fn read_floor(
    floor: &Floor,
    metres: f64,
    folder: &Path,
    file: &Path,
    account: &mut Account,
) -> Result<Capture> {
    let mut rooms = complete_rooms(floor, metres, account);
    if rooms.is_empty() {
        return Err(Error::input(
            file,
            "merger: no room has a layout; download the tour again",
        ));
    }
    let doorways = mark_passages(&mut rooms);
    let classes = ShellClasses {
        floor: 1,
        ceiling: 2,
        wall: 3,
    };
    let mut mesh = LabelledMesh::default();
    let lost: usize = rooms
        .iter()
        .map(|r| extrude(&r.shell, classes, &mut mesh))
        .sum();
    let shots: Vec<Shot> = panos(floor).map(|p| shot(p, metres, folder)).collect();
    let of = |c: u16| {
        rooms
            .iter()
            .flat_map(|r| &r.shell.openings)
            .filter(|o| o.class == c)
            .count()
    };
    account.read(format!(
        "{}: {} panoramas, {} rooms, {} doors and openings, {} windows",
        file.display(),
        shots.len(),
        rooms.len(),
        of(DOOR),
        of(WINDOW)
    ));
    account.converted(format!(
        "plan coordinates to metres ({metres} m each), x mirrored, z up; each complete room extruded from the layout of its first primary panorama"
    ));
    account.converted(format!(
        "{doorways} doors drawn from both sides are left open, the others are closed by a leaf"
    ));
    if lost > 0 {
        account.ignored(format!(
            "{lost} doors or windows that lie on no wall of their room"
        ));
    }
    account
        .ignored("layouts of partial rooms, what each panorama sees of them, and the redrawn plan");
    let outline = |r: &Room| RoomOutline {
        name: r.label.clone(),
        corners: r
            .shell
            .corners
            .iter()
            .map(|c| DVec2::new(c.x, -c.y))
            .collect(),
    };
    Ok(Capture {
        shots,
        rooms: rooms.iter().map(outline).collect(),
        surface: Some(Surface::Built(mesh)),
        classes: CLASSES
            .iter()
            .enumerate()
            .map(|(i, name)| Class {
                id: i as u16 + 1,
                name: (*name).into(),
                is_light: false,
            })
            .collect(),
        up: Up::Z,
        ..Capture::default()
    })
}

/// Complete rooms, each from the layout of its first primary panorama.
fn complete_rooms(floor: &Floor, metres: f64, account: &mut Account) -> Vec<Room> {
    let mut rooms: Vec<Room> = Vec::new();
    for (name, complete) in &floor.0 {
        let inside = || complete.0.iter().flat_map(|p| &p.1.0).map(|p| &p.1);
        let primary = inside().find(|p| p.is_primary).or_else(|| inside().next());
        match primary.and_then(|p| room(p, metres)) {
            Some(r) => rooms.push(r),
            None => account.ignored(format!("{name}: no layout of at least three corners")),
        }
    }
    rooms
}

fn room(pano: &Pano, metres: f64) -> Option<Room> {
    let pose = Pose::new(&pano.floor_plan_transformation, metres);
    let layout = pano
        .layout_complete
        .as_ref()
        .filter(|l| l.vertices.len() >= 3)
        .or(pano.layout_raw.as_ref())
        .filter(|l| l.vertices.len() >= 3)?;
    let opening = |triple: &[[f64; 2]], class: u16, passage: bool| Opening {
        ends: [pose.plan(triple[0]), pose.plan(triple[1])],
        heights: triple[2].map(|z| (z + pano.camera_height) * pose.unit),
        class,
        passage,
    };
    let triples = |list: &'_ [[f64; 2]], class: u16, passage: bool| -> Vec<Opening> {
        list.chunks_exact(3)
            .map(|t| opening(t, class, passage))
            .collect()
    };
    let mut openings = triples(&layout.doors, DOOR, false);
    openings.extend(triples(&layout.windows, WINDOW, false));
    // openings left over in a complete room lead where no panorama was taken
    openings.extend(triples(&layout.openings, DOOR, true));
    let shell = Shell {
        corners: layout.vertices.iter().map(|&v| pose.plan(v)).collect(),
        height: pano.ceiling_height * pose.unit,
        openings,
    };
    let finite = shell.corners.iter().all(|c| c.is_finite())
        && shell.height.is_finite()
        && shell.height > 0.0;
    finite.then(|| Room {
        shell,
        label: pano.label.clone(),
    })
}

/// Opens every door that another room draws as well; the number of doorways.
fn mark_passages(rooms: &mut [Room]) -> usize {
    let doors: Vec<(usize, usize, [DVec2; 2])> = rooms
        .iter()
        .enumerate()
        .flat_map(|(r, room)| {
            let openings = room.shell.openings.iter().enumerate();
            openings
                .filter(|(_, o)| o.class == DOOR)
                .map(move |(i, o)| (r, i, o.ends))
        })
        .collect();
    let mut pairs = 0;
    for (at, a) in doors.iter().enumerate() {
        for b in &doors[at + 1..] {
            if a.0 != b.0 && same_doorway(a.2, b.2) {
                pairs += 1;
                for (r, i, _) in [a, b] {
                    rooms[*r].shell.openings[*i].passage = true;
                }
            }
        }
    }
    pairs
}

/// Whether two segments run along each other, at most a wall apart, over half of the shorter one.
fn same_doorway(a: [DVec2; 2], b: [DVec2; 2]) -> bool {
    let length = |s: [DVec2; 2]| (s[1] - s[0]).length();
    let shorter = length(a).min(length(b));
    if shorter <= 0.0 {
        return false;
    }
    let along = (a[1] - a[0]) / length(a);
    let offset = |p: DVec2| (p - a[0]).perp_dot(along).abs();
    let [u, v] = b.map(|p| (p - a[0]).dot(along));
    let overlap = u.max(v).min(length(a)) - u.min(v).max(0.0);
    overlap >= 0.5 * shorter && offset(b[0]).max(offset(b[1])) < DOORWAY_DEPTH
}

fn shot(pano: &Pano, metres: f64, folder: &Path) -> Shot {
    let pose = Pose::new(&pano.floor_plan_transformation, metres);
    let stem = pano
        .image_path
        .file_stem()
        .map(|s| s.to_string_lossy().into_owned())
        .unwrap_or_default();
    // one storey at a time, so its name only lengthens the others
    let plain = match stem.split_once("_partial_room_") {
        Some((_, rest)) => format!("partial_room_{rest}"),
        None => stem,
    };
    Shot::new(
        plain,
        folder.join(&pano.image_path),
        pose.world_from_camera(pano.camera_height),
        Optics::Panorama,
    )
}
