//! What the reader makes of stages of USD, against areas and places in closed form.

use super::account::Account;
use super::capture::{Capture, Surface};
use super::importer::{Importer, PrepareOptions};
use super::roomplan::RoomPlan;
use glam::DVec3;
use std::path::Path;

/// Area and bounds of `composed` by usd-core (`scripts/make_usd_files.py`, usd-core 26.11).
const COMPOSED_AREA: f64 = 49.134962113;
const COMPOSED_BOUNDS: [[f64; 3]; 2] = [[-2.0, 0.0, 0.0], [20.0, 5.107305089, 8.421746634]];

/// What a stage became.
struct Drawn {
    capture: Capture,
    notes: String,
}

impl Drawn {
    fn corners(&self) -> Vec<[DVec3; 3]> {
        let Some(Surface::Built(m)) = &self.capture.surface else {
            panic!("a surface")
        };
        let place = |i: u32| m.mesh.positions[i as usize];
        m.mesh.triangles.iter().map(|t| t.map(place)).collect()
    }

    fn area(&self) -> f64 {
        let doubled = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).length();
        self.corners().into_iter().map(doubled).sum::<f64>() * 0.5
    }

    /// Least and greatest corner.
    fn bounds(&self) -> [DVec3; 2] {
        let all = || self.corners().into_iter().flatten();
        [
            all().fold(DVec3::INFINITY, DVec3::min),
            all().fold(DVec3::NEG_INFINITY, DVec3::max),
        ]
    }

    fn assert_bounds(&self, least: [f64; 3], greatest: [f64; 3]) {
        for (found, wanted) in self.bounds().into_iter().zip([least, greatest]) {
            let wanted = DVec3::from_array(wanted);
            assert!((found - wanted).length() < 1e-9, "{found}, not {wanted}");
        }
    }

    fn assert_area(&self, wanted: f64) {
        let found = self.area();
        assert!((found - wanted).abs() < 1e-9, "{found} m², not {wanted}");
    }
}

fn read(file: &Path) -> Result<Drawn, String> {
    let mut account = Account::default();
    let capture = RoomPlan
        .import(file, &PrepareOptions::default(), &mut account)
        .map_err(|e| e.to_string())?;
    Ok(Drawn {
        capture,
        notes: account.lines().join("\n"),
    })
}

/// Reads `room`, beside it the layers in `others`, all in metres; `SQUARE` stands for a square metre
/// in the xy plane, `LARGE` for one of 2 m × 2 m.
fn stage_with(room: &str, others: &[(&str, &str)]) -> Result<Drawn, String> {
    let dir = tempfile::tempdir().expect("folder");
    let quad = |side: u32| {
        format!(
            "int[] faceVertexCounts = [4]\n int[] faceVertexIndices = [0, 1, 2, 3]\n point3f[] points = [(0, 0, 0), ({side}, 0, 0), ({side}, {side}, 0), (0, {side}, 0)]"
        )
    };
    for (name, text) in [("Room.usda", room)]
        .into_iter()
        .chain(others.iter().copied())
    {
        let text = text.replace("SQUARE", &quad(1)).replace("LARGE", &quad(2));
        let head = match text.starts_with('(') {
            true => "#usda 1.0\n",
            false => "#usda 1.0\n(\n metersPerUnit = 1\n)\n",
        };
        std::fs::write(dir.path().join(name), format!("{head}{text}")).expect("file");
    }
    read(&dir.path().join("Room.usda"))
}

fn stage(room: &str) -> Drawn {
    stage_with(room, &[]).expect("readable")
}

#[test]
fn concave_faces_keep_their_area() {
    // an L of 3 × 1 and 1 × 3, begun where a fan leaves it
    let drawn = stage(
        "def Mesh \"Floor0\" { int[] faceVertexCounts = [6]\n int[] faceVertexIndices = [0, 1, 2, 3, 4, 5]\n point3f[] points = [(3, 1, 0), (1, 1, 0), (1, 4, 0), (0, 4, 0), (0, 0, 0), (3, 0, 0)] }",
    );
    drawn.assert_area(6.0);
}

