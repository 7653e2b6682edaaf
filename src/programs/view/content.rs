//! What the page is given: the scene's description and its binary blocks, made at the first request
//! and kept.

use super::encode::{self, gzip};
use super::lamps::{self, Slider};
use super::live_light::PageLight;
use super::probes::{self, Probe, Relit};
use super::{inspect, photos::Photos, ray_tree, response};
use crate::core::math::luminance;
use crate::core::trace::EmbreeTracer;
use crate::error::{Error, Result};
use crate::programs::report::RunRecord;
use crate::render::live::LightEdit;
use crate::scene::{Scene, Split, unnamed_class};
use crate::solution::Solution;
use glam::{Vec2, Vec3};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// A compressed block, computed by whoever asks first while others wait for it alone.
type Slot = Arc<OnceLock<Arc<Vec<u8>>>>;

/// Layers that are textures on the atlas.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Layer {
    /// Albedo, and in its fourth channel the share that is no metal.
    Albedo,
    /// Roughness R, and in its second channel the share of transmitted light where there are panes.
    Roughness,
    /// Irradiance E.
    Irradiance,
    /// Outgoing radiance as observed.
    Radiance,
    /// Emitted radiance.
    Emission,
    /// Standard errors.
    Confidence,
    /// Class and room ids.
    Ids,
}

impl Layer {
    /// All layers with their names in paths.
    pub const ALL: [(&'static str, Self); 7] = [
        ("albedo", Self::Albedo),
        ("roughness", Self::Roughness),
        ("irradiance", Self::Irradiance),
        ("radiance", Self::Radiance),
        ("emission", Self::Emission),
        ("confidence", Self::Confidence),
        ("ids", Self::Ids),
    ];
}

/// A loaded solution, ready to be shown.
pub struct Content {
    solution: Solution,
    scene: Option<Scene>,
    name: String,
    tracer: EmbreeTracer,
    lamps: Vec<Slider>,
    probes: Vec<Probe>,
    exposure: f32,
    photos: Photos,
    textures: Mutex<BTreeMap<(Layer, usize), Slot>>,
    mesh: OnceLock<Arc<Vec<u8>>>,
    panoramas: OnceLock<Arc<Vec<u8>>>,
    ray_tree: OnceLock<Arc<Vec<u8>>>,
    response: OnceLock<Arc<Vec<u8>>>,
    light: OnceLock<PageLight>,
    /// Where the light operator is kept.
    folder: Option<PathBuf>,
}

impl Content {
    /// Prepares a solution, with its scene's cameras and class names if there is a scene.
    ///
    /// # Errors
    /// If the scene is another one than was reconstructed, or the mesh cannot be traced.
    pub fn new(
        solution: Solution,
        scene: Option<Scene>,
        record: Option<&RunRecord>,
    ) -> Result<Self> {
        if let Some(scene) = scene
            .as_ref()
            .filter(|s| (s.origin - solution.origin).length() > 1e-6)
        {
            let message = format!(
                "is centred at {}, but the reconstruction at {}; give the scene it was made from",
                scene.origin, solution.origin
            );
            return Err(Error::input(&scene.folder, message));
        }
        let tracer = EmbreeTracer::new(&solution.mesh)?;
        let lamps = lamps::sliders(&solution);
        let probes = probes::place(&solution, &tracer);
        let from_record = record
            .map(|r| r.scene.name.clone())
            .filter(|n| !n.is_empty());
        let exposure = exposure(&solution);
        Ok(Self {
            name: from_record.unwrap_or_else(|| "scene".into()),
            solution,
            scene,
            tracer,
            lamps,
            probes,
            exposure,
            photos: Photos::default(),
            textures: Mutex::default(),
            mesh: OnceLock::new(),
            panoramas: OnceLock::new(),
            ray_tree: OnceLock::new(),
            response: OnceLock::new(),
            light: OnceLock::new(),
            folder: None,
        })
    }

    /// Lets the light operator be kept in a folder, that of the result.
    #[must_use]
    pub fn kept_in(self, folder: &Path) -> Self {
        Self {
            folder: Some(folder.to_owned()),
            ..self
        }
    }

    /// Factor on all radiometric values before they are packed: keeps them in the range of the
    /// format at any exposure.
    fn scale(&self) -> f32 {
        self.exposure.exp2()
    }

