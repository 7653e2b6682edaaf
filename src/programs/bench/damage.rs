//! Copies of a scene whose training views (or geometry) are damaged in a known way. Held-out views
//! and ground truth stay as they are; what is not damaged is linked, not copied.

use crate::core::formats::{srgb8_from_linear, write_png_rgb8, write_png16, write_rgb_float};
use crate::core::geometry::Mesh;
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::luminance;
use crate::core::sampling::{KeyedRng, hash_u64};
use crate::error::{Error, Result};
use crate::scene::{Scene, Split, View};
use glam::{DMat3, DQuat, DVec3, Vec3};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// One kind of damage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Damage {
    /// None: the scene as it is.
    Clean,
    /// A square of this side, in label pixels, with a random wrong class in every view (the paper's
    /// supplement, Table 3).
    LabelSquares(usize),
    /// Labels moved by up to this many pixels, each view its own way.
    LabelShift(usize),
    /// Exposure drift (standard deviation in stops) and white balance drift (standard deviation of
    /// ln gain per channel).
    Exposure(f64, f64),
    /// Every second view clipped at this quantile of its luminance.
    Clipped(f64),
    /// Every view as an ordinary camera takes it.
    Camera(CameraDamage),
    /// Cameras moved (standard deviation per axis, metres) and turned (standard deviation,
    /// degrees).
    Pose(f64, f64),
    /// Vertices moved (standard deviation per axis, metres).
    Vertices(f64),
    /// Discs of 10 cm radius missing from the mesh: their share of its area.
    Holes(f64),
}

/// What an ordinary camera does to the light: clips it at the sensor's ceiling, adjusts exposure
/// and white balance to each view, and writes 8 bits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraDamage {
    /// Share of the pixels with a channel at the ceiling: of all views together, or of each one
    /// where it is exposed for itself.
    pub saturated: f64,
    /// 8-bit sRGB in PNG instead of linear float in EXR.
    pub eight_bit: bool,
    /// Standard deviation of ln gain per channel, drawn anew for every view, which is then also
    /// exposed for itself; `None`: one exposure and balance for all views, and it is known.
    pub balance: Option<f64>,
}

impl CameraDamage {
    /// Clipping alone, at a known exposure.
    const fn clipped(saturated: f64) -> Damage {
        Damage::Camera(Self {
            saturated,
            eight_bit: false,
            balance: None,
        })
    }

    /// Clipping and 8 bits at a known exposure.
    const fn encoded(saturated: f64) -> Damage {
        Damage::Camera(Self {
            saturated,
            eight_bit: true,
            balance: None,
        })
    }

    /// All of it.
    const fn automatic(saturated: f64, balance: f64) -> Damage {
        Damage::Camera(Self {
            saturated,
            eight_bit: true,
            balance: Some(balance),
        })
    }
}

/// The conditions of a full run, mildest first within each kind.
pub const CONDITIONS: &[(&str, Damage)] = &[
    ("clean", Damage::Clean),
    ("labels-16", Damage::LabelSquares(16)),
    ("labels-32", Damage::LabelSquares(32)),
    ("labels-64", Damage::LabelSquares(64)),
    ("labels-128", Damage::LabelSquares(128)),
    ("labels-256", Damage::LabelSquares(256)),
    ("label-edges-3px", Damage::LabelShift(3)),
    ("exposure-0.2ev-wb-3%", Damage::Exposure(0.2, 0.03)),
    ("clipped-2%", Damage::Clipped(0.98)),
    ("all-clipped-1%", CameraDamage::clipped(0.01)),
    ("all-clipped-3%", CameraDamage::clipped(0.03)),
    ("all-clipped-5%", CameraDamage::clipped(0.05)),
    ("all-clipped-10%", CameraDamage::clipped(0.1)),
    ("8bit-5%", CameraDamage::encoded(0.05)),
    ("auto-5%-wb-0%", CameraDamage::automatic(0.05, 0.0)),
    ("auto-5%-wb-5%", CameraDamage::automatic(0.05, 0.05)),
    ("pose-1cm-0.3deg", Damage::Pose(0.01, 0.3)),
    ("vertices-1cm", Damage::Vertices(0.01)),
    ("holes-2%", Damage::Holes(0.02)),
];

