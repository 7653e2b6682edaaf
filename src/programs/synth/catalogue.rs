//! The classes and materials of an apartment.
//!
//! Roughness belongs to a class (and room), as the method assumes; colours vary between instances
//! and rooms. Albedos stay below
//! 0.85 because the paper's model adds its specular lobe on top; metals, which have no other, are as
//! bright as published.

use super::pattern::{Paint, Pattern};
use crate::core::sampling::KeyedRng;
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
    31 TAP "tap" false;
    32 HOOD "hood" false;
    33 MIRROR "mirror" false;
    34 HANDLE "handle" false;
    35 PLANTER "planter" false;
    36 TABLE_TOP "table top" false;
    37 GLASS_DOOR "glass door" false;
    38 GLASS_SCREEN "glass screen" false;
}

/// Classes of metal: only apartments with fittings have them.
pub const METALS: [u16; 6] = [TAP, HOOD, MIRROR, HANDLE, PLANTER, TABLE_TOP];

/// The share of metal of a class.
#[must_use]
pub fn metallic(class: u16) -> f32 {
    f32::from(METALS.contains(&class))
}

/// Classes of glass: only apartments with panes have them.
pub const PANES: [u16; 2] = [GLASS_DOOR, GLASS_SCREEN];

/// The share of light that a class lets straight through.
#[must_use]
pub fn transmission(class: u16) -> f32 {
    f32::from(PANES.contains(&class))
}

/// What metals reflect at normal incidence. Iron and steel: Hoffman 2010 ("Background:
/// Physically-Based Shading", table 1). Brass: Akenine-Möller et al. 2018 ("Real-Time Rendering",
/// table 9.2). Silver behind glass: its 0.95 through two passages of about 2.5 % each, made neutral.
const STEEL: Tint = fixed([0.56, 0.57, 0.58]);
const BRASS: Tint = fixed([0.91, 0.78, 0.42]);
const SILVERED_GLASS: Tint = fixed([0.9; 3]);

/// Tint of clear glass. Cited: about 0.90 of the light goes through 4 mm of float glass (SCI Windows,
/// sciwindows.co.uk/glass). Derived: the first face's 0.96 is the specular lobe's, 0.94 are left.
const CLEAR_GLASS: Tint = fixed([0.94; 3]);

/// A colour of a recipe: linear reflectance and how far a room's own may lie from it.
#[derive(Clone, Copy)]
struct Tint {
    rgb: [f32; 3],
    /// Largest relative difference per channel; absent where every room has the same colour.
    spread: Option<f32>,
}

impl Tint {
    /// The colour of one room: draws three numbers if it varies, none otherwise.
    fn draw(self, rng: &mut KeyedRng) -> Vec3 {
        let base = Vec3::from_array(self.rgb);
        let Some(spread) = self.spread else {
            return base;
        };
        let shift = Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32()) - Vec3::splat(0.5);
        (base * (Vec3::ONE + 2.0 * spread * shift)).clamp(Vec3::splat(0.03), Vec3::splat(0.82))
    }
}

const fn varied(rgb: [f32; 3], spread: f32) -> Tint {
    Tint {
        rgb,
        spread: Some(spread),
    }
}

const fn fixed(rgb: [f32; 3]) -> Tint {
    Tint { rgb, spread: None }
}

/// What the paints of a class have in common.
struct Recipe {
    class: u16,
    pattern: Pattern,
    /// First and second colour.
    colours: [Tint; 2],
    /// Roughness R.
    roughness: f32,
}

/// The second colour of patterns that have but one.
const NONE: Tint = fixed([0.0; 3]);
const WOOD: Pattern = Pattern::Wood { board: 0.13 };

/// Metal or glass of one colour.
const fn polished(class: u16, colour: Tint, roughness: f32) -> Recipe {
    Recipe {
        class,
        pattern: Pattern::Polished,
        colours: [colour, NONE],
        roughness,
    }
}