    /// The description that the page reads first.
    #[must_use]
    pub fn description(&self) -> Value {
        let s = &self.solution;
        let mesh = &s.mesh;
        let (low, high) = mesh.bounds();
        let size = |w: usize, h: usize| json!([w, h]);
        let probes: Vec<Value> = self
            .probes
            .iter()
            .map(|p| json!({"position": p.position.to_array(), "room": p.room}))
            .collect();
        json!({
            "name": self.name,
            "version": env!("CARGO_PKG_VERSION"),
            "vertices": mesh.positions.len(),
            "triangles": mesh.triangles.len(),
            "low": low.to_array(),
            "high": high.to_array(),
            "exposure": self.exposure,
            "caps": encode::CAPS,
            "sizes": {
                "albedo": size(s.albedo.width, s.albedo.height),
                "roughness": size(s.roughness.width, s.roughness.height),
                "irradiance": size(s.irradiance.width, s.irradiance.height),
            },
            "classes": self.classes(),
            "rooms": s.rooms.data.iter().copied().max().unwrap_or(0),
            "lamps": self.lamps.iter().map(|l| self.lamp(l)).collect::<Vec<_>>(),
            "lights": self.solution.lamps.iter().map(light).collect::<Vec<_>>(),
            "probes": {"levels": probes::LEVELS, "places": probes},
            "cameras": self.cameras(),
            "panes": s.transmission.is_some(),
        })
    }

    fn class_name(&self, id: u16) -> String {
        self.scene
            .as_ref()
            .map_or_else(|| unnamed_class(id), |s| s.class_name(id))
    }

    fn lamp(&self, lamp: &Slider) -> Value {
        let outside = lamp.triangles.is_empty();
        let name = if outside {
            lamp.name.clone()
        } else {
            format!("{} ({})", lamp.name, self.class_name(lamp.class))
        };
        json!({"name": name, "ids": lamp.ids, "outside": outside, "centre": lamp.centre.to_array(), "triangles": lamp.triangles.len()})
    }

    /// Classes by falling area, with their mean material: what an edit starts from.
    fn classes(&self) -> Vec<Value> {
        #[derive(Default)]
        struct Tally {
            area: f64,
            albedo: Vec3,
            roughness: f64,
        }
        let s = &self.solution;
        let mut tallies: BTreeMap<u16, Tally> = BTreeMap::new();
        for t in 0..s.mesh.triangles.len() {
            let uv = s.mesh.uv(t, 1.0 / 3.0, 1.0 / 3.0);
            let at = |w: usize, h: usize| uv * Vec2::new(w as f32, h as f32);
            let area = s.mesh.area(t);
            if !(uv.is_finite() && area.is_finite()) {
                continue;
            }
            let tally = tallies
                .entry(*s.labels.nearest(at(s.labels.width, s.labels.height)))
                .or_default();
            tally.area += f64::from(area);
            tally.albedo += *s.albedo.nearest(at(s.albedo.width, s.albedo.height)) * area;
            tally.roughness += f64::from(
                *s.roughness
                    .nearest(at(s.roughness.width, s.roughness.height))
                    * area,
            );
        }
        let whole: f64 = tallies.values().map(|t| t.area).sum::<f64>().max(1e-30);
        let mut sorted: Vec<_> = tallies.into_iter().filter(|(_, t)| t.area > 0.0).collect();
        sorted.sort_by(|a, b| b.1.area.total_cmp(&a.1.area).then(a.0.cmp(&b.0)));
        sorted
            .into_iter()
            .map(|(id, t)| {
                let albedo = t.albedo / t.area as f32;
                json!({
                    "id": id,
                    "name": self.class_name(id),
                    "share": t.area / whole,
                    "albedo": albedo.to_array(),
                    "albedo_srgb": inspect::hex(albedo),
                    "roughness": t.roughness / t.area,
                })
            })
            .collect()
    }

    fn cameras(&self) -> Vec<Value> {
        let Some(scene) = &self.scene else {
            return Vec::new();
        };
        scene
            .views
            .iter()
            .map(|v| {
                json!({
                    "name": v.stem,
                    "held_out": v.split == Split::Test,
                    "position": v.camera.position.to_array(),
                    "world_from_camera": v.camera.world_from_camera.to_cols_array(),
                    "panorama": v.camera.projection == crate::core::geometry::Projection::Equirectangular,
                })
            })
            .collect()
    }