/// A standard normal number (Box & Muller 1958).
fn normal(rng: &mut KeyedRng) -> f64 {
    let (u, v) = (
        f64::from(rng.next_f32()).max(1e-9),
        f64::from(rng.next_f32()),
    );
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// Writes the damaged scene into the new folder `to`.
///
/// # Errors
/// A scene whose files lie outside its folder or, where images are to be damaged, are not EXR;
/// files that cannot be written.
pub fn write_damaged(scene: &Scene, damage: Damage, seed: u64, to: &Path) -> Result<()> {
    let source = scene
        .folder
        .canonicalize()
        .map_err(|e| Error::io(&scene.folder, e))?;
    let file = source.join("transforms.json");
    let text = std::fs::read(&file).map_err(|e| Error::io(&file, e))?;
    let mut json: Value =
        serde_json::from_slice(&text).map_err(|e| Error::input(&file, e.to_string()))?;
    std::fs::create_dir_all(to).map_err(|e| Error::io(to, e))?;
    let train: Vec<&View> = scene
        .views
        .iter()
        .filter(|v| v.split == Split::Train)
        .collect();
    let copy = Copy {
        scene,
        damage,
        gains: match damage {
            Damage::Camera(camera) => camera_gains(scene, &train, camera, seed)?,
            _ => exposure_gains(damage, train.len(), seed),
        },
        seed,
        source,
        to: to.to_path_buf(),
    };
    copy.link(Path::new("gt"))?;
    copy.geometry(&mut json, &file)?;
    let frames = json["frames"]
        .as_array_mut()
        .ok_or_else(|| Error::input(&file, "has no frames"))?;
    let mut renamed = Vec::new();
    for frame in frames.iter_mut() {
        let path = PathBuf::from(frame["file_path"].as_str().unwrap_or_default());
        let number = train
            .iter()
            .position(|v| v.image_path.file_name() == path.file_name());
        let damaged = number.map(|k| (k, train[k]));
        copy.frame(frame, &path, damaged)?;
        let now = frame["file_path"].clone();
        if now != json!(path) {
            renamed.push((json!(path), now));
        }
    }
    rename_training(&mut json, &renamed);
    copy.write("transforms.json", &format!("{json:#}\n"))
}

/// Training images in another format have another name.
fn rename_training(json: &mut Value, renamed: &[(Value, Value)]) {
    for name in (json["train_filenames"].as_array_mut().into_iter()).flatten() {
        if let Some((_, now)) = renamed.iter().find(|(before, _)| before == name) {
            *name = now.clone();
        }
    }
}

struct Copy<'a> {
    scene: &'a Scene,
    damage: Damage,
    /// Per training view, for drifting exposure; up to the camera's ceiling at 1.
    gains: Vec<Vec3>,
    seed: u64,
    source: PathBuf,
    to: PathBuf,
}

