//! A whole reconstruction as a process of its own: peak memory is a property of a process, and a
//! cold start is part of the time.

use crate::error::{Error, Result};
use crate::programs::evaluate::{CalibrationBin, Evaluation};
use crate::programs::report::RunRecord;
use crate::verdict::{Findings, Verdict};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Runs `solve` and `eval` of this program in processes of their own.
pub struct Runner {
    exe: PathBuf,
    scene: PathBuf,
    work: PathBuf,
    config: PathBuf,
    keep: bool,
}

/// What a reconstruction cost and how good it is.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Outcome {
    /// Wall time of `solve` from process start to the last file, by the parent's clock.
    pub seconds: f64,
    /// Its processor time.
    pub cpu_seconds: f64,
    /// Its largest resident size.
    pub peak_bytes: u64,
    /// Rays it traced.
    pub rays: u64,
    /// Threads it used.
    pub threads: usize,
    /// Albedo PSNR over the held-out views, no alignment, peak 1, dB.
    pub albedo_psnr: Option<f64>,
    /// Roughness PSNR over the held-out views, FIPT's protocol, dB.
    pub roughness_psnr: Option<f64>,
    /// PSNR of the held-out views' re-rendering, dB.
    pub novel_psnr: Option<f64>,
    /// SSIM of the same.
    pub novel_ssim: Option<f64>,
    /// Stated against actual error of the albedo.
    pub albedo_calibration: Option<CalibrationBin>,
    /// The reconstruction's verdict on itself.
    pub verdict: Option<Verdict>,
    /// Wall seconds of the stages of depth 0, in order.
    pub stages: Vec<(String, f64)>,
}

/// Where processes of their own work, and what they are told.
#[derive(Clone, Debug)]
pub struct Workplace {
    /// The working folder; its parent must exist.
    pub folder: PathBuf,
    /// Whether what the processes write stays.
    pub keep: bool,
    /// The TOML text of the configuration that they read.
    pub config: String,
}

impl Workplace {
    /// Makes the working folder of a scene's reconstructions.
    ///
    /// # Errors
    /// A folder that cannot be made or written.
    pub fn runner(&self, scene: &Path) -> Result<Runner> {
        let exe = std::env::current_exe()
            .map_err(|e| Error::Failed(format!("cannot find this program's own file: {e}")))?;
        std::fs::create_dir(&self.folder).map_err(|e| Error::io(&self.folder, e))?;
        let path = self.folder.join("config.toml");
        std::fs::write(&path, &self.config).map_err(|e| Error::io(&path, e))?;
        Ok(Runner {
            exe,
            scene: scene.to_path_buf(),
            work: self.folder.clone(),
            config: path,
            keep: self.keep,
        })
    }

    /// Removes the working folder, unless what the processes wrote stays.
    pub fn clear(&self) {
        if !self.keep {
            // nothing can be done about files that will not go
            let _ = std::fs::remove_dir_all(&self.folder);
        }
    }

    /// A folder of its own in this one.
    #[must_use]
    pub fn within(&self, name: &str) -> Self {
        Self {
            folder: self.folder.join(name),
            ..self.clone()
        }
    }
}

impl Runner {
    /// The folder of the run called `name`.
    #[must_use]
    pub fn folder(&self, name: &str) -> PathBuf {
        self.work.join(name)
    }

    /// Reconstructs with the given `solve` flags and scores the result; `look` sees the output
    /// folder before it is removed.
    ///
    /// # Errors
    /// A process that fails; its own words are part of the message.
    pub fn run<T>(
        &self,
        name: &str,
        flags: &[String],
        look: impl FnOnce(&Path) -> Result<T>,
    ) -> Result<(Outcome, T)> {
        let out = self.folder(name);
        let solve = [
            "solve".as_ref(),
            self.scene.as_os_str(),
            "--out".as_ref(),
            out.as_os_str(),
        ];
        let ((), seconds) = {
            let (done, seconds) = super::timed(|| self.process(&solve, flags));
            (done?, seconds)
        };
        self.process(
            &[
                "eval".as_ref(),
                out.as_os_str(),
                "--scene".as_ref(),
                self.scene.as_os_str(),
            ],
            &[],
        )?;
        let record = RunRecord::read_manifest(&out)
            .ok_or_else(|| Error::Failed(format!("{}: no manifest.json", out.display())))?;
        let path = out.join("eval").join("metrics.json");
        let bytes = std::fs::read(&path).map_err(|e| Error::io(&path, e))?;
        let scores: Evaluation = serde_json::from_slice(&bytes)
            .map_err(|e| Error::Failed(format!("{}: {e}", path.display())))?;
        let seen = look(&out)?;
        if !self.keep {
            std::fs::remove_dir_all(&out).map_err(|e| Error::io(&out, e))?;
        }
        Ok((outcome(seconds, &record, &scores), seen))
    }

    /// Reconstructs with the given `solve` flags alone and returns the record of the run.
    ///
    /// # Errors
    /// As [`Runner::run`].
    pub fn solve(&self, name: &str, flags: &[String]) -> Result<RunRecord> {
        let out = self.folder(name);
        let solve = [
            "solve".as_ref(),
            self.scene.as_os_str(),
            "--out".as_ref(),
            out.as_os_str(),
        ];
        self.process(&solve, flags)?;
        let record = RunRecord::read_manifest(&out)
            .ok_or_else(|| Error::Failed(format!("{}: no manifest.json", out.display())))?;
        if !self.keep {
            std::fs::remove_dir_all(&out).map_err(|e| Error::io(&out, e))?;
        }
        Ok(record)
    }

    fn process(&self, arguments: &[&std::ffi::OsStr], flags: &[String]) -> Result<()> {
        let mut command = Command::new(&self.exe);
        command
            .args(arguments)
            .args(flags)
            .arg("--config")
            .arg(&self.config);
        command
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let output = command.output().map_err(|e| Error::io(&self.exe, e))?;
        if output.status.success() {
            return Ok(());
        }
        let words = String::from_utf8_lossy(&output.stderr);
        let verb = arguments[0].to_string_lossy();
        Err(Error::Failed(format!(
            "unbake {verb} {} ended with {}:\n{}",
            flags.join(" "),
            output.status,
            words.trim()
        )))
    }
}

impl Drop for Runner {
    fn drop(&mut self) {
        if !self.keep {
            // nothing can be done about files that will not go
            let _ = std::fs::remove_dir_all(&self.work);
        }
    }
}

fn outcome(seconds: f64, record: &RunRecord, scores: &Evaluation) -> Outcome {
    let split = scores.test.as_ref().or(scores.train.as_ref());
    let materials = split.and_then(|s| s.materials.as_ref());
    Outcome {
        seconds,
        cpu_seconds: record.cpu_seconds,
        peak_bytes: record.peak_bytes,
        rays: record.rays,
        threads: record.machine.threads,
        albedo_psnr: materials.map(|m| m.albedo.linear.psnr_of_mean_mse),
        roughness_psnr: materials.map(|m| m.roughness.fipt.psnr_of_mean_mse),
        novel_psnr: split.map(|s| s.rendering.psnr_of_mean_mse),
        novel_ssim: split.map(|s| s.rendering.ssim),
        albedo_calibration: materials.map(|m| m.calibration.albedo.all),
        verdict: record.findings.as_ref().map(Findings::verdict),
        stages: record
            .stages
            .iter()
            .filter(|s| s.depth == 0)
            .map(|s| (s.name.clone(), s.wall_seconds))
            .collect(),
    }
}