#[test]
fn references_may_stay_within_the_layer() {
    let drawn = stage(
        "def Xform \"Room\" {
  def \"a\" ( prepend references = </Room/prototypes/Lamp_0> ) {
    double3 xformOp:translate = (5, 0, 0)
    uniform token[] xformOpOrder = [\"xformOp:translate\"]
  }
  class \"prototypes\" { def Xform \"Lamp_0\" { def Mesh \"Lamp\" { SQUARE } } }
}",
    );
    drawn.assert_area(1.0);
    drawn.assert_bounds([5.0, 0.0, 0.0], [6.0, 1.0, 0.0]);
}

#[test]
fn references_and_payloads_may_name_a_prim() {
    let library = "(\n defaultPrim = \"A\"\n)\ndef Xform \"A\" { def Mesh \"g\" { SQUARE } }\ndef Xform \"B\" { def Mesh \"g\" { LARGE } }";
    for kind in ["references", "payload"] {
        for (target, area) in [("@lib.usda@", 1.0), ("@./lib.usda@</B>", 4.0)] {
            let room = format!("def \"Chair\" ( {kind} = {target} ) {{}}");
            let drawn = stage_with(&room, &[("lib.usda", library)]).expect("readable");
            drawn.assert_area(area);
        }
    }
    let missing = stage_with(
        "def \"Chair\" ( references = @lib.usda@</C> ) {}",
        &[("lib.usda", library)],
    );
    let message = missing.err().expect("refused");
    assert!(message.contains("lib.usda has no prim /C"), "{message}");
}

#[test]
fn classes_are_inherited_and_not_drawn_themselves() {
    let drawn = stage(
        "class \"_chair\" { def Mesh \"Chair0\" { SQUARE } }
def Xform \"c\" ( prepend inherits = [</_chair>, </_missing>] ) {}
def Xform \"d\" ( specializes = </_chair> ) {}
over \"Room\" { def Mesh \"never\" { LARGE } }",
    );
    drawn.assert_area(2.0);
}

#[test]
fn circles_are_refused() {
    let rooms = [
        "def \"a\" ( references = </b> ) {}\ndef \"b\" ( references = </a> ) {}",
        "def \"a\" { def \"b\" ( references = </a> ) {} }",
        "def \"a\" ( inherits = </a> ) {}",
    ];
    for room in rooms {
        let message = stage_with(room, &[]).err().expect("refused");
        assert!(message.contains("in a circle"), "{message}");
    }
    let sublayer = "(\n subLayers = [@Room.usda@]\n)\n";
    let room = "(\n subLayers = [@s.usda@]\n)\n";
    let message = stage_with(room, &[("s.usda", sublayer)])
        .err()
        .expect("refused");
    assert!(message.contains("in a circle"), "{message}");
}

#[test]
fn the_referencing_prim_has_the_last_word() {
    let chair = "(\n defaultPrim = \"Chair\"\n)\ndef Xform \"Chair\" {
  double3 xformOp:translate = (5, 0, 0)
  uniform token[] xformOpOrder = [\"xformOp:translate\"]
  def Mesh \"geo\" { LARGE }
  def Mesh \"legs\" { SQUARE }
}";
    let drawn = stage_with(
        "def Xform \"Chair_0\" ( references = @chair.usda@ ) {
  double3 xformOp:translate = (1, 0, 1)
  over \"geo\" { SQUARE }
  over \"legs\" ( active = false ) {}
}",
        &[("chair.usda", chair)],
    )
    .expect("readable");
    drawn.assert_area(1.0);
    drawn.assert_bounds([1.0, 0.0, 1.0], [2.0, 1.0, 1.0]);
}

#[test]
fn what_is_not_to_be_seen_is_left_out_and_counted() {
    let drawn = stage(
        "def Mesh \"Wall0\" { SQUARE }
def Xform \"gone\" { token visibility = \"invisible\"
  def Mesh \"a\" { LARGE }
  def Mesh \"b\" { LARGE }
}
def Xform \"off\" ( active = false ) { def Mesh \"a\" { LARGE } }
def Xform \"hull\" { uniform token purpose = \"guide\"
  def Mesh \"a\" { LARGE }
  def Mesh \"shown\" { SQUARE\n uniform token purpose = \"render\" }
}
def Mesh \"rough\" { LARGE\n uniform token purpose = \"proxy\" }",
    );
    drawn.assert_area(2.0);
    for note in [
        "2 prims that are invisible",
        "1 prims that are inactive",
        "1 prims that are of purpose guide",
        "1 prims that are of purpose proxy",
    ] {
        assert!(drawn.notes.contains(note), "{note} in {}", drawn.notes);
    }
    let nothing = stage_with(
        "def Mesh \"Wall0\" { SQUARE\n token visibility = \"invisible\" }",
        &[],
    );
    let message = nothing.err().expect("refused");
    assert!(message.contains("export them visible"), "{message}");
}

