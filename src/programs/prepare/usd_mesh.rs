//! Triangles of the composed prims: meshes, boxes and the copies of point instancers, each with a
//! class by its name. Called by `roomplan`.

use super::capture::LabelledMesh;
use super::usd_layer::Value;
use super::usd_stage::{Composed, Stage};
use super::usd_xform::{local, quaternion};
use crate::core::formats::polygon;
use crate::core::geometry::BOX_SIDES;
use crate::error::{Error, Result};
use crate::scene::{Class, is_lamp};
use glam::{DMat4, DVec3};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Prims within prims beyond this are damage.
const DEEPEST: usize = 128;
/// Most prims drawn, copies counted: copies of copies could be without end. Derived: some seconds.
const MOST_PRIMS: usize = 1 << 22;
/// Most corners in all. Derived: 2²⁶ take 1.5 GiB.
const MOST_POINTS: usize = 1 << 26;
/// Types that hold no surface of their own.
const SILENT: [&str; 7] = [
    "",
    "Xform",
    "Scope",
    "Material",
    "Shader",
    "NodeGraph",
    "GeomSubset",
];
/// Names that programs give by themselves; their parents' names say more.
const GENERIC: [&str; 20] = [
    "",
    "box",
    "circle",
    "cone",
    "cube",
    "cylinder",
    "geo",
    "geom",
    "geometry",
    "group",
    "icosphere",
    "mesh",
    "object",
    "plane",
    "proxy",
    "render",
    "root",
    "shape",
    "sphere",
    "torus",
];

type Reading<T> = std::result::Result<T, String>;

/// What the prims above say of one.
#[derive(Clone, Copy)]
struct Inherited<'a> {
    world: DMat4,
    /// The nearest name above that says something.
    named: Option<&'a str>,
    /// `default`, `render`, `proxy` or `guide`.
    purpose: &'a str,
    invisible: bool,
    depth: usize,
}

/// Collects the triangles of a stage.
pub struct Drawing<'a> {
    stage: &'a Stage,
    file: &'a Path,
    /// Units of the stage to metres.
    base: DMat4,
    /// The triangles so far.
    pub mesh: LabelledMesh,
    /// Their classes by name.
    pub classes: BTreeMap<String, Class>,
    /// Prims of types that are no surfaces, by type.
    pub skipped: BTreeMap<String, usize>,
    /// Surfaces that are not to be seen, by reason.
    pub hidden: BTreeMap<&'static str, usize>,
    /// Prims that change in time.
    pub moving: usize,
    /// Copies by point instancers.
    pub copies: usize,
    drawn: usize,
}

impl<'a> Drawing<'a> {
    /// Nothing yet of a stage in units of `metres`.
    #[must_use]
    pub fn new(stage: &'a Stage, file: &'a Path, metres: f64) -> Self {
        Self {
            stage,
            file,
            base: DMat4::from_scale(DVec3::splat(metres)),
            mesh: LabelledMesh::default(),
            classes: BTreeMap::new(),
            skipped: BTreeMap::new(),
            hidden: BTreeMap::new(),
            moving: 0,
            copies: 0,
            drawn: 0,
        }
    }

    /// Draws all that the stage defines.
    ///
    /// # Errors
    /// Prims that cannot be understood, with their path.
    pub fn all(&mut self) -> Result<()> {
        let root = self.stage.root()?;
        let above = Inherited {
            world: self.base,
            named: None,
            purpose: "default",
            invisible: false,
            depth: 0,
        };
        self.below(&root, above)
    }

    fn below(&mut self, prim: &Composed, above: Inherited<'_>) -> Result<()> {
        for child in self.stage.children(prim)? {
            if child.is_defined() {
                self.draw(&child, above)?;
            }
        }
        Ok(())
    }

    fn draw(&mut self, prim: &Composed, above: Inherited<'_>) -> Result<()> {
        let fail = refusal(self.file, prim);
        self.drawn += 1;
        if above.depth > DEEPEST {
            return Err(fail(format!("lies more than {DEEPEST} prims deep")));
        }
        if self.drawn > MOST_PRIMS || self.mesh.mesh.positions.len() > MOST_POINTS {
            return Err(fail(format!(
                "more than {MOST_PRIMS} prims or {MOST_POINTS} points in all; simplify the model"
            )));
        }
        if prim.metadata("active").is_some_and(Value::is_false) {
            *self.hidden.entry("inactive").or_default() += 1;
            return Ok(());
        }
        let own_name = Some(prim.name()).filter(|n| !is_generic(n));
        let mut here = Inherited {
            world: above.world,
            named: own_name.or(above.named),
            purpose: own_purpose(prim).unwrap_or(above.purpose),
            invisible: above.invisible || is_invisible(prim),
            depth: above.depth + 1,
        };
        if !here.invisible {
            let local = local(prim).map_err(fail)?;
            let parent = if local.resets { self.base } else { above.world };
            here.world = parent * local.matrix;
        }
        let kind = prim.kind();
        let unseen = match (here.invisible, here.purpose) {
            (true, _) => Some("invisible"),
            (_, "guide") => Some("of purpose guide"),
            (_, "proxy") => Some("of purpose proxy"),
            _ => None,
        };
        let is_surface = ["Mesh", "Cube", "PointInstancer"].contains(&kind);
        match unseen {
            Some(reason) if is_surface => *self.hidden.entry(reason).or_default() += 1,
            Some(_) => {}
            None if is_surface || SILENT.contains(&kind) => {
                self.moving += usize::from(prim.is_sampled());
                self.surface(prim, here, kind)?;
            }
            None => *self.skipped.entry(kind.into()).or_default() += 1,
        }
        // prototypes show as copies only
        match kind {
            "PointInstancer" => Ok(()),
            _ => self.below(prim, here),
        }
    }

