//! Photographs as scene-linear Rec. 709: which part of a file, which channels, which colours.
//!
//! The file says (OpenEXR's `chromaticities` and `adoptedNeutral`, Radiance's `PRIMARIES`,
//! `EXPOSURE`, `COLORCORR` and `FORMAT`, profiles and chunks of JPEG and PNG), or `color_space` in `transforms.json` says it instead.
//! Whatever is converted is told in an [`ImageAccount`]. Own outputs are read by `image_io`, which
//! converts nothing.

use super::eight_bit::{Rounding, white_of_levels};
use super::encoding::Encoding;
use super::exif_exposure::exif_exposure;
use super::exr_header::ExrPart;
use super::image_format::{ImageFormat, sniff};
use super::{hdr, image_io, jpeg_header, png_io};
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::colour::{Chromaticities, ColourSpace, D65, REC709};
use crate::core::parallel::prelude::*;
use crate::ffi::oiio::{OpenImage, Sample};
use crate::{Error, Result};
use glam::{DVec2, Mat3, Vec3};
use std::path::Path;

/// How an image was understood, for people and for `check --json`.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct ImageAccount {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// File format.
    pub format: &'static str,
    /// How samples are stored.
    pub sample: &'static str,
    /// Channels that were taken, in their order.
    pub channels: String,
    /// The part of a multi-part file that was taken.
    pub part: Option<String>,
    /// Primaries and white of the stored values.
    pub primaries: String,
    /// Curve of the stored values: `linear`, `sRGB` or `own curve`.
    pub transfer: &'static str,
    /// What was done to get linear Rec. 709; `None` if nothing.
    pub converted: Option<String>,
    /// Candelas per m² of the stored value 1, where the file says so.
    pub white_luminance: Option<f64>,
    /// The file has an alpha channel: pixels it does not cover are left out.
    pub has_alpha: bool,
    /// EXIF orientation; 1 is the usual. It is never applied.
    pub orientation: i32,
    /// Seconds · ISO / 100 / f-number² by the EXIF data of a JPEG.
    pub exif_exposure: Option<f64>,
}

impl ImageAccount {
    /// Whether values were made for a display rather than measured as light.
    #[must_use]
    pub fn is_display_referred(&self) -> bool {
        matches!(self.format, "PNG" | "JPEG")
    }
}

/// A photograph's pixels.
pub struct Photograph {
    /// Scene-linear Rec. 709.
    pub pixels: RgbPlane,
    /// Alpha, where the file has any that is not 0 everywhere.
    pub alpha: Option<Plane<f32>>,
    /// The file's numbers were the 256 levels of an 8-bit picture (0 to 1, or to 255), which nothing
    /// called linear: its sRGB curve was undone.
    pub eight_bit: bool,
}

impl Photograph {
    /// A photograph without alpha.
    #[must_use]
    pub fn opaque(pixels: RgbPlane) -> Self {
        Self {
            pixels,
            alpha: None,
            eight_bit: false,
        }
    }

    /// The pixels that alpha wholly covers; `None` if it covers all. Values elsewhere are weighted
    /// with what lies behind, or were never photographed.
    #[must_use]
    pub fn covered(&self) -> Option<Plane<bool>> {
        // one step of half precision below 1
        const WHOLE: f32 = 1.0 - 1.0 / 1024.0;
        let alpha = self.alpha.as_ref()?;
        let covered = alpha.map(|a| *a >= WHOLE);
        covered.data.contains(&false).then_some(covered)
    }
}

/// Where red, green and blue come from.
#[derive(Clone, Copy)]
enum Channels {
    /// Stored as such; one channel may serve as all three.
    Rgb([usize; 3]),
    /// Luminance Y and chroma RY = (R − Y) / Y, BY = (B − Y) / Y.
    LuminanceChroma([usize; 3]),
}

/// How to read a file.
struct Plan {
    part: usize,
    channels: Channels,
    alpha: Option<usize>,
    space: Chromaticities,
    neutral: Option<DVec2>,
    curve: bool,
    /// The scene says how values are encoded.
    declared: bool,
    account: ImageAccount,
}

