//! What can be typed.

use super::config::Config;
use super::frames::FrameSource;
use super::verb_args::{BatchIndex, ExportVerb};
use crate::alignment::AlignmentOptions;
use crate::core::blocks::Shard;
use crate::pipeline::SolveRequest;
use crate::programs::bake::BakeOptions;
use crate::programs::evaluate::EvalOptions;
use crate::programs::prepare::PrepareOptions;
use crate::programs::synth::SynthOptions;
use crate::programs::view::ViewOptions;
use crate::render::{RelightOptions, RenderOptions};
use crate::scene::{LoadOptions, ScanOptions};
use clap::{Args, Parser, Subcommand};
use std::path::PathBuf;

/// Takes the light out of photographs of rooms: albedo, roughness and light textures of indoor
/// scenes on ordinary CPUs.
#[derive(Parser, Clone, Debug)]
#[command(
    name = "unbake",
    disable_version_flag = true,
    propagate_version = false,
    max_term_width = 100
)]
pub struct Cli {
    /// Options of every verb.
    #[command(flatten)]
    pub global: Global,
    /// What to do.
    #[command(subcommand)]
    pub verb: Option<Verb>,
}

/// Options of every verb.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Global options")]
pub struct Global {
    /// Number of worker threads [default: all cores]; it never changes the result.
    #[arg(long, global = true, value_name = "N")]
    pub threads: Option<usize>,
    /// Key of every random number [default: 0; synth: 1]; the same seed gives the same bits.
    #[arg(long, global = true, value_name = "N")]
    pub seed: Option<u64>,
    /// Draw no progress; errors are still printed.
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Print the result as one JSON object on stdout.
    #[arg(long, global = true)]
    pub json: bool,
    /// Read options from a TOML file; flags override it.
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Print the effective configuration as TOML, each key with its meaning, and stop.
    #[arg(long, global = true)]
    pub print_config: bool,
    /// Print the versions of unbake, Embree and OpenImageIO and stop.
    #[arg(long, short = 'V')]
    pub version: bool,
}