    fn surface(&mut self, prim: &Composed, here: Inherited<'_>, kind: &str) -> Result<()> {
        let fail = refusal(self.file, prim);
        match kind {
            "Cube" => self.cube(prim, here),
            "Mesh" => self.polygons(prim, here).map_err(fail)?,
            "PointInstancer" => {
                let copies = Copies::read(prim).map_err(fail)?;
                self.copied(prim, &copies, here)?;
            }
            _ => {}
        }
        Ok(())
    }

    fn copied(&mut self, prim: &Composed, copies: &Copies, here: Inherited<'_>) -> Result<()> {
        let fail = refusal(self.file, prim);
        let mut prototypes = Vec::new();
        for path in prim.targets("prototypes") {
            let missing = || fail(format!("prototypes: no prim {path}; export the room again"));
            prototypes.push(self.stage.prim_at(&path)?.ok_or_else(missing)?);
        }
        if let Some(bad) = copies.prototypes.iter().find(|&&i| i >= prototypes.len()) {
            return Err(fail(format!(
                "protoIndices: {bad}, of {} prototypes",
                prototypes.len()
            )));
        }
        for (&prototype, place) in copies.prototypes.iter().zip(&copies.places) {
            let Some(place) = place else {
                *self
                    .hidden
                    .entry("copies left out by their instancer")
                    .or_default() += 1;
                continue;
            };
            self.copies += 1;
            let above = Inherited {
                world: here.world * *place,
                ..here
            };
            self.draw(&prototypes[prototype], above)?;
        }
        Ok(())
    }

    /// The class of a surface, 0 if there are no numbers left.
    fn class(&mut self, prim: &Composed, here: Inherited<'_>) -> u16 {
        let (name, is_light) = class_name(here.named.unwrap_or_else(|| prim.name()));
        if let Some(known) = self.classes.get(&name) {
            return known.id;
        }
        let Ok(id) = u16::try_from(self.classes.len() + 1) else {
            return 0;
        };
        let class = Class {
            id,
            name: name.clone(),
            is_light,
        };
        self.classes.insert(name, class);
        id
    }

    fn cube(&mut self, prim: &Composed, here: Inherited<'_>) {
        let size = prim.value("size").and_then(Value::number).unwrap_or(2.0);
        let corner = |i: u32| {
            let side = |bit: u32| match i >> bit & 1 {
                1 => 0.5 * size,
                _ => -0.5 * size,
            };
            here.world
                .transform_point3(DVec3::new(side(0), side(1), side(2)))
        };
        let class = self.class(prim, here);
        let mirrored = here.world.determinant() < 0.0;
        for side in BOX_SIDES {
            let first = self.mesh.mesh.positions.len() as u32;
            self.mesh.mesh.positions.extend(side.map(corner));
            for t in [[0, 1, 2], [0, 2, 3]] {
                self.triangle(t.map(|i| i + first), mirrored, class);
            }
        }
    }

    fn polygons(&mut self, prim: &Composed, here: Inherited<'_>) -> Reading<()> {
        let points: Vec<DVec3> = triples(&prim.numbers("points"))
            .map(|p| here.world.transform_point3(p))
            .collect();
        let counts = whole_numbers(prim, "faceVertexCounts")?;
        let indices = whole_numbers(prim, "faceVertexIndices")?;
        if let Some(bad) = indices.iter().find(|&&i| i >= points.len()) {
            return Err(format!("a face uses point {bad} of {}", points.len()));
        }
        let class = self.class(prim, here);
        let left_handed = prim.value("orientation").and_then(Value::text) == Some("leftHanded");
        let turned = left_handed != (here.world.determinant() < 0.0);
        let first = self.mesh.mesh.positions.len();
        let mut at = 0usize;
        for count in counts {
            let end = at.checked_add(count).filter(|&e| e <= indices.len());
            let end = end.ok_or("faceVertexCounts: more corners than faceVertexIndices holds")?;
            let face = &indices[at..end];
            at = end;
            let corners: Vec<DVec3> = face.iter().map(|&i| points[i]).collect();
            for t in polygon::triangulate(&corners) {
                self.triangle(t.map(|i| (first + face[i]) as u32), turned, class);
            }
        }
        self.mesh.mesh.positions.extend(points);
        Ok(())
    }

