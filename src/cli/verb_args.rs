//! Arguments of the verbs that have many: export and bench.

use crate::programs::bench::{
    AlignmentBench, IrtBench, KernelBench, LightBench, RobustnessBench, ScalingBench, TablesBench,
    TradeoffBench, TsdrBench,
};
use crate::programs::export::ExportOptions;
use crate::render::FrameOptions;
use clap::{Args, Subcommand};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::str::FromStr;

/// Options of `unbake export`: the formats, and the cameras that go with them.
#[derive(clap::Args, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ExportVerb {
    /// Formats.
    #[command(flatten)]
    pub formats: ExportOptions,
    /// Cameras.
    #[command(flatten)]
    pub frames: FrameOptions,
}

/// Which scenes of a batch are solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BatchIndex {
    /// Whatever is left to do.
    All,
    /// One, by its place in the list from 0.
    One(usize),
}

impl FromStr for BatchIndex {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.trim() {
            "all" => Ok(Self::All),
            number => number
                .parse()
                .map(Self::One)
                .map_err(|_| format!("{number:?} is no index; expected a number from 0, or `all`")),
        }
    }
}

/// The measurements.
#[derive(Subcommand, Clone, Debug)]
pub enum BenchVerb {
    /// Irradiance: rays per second beside a bare Embree loop, error against time, growth with
    /// texels, triangles and threads.
    Irt {
        /// Scene folder (or its transforms.json).
        #[arg(value_name = "SCENE")]
        scene: PathBuf,
        /// What is measured.
        #[command(flatten)]
        bench: IrtBench,
        /// Where the figures go.
        #[command(flatten)]
        outputs: Outputs,
    },
    /// Irradiance against path-traced truth by class, and what its rays meet: where errors of the
    /// light come from.
    Light {
        /// Scene folder (or its transforms.json), with ground truth.
        #[arg(value_name = "SCENE")]
        scene: PathBuf,
        /// What is measured.
        #[command(flatten)]
        bench: LightBench,
        /// Write all figures as JSON to a file; after `bench`, `--json FILE` means the same.
        #[arg(long, value_name = "FILE")]
        json_file: Option<PathBuf>,
    },
    /// Accuracy against time and memory over presets and knobs, each point a reconstruction of its
    /// own.
    Tradeoff {
        /// Scene folder (or its transforms.json), with ground truth.
        #[arg(value_name = "SCENE")]
        scene: PathBuf,
        /// What is measured.
        #[command(flatten)]
        bench: TradeoffBench,
        /// Where reconstructions go.
        #[command(flatten)]
        work: Work,
        /// Where the figures go.
        #[command(flatten)]
        outputs: Outputs,
    },
    /// The whole reconstruction at the paper's resolutions beside the times published for TSDR and
    /// the paper.
    Tsdr {
        /// Scene folder (or its transforms.json).
        #[arg(value_name = "SCENE")]
        scene: PathBuf,
        /// What is measured.
        #[command(flatten)]
        bench: TsdrBench,
        /// Where the reconstruction goes.
        #[command(flatten)]
        work: Work,
        /// Write all figures as JSON to a file; after `bench`, `--json FILE` means the same.
        #[arg(long, value_name = "FILE")]
        json_file: Option<PathBuf>,
    },
    /// The paper's tables: unbake beside the published method, its stages, its light and its
    /// corrections one by one, and wrong labels.
    Tables {
        /// Scene folders (or their transforms.json), with ground truth.
        #[arg(value_name = "SCENE", required = true)]
        scenes: Vec<PathBuf>,
        /// What is run.
        #[command(flatten)]
        bench: TablesBench,
        /// Where reconstructions go.
        #[command(flatten)]
        work: Work,
        /// Write all rows as JSON to a file, and keep the rows that stand there already; after
        /// `bench`, `--json FILE` means the same.
        #[arg(long, value_name = "FILE")]
        json_file: Option<PathBuf>,
    },
    /// What damaged input costs: wrong labels, exposure drift, clipping, pose and geometry noise,
    /// each beside the clean scene.
    Robustness {
        /// Scene folder (or its transforms.json), with ground truth.
        #[arg(value_name = "SCENE")]
        scene: PathBuf,
        /// What is measured.
        #[command(flatten)]
        bench: RobustnessBench,
        /// Where damaged scenes and reconstructions go.
        #[command(flatten)]
        work: Work,
        /// Write all figures as JSON to a file; after `bench`, `--json FILE` means the same.
        #[arg(long, value_name = "FILE")]
        json_file: Option<PathBuf>,
    },
    /// What a reconstruction takes on more cores than are at hand: runs on every number of threads
    /// of this machine, and one recorded on one thread and scheduled on up to 128.
    Scaling {
        /// Scene folder (or its transforms.json).
        #[arg(value_name = "SCENE")]
        scene: PathBuf,
        /// What is run.
        #[command(flatten)]
        bench: ScalingBench,
        /// Where reconstructions go.
        #[command(flatten)]
        work: Work,
        /// Where the figures go.
        #[command(flatten)]
        outputs: Outputs,
    },
    /// Generated misalignments of poses and mesh: how many are recognised, and whether the scenes
    /// as they are pass.
    Alignment {
        /// Scene folders.
        #[arg(value_name = "SCENE", required = true)]
        scenes: Vec<PathBuf>,
        /// What is damaged.
        #[command(flatten)]
        bench: AlignmentBench,
        /// Write all figures as JSON to a file; after `bench`, `--json FILE` means the same.
        #[arg(long, value_name = "FILE")]
        json_file: Option<PathBuf>,
    },
    /// Evaluations per second of the reflection kernel beside the scalar reference and the
    /// machine's limits.
    Kernel {
        /// What is measured.
        #[command(flatten)]
        bench: KernelBench,
        /// Write all figures as JSON to a file; after `bench`, `--json FILE` means the same.
        #[arg(long, value_name = "FILE")]
        json_file: Option<PathBuf>,
    },
}

/// Where the reconstructions of a benchmark go.
#[derive(Args, Clone, Debug, Default)]
pub struct Work {
    /// Keep the reconstructions in a new folder instead of removing each after it is scored.
    #[arg(long, value_name = "FOLDER")]
    pub keep: Option<PathBuf>,
}

/// Where the figures go besides the terminal.
#[derive(Args, Clone, Debug, Default)]
pub struct Outputs {
    /// Write all figures as JSON to a file; after `bench`, `--json FILE` means the same.
    #[arg(long, value_name = "FILE")]
    pub json_file: Option<PathBuf>,
    /// Draw the curves into an SVG file.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
}
