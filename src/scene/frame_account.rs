//! What `check` says of each photograph: how it was understood, and what of it is left out.

use super::pixels::is_beyond;
use super::{PixelStats, Scene, View};
use crate::core::formats::ImageAccount;
use crate::core::image::Plane;
use crate::{Error, Result};
use glam::Vec2;
use serde::Serialize;
use std::collections::BTreeMap;

/// One frame as it was read.
#[derive(Clone, Debug, Default, Serialize)]
pub struct FrameAccount {
    /// The view's name.
    pub stem: String,
    /// How the image was understood.
    #[serde(flatten)]
    pub image: ImageAccount,
    /// Working radiance = image · 2^ev.
    pub exposure_ev: f32,
    /// Share of the pixels that a mask, the alpha channel or `--clamp-nan` leaves out.
    pub masked_share: f64,
    /// What of the light the file may lack.
    #[serde(flatten)]
    pub shortfall: Shortfall,
}

/// What is said of [`PixelStats::eight_bit`].
pub const EIGHT_BIT: &str = "its values are the 256 levels of an 8-bit picture, taken as gamma-encoded (\"color_space\": \"rec709\" in transforms.json says that they are linear)";

/// Light that a linear file does not hold although its values look like any others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Shortfall {
    /// Infinite pixels on surfaces of kind `light`; where nothing is labelled, all of them.
    pub infinite_on_lights: usize,
    /// The values end at exactly 1, as those of pictures for screens do, and nothing says that they
    /// are linear.
    pub ends_at_one: bool,
}

impl Shortfall {
    /// Of a view whose pixels were read.
    ///
    /// # Errors
    /// The image cannot be read a second time.
    pub fn of(
        scene: &Scene,
        view: &View,
        stats: &PixelStats,
        labels: Option<&Plane<u16>>,
    ) -> Result<Self> {
        let infinite_on_lights = match labels {
            Some(labels) if stats.infinite > 0 => infinite_on_lights(scene, view, labels)?,
            _ => stats.infinite,
        };
        let linear =
            !view.account.is_display_referred() && view.colour_space.is_none() && !stats.eight_bit;
        Ok(Self {
            infinite_on_lights,
            ends_at_one: linear && stats.at_one > 0,
        })
    }
}

/// The account of a view whose files were all read.
///
/// # Errors
/// Its mask leaves no pixel.
pub(super) fn account(
    scene: &Scene,
    view: &View,
    (stats, mask, labels): (&PixelStats, Option<&Plane<bool>>, Option<&Plane<u16>>),
) -> Result<FrameAccount> {
    let count = view.camera.width * view.camera.height;
    let out = mask.map_or(0, |m| m.data.iter().filter(|k| !**k).count());
    if out == count {
        let path = view.mask_path.as_ref().unwrap_or(&view.image_path);
        return Err(Error::input(
            path,
            format!(
                "the mask of {} leaves no pixel (0 is left out, anything else kept): is it inverted?",
                view.stem
            ),
        ));
    }
    let mut image = view.account.clone();
    if stats.eight_bit {
        image.transfer = "sRGB";
        let done = format!("{EIGHT_BIT}, the sRGB curve undone");
        image.converted = Some(match image.converted {
            Some(others) => format!("{done}; {others}"),
            None => done,
        });
    }
    Ok(FrameAccount {
        stem: view.stem.clone(),
        image,
        exposure_ev: view.exposure_ev,
        masked_share: out as f64 / count as f64,
        shortfall: Shortfall::of(scene, view, stats, labels)?,
    })
}

/// Infinite pixels whose class is of kind `light`.
fn infinite_on_lights(scene: &Scene, view: &View, labels: &Plane<u16>) -> Result<usize> {
    let image = scene.read_image(view)?.pixels;
    let scale = Vec2::new(
        labels.width as f32 / image.width as f32,
        labels.height as f32 / image.height as f32,
    );
    let on_light = |i: usize| {
        let p = Vec2::new((i % image.width) as f32, (i / image.width) as f32) + 0.5;
        let class = scene.class(*labels.nearest(p * scale));
        class.is_some_and(|c| c.is_light)
    };
    let infinite = |i: &usize| is_beyond(image.data[*i]);
    Ok((0..image.data.len())
        .filter(infinite)
        .filter(|i| on_light(*i))
        .count())
}

/// What a user should know of the photographs although they can be used.
pub(super) fn warnings(frames: &[FrameAccount]) -> Vec<String> {
    let mut notes = Vec::new();
    let mut converted: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for f in frames {
        if let Some(done) = &f.image.converted {
            converted.entry(done).or_default().push(&f.stem);
        }
    }
    for (done, stems) in converted {
        notes.push(format!(
            "{} images: {done} (first: {})",
            stems.len(),
            stems[0]
        ));
    }
    let with = |of: &dyn Fn(&FrameAccount) -> bool| -> Vec<&FrameAccount> {
        frames.iter().filter(|f| of(f)).collect()
    };
    let transparent = with(&|f| f.image.has_alpha && f.masked_share > 0.0);
    if let [first, ..] = transparent[..] {
        let share: f64 = transparent.iter().map(|f| f.masked_share).sum();
        notes.push(format!(
            "{} images have pixels that their alpha does not cover, which are left out ({:.1} % of them; first: {})",
            transparent.len(),
            100.0 * share / transparent.len() as f64,
            first.stem
        ));
    }
    let masked = with(&|f| f.masked_share > 0.5);
    if let [first, ..] = masked[..] {
        notes.push(format!(
            "{} images lose more than half of their pixels to masks (first: {}, {:.0} %)",
            masked.len(),
            first.stem,
            100.0 * first.masked_share
        ));
    }
    let infinite = with(&|f| f.shortfall.infinite_on_lights > 0);
    if let [first, ..] = infinite[..] {
        let count: usize = infinite
            .iter()
            .map(|f| f.shortfall.infinite_on_lights)
            .sum();
        notes.push(format!(
            "{count} infinite pixels lie on classes of kind light (first: {}): how bright the brightest light is will be estimated from the shading it throws; images in single precision would hold it",
            first.stem
        ));
    }
    let ending = with(&|f| f.shortfall.ends_at_one);
    if let [first, ..] = ending[..] {
        notes.push(format!(
            "{} images end at exactly 1 (first: {}), as pictures for screens do: they are taken as linear light that is clipped there. If they are gamma-encoded, say \"color_space\": \"srgb\" in transforms.json; \"rec709\" says that they are linear",
            ending.len(),
            first.stem
        ));
    }
    let turned = with(&|f| f.image.orientation > 1);
    if let [first, ..] = turned[..] {
        notes.push(format!(
            "{} images carry EXIF orientation {} (first: {}), which viewers apply and unbake does not, as COLMAP does not either: poses must be those of the stored rows",
            turned.len(),
            first.image.orientation,
            first.stem
        ));
    }
    notes
}
