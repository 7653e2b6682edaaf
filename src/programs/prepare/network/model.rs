//! A network with what it needs to know of photographs: which tiles, which normalisation. Called by
//! `depth` and `semantic`.

use super::engine_types::{Output, Shape};
use super::options::{NetworkOptions, Normalisation, PanoramaTiles, Properties};
use super::tiles::{Tile, tiles_of};
use crate::core::formats::{image_info, read_ldr, read_photograph};
use crate::core::geometry::{Lens, Projection};
use crate::core::image::{BilinearTaps, RgbPlane, Wrap, bilinear_taps};
use crate::core::math::{luminance, srgb_from_linear};
use crate::core::parallel::prelude::*;
use crate::error::Result;
use crate::programs::prepare::capture::Shot;
use crate::programs::prepare::labels::camera;
use crate::programs::prepare::lens::Optics;
use glam::{DVec3, Vec2, Vec3};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

#[cfg(feature = "onnx")]
use super::engine::{Engine, Plan};
#[cfg(not(feature = "onnx"))]
use super::no_engine::{Engine, Plan};

/// Mean level to which linear photographs are exposed before a network sees them. Cited: Reinhard et al. 2002,
/// "Photographic Tone Reproduction for Digital Images", equation 2, the middle grey of a normal key.
const MIDDLE_GREY: f32 = 0.18;

/// A network, ready for photographs.
pub(super) struct Model {
    /// Its file.
    pub path: PathBuf,
    engine: Engine,
    normalisation: Normalisation,
    panoramas: Option<PanoramaTiles>,
    /// By size of the tiles: photographs of one size share one.
    plans: BTreeMap<[usize; 2], Plan>,
}

/// What a network gave for a tile.
pub(super) struct Answer {
    pub tile: Tile,
    pub output: Output,
}

impl Model {
    /// Reads a network.
    ///
    /// # Errors
    /// A file that is no usable network, or settings that mean nothing.
    pub fn load(path: &Path, options: &NetworkOptions) -> Result<Self> {
        let engine = Engine::load(path)?;
        let properties = Properties {
            path,
            of: &engine.properties,
        };
        Ok(Self {
            path: path.to_path_buf(),
            normalisation: properties.normalisation(options)?,
            panoramas: properties.choice(options.network_tiles, "tiles")?,
            plans: BTreeMap::new(),
            engine,
        })
    }

    /// The file's `metadata_props`.
    pub fn properties(&self) -> Properties<'_> {
        Properties {
            path: &self.path,
            of: &self.engine.properties,
        }
    }

    /// The input as people write it.
    pub fn input(&self) -> String {
        let Shape { width, height } = self.engine.shape;
        let side = |s: Option<usize>| s.map_or("any".into(), |n| n.to_string());
        format!("{} x {}", side(width), side(height))
    }

    /// What the network gives for a photograph, handed on tile by tile in their order; positions are relative
    /// to `origin`.
    ///
    /// # Errors
    /// A photograph that cannot be read, or a network that fails on it.
    pub fn look(
        &mut self,
        shot: &Shot,
        origin: DVec3,
        mut take: impl FnMut(Answer) -> Result<()>,
    ) -> Result<()> {
        let picture = Picture::read(&shot.image)?;
        let size = picture.size();
        let mut photo = camera(&shot.world_from_camera, &shot.optics, size, origin);
        if matches!(shot.optics, Optics::Distorted(_)) {
            // of a lens without a projection of its own only pixels are asked
            photo.projection = Projection::Pinhole(Lens::centred(size[0], size[1], 90.0));
        }
        let tiles = tiles_of(&photo, self.engine.shape, self.panoramas);
        for tile in &tiles {
            if !self.plans.contains_key(&tile.size) {
                self.plans.insert(tile.size, self.engine.plan(tile.size)?);
            }
        }
        let answer = |tile: &Tile| {
            let planes = self.normalisation.planes(&picture.shown(tile));
            let output = self.plans[&tile.size].run(&planes)?;
            Ok(Answer {
                tile: *tile,
                output,
            })
        };
        // as many at once as there are threads: maps of many classes are large
        for some in tiles.chunks(rayon::current_num_threads().max(1)) {
            let answers: Result<Vec<Answer>> = some.par_iter().map(answer).collect();
            answers?.into_iter().try_for_each(&mut take)?;
        }
        Ok(())
    }
}