impl Copy<'_> {
    /// Mesh and rooms: linked, or the mesh damaged.
    fn geometry(&self, json: &mut Value, file: &Path) -> Result<()> {
        let mesh = json["mesh_path"].as_str().unwrap_or_default().to_owned();
        if matches!(self.damage, Damage::Vertices(_) | Damage::Holes(_)) {
            if json["up_axis"]
                .as_str()
                .is_some_and(|a| a.contains(['z', 'Z']))
            {
                return Err(Error::input(
                    file,
                    "damaging the mesh of a z-up scene is not supported; turn the scene y-up",
                ));
            }
            let damaged = damaged_mesh(&self.scene.mesh, self.damage, self.seed);
            self.write("damaged.obj", &obj(&damaged, self.scene.origin))?;
            json["mesh_path"] = "damaged.obj".into();
        } else {
            self.link(Path::new(&mesh))?;
        }
        let Some(rooms) = json["rooms_path"].as_str() else {
            return Ok(());
        };
        self.link(Path::new(rooms))?;
        for side in [
            Path::new(rooms).with_extension("json"),
            Path::new(rooms).with_file_name("rooms.json"),
        ] {
            if self.source.join(&side).is_file() {
                self.link(&side)?;
            }
        }
        Ok(())
    }

    /// Links a file or folder of the scene; nothing where the scene has none.
    fn link(&self, path: &Path) -> Result<()> {
        let from = self.source.join(path);
        if !from.exists() {
            return Ok(());
        }
        let to = self.place(path)?;
        match std::os::unix::fs::symlink(&from, &to) {
            Err(e) if e.kind() != std::io::ErrorKind::AlreadyExists => Err(Error::io(&to, e)),
            _ => Ok(()),
        }
    }

    /// Where a file of the scene goes in the copy; its folder exists afterwards.
    fn place(&self, path: &Path) -> Result<PathBuf> {
        let inside = path.components().all(|c| {
            matches!(
                c,
                std::path::Component::Normal(_) | std::path::Component::CurDir
            )
        });
        if !inside {
            return Err(Error::input(
                path,
                "lies outside the scene's folder; a damaged copy needs all files inside it",
            ));
        }
        let to = self.to.join(path);
        let folder = to.parent().unwrap_or(&self.to);
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        Ok(to)
    }

    fn write(&self, name: &str, text: &str) -> Result<()> {
        let path = self.to.join(name);
        std::fs::write(&path, text).map_err(|e| Error::io(&path, e))
    }

    /// One frame: its files linked or damaged, its pose kept or damaged.
    fn frame(&self, frame: &mut Value, path: &Path, view: Option<(usize, &View)>) -> Result<()> {
        let (scene, damage, gains) = (self.scene, self.damage, &self.gains);
        if let Some(mask) = frame["mask_path"].as_str() {
            self.link(Path::new(mask))?;
        }
        let label = frame["label_path"].as_str().map(PathBuf::from);
        let mut rng = KeyedRng::new(
            self.seed,
            hash_u64(0xda_4a6e, view.map_or(u64::MAX, |v| v.0 as u64)),
        );
        let labels = match (view, damage) {
            (Some((_, v)), Damage::LabelSquares(_) | Damage::LabelShift(_)) => {
                scene.load_labels(v)?
            }
            _ => None,
        };
        match (&label, labels) {
            (Some(path), Some(labels)) => write_png16(
                self.place(path)?,
                &damaged_labels(scene, &labels, damage, &mut rng),
            )?,
            (Some(path), None) => self.link(path)?,
            _ => {}
        }
        let image = match (view, damage) {
            (Some((k, v)), Damage::Exposure(..)) => {
                Some(scene.load_radiance(v)?.map(|l| *l * gains[k]))
            }
            (Some((k, v)), Damage::Clipped(quantile)) if k % 2 == 1 => {
                Some(clipped(&scene.load_radiance(v)?, quantile))
            }
            (Some((k, v)), Damage::Camera(camera)) => {
                let gain = gains[k];
                let image = scene.load_radiance(v)?.map(|l| (*l * gain).min(Vec3::ONE));
                return self.photograph(frame, path, &image, camera, gain);
            }
            _ => None,
        };
        match image {
            Some(image) if path.extension().is_some_and(|e| e == "exr") => {
                frame["exposure_ev"] = json!(0.0);
                write_rgb_float(self.place(path)?, &image)?;
            }
            Some(_) => {
                return Err(Error::input(
                    path,
                    "is not EXR; only EXR photographs can be damaged",
                ));
            }
            None => self.link(path)?,
        }
        if let (Some(_), Damage::Pose(metres, degrees)) = (view, damage) {
            move_camera(&mut frame["transform_matrix"], metres, degrees, &mut rng);
        }
        Ok(())
    }

    /// Writes what the camera made of a view, and says in the frame what a photographer would know.
    fn photograph(
        &self,
        frame: &mut Value,
        path: &Path,
        image: &RgbPlane,
        camera: CameraDamage,
        gain: Vec3,
    ) -> Result<()> {
        if camera.balance.is_none() {
            frame["exposure_ev"] = json!(-gain.x.log2());
        } else if let Some(frame) = frame.as_object_mut() {
            frame.remove("exposure_ev");
        }
        if !camera.eight_bit {
            frame["color_space"] = json!("rec709");
            return write_rgb_float(self.place(&path.with_extension("exr"))?, image)
                .map(|()| frame["file_path"] = json!(path.with_extension("exr")));
        }
        let pixels: Vec<u8> = image
            .data
            .iter()
            .flat_map(|l| l.to_array().map(srgb8_from_linear))
            .collect();
        let path = path.with_extension("png");
        write_png_rgb8(self.place(&path)?, image.width, image.height, &pixels)?;
        // whatever the scene says of its own files
        frame["color_space"] = json!("srgb");
        frame["file_path"] = json!(path);
        Ok(())
    }
}