/// The verbs.
#[derive(Subcommand, Clone, Debug)]
pub enum Verb {
    /// Make a synthetic apartment with ground truth: mesh, HDR panoramas, labels, true albedo and
    /// roughness.
    Synth {
        /// Folder for the scene; created if need be.
        #[arg(
            long,
            short,
            required_unless_present = "print_config",
            value_name = "SCENE"
        )]
        out: Option<PathBuf>,
        /// The apartment's options.
        #[command(flatten)]
        options: SynthOptions,
    },
    /// Make a scene folder from what a device or program exports: poses, photographs, mesh, labels,
    /// rooms.
    Prepare {
        /// The capture's folder or file; its kind before it where looking does not tell (`unbake
        /// prepare colmap DIR`). `rooms SCENE` draws the floor plan of a scene folder instead.
        #[arg(required_unless_present = "print_config", num_args = 1..=2, value_name = "[SOURCE] DIR")]
        what: Vec<PathBuf>,
        /// Folder for the scene; created if need be. `rooms` writes beside its scene without it.
        #[arg(long, short, value_name = "SCENE")]
        out: Option<PathBuf>,
        /// How the capture is read.
        #[command(flatten)]
        options: PrepareOptions,
    },
    /// Say what is understood of a scene and everything that is wrong with it.
    Check {
        /// Scene folder (or its transforms.json).
        #[arg(required_unless_present = "print_config", value_name = "SCENE")]
        scene: Option<PathBuf>,
        /// How the scene is read.
        #[command(flatten)]
        load: LoadOptions,
        /// What is done about poses that do not fit.
        #[command(flatten)]
        align: AlignmentOptions,
    },
    /// Take the light out of photographs: reconstruct albedo, roughness and light textures of a
    /// scene.
    Solve {
        /// Scene folder (or its transforms.json).
        #[arg(required_unless_present = "print_config", value_name = "SCENE")]
        scene: Option<PathBuf>,
        /// Folder for the result; created if need be.
        #[arg(
            long,
            short,
            required_unless_present = "print_config",
            value_name = "OUT"
        )]
        out: Option<PathBuf>,
        /// Record every piece of work with its processor time in a file (needs `--threads 1`); read
        /// by `unbake bench scaling`.
        #[arg(long, value_name = "FILE", help_heading = "Advanced: measurement")]
        tape: Option<PathBuf>,
        /// Be process I of N that share this scene over OUT.shards, on as many machines as see it;
        /// `unbake merge OUT` then writes the result.
        #[arg(
            long,
            value_name = "I/N",
            conflicts_with = "tape",
            help_heading = "Many processes"
        )]
        shard: Option<Shard>,
        /// The reconstruction's options.
        #[command(flatten)]
        options: SolveRequest,
        /// How the scene is read.
        #[command(flatten)]
        load: LoadOptions,
        /// What is done about poses that do not fit.
        #[command(flatten)]
        align: AlignmentOptions,
    },
    /// Write the result of `unbake solve --shard`, with the files that one process would write.
    Merge {
        /// Output folder that the shards were given.
        #[arg(required_unless_present = "print_config", value_name = "OUT")]
        out: Option<PathBuf>,
        /// Compute here what shards left undone.
        #[arg(long)]
        complete: bool,
    },
    /// Take the light out of a scan's own colours, without photographs: a mesh with a texture or
    /// vertex colours. Less sure than `solve`, and without roughness.
    Delight {
        /// The scan: .glb, .gltf, .obj or .ply.
        #[arg(required_unless_present = "print_config", value_name = "MESH")]
        mesh: Option<PathBuf>,
        /// Folder for the result; created if need be.
        #[arg(
            long,
            short,
            required_unless_present = "print_config",
            value_name = "OUT"
        )]
        out: Option<PathBuf>,
        /// How the scan is read.
        #[command(flatten)]
        scan: ScanOptions,
        /// The reconstruction's options; those of views and roughness have no effect.
        #[command(flatten)]
        options: SolveRequest,
        /// How the mesh is read.
        #[command(flatten)]
        load: LoadOptions,
    },
    /// Reconstruct many scenes: run it as often as you like, on as many machines as share the
    /// folder; each scene is solved once, and what was stopped goes on.
    Batch {
        /// Text file with a scene folder a line, relative to the file, and flags of `solve` after
        /// it; or a folder whose sub-folders are scenes.
        #[arg(required_unless_present = "print_config", value_name = "LIST")]
        list: Option<PathBuf>,
        /// Folder for the results, one sub-folder a scene, and batch.json and batch.md; created if
        /// need be.
        #[arg(
            long,
            short,
            required_unless_present = "print_config",
            value_name = "DIR"
        )]
        out: Option<PathBuf>,
        /// Solve only the scene of this index, from 0, or all [default: what
        /// SLURM_ARRAY_TASK_ID or AWS_BATCH_JOB_ARRAY_INDEX say, else all].
        #[arg(long, value_name = "N|all")]
        index: Option<BatchIndex>,
        /// Options of every scene's reconstruction; flags in LIST override them.
        #[command(flatten)]
        options: SolveRequest,
        /// How the scenes are read.
        #[command(flatten)]
        load: LoadOptions,
        /// What is done about poses that do not fit.
        #[command(flatten)]
        align: AlignmentOptions,
    },
    /// Score a reconstruction: re-rendering, novel views and, with ground truth, materials.
    Eval {
        /// Output folder of `unbake solve`.
        #[arg(required_unless_present = "print_config", value_name = "OUT")]
        out: Option<PathBuf>,
        /// Scene folder (or its transforms.json) that was reconstructed.
        #[arg(long, required_unless_present = "print_config", value_name = "SCENE")]
        scene: Option<PathBuf>,
        /// The evaluation's options.
        #[command(flatten)]
        options: EvalOptions,
        /// How the scene is read.
        #[command(flatten)]
        load: LoadOptions,
    },
    /// Measure: speed and accuracy of the light, the trade of the presets, the time beside
    /// published ones.
    Bench {
        /// What to measure.
        #[command(subcommand)]
        what: super::verb_args::BenchVerb,
    },
    /// Novel views of a reconstruction: panoramas or pinhole frames from cameras, views of a scene
    /// or along a smooth path.
    #[command(mut_arg("views", |a| a.alias("split")))]
    Render {
        /// Output folder of `unbake solve`.
        #[arg(required_unless_present = "print_config", value_name = "OUT")]
        out: Option<PathBuf>,
        /// Cameras and destination.
        #[command(flatten)]
        places: FrameSource,
        /// The renderer's options.
        #[command(flatten)]
        options: RenderOptions,
        /// How the scene is read.
        #[command(flatten)]
        load: LoadOptions,
    },
    /// Edit materials of a reconstruction without touching it: the list lies in OUT/edits.toml, the
    /// result in OUT/edited.
    Edit {
        /// Output folder of `unbake solve`.
        #[arg(required_unless_present = "print_config", value_name = "OUT")]
        out: Option<PathBuf>,
        /// List of edits to take over; without it OUT/edits.toml is applied again.
        #[arg(long, value_name = "FILE")]
        edits: Option<PathBuf>,
        /// Scene whose class names the list uses.
        #[arg(long, value_name = "SCENE")]
        scene: Option<PathBuf>,
        /// Remove the edits.
        #[arg(long)]
        clear: bool,
        /// How the scene is read.
        #[command(flatten)]
        load: LoadOptions,
    },
    /// Files for other programs: glTF, USD, Mitsuba 3.
    Export {
        /// Output folder of `unbake solve`.
        #[arg(required_unless_present = "print_config", value_name = "OUT")]
        out: Option<PathBuf>,
        /// Cameras and destination.
        #[command(flatten)]
        places: FrameSource,
        /// Write a glTF and a USD file per lighting of a TOML file instead, each with baked light, one
        /// without light, and manifest.json with what was changed in each.
        #[arg(long, value_name = "FILE", conflicts_with = "cameras")]
        lightings: Option<PathBuf>,
        /// What to write.
        #[command(flatten)]
        options: ExportVerb,
        /// How the scene is read.
        #[command(flatten)]
        load: LoadOptions,
    },
    /// Bake the light of any glTF scene into a lightmap: its lamps, luminous surfaces and what shines
    /// in from outside, over all bounces. Needs no photographs.
    Bake {
        /// Scene: a .glb or .gltf file with materials and lamps.
        #[arg(required_unless_present = "print_config", value_name = "SCENE")]
        scene: Option<PathBuf>,
        /// Folder for lightmap.exr, scene.glb and bake.json; created if need be.
        #[arg(
            long,
            short,
            required_unless_present = "print_config",
            value_name = "DIR"
        )]
        out: Option<PathBuf>,
        /// How the light is baked.
        #[command(flatten)]
        options: BakeOptions,
    },
    /// Pictures of a reconstruction under changed light: lamps off, scaled, coloured, moved or
    /// added, another environment.
    #[command(mut_arg("views", |a| a.alias("split")))]
    Relight {
        /// Output folder of `unbake solve`.
        #[arg(required_unless_present = "print_config", value_name = "OUT")]
        out: Option<PathBuf>,
        /// Cameras and destination.
        #[command(flatten)]
        places: FrameSource,
        /// Changes of the light: a TOML file with `[[lamp]]`, `[[add]]` and `[environment]`.
        #[arg(long, value_name = "FILE")]
        lights: Option<PathBuf>,
        /// Another solution of the same scene, such as the truth of a synthetic one: relight both
        /// alike and print the PSNR.
        #[arg(long, value_name = "TRUTH")]
        against: Option<PathBuf>,
        /// List the lamps with number, place and power, and stop.
        #[arg(long)]
        list_lamps: bool,
        /// The renderer's options.
        #[command(flatten)]
        options: RelightOptions,
        /// How the scene is read.
        #[command(flatten)]
        load: LoadOptions,
    },
    /// Walk through a reconstruction in the browser: a page served by this program, to this machine
    /// alone.
    View {
        /// Output folder of `unbake solve`.
        #[arg(required_unless_present = "print_config", value_name = "OUT")]
        out: Option<PathBuf>,
        /// Scene folder (or its transforms.json): adds its cameras, photographs and class names.
        #[arg(long, value_name = "SCENE")]
        scene: Option<PathBuf>,
        /// The page's options.
        #[command(flatten)]
        options: ViewOptions,
        /// How the scene is read.
        #[command(flatten)]
        load: LoadOptions,
    },
    /// Print the completion script of a shell: bash, elvish, fish, powershell or zsh.
    #[command(hide = true)]
    Completions {
        /// The shell to write completions for.
        #[arg(value_name = "SHELL")]
        shell: clap_complete::Shell,
    },
    /// Print the manual page in roff, or write one per verb into a folder.
    #[command(hide = true)]
    Man {
        /// Folder for unbake.1, unbake-solve.1 and so on.
        #[arg(long, value_name = "FOLDER")]
        to: Option<PathBuf>,
    },
}

