//! The output folder: a solution on disk and back.
//!
//! Everything is written aside first (a hidden folder inside the output folder, so that it lies on
//! the same file system) and renamed into place only when every file is complete: a reader sees the
//! old solution or the new one, and a full disk leaves the old one untouched.

use super::Solution;
use super::camera_masks::{read_camera_masks, replace_camera_masks, write_camera_masks};
use super::generation::other_run;
use super::glb::{GlbOptions, marked_glb, read_glb};
use super::lamps::{self, LIGHTS};
use crate::core::formats::{
    AsideFolder, Marked, generation_mark, read_labels, read_plane, read_rgb, read_two_channels,
    remove_if_there,
};
use crate::core::image::{Plane, RgbPlane};
use crate::error::{Error, Result};
use std::path::Path;

/// Files of a solution in the order in which they are renamed into place; `scene.glb` last, as the
/// mark of completeness.
pub const FILES: [&str; 11] = [
    "albedo.exr",
    "roughness.exr",
    "irradiance.exr",
    "radiance.exr",
    "emission.exr",
    "confidence.exr",
    "labels.png",
    "rooms.png",
    "environment.exr",
    LIGHTS,
    "scene.glb",
];

/// The scores that `eval` leaves beside a solution.
const SCORES: &str = "eval/metrics.json";

/// A file that only solutions with a stated error of their irradiance have.
const IRRADIANCE_ERROR: &str = "irradiance_error.exr";

/// A file that only solutions with metal have.
const METALLIC: &str = "metallic.exr";

/// A file that only solutions with panes have.
const TRANSMISSION: &str = "transmission.exr";

/// Choices of [`Solution::save`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SaveOptions {
    /// The glTF file's choices.
    pub glb: GlbOptions,
}

impl Solution {
    /// Writes the files of docs/outputs.md into `folder`, creating it if need be: all or none.
    ///
    /// Every file carries the solution's [generation](Solution::generation), which is returned.
    ///
    /// # Errors
    /// If the folder cannot be written to; what was there before then stays.
    pub fn save(&self, folder: &Path, options: &SaveOptions) -> Result<String> {
        self.check_finite()?;
        let generation = self.generation();
        let marked = Marked(&generation);
        let before = generation_mark(&folder.join(FILES[0])).ok().flatten();
        let aside = AsideFolder::new(folder)?;
        let at = |name: &str| aside.path().join(name);
        let glb = || {
            let bytes = marked_glb(self, &options.glb, &generation)?;
            std::fs::write(at("scene.glb"), bytes)
                .map_err(|e| Error::io(folder.join("scene.glb"), e))
        };
        let textures = || {
            marked.rgb_half(&at("albedo.exr"), &self.albedo)?;
            marked.plane_half(&at("roughness.exr"), &self.roughness)?;
            marked.radiance(&at("irradiance.exr"), &self.irradiance)?;
            marked.radiance(&at("radiance.exr"), &self.radiance)?;
            marked.radiance(&at("emission.exr"), &self.emission)?;
            marked.two_channels_half(&at("confidence.exr"), &self.confidence)?;
            for (name, plane) in self.optional_planes() {
                if let Some(plane) = plane {
                    marked.plane_half(&at(name), plane)?;
                }
            }
            marked.png16(&at("labels.png"), &self.labels)?;
            marked.png16(&at("rooms.png"), &self.rooms)?;
            write_camera_masks(aside.path(), &self.camera_masks)?;
            marked.radiance(&at("environment.exr"), &self.environment)?;
            let path = at(LIGHTS);
            std::fs::write(
                &path,
                lamps::encode(&self.lamps, &self.portals, &generation)?,
            )
            .map_err(|e| Error::io(folder.join(LIGHTS), e))
        };
        let (glb, textures) = crate::core::parallel::join(glb, textures);
        textures.and(glb)?;
        for (name, plane) in self.optional_planes() {
            match plane {
                Some(_) => aside.publish(folder, &[name])?,
                None => remove_if_there(&folder.join(name))?,
            }
        }
        replace_camera_masks(&aside, folder)?;
        aside.publish(folder, &FILES)?;
        if before.is_some_and(|before| before != generation) {
            // they are of the solution that lay here
            remove_if_there(&folder.join(SCORES))?;
        }
        Ok(generation)
    }