/// Gains per training view that bring the given share of pixels to the ceiling at 1.
fn camera_gains(
    scene: &Scene,
    train: &[&View],
    camera: CameraDamage,
    seed: u64,
) -> Result<Vec<Vec3>> {
    let mut rng = KeyedRng::new(seed, 0xca3e7a);
    let mut gains: Vec<Vec3> = train
        .iter()
        .map(|_| {
            let sd = camera.balance.unwrap_or(0.0);
            (DVec3::new(normal(&mut rng), normal(&mut rng), normal(&mut rng)) * sd)
                .exp()
                .as_vec3()
        })
        .collect();
    let mut peaks: Vec<Vec<f32>> = train
        .iter()
        .zip(&gains)
        .map(|(v, g)| {
            let image = scene.load_radiance(v)?;
            Ok(image.data.iter().map(|l| (*l * *g).max_element()).collect())
        })
        .collect::<Result<_>>()?;
    if camera.balance.is_none() {
        peaks = vec![peaks.concat(); 1];
    }
    let ceiling: Vec<f32> = peaks
        .into_iter()
        .map(|mut all| {
            all.sort_by(f32::total_cmp);
            let at = (all.len() as f64 * (1.0 - camera.saturated)) as usize;
            all.get(at.min(all.len().saturating_sub(1)))
                .copied()
                .unwrap_or(1.0)
                .max(f32::MIN_POSITIVE)
        })
        .collect();
    for (k, gain) in gains.iter_mut().enumerate() {
        *gain /= ceiling[k.min(ceiling.len() - 1)];
    }
    Ok(gains)
}

/// Gains per training view, of geometric mean 1: drift says nothing about the mean exposure.
fn exposure_gains(damage: Damage, views: usize, seed: u64) -> Vec<Vec3> {
    let Damage::Exposure(stops, balance) = damage else {
        return Vec::new();
    };
    let mut rng = KeyedRng::new(seed, 0xe7);
    let mut logs: Vec<DVec3> = (0..views)
        .map(|_| {
            let ev = std::f64::consts::LN_2 * stops * normal(&mut rng);
            DVec3::splat(ev)
                + DVec3::new(normal(&mut rng), normal(&mut rng), normal(&mut rng)) * balance
        })
        .collect();
    let mean = logs.iter().sum::<DVec3>() / views.max(1) as f64;
    logs.iter_mut().for_each(|l| *l -= mean);
    logs.into_iter().map(|l| l.exp().as_vec3()).collect()
}

fn clipped(image: &RgbPlane, quantile: f64) -> RgbPlane {
    let mut all: Vec<f32> = image.data.iter().map(|l| luminance(*l)).collect();
    all.sort_by(f32::total_cmp);
    let level = all
        .get(((all.len() as f64 * quantile) as usize).min(all.len().saturating_sub(1)))
        .copied()
        .unwrap_or(0.0);
    image.map(|l| l.min(Vec3::splat(level)))
}