#[test]
fn point_instancers_copy_their_prototypes() {
    let instancer = "def PointInstancer \"Chairs\" {
  point3f[] positions = [(0, 0, 0), (10, 0, 0), (20, 0, 0), (30, 0, 0)]
  float3[] scales = [(1, 1, 1), (3, 1, 1), (1, 1, 1), (1, 1, 1)]
  quath[] orientations = [(1, 0, 0, 0), (1, 0, 0, 0), (0, 0, 0, 1), (1, 0, 0, 0)]
  int[] protoIndices = [1, 0, 0, 0]
  int64[] ids = [7, 8, 9, 10]
  int64[] invisibleIds = [10]
  rel prototypes = [<PATH/protos/Chair>, <PATH/protos/Large>]
  def \"protos\" {
    def Xform \"Chair\" { double3 xformOp:translate = (0, 1, 0)\n uniform token[] xformOpOrder = [\"xformOp:translate\"]
      def Mesh \"g\" { SQUARE }
    }
    def Mesh \"Large\" { LARGE }
  }
}";
    let own = instancer.replace("PATH", "/Chairs");
    let library = format!(
        "def Xform \"Lib\" {{\n{}\n}}",
        instancer.replace("PATH", "/Lib/Chairs")
    );
    // the paths of a relationship move with what is referred to
    let referring = "def Xform \"Room\" ( references = @lib.usda@ ) {}";
    let both = [
        stage(&own),
        stage_with(referring, &[("lib.usda", &library)]).expect("readable"),
    ];
    for drawn in both {
        drawn.assert_area(4.0 + 3.0 + 1.0);
        // half a turn about z at x = 20, above the origin by 1 before it
        drawn.assert_bounds([0.0, -2.0, 0.0], [20.0, 2.0, 0.0]);
        let notes = &drawn.notes;
        assert!(notes.contains("3 copies by point instancers"), "{notes}");
        assert!(
            notes.contains("1 prims that are copies left out"),
            "{notes}"
        );
    }
    let message = stage_with(&own.replace("[1, 0, 0, 0]", "[1, 0, 0, 2]"), &[])
        .err()
        .expect("refused");
    assert!(message.contains("protoIndices: 2, of 2"), "{message}");
    let message = stage_with(&own.replace("(30, 0, 0)]", "]"), &[])
        .err()
        .expect("refused");
    assert!(message.contains("positions: 9 numbers"), "{message}");
}

#[test]
fn a_transform_may_drop_its_parents() {
    let drawn = stage(
        "def Xform \"Room\" { double3 xformOp:translate = (10, 0, 0)\n uniform token[] xformOpOrder = [\"xformOp:translate\"]
  def Mesh \"Chair0\" { SQUARE\n double3 xformOp:translate = (0, 0, 2)\n uniform token[] xformOpOrder = [\"!resetXformStack!\", \"xformOp:translate\"] }
}",
    );
    drawn.assert_bounds([0.0, 0.0, 2.0], [1.0, 1.0, 2.0]);
}