    /// Positions (f32 × 3), atlas coordinates (f32 × 2), normals and lamp numbers (i8 × 4), corner
    /// indices (u32 × 3), one after the other.
    #[must_use]
    pub fn mesh(&self) -> Arc<Vec<u8>> {
        let pack = || {
            let mesh = &self.solution.mesh;
            let lamp = lamps::lamp_of_vertices(mesh, &self.lamps);
            let mut bytes =
                Vec::with_capacity(mesh.positions.len() * 24 + mesh.triangles.len() * 12);
            bytes.extend_from_slice(bytemuck::cast_slice(&mesh.positions));
            bytes.extend_from_slice(bytemuck::cast_slice(&mesh.uvs));
            for (n, lamp) in mesh.normals.iter().zip(&lamp) {
                bytes.extend(
                    n.to_array()
                        .map(|x| ((x.clamp(-1.0, 1.0) * 127.0).round() as i8).cast_unsigned()),
                );
                bytes.push(*lamp);
            }
            bytes.extend_from_slice(bytemuck::cast_slice(&mesh.triangles));
            Arc::new(gzip(&bytes))
        };
        self.mesh.get_or_init(pack).clone()
    }

    /// A texture whose longest side is at most `cap`.
    #[must_use]
    pub fn texture(&self, layer: Layer, cap: usize) -> Arc<Vec<u8>> {
        let slot = self
            .textures
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .entry((layer, cap))
            .or_default()
            .clone();
        let s = &self.solution;
        let pack = || {
            let block = match layer {
                Layer::Albedo => encode::albedo(&s.albedo, s.metallic.as_ref(), cap),
                Layer::Roughness => encode::roughness(&s.roughness, s.transmission.as_ref(), cap),
                Layer::Irradiance => encode::radiometric(&s.irradiance, cap, self.scale()),
                Layer::Radiance => encode::radiometric(&s.radiance, cap, self.scale()),
                Layer::Emission => encode::radiometric(&s.emission, cap, self.scale()),
                Layer::Confidence => encode::confidence(&s.confidence, cap),
                Layer::Ids => encode::ids(&s.labels, &s.rooms, cap),
            };
            Arc::new(gzip(&block))
        };
        slot.get_or_init(pack).clone()
    }

    /// The environment as a texture.
    #[must_use]
    pub fn environment(&self) -> Vec<u8> {
        gzip(&encode::radiometric(
            &self.solution.environment,
            1024,
            self.scale(),
        ))
    }

    /// The panoramas of the reflection probes.
    #[must_use]
    pub fn panoramas(&self) -> Arc<Vec<u8>> {
        let pack = || {
            Arc::new(probes::panoramas(
                &self.solution,
                &self.probes,
                &self.tracer,
                self.scale(),
                None,
            ))
        };
        self.panoramas.get_or_init(pack).clone()
    }

    /// The panoramas under changed light.
    pub fn relit_panoramas(&self, edit: &LightEdit) -> Vec<u8> {
        let light = self.light();
        let emitted = light.emission_factors(edit, self.solution.mesh.triangles.len());
        let relit = Relit {
            reflected: light.reflection_factors(edit, &self.solution),
            emitted: &emitted,
            outside: light.outside_factor(edit),
        };
        probes::panoramas(
            &self.solution,
            &self.probes,
            &self.tracer,
            self.scale(),
            Some(&relit),
        )
    }

    /// The tree that reflections are traced through ([`ray_tree::records`]); empty where they are not.
    #[must_use]
    pub fn ray_tree(&self) -> Arc<Vec<u8>> {
        let pack = || {
            let records = ray_tree::records(&self.solution.mesh);
            Arc::new(gzip(bytemuck::cast_slice(&records)))
        };
        self.ray_tree.get_or_init(pack).clone()
    }

    /// What surfaces send to a viewer under even light ([`response::table`]).
    #[must_use]
    pub fn response(&self) -> Arc<Vec<u8>> {
        let pack = || Arc::new(gzip(&response::table(self.solution.reflectance)));
        self.response.get_or_init(pack).clone()
    }

    /// The light that can be changed; traced when it is first asked for.
    pub fn light(&self) -> &PageLight {
        self.light.get_or_init(|| {
            let folder = self.folder.as_deref();
            PageLight::new(&self.solution, folder, &self.tracer)
        })
    }

    /// The photograph of a camera, or why there is none.
    ///
    /// # Errors
    /// If the photograph cannot be read.
    pub fn photograph(&self, camera: usize, cap: usize) -> Result<Option<Arc<Vec<u8>>>> {
        let Some(scene) = self.scene.as_ref().filter(|s| camera < s.views.len()) else {
            return Ok(None);
        };
        self.photos
            .packed(scene, camera, cap, self.scale())
            .map(Some)
    }

