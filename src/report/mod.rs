//! What a run leaves for people to read: `manifest.json`, `report.json` and `report.html`.

mod record;

pub use record::{
    InputFile, Machine, Recorder, RunRecord, SceneSummary, StageRecord, Versions, cpu_seconds, hash_inputs, machine, peak_bytes,
};
