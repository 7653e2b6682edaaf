//! What roughness to expect of classes that photographs tell nothing about: too small, too thin or
//! seen once.

use crate::inverse::Materials;
use crate::scene::{Class, Scene};
use std::collections::BTreeMap;

/// Roughness of glass: as smooth as the method allows to see.
pub(super) const SMOOTH: f32 = 0.03;
/// Roughness by what a class' name says it is made of. Cited: Material Reference of the Roblox
/// Creator Hub (read 2026-11), middles of its ranges.
const BY_WORD: [(&[&str], f32); 7] = [
    (&["mirror", "glass"], SMOOTH),
    (
        &[
            "metal",
            "steel",
            "chrome",
            "iron",
            "aluminium",
            "aluminum",
            "brass",
            "bronze",
            "copper",
            "gold",
            "silver",
            "nickel",
            "tap",
            "faucet",
        ],
        0.25,
    ),
    (&["plastic"], 0.25),
    (&["marble"], 0.375),
    (&["rubber"], 0.55),
    (&["leather"], 0.45),
    (
        &[
            "cotton", "canvas", "denim", "linen", "wool", "fabric", "cloth", "carpet", "rug",
            "curtain", "towel", "blanket",
        ],
        0.88,
    ),
];
/// Roughness of a scene without any evidence: matte, as most indoor surfaces without visible
/// highlights are. Counts as one class among those known.
const MATTE: f32 = 0.8;
/// Variance of a roughness of which nothing is known. Derived: uniform on [0, 1].
const UNKNOWN: f32 = 1.0 / 12.0;

/// The roughness to expect where there is no evidence.
#[derive(Clone, Debug)]
pub struct UsualRoughness {
    by_class: BTreeMap<u16, f32>,
    of_all: f32,
}

impl UsualRoughness {
    /// By the names of a scene's classes; of the others, the mean of those that are known
    /// (empirical Bayes: Robbins 1956), the surer ones counting more.
    #[must_use]
    pub fn of(scene: &Scene, materials: &Materials) -> Self {
        let (mut sum, mut weight) = (MATTE, 1.0);
        for fit in materials.fits() {
            let w = UNKNOWN / (UNKNOWN + fit.error * fit.error);
            sum += w * fit.roughness;
            weight += w;
        }
        let named = |c: &Class| Some((c.id, by_name(c)?));
        Self {
            by_class: scene.classes.iter().filter_map(named).collect(),
            of_all: sum / weight,
        }
    }

    /// That of a class.
    #[must_use]
    pub fn of_class(&self, class: u16) -> f32 {
        self.by_class.get(&class).copied().unwrap_or(self.of_all)
    }
}

/// That of what a name says.
fn by_name(class: &Class) -> Option<f32> {
    let words = class.words();
    let says = |(list, _): &&(&[&str], f32)| words.iter().any(|w| list.contains(&w.as_str()));
    BY_WORD.iter().find(says).map(|(_, roughness)| *roughness)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inverse::GroupFit;
    use crate::observed::surface_tests::box_scene;

    fn fit(class: u16, roughness: f32, error: f32) -> GroupFit {
        GroupFit {
            class,
            roughness,
            error,
            own_error: error,
            objective: Vec::new(),
            points: 100,
        }
    }

    #[test]
    fn names_say_what_a_class_is_like_and_else_the_scene_does() {
        let mut scene = box_scene();
        let class = |id, name: &str| Class {
            id,
            name: name.into(),
            is_light: false,
        };
        scene.classes = vec![
            class(1, "BrushedStainlessSteel"),
            class(2, "kitchen tap.001"),
            class(3, "goldfish bowl"),
            class(4, "wool rug"),
        ];
        let nothing = UsualRoughness::of(&scene, &Materials::default());
        assert_eq!(
            [1, 2, 3, 4].map(|c| nothing.of_class(c)),
            [0.25, 0.25, MATTE, 0.88]
        );
        let glossy = [fit(5, 0.2, 0.01), fit(6, 0.3, 0.01), fit(7, 0.9, 10.0)];
        let known = UsualRoughness::of(&scene, &Materials::undivided(glossy.to_vec()));
        let expected = (MATTE + 0.2 + 0.3) / 3.0;
        assert!((known.of_class(3) - expected).abs() < 0.002, "{known:?}");
        assert_eq!(known.of_class(1), 0.25);
    }
}