impl Answer {
    /// The four values around a place of the tile: index in a map, and weight.
    pub fn taps(&self, pixel: Vec2) -> BilinearTaps {
        let size = self.output.size;
        let scale = Vec2::new(
            size[0] as f32 / self.tile.size[0] as f32,
            size[1] as f32 / self.tile.size[1] as f32,
        );
        bilinear_taps(size[0], size[1], pixel * scale, Wrap::Clamp)
    }
}

impl Normalisation {
    /// Planes of a tile's pixels as the network wants them.
    fn planes(&self, tile: &RgbPlane) -> Vec<f32> {
        let order = if self.bgr { [2, 1, 0] } else { [0, 1, 2] };
        let plane = |c: usize| {
            let of = move |p: &Vec3| (p[c] - self.mean[c]) / self.std[c];
            tile.data.iter().map(of)
        };
        order.into_iter().flat_map(plane).collect()
    }
}

/// A photograph as a display shows it, sRGB from 0 to 1, with halves of itself.
struct Picture {
    levels: Vec<RgbPlane>,
    wrap: Wrap,
}

impl Picture {
    fn read(path: &Path) -> Result<Self> {
        let info = image_info(path)?;
        let linear = info.format.is_linear();
        let mut pixels = match linear {
            true => read_photograph(path, None)?.pixels,
            false => read_ldr(path)?,
        };
        let exposure = if linear { exposure(&pixels) } else { 1.0 };
        pixels.data.par_iter_mut().for_each(|p| {
            let shown = |v: f32| match v.is_finite() {
                true => srgb_from_linear(exposure * v),
                false => 0.0,
            };
            *p = p.map(shown);
        });
        let wrap = match info.width == 2 * info.height {
            true => Wrap::Repeat,
            false => Wrap::Clamp,
        };
        Ok(Self {
            levels: vec![pixels],
            wrap,
        }
        .halved())
    }

    fn halved(mut self) -> Self {
        while let Some(last) = self.levels.last()
            && last.width.min(last.height) > 1
        {
            let half = last.half();
            self.levels.push(half);
        }
        self
    }

    fn size(&self) -> [usize; 2] {
        [self.levels[0].width, self.levels[0].height]
    }

    /// A tile's pixels, from the level that is at most twice as fine.
    fn shown(&self, tile: &Tile) -> RgbPlane {
        let level = tile.step().log2().floor().max(0.0) as usize;
        let level = &self.levels[level.min(self.levels.len() - 1)];
        let [w, h] = self.size();
        let scale = Vec2::new(
            level.width as f32 / w as f32,
            level.height as f32 / h as f32,
        );
        let width = tile.size[0];
        let pixel = |i: usize| {
            let place = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
            let seen = tile.photo_pixel(place);
            seen.map_or(Vec3::ZERO, |p| level.bilinear(p * scale, self.wrap))
        };
        RgbPlane {
            width,
            height: tile.size[1],
            data: (0..width * tile.size[1]).map(pixel).collect(),
        }
    }
}

/// The factor that brings a linear photograph's mean logarithm to middle grey.
fn exposure(pixels: &RgbPlane) -> f32 {
    let levels = pixels.data.iter().map(|p| luminance(*p));
    let (sum, count) = (levels.filter(|l| l.is_finite() && *l > 0.0))
        .fold((0.0f64, 0.0f64), |(s, n), l| {
            (s + f64::from(l).ln(), n + 1.0)
        });
    match count > 0.0 {
        true => MIDDLE_GREY / (sum / count).exp() as f32,
        false => 1.0,
    }
}