#[test]
fn transforms_turn_about_pivots() {
    // about (1, 0, 0) by 90°: x from −1..0 before the turn comes to lie along y
    let drawn = stage(
        "def Mesh \"Chair0\" { SQUARE
  double3 xformOp:translate:pivot = (1, 0, 0)
  float xformOp:rotateZ = 90
  uniform token[] xformOpOrder = [\"xformOp:translate:pivot\", \"xformOp:rotateZ\", \"!invert!xformOp:translate:pivot\"] }",
    );
    drawn.assert_bounds([0.0, -1.0, 0.0], [1.0, 0.0, 0.0]);
    let flat = stage_with(
        "def Mesh \"Chair0\" { SQUARE\n float3 xformOp:scale = (1, 0, 1)\n uniform token[] xformOpOrder = [\"!invert!xformOp:scale\"] }",
        &[],
    );
    let message = flat.err().expect("refused");
    assert!(message.contains("nothing undoes it"), "{message}");
}

/// 90° about x, then y, then z bring the point (0, 0, 1) to different places by their order.
#[test]
fn rotations_have_six_orders() {
    for (order, place) in [
        // x: (0,-1,0), y: the same, z: (1,0,0)
        ("XYZ", [1.0, 0.0, 0.0]),
        // x: (0,-1,0), z: (1,0,0), y: (0,0,-1)
        ("XZY", [0.0, 0.0, -1.0]),
        // y: (1,0,0), x: the same, z: (0,1,0)
        ("YXZ", [0.0, 1.0, 0.0]),
        // y: (1,0,0), z: (0,1,0), x: (0,0,1)
        ("YZX", [0.0, 0.0, 1.0]),
        // z: the same, x: (0,-1,0), y: the same
        ("ZXY", [0.0, -1.0, 0.0]),
        // z: the same, y: (1,0,0), x: the same
        ("ZYX", [1.0, 0.0, 0.0]),
    ] {
        let drawn = stage(&format!(
            "def Mesh \"Chair0\" {{ int[] faceVertexCounts = [3]\n int[] faceVertexIndices = [0, 1, 2]\n point3f[] points = [(0, 0, 1), (0, 0, 0), (0, 0, 0)]
  float3 xformOp:rotate{order} = (90, 90, 90)\n uniform token[] xformOpOrder = [\"xformOp:rotate{order}\"] }}"
        ));
        let found = drawn.corners()[0][0];
        let wanted = DVec3::from_array(place);
        assert!((found - wanted).length() < 1e-9, "{order}: {found}");
    }
}

#[test]
fn mirrored_and_left_handed_faces_keep_their_outside() {
    let faces = |more: &str| {
        let drawn = stage(&format!("def Mesh \"Wall0\" {{ SQUARE\n {more} }}"));
        let [a, b, c] = drawn.corners()[0];
        (b - a).cross(c - a).normalize()
    };
    let mirror =
        "float3 xformOp:scale = (-1, 1, 1)\n uniform token[] xformOpOrder = [\"xformOp:scale\"]";
    let left = "uniform token orientation = \"leftHanded\"";
    assert_eq!(faces(""), DVec3::Z);
    assert_eq!(faces(mirror), DVec3::Z);
    assert_eq!(faces(left), -DVec3::Z);
}

#[test]
fn the_selected_variant_is_drawn() {
    let sofa = |selected: &str| {
        format!(
            "def Xform \"Sofa\" ( variants = {{ string m = \"{selected}\" }}\n prepend variantSets = \"m\" ) {{
  variantSet \"m\" = {{
    \"small\" {{ def Mesh \"g\" {{ SQUARE }} }}
    \"large\" ( references = </Library> ) {{ double3 xformOp:translate = (7, 0, 0)\n uniform token[] xformOpOrder = [\"xformOp:translate\"] }}
  }}
}}
class \"Library\" {{ def Mesh \"h\" {{ LARGE }} }}"
        )
    };
    stage(&sofa("small")).assert_area(1.0);
    let large = stage(&sofa("large"));
    large.assert_area(4.0);
    large.assert_bounds([7.0, 0.0, 0.0], [9.0, 2.0, 0.0]);
    // who refers to it may choose otherwise
    let chosen = stage_with(
        "def \"s\" ( references = @lib.usda@</Sofa>\n variants = { string m = \"large\" } ) {}",
        &[("lib.usda", &sofa("small"))],
    );
    chosen.expect("readable").assert_area(4.0);
}

#[test]
fn sublayers_are_weaker_than_what_lists_them() {
    let drawn = stage_with(
        "(\n metersPerUnit = 1\n subLayers = [@first.usda@, @second.usda@ (offset = 1)]\n)\nover \"Room\" { over \"a\" { SQUARE } }",
        &[
            ("first.usda", "def Xform \"Room\" { def Mesh \"a\" { LARGE }\n def Mesh \"b\" { SQUARE } }"),
            ("second.usda", "def Xform \"Room\" { def Mesh \"b\" { LARGE }\n def Mesh \"c\" { LARGE } }"),
        ],
    )
    .expect("readable");
    drawn.assert_area(1.0 + 1.0 + 4.0);
}

