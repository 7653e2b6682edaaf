//! What stands in the engine's place in a program that was built without one.

use super::engine_types::{Output, Shape};
use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// No network; never made.
pub(super) struct Engine {
    pub shape: Shape,
    pub properties: BTreeMap<String, String>,
}

/// No network for any size.
pub(super) struct Plan(());

impl Engine {
    /// Says what is missing.
    ///
    /// # Errors
    /// Always.
    pub fn load(path: &Path) -> Result<Self> {
        Err(Error::Usage(format!(
            "{}: this unbake was built without networks; build it with `cargo build --release --features onnx`, or give depth and labels as files (docs/bring-your-own.md)",
            path.display()
        )))
    }

    pub fn plan(&self, _size: [usize; 2]) -> Result<Plan> {
        Ok(Plan(()))
    }
}

impl Plan {
    pub fn run(&self, _planes: &[f32]) -> Result<Output> {
        Err(Error::Failed("no networks in this build".into()))
    }
}