    /// What is known at an atlas coordinate and, with a scene, which views see the point.
    #[must_use]
    pub fn inspect(&self, uv: Vec2, point: Option<Vec3>) -> Value {
        let mut out = inspect::values(&self.solution, uv);
        out["class"] = json!(self.class_name(out["label"].as_u64().unwrap_or(0) as u16));
        if let (Some(scene), Some(point)) = (&self.scene, point) {
            let photograph = |i: usize| self.photos.pixels(scene, i).ok();
            out["observations"] = inspect::observations(scene, &self.tracer, point, &photograph);
        }
        out
    }
}

/// The exposure, in stops, at which the brightest twentieth of the surfaces' diffuse light clips.
fn exposure(solution: &Solution) -> f32 {
    let mesh = &solution.mesh;
    let size = |p: &crate::core::image::RgbPlane| Vec2::new(p.width as f32, p.height as f32);
    let step = (mesh.triangles.len() / 20_000).max(1);
    let mut bright: Vec<(f32, f32)> = (0..mesh.triangles.len())
        .step_by(step)
        .map(|t| {
            let uv = mesh.uv(t, 1.0 / 3.0, 1.0 / 3.0);
            let r = *solution.radiance.nearest(uv * size(&solution.radiance));
            (luminance(r), mesh.area(t))
        })
        .filter(|(l, a)| *l > 0.0 && l.is_finite() && *a > 0.0 && a.is_finite())
        .collect();
    bright.sort_by(|a, b| a.0.total_cmp(&b.0));
    let whole: f32 = bright.iter().map(|b| b.1).sum();
    let mut sum = 0.0;
    let white = bright.iter().find(|b| {
        sum += b.1;
        sum >= 0.95 * whole
    });
    white.map_or(0.0, |b| -b.0.log2()).clamp(-60.0, 60.0)
}

/// A lamp of `lights.json` as the page names it, in the file's coordinates.
fn light(lamp: &crate::solution::Lamp) -> Value {
    json!({"id": lamp.id, "kind": lamp.kind, "centre": lamp.centre, "area": lamp.area, "power": lamp.power})
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solution::tests::small_solution;

    #[test]
    fn exposure_follows_the_scenes_brightness() {
        let mut solution = small_solution();
        let base = exposure(&solution);
        for v in &mut solution.radiance.data {
            *v *= 1024.0;
        }
        assert!((exposure(&solution) - base + 10.0).abs() < 1e-4);
        solution.radiance.data.fill(Vec3::ZERO);
        assert!(
            exposure(&solution).abs() < 1e-6,
            "a black scene keeps its exposure"
        );
    }

    #[test]
    fn the_description_is_complete_and_finite() {
        let content = Content::new(small_solution(), None, None).expect("prepares");
        let d = content.description();
        assert_eq!(
            (d["vertices"].as_u64(), d["triangles"].as_u64()),
            (Some(4), Some(2))
        );
        assert!(d["classes"].as_array().is_some_and(|c| !c.is_empty()));
        assert_eq!(d["cameras"], json!([]));
        assert!(!d.to_string().contains("null"), "{d}");
        let shares: f64 = d["classes"]
            .as_array()
            .expect("classes")
            .iter()
            .filter_map(|c| c["share"].as_f64())
            .sum();
        assert!((shares - 1.0).abs() < 1e-9);
    }

    #[test]
    fn blocks_are_made_once() {
        let content = Content::new(small_solution(), None, None).expect("prepares");
        assert!(Arc::ptr_eq(
            &content.texture(Layer::Albedo, 1024),
            &content.texture(Layer::Albedo, 1024)
        ));
        assert!(Arc::ptr_eq(&content.mesh(), &content.mesh()));
        assert!(
            content
                .photograph(0, 1024)
                .expect("no scene is no failure")
                .is_none()
        );
    }

    #[test]
    fn a_foreign_scene_is_refused() {
        let solution = small_solution();
        let scene = Scene::from_parts(
            "elsewhere".into(),
            glam::DVec3::ONE,
            solution.mesh.clone(),
            Vec::new(),
            Vec::new(),
        );
        let e = Content::new(solution, Some(scene), None)
            .err()
            .expect("foreign");
        assert_eq!(e.exit_code(), 2);
        assert!(e.to_string().contains("elsewhere"), "{e}");
    }
}