#[test]
fn the_first_sample_in_time_is_taken() {
    let drawn = stage(
        "def Xform \"Sofa\" { double3 xformOp:translate.timeSamples = { 10: (2, 0, 0), 9: (1, 0, 0), }\n uniform token[] xformOpOrder = [\"xformOp:translate\"]
  def Mesh \"g\" { LARGE\n point3f[] points.timeSamples = { 1: [(0, 0, 0), (3, 0, 0), (3, 3, 0), (0, 3, 0)] } }
}",
    );
    drawn.assert_area(9.0);
    drawn.assert_bounds([1.0, 0.0, 0.0], [4.0, 3.0, 0.0]);
    let notes = &drawn.notes;
    assert!(notes.contains("2 prims that change in time"), "{notes}");
}

#[test]
fn names_say_what_is_a_lamp() {
    let drawn = stage(
        "def Mesh \"Wall3\" { SQUARE }
def Mesh \"Ceiling_Lamp_01\" { SQUARE }
def Xform \"Lamp_0\" { def Mesh \"Cube_003\" { SQUARE } }
def Mesh \"Light_Oak_Table\" { SQUARE }
def Mesh \"DeskLamp2\" { SQUARE }
def SphereLight \"Bulb\" { float inputs:intensity = 3 }",
    );
    let classes: Vec<(&str, bool)> = (drawn.capture.classes.iter())
        .map(|c| (c.name.as_str(), c.is_light))
        .collect();
    assert_eq!(
        classes,
        [
            ("wall", false),
            ("ceiling_lamp", true),
            ("lamp", true),
            ("light_oak_table", false),
            ("desklamp", true),
        ]
    );
    let notes = &drawn.notes;
    assert!(notes.contains("1 prims of type SphereLight"), "{notes}");
}

#[test]
fn references_that_double_at_every_step_end() {
    let mut room = String::from("def Mesh \"p0\" { SQUARE }\n");
    for i in 1..30 {
        let below = i - 1;
        room += &format!("def \"p{i}\" ( references = [</p{below}>, </p{below}>] ) {{}}\n");
    }
    let message = stage_with(&room, &[]).err().expect("refused");
    assert!(message.contains("simplify the model"), "{message}");
}

#[test]
fn composition_is_the_same_in_binary() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/files/usd");
    for form in ["usda", "usdc"] {
        let drawn = read(&folder.join(format!("composed.{form}"))).expect(form);
        let found = drawn.area();
        assert!((found - COMPOSED_AREA).abs() < 1e-5, "{form}: {found} m²");
        for (found, wanted) in drawn.bounds().into_iter().zip(COMPOSED_BOUNDS) {
            let wanted = DVec3::from_array(wanted);
            assert!((found - wanted).length() < 1e-5, "{form}: {found}");
        }
        for note in [
            "20 copies by",
            "1 prims that are invisible",
            "1 prims that change in time",
        ] {
            assert!(
                drawn.notes.contains(note),
                "{form}: {note} in {}",
                drawn.notes
            );
        }
    }
}

/// Every third byte of a layer changed in turn: whatever comes out, nothing panics or takes long.
#[test]
fn damaged_layers_are_survived_as_a_whole() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/files/usd");
    for (form, changes) in [("usda", &b"<({\"0-"[..]), ("usdc", &[0x01, 0x80, 0xff])] {
        let dir = tempfile::tempdir().expect("folder");
        let below = format!("below.{form}");
        std::fs::copy(folder.join(&below), dir.path().join(&below)).expect("copied");
        let whole = std::fs::read(folder.join(format!("composed.{form}"))).expect("file");
        let file = dir.path().join(format!("composed.{form}"));
        for at in (0..whole.len()).step_by(3) {
            let mut damaged = whole.clone();
            let change = changes[at / 3 % changes.len()];
            damaged[at] = match form {
                "usda" => change,
                _ => damaged[at] ^ change,
            };
            std::fs::write(&file, damaged).expect("written");
            let _ = read(&file);
        }
    }
}