    /// Textures that not every solution has, under the names of their files.
    const fn optional_planes(&self) -> [(&'static str, Option<&Plane<f32>>); 3] {
        [
            (IRRADIANCE_ERROR, self.irradiance_error.as_ref()),
            (METALLIC, self.metallic.as_ref()),
            (TRANSMISSION, self.transmission.as_ref()),
        ]
    }

    /// What tells this solution from any other: a hash of all it consists of, so that the same
    /// content has the same generation.
    #[must_use]
    pub fn generation(&self) -> String {
        let mut hash = blake3::Hasher::new();
        let mesh = &self.mesh;
        let columns: [&[u8]; 13] = [
            bytemuck::cast_slice(&mesh.positions),
            bytemuck::cast_slice(&mesh.normals),
            bytemuck::cast_slice(&mesh.uvs),
            bytemuck::cast_slice(&mesh.triangles),
            bytemuck::cast_slice(&self.albedo.data),
            bytemuck::cast_slice(&self.roughness.data),
            bytemuck::cast_slice(&self.irradiance.data),
            bytemuck::cast_slice(&self.radiance.data),
            bytemuck::cast_slice(&self.emission.data),
            bytemuck::cast_slice(&self.confidence.data),
            bytemuck::cast_slice(&self.labels.data),
            bytemuck::cast_slice(&self.rooms.data),
            bytemuck::cast_slice(&self.environment.data),
        ];
        for column in columns {
            hash.update(&(column.len() as u64).to_le_bytes());
            hash.update_rayon(column);
        }
        if let Some(error) = &self.irradiance_error {
            hash.update_rayon(bytemuck::cast_slice(&error.data));
        }
        for (name, share) in [
            (METALLIC, &self.metallic),
            (TRANSMISSION, &self.transmission),
        ] {
            if let Some(share) = share {
                hash.update(name.as_bytes());
                hash.update_rayon(bytemuck::cast_slice(&share.data));
            }
        }
        hash.update(format!("{:?} {:?}", self.origin, self.reflectance).as_bytes());
        hash.finalize().to_hex()[..32].to_owned()
    }

    /// Reads what [`Solution::save`] wrote. Textures come back at file precision (half), the mesh
    /// bit for bit.
    ///
    /// # Errors
    /// If a file is missing, damaged, or does not fit the others.
    pub fn load(folder: &Path) -> Result<Self> {
        if !folder.is_dir() {
            return Err(Error::input(
                folder,
                "is not a folder; expected the output folder of `unbake solve SCENE -o OUT`",
            ));
        }
        let missing: Vec<Error> = FILES
            .iter()
            .map(|name| folder.join(name))
            .filter(|path| !path.is_file() && !path.ends_with(LIGHTS))
            .map(|path| {
                Error::input(
                    path,
                    "is missing from the solution; run `unbake solve` again",
                )
            })
            .collect();
        if !missing.is_empty() {
            return Err(Error::Inputs(missing));
        }
        let glb = read_glb(&folder.join("scene.glb"))?;
        one_generation(folder, glb.generation.as_deref())?;
        let rgb = |name: &str| read_rgb(folder.join(name));
        let optional = |name: &str| match folder.join(name) {
            path if path.is_file() => read_plane(path).map(Some),
            _ => Ok(None),
        };
        let albedo = rgb("albedo.exr")?;
        let share = |name: &str, of: &str| -> Result<Option<Plane<f32>>> {
            let plane = optional(name)?;
            if let Some(plane) = &plane {
                check_share(&folder.join(name), of, plane, &albedo)?;
            }
            Ok(plane)
        };
        let metallic = share(METALLIC, "metal")?;
        let transmission = share(TRANSMISSION, "transmitted light")?;
        let mut solution = Self {
            mesh: glb.mesh,
            origin: glb.origin,
            albedo,
            metallic,
            transmission,
            roughness: read_plane(folder.join("roughness.exr"))?,
            irradiance: rgb("irradiance.exr")?,
            radiance: rgb("radiance.exr")?,
            emission: rgb("emission.exr")?,
            confidence: read_two_channels(folder.join("confidence.exr"))?,
            irradiance_error: optional(IRRADIANCE_ERROR)?,
            labels: read_labels(folder.join("labels.png"))?,
            rooms: read_labels(folder.join("rooms.png"))?,
            environment: rgb("environment.exr")?,
            reflectance: glb.reflectance,
            lamps: Vec::new(),
            portals: Vec::new(),
            camera_masks: read_camera_masks(folder)?,
        };
        (solution.lamps, solution.portals) =
            lamps::read(folder, &solution, glb.generation.as_deref())?;
        Ok(solution)
    }

    /// Every texture must be finite: a NaN in a file would surface much later, in another program.
    fn check_finite(&self) -> Result<()> {
        let rgb = [
            ("albedo", &self.albedo),
            ("irradiance", &self.irradiance),
            ("radiance", &self.radiance),
            ("emission", &self.emission),
            ("environment", &self.environment),
        ];
        let first = rgb
            .iter()
            .find_map(|(name, plane)| {
                plane
                    .data
                    .iter()
                    .position(|v| !v.is_finite())
                    .map(|i| (*name, i, plane.width))
            })
            .or_else(|| {
                let i = self.roughness.data.iter().position(|v| !v.is_finite())?;
                Some(("roughness", i, self.roughness.width))
            })
            .or_else(|| {
                let i = self.confidence.data.iter().position(|v| !v.is_finite())?;
                Some(("confidence", i, self.confidence.width))
            })
            .or_else(|| {
                let optional = [
                    ("irradiance error", &self.irradiance_error),
                    ("metallic", &self.metallic),
                    ("transmission", &self.transmission),
                ];
                optional.into_iter().find_map(|(name, plane)| {
                    let plane = plane.as_ref()?;
                    let i = plane.data.iter().position(|v| !v.is_finite())?;
                    Some((name, i, plane.width))
                })
            });
        match first {
            None => Ok(()),
            Some((name, i, width)) => Err(Error::Failed(format!(
                "the {name} texture is not finite at texel ({}, {}): nothing was written; please report this with the scene",
                i % width.max(1),
                i / width.max(1)
            ))),
        }
    }
}

/// Refuses a texture of shares (`of` metal, say) that is not of the albedo's size, or not in [0, 1].
fn check_share(path: &Path, of: &str, share: &Plane<f32>, albedo: &RgbPlane) -> Result<()> {
    let (w, h) = (share.width, share.height);
    if (w, h) != (albedo.width, albedo.height) {
        return Err(Error::input(
            path,
            format!(
                "is {w}x{h}, expected {}x{}, the size of albedo.exr; write it at that size, or delete it for a scene without {of}",
                albedo.width, albedo.height
            ),
        ));
    }
    let wrong = |m: &f32| !(0.0..=1.0).contains(m);
    if let Some(i) = share.data.iter().position(wrong) {
        return Err(Error::input(
            path,
            format!(
                "is {} at texel ({}, {}), expected a share of {of} from 0 to 1; mend it, or delete it for a scene without {of}",
                share.data[i],
                i % w,
                i / w
            ),
        ));
    }
    Ok(())
}

/// Refuses a folder whose files come from different runs: one that was killed between two renames,
/// or copied together. Files without a mark (of an older version, or changed by hand) are accepted.
fn one_generation(folder: &Path, of_glb: Option<&str>) -> Result<()> {
    let Some(expected) = of_glb else {
        return Ok(());
    };
    for name in FILES
        .iter()
        .chain(&[IRRADIANCE_ERROR, METALLIC, TRANSMISSION])
    {
        let path = folder.join(name);
        if ["scene.glb", LIGHTS].contains(name) || !path.is_file() {
            continue;
        }
        if generation_mark(&path)?.is_some_and(|mark| mark != expected) {
            return Err(other_run(&path));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solution::tests::small_solution;
    use glam::{Vec2, Vec3};

    #[test]
    fn scores_of_another_solution_are_taken_away() {
        let folder = tempfile::tempdir().expect("temp");
        let save = |solution: &Solution| {
            let saved = solution.save(folder.path(), &SaveOptions::default());
            saved.expect("saves")
        };
        let mut solution = small_solution();
        save(&solution);
        let scores = folder.path().join(SCORES);
        std::fs::create_dir_all(scores.parent().expect("folder")).expect("folder");
        std::fs::write(&scores, b"{}").expect("writes");
        save(&solution);
        assert!(scores.is_file(), "they are of this solution");
        solution.albedo.data[0] += Vec3::splat(0.01);
        save(&solution);
        assert!(!scores.is_file());
    }

    #[test]
    fn a_solution_survives_the_disk() {
        let folder = tempfile::tempdir().expect("temp");
        let out = folder.path().join("deep/out");
        let solution = small_solution();
        solution.save(&out, &SaveOptions::default()).expect("saves");
        let mut names: Vec<String> = std::fs::read_dir(&out)
            .expect("lists")
            .map(|e| e.expect("entry").file_name().into_string().expect("utf-8"))
            .collect();
        names.sort();
        let mut expected = FILES.map(String::from).to_vec();
        expected.push(IRRADIANCE_ERROR.into());
        expected.push("camera_mask_panorama_8x4.png".into());
        expected.sort();
        assert_eq!(
            names, expected,
            "exactly the promised files, nothing left aside"
        );

        let back = Solution::load(&out).expect("loads");
        assert_eq!(back.mesh, solution.mesh, "geometry is bit-exact");
        assert_eq!(back.origin, solution.origin, "origin is exact in f64");
        assert_eq!(back.labels, solution.labels);
        assert_eq!(back.camera_masks, solution.camera_masks);
        assert_eq!(back.rooms, solution.rooms);
        let close = |a: &RgbPlane, b: &RgbPlane| {
            assert_eq!((a.width, a.height), (b.width, b.height));
            for (a, b) in a.data.iter().zip(&b.data) {
                assert!(
                    (*a - *b).abs().max_element() <= 1e-3 * b.abs().max_element() + 1e-6,
                    "{a} {b}"
                );
            }
        };
        close(&back.albedo, &solution.albedo);
        close(&back.irradiance, &solution.irradiance);
        close(&back.radiance, &solution.radiance);
        close(&back.emission, &solution.emission);
        close(&back.environment, &solution.environment);
        for (a, b) in back.roughness.data.iter().zip(&solution.roughness.data) {
            assert!((a - b).abs() < 1e-3);
        }
        for (a, b) in back.confidence.data.iter().zip(&solution.confidence.data) {
            assert!((*a - *b).abs().max_element() <= 1e-3 * b.abs().max_element());
        }
    }

    #[test]
    fn files_of_two_runs_are_no_solution() {
        let (first, second) = (tempfile::tempdir(), tempfile::tempdir());
        let (first, second) = (first.expect("temp"), second.expect("temp"));
        let mut solution = small_solution();
        let options = SaveOptions::default();
        let one = solution.save(first.path(), &options).expect("saves");
        assert_eq!(one, solution.generation(), "the content decides");
        solution.albedo.data[0].x += 0.25;
        let two = solution.save(second.path(), &options).expect("saves");
        assert_ne!(one, two);
        let marked = FILES.iter().filter(|n| **n != LIGHTS);
        for name in marked.chain([&IRRADIANCE_ERROR]) {
            let path = first.path().join(name);
            let own = std::fs::read(&path).expect("reads");
            std::fs::copy(second.path().join(name), &path).expect("mixes");
            let e = Solution::load(first.path()).expect_err("a mixture");
            assert!(
                e.exit_code() == 2 && e.to_string().contains("another run"),
                "{name}: {e}"
            );
            std::fs::write(&path, own).expect("restores");
        }
        Solution::load(first.path()).expect("whole again");
        // a texture painted by hand has no mark
        let path = first.path().join("albedo.exr");
        crate::core::formats::write_rgb_half(path, &solution.albedo).expect("painted");
        Solution::load(first.path()).expect("accepted");
    }

    #[test]
    fn outputs_say_their_primaries() {
        let folder = tempfile::tempdir().expect("temp");
        let options = SaveOptions::default();
        small_solution()
            .save(folder.path(), &options)
            .expect("saves");
        let bytes = std::fs::read(folder.path().join("albedo.exr")).expect("reads");
        let found = |w: &[u8]| bytes.windows(w.len()).any(|x| x == w);
        assert!(found(b"chromaticities\0chromaticities\0"));
    }

    #[test]
    fn faint_light_keeps_its_precision() {
        let folder = tempfile::tempdir().expect("temp");
        let mut solution = small_solution();
        solution.radiance.data.iter_mut().for_each(|v| *v *= 1e-7);
        let expected = solution.radiance.clone();
        let options = SaveOptions::default();
        solution.save(folder.path(), &options).expect("saves");
        let back = Solution::load(folder.path()).expect("loads").radiance;
        assert_eq!(back, expected, "single precision");
    }

    #[test]
    fn radiance_beyond_half_precision_is_kept() {
        let folder = tempfile::tempdir().expect("temp");
        let mut solution = small_solution();
        solution.emission.data[1] = Vec3::splat(3.0e6);
        solution
            .save(folder.path(), &SaveOptions::default())
            .expect("saves");
        let back = Solution::load(folder.path()).expect("loads");
        assert_eq!(back.emission.data[1], Vec3::splat(3.0e6));
    }

    #[test]
    fn the_irradiances_error_is_kept_and_an_old_one_removed() {
        let folder = tempfile::tempdir().expect("temp");
        let mut solution = small_solution();
        solution
            .save(folder.path(), &SaveOptions::default())
            .expect("saves");
        let back = Solution::load(folder.path())
            .expect("loads")
            .irradiance_error
            .expect("is there");
        let stated = solution.irradiance_error.take().expect("is stated");
        assert!(
            back.data
                .iter()
                .zip(&stated.data)
                .all(|(a, b)| (a - b).abs() <= b * 5e-4 + 1e-7)
        );
        solution
            .save(folder.path(), &SaveOptions::default())
            .expect("saves");
        assert!(
            Solution::load(folder.path())
                .expect("loads")
                .irradiance_error
                .is_none(),
            "nobody's error"
        );
    }

    #[test]
    fn metal_is_kept_and_an_old_solutions_removed() {
        share_is_kept_and_an_old_one_removed(METALLIC, |s| &mut s.metallic, Solution::metal_at);
    }

    #[test]
    fn panes_are_kept_and_an_old_solutions_removed() {
        share_is_kept_and_an_old_one_removed(
            TRANSMISSION,
            |s| &mut s.transmission,
            Solution::transmission_at,
        );
    }

    fn share_is_kept_and_an_old_one_removed(
        name: &str,
        field: fn(&mut Solution) -> &mut Option<Plane<f32>>,
        look_up: fn(&Solution, Vec2) -> f32,
    ) {
        let folder = tempfile::tempdir().expect("temp");
        let path = folder.path().join(name);
        let options = SaveOptions::default();
        let mut solution = small_solution();
        let without = solution.generation();
        let (w, h) = (solution.albedo.width, solution.albedo.height);
        let mut share = Plane::filled(w, h, 0.0);
        share.data[7] = 1.0;
        share.data[40] = 0.25;
        *field(&mut solution) = Some(share.clone());
        assert_ne!(solution.generation(), without);
        solution.save(folder.path(), &options).expect("saves");
        let mut back = Solution::load(folder.path()).expect("loads");
        assert_eq!(
            (look_up(&back, Vec2::new(7.5, 0.5) / w as f32), w),
            (1.0, h),
            "a look-up meets its texel"
        );
        assert_eq!(
            field(&mut back).as_ref(),
            Some(&share),
            "half precision holds these"
        );

        let whole = std::fs::read(&path).expect("reads");
        let refused = |what: &str| {
            let e = Solution::load(folder.path()).expect_err(what);
            assert!(
                e.exit_code() == 2 && e.to_string().contains(name),
                "{what}: {e}"
            );
            e.to_string()
        };
        std::fs::write(&path, &whole[..whole.len() / 2]).expect("cuts");
        refused("cut short");
        let write = |plane: &Plane<f32>| {
            crate::core::formats::write_plane_float(&path, plane).expect("writes");
        };
        write(&Plane::filled(w / 2, h, 0.5));
        let e = refused("of another size");
        assert!(
            e.contains("8x16, expected 16x16") && e.contains("delete"),
            "{e}"
        );
        for wrong in [1.5, -0.1] {
            share.data[18] = wrong;
            write(&share);
            let e = refused("no share");
            assert!(e.contains("texel (2, 1)") && e.contains("delete"), "{e}");
        }

        *field(&mut solution) = None;
        assert_eq!(solution.generation(), without);
        solution.save(folder.path(), &options).expect("saves");
        assert!(!path.exists(), "nobody's share");
        let mut back = Solution::load(folder.path()).expect("loads");
        assert!(field(&mut back).is_none() && look_up(&back, Vec2::splat(0.5)) == 0.0);
    }

    #[test]
    fn the_hour_of_writing_is_not_in_the_files() {
        let folder = tempfile::tempdir().expect("temp");
        small_solution()
            .save(folder.path(), &SaveOptions::default())
            .expect("saves");
        let bytes = std::fs::read(folder.path().join("albedo.exr")).expect("reads");
        assert!(bytes.windows(19).any(|w| w == b"1970:01:01 00:00:00"));
    }

    #[test]
    fn a_failed_save_leaves_the_old_solution() {
        let folder = tempfile::tempdir().expect("temp");
        let solution = small_solution();
        solution
            .save(folder.path(), &SaveOptions::default())
            .expect("saves");
        let before = std::fs::read(folder.path().join("albedo.exr")).expect("reads");
        let mut broken = solution.clone();
        broken.albedo.data[0].x = 0.9;
        broken.roughness.data[3] = f32::NAN;
        let message = broken
            .save(folder.path(), &SaveOptions::default())
            .expect_err("refuses")
            .to_string();
        assert!(
            message.contains("roughness texture is not finite at texel (3, 0)"),
            "{message}"
        );
        assert_eq!(
            std::fs::read(folder.path().join("albedo.exr")).expect("reads"),
            before
        );
        assert_eq!(
            std::fs::read_dir(folder.path()).expect("lists").count(),
            FILES.len() + 2
        );
    }

    #[test]
    fn what_is_missing_is_named_with_the_cure() {
        let folder = tempfile::tempdir().expect("temp");
        small_solution()
            .save(folder.path(), &SaveOptions::default())
            .expect("saves");
        std::fs::remove_file(folder.path().join("rooms.png")).expect("removes");
        let e = Solution::load(folder.path()).expect_err("incomplete");
        assert_eq!(e.exit_code(), 2);
        assert!(
            e.to_string().contains("rooms.png: is missing")
                && e.to_string().contains("unbake solve"),
            "{e}"
        );
        let e = Solution::load(&folder.path().join("nowhere")).expect_err("no folder");
        assert_eq!(e.exit_code(), 2);
        std::fs::write(folder.path().join("rooms.png"), b"x").expect("writes");
        std::fs::write(folder.path().join("scene.glb"), b"glTF nonsense").expect("writes");
        assert_eq!(
            Solution::load(folder.path())
                .expect_err("garbage")
                .exit_code(),
            2
        );
    }
}