impl Cli {
    /// Everything typed or defaulted on the command line, in the shape of the configuration file.
    #[must_use]
    pub fn flags(&self) -> Config {
        let g = &self.global;
        let mut config = Config {
            threads: g.threads,
            seed: g.seed,
            quiet: g.quiet,
            json: g.json,
            ..Config::default()
        };
        match &self.verb {
            Some(Verb::Synth { options, .. }) => config.synth = options.clone(),
            Some(Verb::Bake { options, .. }) => config.bake = options.clone(),
            Some(Verb::Prepare { options, .. }) => config.prepare = options.clone(),
            Some(Verb::Check { load, align, .. }) => {
                (config.scene, config.alignment) = (load.clone(), align.clone());
            }
            Some(
                Verb::Solve {
                    options,
                    load,
                    align,
                    ..
                }
                | Verb::Batch {
                    options,
                    load,
                    align,
                    ..
                },
            ) => {
                (config.solve, config.scene) = (options.clone(), load.clone());
                config.alignment = align.clone();
            }
            Some(Verb::Delight {
                scan,
                options,
                load,
                ..
            }) => {
                (config.solve, config.scene) = (options.clone(), load.clone());
                config.scan = scan.clone();
            }
            Some(Verb::Eval { options, load, .. }) => {
                (config.eval, config.scene) = (options.clone(), load.clone())
            }
            Some(Verb::Render { options, load, .. }) => {
                (config.render, config.scene) = (options.clone(), load.clone())
            }
            Some(Verb::Edit { load, .. }) => config.scene = load.clone(),
            Some(Verb::Export { options, load, .. }) => {
                (config.export, config.scene) = (options.clone(), load.clone())
            }
            Some(Verb::Relight { options, load, .. }) => {
                (config.relight, config.scene) = (options.clone(), load.clone())
            }
            Some(
                Verb::Merge { .. }
                | Verb::Bench { .. }
                | Verb::Completions { .. }
                | Verb::Man { .. },
            )
            | None => {}
            Some(Verb::View { options, load, .. }) => {
                (config.view, config.scene) = (options.clone(), load.clone())
            }
        }
        config
    }
}