/// The recipes of all classes.
const RECIPES: &[Recipe] = &[
    Recipe {
        class: WALL,
        pattern: Pattern::Plain,
        colours: [varied([0.66, 0.62, 0.55], 0.12), NONE],
        roughness: 0.75,
    },
    Recipe {
        class: CEILING,
        pattern: Pattern::Plain,
        colours: [varied([0.78, 0.78, 0.76], 0.02), NONE],
        roughness: 0.85,
    },
    Recipe {
        class: PARQUET,
        pattern: Pattern::Wood { board: 0.11 },
        colours: [
            varied([0.42, 0.25, 0.13], 0.15),
            varied([0.2, 0.1, 0.045], 0.1),
        ],
        roughness: 0.28,
    },
    Recipe {
        class: TILED_FLOOR,
        pattern: Pattern::Tiles {
            edge: 0.33,
            grout_roughness: 0.85,
        },
        colours: [
            varied([0.5, 0.49, 0.45], 0.1),
            varied([0.24, 0.23, 0.22], 0.05),
        ],
        roughness: 0.14,
    },
    Recipe {
        class: SKIRTING,
        pattern: Pattern::Plain,
        colours: [varied([0.74, 0.73, 0.7], 0.03), NONE],
        roughness: 0.35,
    },
    Recipe {
        class: DOOR_FRAME,
        pattern: Pattern::Plain,
        colours: [varied([0.7, 0.68, 0.63], 0.05), NONE],
        roughness: 0.3,
    },
    Recipe {
        class: WINDOW_FRAME,
        pattern: Pattern::Plain,
        colours: [varied([0.76, 0.76, 0.75], 0.03), NONE],
        roughness: 0.25,
    },
    Recipe {
        class: TABLE,
        pattern: WOOD,
        colours: [
            varied([0.45, 0.24, 0.11], 0.2),
            varied([0.2, 0.09, 0.04], 0.2),
        ],
        roughness: 0.22,
    },
    Recipe {
        class: CHAIR,
        pattern: WOOD,
        colours: [
            varied([0.52, 0.33, 0.17], 0.2),
            varied([0.3, 0.16, 0.07], 0.2),
        ],
        roughness: 0.4,
    },
    Recipe {
        class: SOFA,
        pattern: Pattern::Fabric,
        colours: [
            varied([0.2, 0.3, 0.38], 0.5),
            varied([0.34, 0.42, 0.48], 0.3),
        ],
        roughness: 0.9,
    },
    Recipe {
        class: CUSHION,
        pattern: Pattern::Stripes { width: 0.05 },
        colours: [
            varied([0.68, 0.5, 0.2], 0.5),
            varied([0.72, 0.68, 0.6], 0.1),
        ],
        roughness: 0.85,
    },
    Recipe {
        class: BED_FRAME,
        pattern: WOOD,
        colours: [
            varied([0.33, 0.2, 0.11], 0.2),
            varied([0.16, 0.08, 0.04], 0.2),
        ],
        roughness: 0.33,
    },
    Recipe {
        class: BEDDING,
        pattern: Pattern::Checks { edge: 0.12 },
        colours: [
            varied([0.62, 0.62, 0.66], 0.1),
            varied([0.25, 0.34, 0.52], 0.4),
        ],
        roughness: 0.88,
    },
    Recipe {
        class: PILLOW,
        pattern: Pattern::Fabric,
        colours: [
            varied([0.7, 0.69, 0.66], 0.05),
            varied([0.6, 0.58, 0.54], 0.05),
        ],
        roughness: 0.86,
    },
    Recipe {
        class: SHELF,
        pattern: WOOD,
        colours: [
            varied([0.56, 0.42, 0.26], 0.15),
            varied([0.38, 0.26, 0.14], 0.15),
        ],
        roughness: 0.45,
    },
    Recipe {
        class: BOOK,
        pattern: Pattern::Assorted,
        colours: [fixed([0.75, 0.75, 0.75]), fixed([0.6, 0.6, 0.6])],
        roughness: 0.55,
    },
    Recipe {
        class: VASE,
        pattern: Pattern::Stripes { width: 0.06 },
        colours: [
            varied([0.15, 0.33, 0.42], 0.5),
            varied([0.6, 0.58, 0.5], 0.2),
        ],
        roughness: 0.1,
    },
    Recipe {
        class: BOWL,
        pattern: Pattern::Plain,
        colours: [varied([0.55, 0.2, 0.12], 0.5), NONE],
        roughness: 0.12,
    },
    Recipe {
        class: CABINET,
        pattern: Pattern::Plain,
        colours: [varied([0.38, 0.46, 0.44], 0.4), NONE],
        roughness: 0.2,
    },
    Recipe {
        class: WORKTOP,
        pattern: Pattern::Fabric,
        colours: [
            varied([0.16, 0.16, 0.17], 0.2),
            varied([0.3, 0.3, 0.3], 0.2),
        ],
        roughness: 0.11,
    },
    Recipe {
        class: PICTURE,
        pattern: Pattern::Picture,
        colours: [NONE, NONE],
        roughness: 0.5,
    },
    Recipe {
        class: PICTURE_FRAME,
        pattern: Pattern::Plain,
        colours: [varied([0.1, 0.08, 0.06], 0.3), NONE],
        roughness: 0.18,
    },
    Recipe {
        class: RUG,
        pattern: Pattern::Rug,
        colours: [
            varied([0.5, 0.16, 0.13], 0.5),
            varied([0.18, 0.14, 0.26], 0.4),
        ],
        roughness: 0.9,
    },
    Recipe {
        class: PLANT_POT,
        pattern: Pattern::Plain,
        colours: [varied([0.5, 0.24, 0.14], 0.2), NONE],
        roughness: 0.6,
    },
    Recipe {
        class: PLANT,
        pattern: Pattern::Fabric,
        colours: [
            varied([0.1, 0.24, 0.06], 0.2),
            varied([0.2, 0.36, 0.1], 0.2),
        ],
        roughness: 0.5,
    },
    Recipe {
        class: ORNAMENT,
        pattern: Pattern::Plain,
        colours: [varied([0.6, 0.55, 0.3], 0.5), NONE],
        roughness: 0.08,
    },
    Recipe {
        class: LAMP_STAND,
        pattern: Pattern::Plain,
        colours: [varied([0.14, 0.14, 0.15], 0.2), NONE],
        roughness: 0.16,
    },
    Recipe {
        class: SPLASHBACK,
        pattern: Pattern::Tiles {
            edge: 0.15,
            grout_roughness: 0.8,
        },
        colours: [
            varied([0.6, 0.66, 0.64], 0.2),
            varied([0.4, 0.4, 0.39], 0.05),
        ],
        roughness: 0.09,
    },
    Recipe {
        class: FRUIT,
        pattern: Pattern::Assorted,
        colours: [fixed([0.8, 0.5, 0.15]), fixed([0.7, 0.2, 0.1])],
        roughness: 0.3,
    },
    polished(TAP, STEEL, 0.1),
    polished(HOOD, STEEL, 0.3),
    polished(MIRROR, SILVERED_GLASS, 0.05),
    polished(HANDLE, BRASS, 0.2),
    polished(PLANTER, BRASS, 0.15),
    polished(TABLE_TOP, BRASS, 0.25),
    polished(GLASS_DOOR, CLEAR_GLASS, 0.05),
    polished(GLASS_SCREEN, CLEAR_GLASS, 0.05),
];
/// Of what has no recipe, lamps: white.
const WHITE: Recipe = Recipe {
    class: LAMP,
    pattern: Pattern::Plain,
    colours: [fixed([0.78; 3]), NONE],
    roughness: 0.6,
};

/// The paint of a class in a room: its colours drawn from `rng`.
#[must_use]
pub fn paint(class: u16, rng: &mut KeyedRng) -> Paint {
    let recipe = RECIPES.iter().find(|r| r.class == class).unwrap_or(&WHITE);
    Paint {
        pattern: recipe.pattern,
        colours: recipe.colours.map(|c| c.draw(rng)),
        roughness: recipe.roughness,
    }
}
