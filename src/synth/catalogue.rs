//! The classes and materials of an apartment.
//!
//! Roughness belongs to a class (and room), as the method assumes; colours vary between instances
//! and rooms. Albedos stay below
//! 0.85 because the paper's model adds its specular lobe on top.

use super::pattern::{Paint, Pattern};
use crate::sampling::KeyedRng;
use glam::Vec3;

macro_rules! classes {
    ($($id:literal $name:ident $text:literal $kind:literal;)*) => {
        $(#[doc = concat!("Class \"", $text, "\".")] pub const $name: u16 = $id;)*
        /// All classes: id, name, whether it emits.
        pub const CLASSES: &[(u16, &str, bool)] = &[$(($id, $text, $kind)),*];
    };
}

classes! {
    1 WALL "wall" false;
    2 CEILING "ceiling" false;
    3 PARQUET "parquet" false;
    4 TILED_FLOOR "tiled floor" false;
    5 SKIRTING "skirting" false;
    6 DOOR_FRAME "door frame" false;
    7 WINDOW_FRAME "window frame" false;
    8 TABLE "table" false;
    9 CHAIR "chair" false;
    10 SOFA "sofa" false;
    11 CUSHION "cushion" false;
    12 BED_FRAME "bed frame" false;
    13 BEDDING "bedding" false;
    14 PILLOW "pillow" false;
    15 SHELF "shelf" false;
    16 BOOK "book" false;
    17 VASE "vase" false;
    18 BOWL "bowl" false;
    19 CABINET "cabinet" false;
    20 WORKTOP "worktop" false;
    21 PICTURE "picture" false;
    22 PICTURE_FRAME "picture frame" false;
    23 RUG "rug" false;
    24 PLANT_POT "plant pot" false;
    25 PLANT "plant" false;
    26 ORNAMENT "ornament" false;
    27 LAMP_STAND "lamp stand" false;
    28 SPLASHBACK "splashback" false;
    29 FRUIT "fruit" false;
    30 LAMP "lamp" true;
}

/// The paint of a class in a room: its colours drawn from `rng`.
#[must_use]
pub fn paint(class: u16, rng: &mut KeyedRng) -> Paint {
    let mut tint = |rgb: [f32; 3], spread: f32| {
        let base = Vec3::from_array(rgb);
        let shift = Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32()) - Vec3::splat(0.5);
        (base * (Vec3::ONE + 2.0 * spread * shift)).clamp(Vec3::splat(0.03), Vec3::splat(0.82))
    };
    let wood = Pattern::Wood { board: 0.13 };
    let (pattern, a, b, roughness) = match class {
        WALL => (
            Pattern::Plain,
            tint([0.66, 0.62, 0.55], 0.12),
            Vec3::ZERO,
            0.75,
        ),
        CEILING => (
            Pattern::Plain,
            tint([0.78, 0.78, 0.76], 0.02),
            Vec3::ZERO,
            0.85,
        ),
        PARQUET => (
            Pattern::Wood { board: 0.11 },
            tint([0.42, 0.25, 0.13], 0.15),
            tint([0.2, 0.1, 0.045], 0.1),
            0.28,
        ),
        TILED_FLOOR => {
            let grout = Pattern::Tiles {
                edge: 0.33,
                grout_roughness: 0.85,
            };
            (
                grout,
                tint([0.5, 0.49, 0.45], 0.1),
                tint([0.24, 0.23, 0.22], 0.05),
                0.14,
            )
        }
        SKIRTING => (
            Pattern::Plain,
            tint([0.74, 0.73, 0.7], 0.03),
            Vec3::ZERO,
            0.35,
        ),
        DOOR_FRAME => (
            Pattern::Plain,
            tint([0.7, 0.68, 0.63], 0.05),
            Vec3::ZERO,
            0.3,
        ),
        WINDOW_FRAME => (
            Pattern::Plain,
            tint([0.76, 0.76, 0.75], 0.03),
            Vec3::ZERO,
            0.25,
        ),
        TABLE => (
            wood,
            tint([0.45, 0.24, 0.11], 0.2),
            tint([0.2, 0.09, 0.04], 0.2),
            0.22,
        ),
        CHAIR => (
            wood,
            tint([0.52, 0.33, 0.17], 0.2),
            tint([0.3, 0.16, 0.07], 0.2),
            0.4,
        ),
        SOFA => (
            Pattern::Fabric,
            tint([0.2, 0.3, 0.38], 0.5),
            tint([0.34, 0.42, 0.48], 0.3),
            0.9,
        ),
        CUSHION => (
            Pattern::Stripes { width: 0.05 },
            tint([0.68, 0.5, 0.2], 0.5),
            tint([0.72, 0.68, 0.6], 0.1),
            0.85,
        ),
        BED_FRAME => (
            wood,
            tint([0.33, 0.2, 0.11], 0.2),
            tint([0.16, 0.08, 0.04], 0.2),
            0.33,
        ),
        BEDDING => (
            Pattern::Checks { edge: 0.12 },
            tint([0.62, 0.62, 0.66], 0.1),
            tint([0.25, 0.34, 0.52], 0.4),
            0.88,
        ),
        PILLOW => (
            Pattern::Fabric,
            tint([0.7, 0.69, 0.66], 0.05),
            tint([0.6, 0.58, 0.54], 0.05),
            0.86,
        ),
        SHELF => (
            wood,
            tint([0.56, 0.42, 0.26], 0.15),
            tint([0.38, 0.26, 0.14], 0.15),
            0.45,
        ),
        BOOK => (Pattern::Assorted, Vec3::splat(0.75), Vec3::splat(0.6), 0.55),
        VASE => (
            Pattern::Stripes { width: 0.06 },
            tint([0.15, 0.33, 0.42], 0.5),
            tint([0.6, 0.58, 0.5], 0.2),
            0.1,
        ),
        BOWL => (
            Pattern::Plain,
            tint([0.55, 0.2, 0.12], 0.5),
            Vec3::ZERO,
            0.12,
        ),
        CABINET => (
            Pattern::Plain,
            tint([0.38, 0.46, 0.44], 0.4),
            Vec3::ZERO,
            0.2,
        ),
        WORKTOP => (
            Pattern::Fabric,
            tint([0.16, 0.16, 0.17], 0.2),
            tint([0.3, 0.3, 0.3], 0.2),
            0.11,
        ),
        PICTURE => (Pattern::Picture, Vec3::ZERO, Vec3::ZERO, 0.5),
        PICTURE_FRAME => (
            Pattern::Plain,
            tint([0.1, 0.08, 0.06], 0.3),
            Vec3::ZERO,
            0.18,
        ),
        RUG => (
            Pattern::Rug,
            tint([0.5, 0.16, 0.13], 0.5),
            tint([0.18, 0.14, 0.26], 0.4),
            0.9,
        ),
        PLANT_POT => (
            Pattern::Plain,
            tint([0.5, 0.24, 0.14], 0.2),
            Vec3::ZERO,
            0.6,
        ),
        PLANT => (
            Pattern::Fabric,
            tint([0.1, 0.24, 0.06], 0.2),
            tint([0.2, 0.36, 0.1], 0.2),
            0.5,
        ),
        ORNAMENT => (
            Pattern::Plain,
            tint([0.6, 0.55, 0.3], 0.5),
            Vec3::ZERO,
            0.08,
        ),
        LAMP_STAND => (
            Pattern::Plain,
            tint([0.14, 0.14, 0.15], 0.2),
            Vec3::ZERO,
            0.16,
        ),
        SPLASHBACK => {
            let grout = Pattern::Tiles {
                edge: 0.15,
                grout_roughness: 0.8,
            };
            (
                grout,
                tint([0.6, 0.66, 0.64], 0.2),
                tint([0.4, 0.4, 0.39], 0.05),
                0.09,
            )
        }
        FRUIT => (
            Pattern::Assorted,
            Vec3::new(0.8, 0.5, 0.15),
            Vec3::new(0.7, 0.2, 0.1),
            0.3,
        ),
        _ => (Pattern::Plain, Vec3::splat(0.78), Vec3::ZERO, 0.6),
    };
    Paint {
        pattern,
        colours: [a, b],
        roughness,
    }
}