    fn triangle(&mut self, mut corners: [u32; 3], turned: bool, class: u16) {
        if turned {
            corners.swap(1, 2);
        }
        self.mesh.mesh.triangles.push(corners);
        self.mesh.classes.push(class);
    }
}

/// Makes errors that name a prim.
fn refusal<'a>(file: &'a Path, prim: &'a Composed) -> impl Fn(String) -> Error + use<'a> {
    move |m| Error::input(file, format!("prim {}: {m}", prim.path))
}

/// What a point instancer copies and where to.
struct Copies {
    /// Which prototype, by copy.
    prototypes: Vec<usize>,
    /// Prototype to instancer, by copy; `None` where the instancer leaves it out.
    places: Vec<Option<DMat4>>,
}

impl Copies {
    fn read(prim: &Composed) -> Reading<Self> {
        let prototypes = whole_numbers(prim, "protoIndices")?;
        let count = prototypes.len();
        let list = |name: &str, each: usize| {
            let numbers = prim.numbers(name);
            match numbers.len() {
                0 => Ok(None),
                n if n == each * count => Ok(Some(numbers)),
                n => Err(format!(
                    "{name}: {n} numbers, expected {each} for each of {count} copies"
                )),
            }
        };
        let positions = list("positions", 3)?;
        let scales = list("scales", 3)?;
        let turns = match list("orientationsf", 4)? {
            None => list("orientations", 4)?,
            some => some,
        };
        let ids = list("ids", 1)?;
        let unseen = unseen_ids(prim);
        let triple = |list: &Option<Vec<f64>>, i: usize, otherwise: DVec3| {
            let list = list.as_deref().unwrap_or_default();
            triples(&list[(3 * i).min(list.len())..])
                .next()
                .unwrap_or(otherwise)
        };
        let place = |i: usize| {
            let id = ids.as_ref().map_or(i as f64, |ids| ids[i]);
            if unseen.contains(&(id as i64)) {
                return Ok(None);
            }
            let turn = match &turns {
                None => Some(glam::DQuat::IDENTITY),
                Some(turns) => quaternion(&turns[4 * i..4 * i + 4]),
            };
            let turn = turn.ok_or_else(|| format!("orientations: copy {i} has none"))?;
            Ok(Some(DMat4::from_scale_rotation_translation(
                triple(&scales, i, DVec3::ONE),
                turn,
                triple(&positions, i, DVec3::ZERO),
            )))
        };
        Ok(Self {
            places: (0..count).map(place).collect::<Reading<_>>()?,
            prototypes,
        })
    }
}

/// Copies that are invisible or inactive.
fn unseen_ids(prim: &Composed) -> BTreeSet<i64> {
    let mut ids = prim.numbers("invisibleIds");
    for value in prim.metadata("inactiveIds").into_iter() {
        (value.edits().applied_to(Vec::new()).iter()).for_each(|v| v.numbers(&mut ids));
    }
    ids.into_iter().map(|id| id as i64).collect()
}

fn triples(numbers: &[f64]) -> impl Iterator<Item = DVec3> {
    let whole = numbers.as_chunks::<3>().0;
    whole.iter().map(|p| DVec3::from_array(*p))
}

fn whole_numbers(prim: &Composed, name: &str) -> Reading<Vec<usize>> {
    let whole = |n: &f64| (*n >= 0.0 && n.fract() == 0.0).then_some(*n as usize);
    let list: Option<Vec<usize>> = prim.numbers(name).iter().map(whole).collect();
    list.ok_or_else(|| format!("{name}: expected whole numbers"))
}

fn own_purpose(prim: &Composed) -> Option<&str> {
    prim.value("purpose").and_then(Value::text)
}

fn is_invisible(prim: &Composed) -> bool {
    prim.value("visibility").and_then(Value::text) == Some("invisible")
}

/// Letters before the first other character, which numbers or parts follow.
fn stem(name: &str) -> &str {
    let end = name.find(|c: char| !c.is_alphabetic());
    &name[..end.unwrap_or(name.len())]
}

fn is_generic(name: &str) -> bool {
    GENERIC.contains(&stem(name).to_lowercase().as_str())
}

/// The class that a name stands for, and whether it emits light: all of a lamp's name (its last word
/// says so), the first word of another.
fn class_name(name: &str) -> (String, bool) {
    let tail = |c: char| c.is_ascii_digit() || c == '_';
    let whole = name.trim_end_matches(tail);
    let is_light = is_lamp(whole);
    let shown = match stem(name) {
        first if is_light || is_lamp(first) => whole.trim_start_matches('_'),
        "" => "object",
        first => first,
    };
    (shown.to_lowercase(), is_light)
}