fn damaged_labels(
    scene: &Scene,
    labels: &Plane<u16>,
    damage: Damage,
    rng: &mut KeyedRng,
) -> Plane<u16> {
    let (w, h) = (labels.width, labels.height);
    match damage {
        Damage::LabelSquares(side) => {
            let (sw, sh) = (side.min(w), side.min(h));
            let (x0, y0) = (rng.below(w - sw + 1), rng.below(h - sh + 1));
            let there = labels[(x0 + sw / 2, y0 + sh / 2)];
            let others: Vec<u16> = scene
                .classes
                .iter()
                .map(|c| c.id)
                .filter(|id| *id != there)
                .collect();
            let wrong = others
                .get(rng.below(others.len().max(1)))
                .copied()
                .unwrap_or(there);
            let mut out = labels.clone();
            for y in y0..y0 + sh {
                out.data[y * w + x0..y * w + x0 + sw].fill(wrong);
            }
            out
        }
        Damage::LabelShift(most) => {
            let step = |rng: &mut KeyedRng| rng.below(2 * most + 1) as i64 - most as i64;
            let (dx, dy) = (step(rng), step(rng));
            let at = |i: usize| {
                let (x, y) = ((i % w) as i64 + dx, (i / w) as i64 + dy);
                labels[(
                    x.rem_euclid(w as i64) as usize,
                    y.clamp(0, h as i64 - 1) as usize,
                )]
            };
            Plane {
                width: w,
                height: h,
                data: (0..w * h).map(at).collect(),
            }
        }
        _ => labels.clone(),
    }
}

fn move_camera(matrix: &mut Value, metres: f64, degrees: f64, rng: &mut KeyedRng) {
    let entry = |m: &Value, r: usize, c: usize| m[r][c].as_f64().unwrap_or(0.0);
    let column = |m: &Value, c: usize| DVec3::new(entry(m, 0, c), entry(m, 1, c), entry(m, 2, c));
    let rotation = DMat3::from_cols(column(matrix, 0), column(matrix, 1), column(matrix, 2));
    let axis = DVec3::new(normal(rng), normal(rng), normal(rng)).normalize_or(DVec3::Y);
    let turned = DMat3::from_quat(DQuat::from_axis_angle(
        axis,
        (degrees * normal(rng)).to_radians(),
    )) * rotation;
    let moved = column(matrix, 3) + DVec3::new(normal(rng), normal(rng), normal(rng)) * metres;
    for r in 0..3 {
        for c in 0..3 {
            matrix[r][c] = json!(turned.col(c)[r]);
        }
        matrix[r][3] = json!(moved[r]);
    }
}

fn damaged_mesh(mesh: &Mesh, damage: Damage, seed: u64) -> Mesh {
    let (lo, hi) = mesh.bounds();
    let mut out = mesh.clone();
    match damage {
        Damage::Vertices(metres) => {
            for p in &mut out.positions {
                // vertices at one place move together, and none leaves the bounding box
                let key = p
                    .to_array()
                    .iter()
                    .fold(0, |k, x| hash_u64(k, u64::from(x.to_bits())));
                let mut rng = KeyedRng::new(seed, key);
                let step =
                    DVec3::new(normal(&mut rng), normal(&mut rng), normal(&mut rng)) * metres;
                *p = (*p + step.as_vec3()).clamp(lo, hi);
            }
        }
        Damage::Holes(share) => {
            const RADIUS: f32 = 0.1;
            const LARGEST: f32 = 0.05;
            let mut rng = KeyedRng::new(seed, 0x401e);
            let small: Vec<usize> = (0..mesh.triangles.len())
                .filter(|&t| (1e-6..LARGEST).contains(&mesh.area(t)))
                .collect();
            let total: f32 = small.iter().map(|&t| mesh.area(t)).sum();
            let discs = (f64::from(total) * share
                / f64::from(std::f32::consts::PI * RADIUS * RADIUS))
            .round() as usize;
            let table = crate::core::sampling::Discrete::new(
                &small
                    .iter()
                    .map(|&t| f64::from(mesh.area(t)))
                    .collect::<Vec<_>>(),
            );
            let centres: Vec<Vec3> = (0..discs)
                .filter_map(|_| {
                    table.as_ref().map(|d| {
                        mesh.position(small[d.sample(rng.next_f32()).0], 1.0 / 3.0, 1.0 / 3.0)
                    })
                })
                .collect();
            let hit: Vec<bool> = (0..mesh.triangles.len())
                .map(|t| {
                    let p = mesh.position(t, 1.0 / 3.0, 1.0 / 3.0);
                    mesh.area(t) < LARGEST
                        && centres
                            .iter()
                            .any(|c| c.distance_squared(p) < RADIUS * RADIUS)
                })
                .collect();
            let mut t = 0;
            out.triangles.retain(|_| {
                t += 1;
                !hit[t - 1]
            });
        }
        _ => {}
    }
    out
}