/// How the image at `path` would be read; only its header is.
///
/// `space` overrides what the file says of its colours.
///
/// # Errors
/// It cannot be read, or it is not clear which of its parts or channels is meant.
pub fn image_account(path: &Path, space: Option<ColourSpace>) -> Result<ImageAccount> {
    match sniff(path)? {
        ImageFormat::Exr => exr_plan(path, space).map(|(plan, _)| plan.account),
        ImageFormat::Hdr => hdr_plan(path, space, &hdr::header(path)?).map(|p| p.account),
        format => display_account(path, format, space),
    }
}

/// The account of a PNG or JPEG.
fn display_account(
    path: &Path,
    format: ImageFormat,
    space: Option<ColourSpace>,
) -> Result<ImageAccount> {
    let info = super::image_info(path)?;
    let jpeg = format == ImageFormat::Jpeg;
    let (encoding, has_alpha, orientation) = match jpeg {
        true => {
            let orientation = image_io::open(path, format)?.orientation();
            (jpeg_encoding(path, space)?, false, orientation)
        }
        false => {
            let png = png_io::says(path, space)?;
            (png.encoding, png.has_alpha, 1)
        }
    };
    Ok(ImageAccount {
        width: info.width,
        height: info.height,
        format: if jpeg { "JPEG" } else { "PNG" },
        sample: sample_name(info.sample),
        channels: if info.channels < 3 { "grey" } else { "R, G, B" }.into(),
        primaries: encoding.space.title(),
        transfer: encoding.transfer(),
        converted: encoding.account(),
        has_alpha,
        orientation,
        exif_exposure: jpeg.then(|| exif_exposure(path).ok()).flatten(),
        ..ImageAccount::default()
    })
}

fn jpeg_encoding(path: &Path, space: Option<ColourSpace>) -> Result<Encoding> {
    Ok(match space {
        Some(space) => Encoding::declared(space),
        None => Encoding::of_profile(jpeg_header::read(path)?.profile.as_deref()),
    })
}

/// Reads a display-referred photograph, PNG or JPEG, as light.
///
/// # Errors
/// As [`image_account`], or the pixels are damaged, or the image is scene-linear.
pub fn read_display_photograph(path: &Path, space: Option<ColourSpace>) -> Result<Photograph> {
    match sniff(path)? {
        ImageFormat::Png => {
            let png = png_io::read_picture(path, space)?;
            Ok(Photograph {
                alpha: png.alpha.and_then(filled),
                ..Photograph::opaque(png.pixels)
            })
        }
        ImageFormat::Jpeg => {
            let mut pixels = image_io::read_jpeg(path)?;
            jpeg_encoding(path, space)?.decode(&mut pixels);
            Ok(Photograph::opaque(pixels))
        }
        _ => Err(Error::input(
            path,
            "scene-linear where a display-referred PNG or JPEG is expected; leave out --ldr",
        )),
    }
}

/// Reads a display-referred PNG or JPEG as linear Rec. 709 from 0 to 1; transparency is ignored, and
/// colours beyond Rec. 709 become the nearest within.
///
/// # Errors
/// If the file cannot be read, is damaged, or is of another format.
pub fn read_ldr(path: impl AsRef<Path>) -> Result<RgbPlane> {
    let mut pixels = read_display_photograph(path.as_ref(), None)?.pixels;
    let within = |p: Vec3| p.clamp(Vec3::ZERO, Vec3::ONE);
    pixels.data.par_iter_mut().for_each(|p| *p = within(*p));
    Ok(pixels)
}

/// An alpha channel, unless nobody filled it: one of 0 throughout says nothing.
fn filled(alpha: Plane<f32>) -> Option<Plane<f32>> {
    alpha.data.iter().any(|a| *a != 0.0).then_some(alpha)
}

/// Reads an OpenEXR or Radiance HDR photograph.
///
/// # Errors
/// As [`image_account`], or the pixels are damaged, or the image is display-referred.
pub fn read_photograph(path: &Path, space: Option<ColourSpace>) -> Result<Photograph> {
    match sniff(path)? {
        ImageFormat::Exr => {
            let (plan, image) = exr_plan(path, space)?;
            read_exr(path, plan, image)
        }
        ImageFormat::Hdr => {
            let (mut pixels, header) = hdr::read(path)?;
            let mut plan = hdr_plan(path, space, &header)?;
            let eight_bit = plan.undo_levels(&mut pixels, Rounding::Rgbe);
            plan.convert(&mut pixels);
            Ok(Photograph {
                eight_bit,
                ..Photograph::opaque(pixels)
            })
        }
        _ => Err(Error::input(
            path,
            "a display-referred PNG or JPEG where scene-linear OpenEXR or Radiance HDR is expected; --ldr accepts it as an approximation",
        )),
    }
}

