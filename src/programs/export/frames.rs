//! Rendered frames on disk: radiance as EXR, pictures as PNG, a film through ffmpeg.

use crate::core::formats::{Aside, srgb8_from_linear, write_png_rgb8, write_rgb_float};
use crate::core::image::RgbPlane;
use crate::error::{Error, Result};
use crate::render::{Exposure, Video, tone_map};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Writes frames into a folder; all pictures get the exposure of the first.
pub struct FrameWriter {
    folder: PathBuf,
    exposure: Exposure,
    factor: Option<f32>,
    exr: bool,
    pictures: Vec<PathBuf>,
}

impl FrameWriter {
    /// Creates the folder if need be.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn new(folder: &Path, exposure: Exposure, exr: bool) -> Result<Self> {
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        Ok(Self {
            folder: folder.to_path_buf(),
            exposure,
            factor: None,
            exr,
            pictures: Vec::new(),
        })
    }

    /// Writes a picture of a frame that is not finished yet; the finished one takes its place.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn preview(&mut self, name: &str, radiance: &RgbPlane) -> Result<()> {
        let factor = self
            .factor
            .unwrap_or_else(|| self.exposure.factor(radiance));
        write_picture(&self.folder.join(format!("{name}.png")), radiance, factor)
    }

    /// Writes a finished frame.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&mut self, name: &str, radiance: &RgbPlane) -> Result<()> {
        let factor = *self
            .factor
            .get_or_insert_with(|| self.exposure.factor(radiance));
        if self.exr {
            let aside = Aside::new(self.folder.join(format!("{name}.exr")))?;
            write_rgb_float(aside.path(), radiance)?;
            aside.finish()?;
        }
        let path = self.folder.join(format!("{name}.png"));
        write_picture(&path, radiance, factor)?;
        self.pictures.push(path);
        Ok(())
    }

    /// Exposure of the pictures in stops, once a frame is written.
    #[must_use]
    pub fn stops(&self) -> Option<f32> {
        self.factor.map(f32::log2)
    }

    /// Brings the film's pictures into the order of their names.
    pub fn sort(&mut self) {
        self.pictures.sort();
    }

    /// Makes a film of the pictures; `Ok(None)` if none is wanted.
    ///
    /// # Errors
    /// ffmpeg is missing or fails.
    pub fn film(&self, video: Video, fps: u32) -> Result<Option<PathBuf>> {
        let (name, codec): (&str, &[&str]) = match video {
            Video::None => return Ok(None),
            Video::Mp4 => (
                "frames.mp4",
                &["-c:v", "libx264", "-crf", "18", "-movflags", "+faststart"],
            ),
            Video::Webm => (
                "frames.webm",
                &["-c:v", "libvpx-vp9", "-crf", "28", "-b:v", "0"],
            ),
        };
        let path = self.folder.join(name);
        let aside = Aside::new(&path)?;
        let mut child = Command::new("ffmpeg")
            .args(["-y", "-v", "error", "-f", "image2pipe", "-framerate", &fps.to_string(), "-i", "-"])
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"])
            .args(codec)
            .args(["-f", if video == Video::Mp4 { "mp4" } else { "webm" }])
            .arg(aside.path())
            .stdin(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|e| {
                Error::Failed(format!(
                    "--video needs the program ffmpeg, which cannot be started ({e}); install it (Debian: apt-get install ffmpeg). \
                     The pictures are complete in {}",
                    self.folder.display()
                ))
            })?;
        // a broken pipe shows in ffmpeg's own message below
        let fed = child.stdin.take().map_or(Ok(()), |mut pipe| {
            self.pictures
                .iter()
                .try_for_each(|p| std::fs::read(p).and_then(|bytes| pipe.write_all(&bytes)))
        });
        let output = child.wait_with_output().map_err(|e| Error::io(&path, e))?;
        if !output.status.success() || fed.is_err() {
            let said = String::from_utf8_lossy(&output.stderr);
            return Err(Error::Failed(format!(
                "{}: ffmpeg failed: {}",
                path.display(),
                said.trim()
            )));
        }
        aside.finish()?;
        Ok(Some(path))
    }
}

fn write_picture(path: &Path, radiance: &RgbPlane, factor: f32) -> Result<()> {
    let aside = Aside::new(path)?;
    write_png_rgb8(
        aside.path(),
        radiance.width,
        radiance.height,
        &tone_map(radiance, factor, srgb8_from_linear),
    )?;
    aside.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Plane;
    use glam::Vec3;

    #[test]
    fn frames_share_the_first_ones_exposure() {
        let folder = tempfile::tempdir().expect("temp");
        let mut writer =
            FrameWriter::new(&folder.path().join("a/b"), Exposure::Auto, true).expect("folder");
        let grey = |v: f32| Plane::filled(7, 5, Vec3::splat(v));
        writer.preview("x", &grey(1.0)).expect("writes");
        writer.write("x", &grey(4.0)).expect("writes");
        writer.write("y", &grey(8.0)).expect("writes");
        assert!((writer.stops().expect("set") - 0.2f32.log2()).abs() < 1e-5);
        let back = crate::core::formats::read_rgb(folder.path().join("a/b/y.exr")).expect("reads");
        assert_eq!(back.data[3], Vec3::splat(8.0));
        let names = std::fs::read_dir(folder.path().join("a/b"))
            .expect("lists")
            .count();
        assert_eq!(names, 4, "two frames, nothing aside");
        assert_eq!(writer.film(Video::None, 24).expect("none"), None);
    }
}