/// The mesh as Wavefront OBJ in file coordinates (texture v upwards, as the format has it).
fn obj(mesh: &Mesh, origin: DVec3) -> String {
    let mut out = String::new();
    // writing to a string cannot fail
    for p in &mesh.positions {
        let p = p.as_dvec3() + origin;
        let _ = writeln!(out, "v {} {} {}", p.x, p.y, p.z);
    }
    for uv in &mesh.uvs {
        let _ = writeln!(out, "vt {} {}", uv.x, 1.0 - uv.y);
    }
    for n in &mesh.normals {
        let _ = writeln!(out, "vn {} {} {}", n.x, n.y, n.z);
    }
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| i + 1);
        let _ = writeln!(out, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}");
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::LoadOptions;

    /// Every damage yields a scene that loads, with the held-out views untouched and the training
    /// views changed as named.
    #[test]
    fn every_damage_is_a_scene_of_its_own() {
        let folder = tempfile::tempdir().expect("temp");
        let source = folder.path().join("scene");
        let options = crate::programs::synth::SynthOptions {
            rooms: 1,
            views: 4,
            test_views: 1,
            width: 64,
            spp: 1,
            texture: 512,
            no_denoise: true,
            ..crate::programs::synth::SynthOptions::default()
        };
        crate::programs::synth::generate(
            &options,
            &source,
            &crate::core::progress::Progress::silent(),
        )
        .expect("synth");
        let scene = Scene::load(&source, &LoadOptions::default()).expect("loads");
        for (name, damage) in CONDITIONS {
            let to = folder.path().join(name);
            write_damaged(&scene, *damage, 5, &to).expect(name);
            let copy = Scene::load(&to, &LoadOptions::default()).expect(name);
            assert_eq!(copy.views.len(), scene.views.len(), "{name}");
            let (mut labels, mut images, mut poses) = (0, 0, 0);
            for (a, b) in scene.views.iter().zip(&copy.views) {
                assert_eq!((a.split, &a.stem), (b.split, &b.stem));
                let changed = [
                    scene.load_labels(a).expect("labels") != copy.load_labels(b).expect("labels"),
                    scene.load_radiance(a).expect("image") != copy.load_radiance(b).expect("image"),
                    a.camera.position.distance(b.camera.position) > 1e-3,
                ];
                assert!(
                    a.split == Split::Train || changed == [false; 3],
                    "{name}: held-out views stay"
                );
                labels += usize::from(changed[0]);
                images += usize::from(changed[1]);
                poses += usize::from(changed[2]);
            }
            let expected = match damage {
                Damage::LabelSquares(_) => labels == 3,
                Damage::LabelShift(_) => labels >= 2,
                Damage::Exposure(..) => images == 3,
                Damage::Clipped(_) => images == 1,
                Damage::Camera(_) => images == 3,
                Damage::Pose(..) => poses == 3,
                Damage::Vertices(_) => copy.mesh.positions != scene.mesh.positions,
                Damage::Holes(_) => copy.mesh.triangles.len() <= scene.mesh.triangles.len(),
                Damage::Clean => labels + images + poses == 0,
            };
            assert!(
                expected,
                "{name}: {labels} labels, {images} images, {poses} poses changed"
            );
            assert!(
                (copy.origin - scene.origin).length() < 1e-6,
                "{name}: the bounding box stays"
            );
        }
    }
}