fn sample_name(sample: Sample) -> &'static str {
    match sample {
        Sample::U8 => "8 bit",
        Sample::U16 => "16 bit",
        Sample::Half => "half",
        Sample::Float => "float",
        Sample::Other => "other",
    }
}

fn hdr_plan(path: &Path, space: Option<ColourSpace>, header: &hdr::HdrHeader) -> Result<Plan> {
    let own = match header.xyz {
        true => ColourSpace::Xyz.chromaticities(),
        false => header.primaries.unwrap_or(REC709),
    };
    let mut plan = Plan::new(space, own, None);
    plan.account = ImageAccount {
        width: header.width,
        height: header.height,
        format: "Radiance HDR",
        sample: "RGBE",
        channels: if header.xyz { "X, Y, Z" } else { "R, G, B" }.into(),
        orientation: 1,
        ..ImageAccount::default()
    };
    let gain = header.gain();
    if !gain.is_finite() || gain.min_element() <= 0.0 {
        return Err(Error::input(
            path,
            "its EXPOSURE lines multiply to nonsense; remove them",
        ));
    }
    let divided = (gain != Vec3::ONE).then(|| {
        let c = header.correction;
        format!(
            "divided by exposure {} and colour correction {c}",
            header.exposure
        )
    });
    plan.tell(divided);
    Ok(plan)
}

fn exr_plan(path: &Path, space: Option<ColourSpace>) -> Result<(Plan, OpenImage)> {
    let parts = image_io::exr_parts(path)?;
    let chosen = choose_part(&parts).map_err(|e| Error::input(path, e))?;
    let part = &parts[chosen];
    let image = image_io::open_part(path, ImageFormat::Exr, chosen).map_err(|e| {
        match part.sampled_apart() {
            None if part.is_luminance_chroma() => unread_chroma(path, &e),
            _ => e,
        }
    })?;
    let names: Vec<String> = (0..image.size().2 as usize)
        .map(|c| image.channel_name(c))
        .collect();
    let xyz = space == Some(ColourSpace::Xyz);
    let (channels, alpha) = pick(&names, xyz).map_err(|e| Error::input(path, e))?;
    let own = part.chromaticities.unwrap_or(REC709);
    let mut plan = Plan::new(space, own, part.neutral.map(DVec2::from_array));
    (plan.part, plan.channels, plan.alpha) = (chosen, channels, alpha);
    let (Channels::Rgb(taken) | Channels::LuminanceChroma(taken)) = channels;
    let taken = match taken {
        [a, b, _] if a == b => names[a].clone(),
        three => three.map(|c| names[c].as_str()).join(", "),
    };
    plan.account = ImageAccount {
        width: image.size().0 as usize,
        height: image.size().1 as usize,
        format: "OpenEXR",
        sample: sample_name(image.sample()),
        channels: taken,
        part: (parts.len() > 1).then(|| part.title()),
        white_luminance: part.white_luminance.filter(|w| w.is_finite() && *w > 0.0),
        has_alpha: alpha.is_some(),
        orientation: 1,
        ..ImageAccount::default()
    };
    let decoded = matches!(channels, Channels::LuminanceChroma(_));
    plan.tell(decoded.then(|| "luminance and chroma decoded".to_owned()));
    Ok((plan, image))
}

impl Plan {
    fn new(space: Option<ColourSpace>, own: Chromaticities, neutral: Option<DVec2>) -> Self {
        Self {
            part: 0,
            channels: Channels::Rgb([0, 1, 2]),
            alpha: None,
            space: space.map_or(own, ColourSpace::chromaticities),
            // the override speaks of the whole encoding
            neutral: neutral.filter(|_| space.is_none()),
            curve: space == Some(ColourSpace::Srgb),
            declared: space.is_some(),
            account: ImageAccount::default(),
        }
    }

    /// The matrix to Rec. 709; `None` where it would change nothing.
    fn matrix(&self) -> Option<Mat3> {
        let neutral = self
            .neutral
            .filter(|n| (*n - self.space.white).length() > 2e-3);
        let same = self.space.is_near(&REC709) && neutral.is_none();
        (!same).then(|| self.space.rec709_from_rgb(neutral).as_mat3())
    }

    /// Completes the account: colours, curve, and what is done about them.
    fn tell(&mut self, first: Option<String>) {
        let a = &mut self.account;
        a.primaries = self.space.title();
        a.transfer = if self.curve { "sRGB" } else { "linear" };
        let mut done: Vec<String> = first.into_iter().collect();
        if self.curve {
            done.push("the sRGB curve undone".into());
        }
        if self.matrix().is_some() {
            let a = &self.account.primaries;
            let white = self.neutral.unwrap_or(self.space.white);
            let adapted = match (white - D65).length() > 2e-3 && !a.starts_with("CIE") {
                true => ", white adapted to D65 (Bradford)",
                false => "",
            };
            done.push(format!("{a} converted to Rec. 709{adapted}"));
        }
        self.account.converted = (!done.is_empty()).then(|| done.join("; "));
    }

    /// Takes files of which nobody says what they hold, and that hold the levels of an 8-bit
    /// picture, as that picture; returns whether it is one.
    fn undo_levels(&mut self, pixels: &mut RgbPlane, rounding: Rounding) -> bool {
        let white = match self.declared {
            true => None,
            false => white_of_levels(pixels, rounding),
        };
        if let Some(white) = white.filter(|w| *w != 1.0) {
            pixels.data.par_iter_mut().for_each(|p| *p /= white);
        }
        self.curve |= white.is_some();
        white.is_some()
    }

    fn convert(&self, pixels: &mut RgbPlane) {
        if let Channels::LuminanceChroma(_) = self.channels {
            let w = self.space.luminance_weights().as_vec3();
            let rgb = |p: Vec3| {
                let (r, b) = (p.x * (1.0 + p.y), p.x * (1.0 + p.z));
                Vec3::new(r, (p.x - w.x * r - w.z * b) / w.y, b)
            };
            pixels.data.par_iter_mut().for_each(|p| *p = rgb(*p));
        }
        if self.curve {
            let linear = |p: Vec3| p.map(linear_from_srgb_beyond);
            pixels.data.par_iter_mut().for_each(|p| *p = linear(*p));
        }
        if let Some(m) = self.matrix() {
            pixels.data.par_iter_mut().for_each(|p| *p = m * *p);
        }
    }
}

/// The sRGB curve's inverse continued above 1 and, mirrored, below 0.
fn linear_from_srgb_beyond(v: f32) -> f32 {
    let x = v.abs();
    let linear = match x <= 0.040_45 {
        true => x / 12.92,
        false => ((x + 0.055) / 1.055).powf(2.4),
    };
    linear.copysign(v)
}

fn read_exr(path: &Path, mut plan: Plan, mut image: OpenImage) -> Result<Photograph> {
    let alpha = match plan.alpha {
        None => None,
        Some(c) => filled(image_io::read_channel(path, &mut image, c)?),
    };
    let (Channels::Rgb(three) | Channels::LuminanceChroma(three)) = plan.channels;
    let chroma = matches!(plan.channels, Channels::LuminanceChroma(_));
    let mut pixels = image_io::read_rgb_channels(path, image, three)
        .map_err(|e| if chroma { unread_chroma(path, &e) } else { e })?;
    let eight_bit = !chroma && plan.undo_levels(&mut pixels, Rounding::Float);
    plan.convert(&mut pixels);
    Ok(Photograph {
        pixels,
        alpha,
        eight_bit,
    })
}

/// Luminance and chroma that are sampled at every pixel are read by OpenImageIO 2.4 (Debian 12),
/// while 2.5 (Debian 13) wants a buffer for halved chroma: what the file holds is said, not that it
/// is damaged.
fn unread_chroma(path: &Path, library: &Error) -> Error {
    Error::input(
        path,
        format!(
            "luminance-chroma channels (Y, RY, BY) that OpenImageIO {} did not read: save the image as R, G, B ({library})",
            super::version()
        ),
    )
}

/// Names that programs give to the part or layer that holds the picture itself.
const PICTURE: [&str; 8] = [
    "beauty",
    "rgba",
    "rgb",
    "combined",
    "main",
    "color",
    "colour",
    "composite",
];

/// The part that holds the photograph, or why that is not clear.
fn choose_part(parts: &[ExrPart]) -> std::result::Result<usize, String> {
    if parts.len() == 1 {
        return Ok(0);
    }
    let listed = || {
        let titles: Vec<String> = parts.iter().map(ExrPart::title).collect();
        titles.join("; ")
    };
    let names =
        |p: &ExrPart| -> Vec<String> { p.channels.iter().map(|c| c.name.clone()).collect() };
    let coloured =
        |p: &ExrPart| p.is_flat() && p.channels.len() >= 3 && pick_named(&names(p)).is_some();
    let candidates: Vec<usize> = (0..parts.len()).filter(|i| coloured(&parts[*i])).collect();
    let called = |i: &&usize| {
        let name = parts[**i]
            .name
            .as_deref()
            .unwrap_or_default()
            .to_lowercase();
        PICTURE
            .iter()
            .any(|p| name == *p || name.ends_with(&format!(".{p}")))
    };
    let pictures: Vec<&usize> = candidates.iter().filter(called).collect();
    match (&candidates[..], &pictures[..]) {
        ([only], _) => Ok(*only),
        (_, [only]) => Ok(**only),
        ([], _) => Err(format!(
            "none of its {} parts has channels R, G and B: {}",
            parts.len(),
            listed()
        )),
        _ => Err(format!(
            "{} of its parts hold a picture, and which one is meant is not clear; save one of them alone: {}",
            candidates.len(),
            listed()
        )),
    }
}

/// R, G, B and alpha by name: plain, or of the only layer that has them, or of the one called as
/// the picture.
fn pick_named(names: &[String]) -> Option<(Channels, Option<usize>)> {
    let find = |wanted: &str| names.iter().position(|n| n.eq_ignore_ascii_case(wanted));
    let three = |r: &str, g: &str, b: &str| Some([find(r)?, find(g)?, find(b)?]);
    if let Some(rgb) = three("R", "G", "B") {
        return Some((Channels::Rgb(rgb), find("A")));
    }
    if let Some(yc) = three("Y", "RY", "BY") {
        return Some((Channels::LuminanceChroma(yc), find("A")));
    }
    let mut layers: Vec<&str> = names
        .iter()
        .filter_map(|n| n.strip_suffix(".R").or_else(|| n.strip_suffix(".r")))
        .collect();
    if layers.len() > 1 {
        layers.retain(|l| {
            let last = l.rsplit('.').next().unwrap_or(l).to_lowercase();
            PICTURE.contains(&last.as_str())
        });
    }
    let [layer] = layers[..] else {
        return None;
    };
    let of = |c: &str| format!("{layer}.{c}");
    let rgb = three(&of("R"), &of("G"), &of("B"))?;
    Some((Channels::Rgb(rgb), find(&of("A"))))
}

/// The channels to read of a part; `xyz` if the scene says that they are CIE XYZ.
fn pick(names: &[String], xyz: bool) -> std::result::Result<(Channels, Option<usize>), String> {
    if let Some(found) = pick_named(names) {
        return Ok(found);
    }
    let shown = names
        .iter()
        .take(12)
        .map(String::as_str)
        .collect::<Vec<_>>();
    let shown = shown.join(", ");
    let last = |n: &String| n.rsplit('.').next().unwrap_or(n).to_lowercase();
    let lasts: Vec<String> = names.iter().map(last).collect();
    let has = |wanted: &str| lasts.iter().any(|l| l == wanted);
    let layered = names.iter().any(|n| n.ends_with(".R") || n.ends_with(".r"));
    let depth = ["z", "depth", "distance", "zback", "id", "a", "u", "v"];
    if has("x") && has("y") && has("z") && names.len() <= 4 {
        let at = |c: &str| lasts.iter().position(|l| l == c);
        return match (xyz, at("x"), at("y"), at("z")) {
            (true, Some(x), Some(y), Some(z)) => Ok((Channels::Rgb([x, y, z]), at("a"))),
            _ => Err(format!(
                "channels {shown}: colours or directions? If they are CIE XYZ, say \"color_space\": \"xyz\" in transforms.json"
            )),
        };
    }
    match names.len() {
        1 | 2 if !depth.contains(&lasts[0].as_str()) => Ok((Channels::Rgb([0; 3]), None)),
        1 | 2 => Err(format!(
            "channel {shown} holds no radiance: expected R, G and B, or Y"
        )),
        // nothing says what they are: the order of every other program
        3 | 4 if !layered => Ok((Channels::Rgb([0, 1, 2]), None)),
        _ => Err(format!(
            "channels R, G and B expected, found {shown}: save one layer as R, G, B"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::super::exr_header;
    use super::*;

    fn strings(names: &[&str]) -> Vec<String> {
        names.iter().map(|n| (*n).to_owned()).collect()
    }

    fn part(name: &str, channels: &[&str]) -> ExrPart {
        let channel = |n: &&str| exr_header::ExrChannel {
            name: (*n).into(),
            bytes: 2,
            full: true,
        };
        ExrPart {
            name: Some(name.into()),
            channels: channels.iter().map(channel).collect(),
            ..ExrPart::default()
        }
    }

    #[test]
    fn the_part_with_the_picture_is_taken_or_all_are_listed() {
        let (depth, beauty) = (part("depth", &["Z"]), part("Beauty", &["R", "G", "B"]));
        let diffuse = part("diffuse", &["diffuse.R", "diffuse.G", "diffuse.B"]);
        let (left, right) = (part("l", &["R", "G", "B"]), part("r", &["R", "G", "B"]));
        assert_eq!(choose_part(&[depth.clone(), beauty.clone()]), Ok(1));
        assert_eq!(
            choose_part(&[diffuse.clone(), beauty, depth.clone()]),
            Ok(1)
        );
        let e = choose_part(&[left, right]).expect_err("stereo");
        assert!(e.contains("\"l\" (R, G, B); \"r\" (R, G, B)"), "{e}");
        let e = choose_part(&[depth.clone(), depth]).expect_err("no picture");
        assert!(e.contains("none of its 2 parts"), "{e}");
    }

    #[test]
    fn channels_that_are_no_radiance_are_refused_by_name() {
        for (names, said) in [
            (&["Z"][..], "no radiance"),
            (&["N.X", "N.Y", "N.Z"], "colours or directions"),
            (&["a.R", "a.G", "a.B", "b.R", "b.G", "b.B"], "one layer"),
        ] {
            let refused = pick(&strings(names), false).is_err_and(|e| e.contains(said));
            assert!(refused, "{names:?}");
        }
        let taken = |names: &[&str], xyz| match pick(&strings(names), xyz) {
            Ok((Channels::Rgb(c) | Channels::LuminanceChroma(c), a)) => (c, a),
            Err(e) => panic!("{e}"),
        };
        assert_eq!(taken(&["X", "Y", "Z"], true), ([0, 1, 2], None));
        assert_eq!(taken(&["A", "B", "G", "R"], false), ([3, 2, 1], Some(0)));
        assert_eq!(
            taken(
                &["a.R", "a.G", "a.B", "beauty.R", "beauty.G", "beauty.B"],
                false
            ),
            ([3, 4, 5], None)
        );
    }

    #[test]
    fn luminance_and_chroma_come_back_as_rgb() {
        let rgb = Vec3::new(0.5, 0.25, 2.0);
        let w = REC709.luminance_weights().as_vec3();
        let y = w.dot(rgb);
        let mut plan = Plan::new(None, REC709, None);
        plan.channels = Channels::LuminanceChroma([0, 1, 2]);
        let mut plane = Plane::filled(1, 1, Vec3::new(y, (rgb.x - y) / y, (rgb.z - y) / y));
        plan.convert(&mut plane);
        assert!(
            (plane.data[0] - rgb).abs().max_element() < 1e-5,
            "{}",
            plane.data[0]
        );
        assert!(plan.matrix().is_none(), "Rec. 709 is left alone");
    }

    #[test]
    fn the_scene_may_say_what_the_file_does_not() {
        let plan = Plan::new(Some(ColourSpace::Srgb), REC709, None);
        let mut plane = Plane::filled(1, 1, Vec3::new(0.5, 1.0, -0.5));
        plan.convert(&mut plane);
        let p = plane.data[0];
        assert!((p.x - 0.214_041).abs() < 1e-5 && (p.y - 1.0).abs() < 1e-6 && p.z == -p.x);
        let mut plan = Plan::new(Some(ColourSpace::AcesCg), REC709, None);
        plan.tell(None);
        let said = plan.account.converted.expect("converted");
        assert!(
            said.contains("ACEScg") && said.contains("Bradford"),
            "{said}"
        );
    }
}
