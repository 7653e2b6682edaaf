//! The verbs: each reads its input, calls the library and prints the result.

use super::{Context, Verb};
use crate::error::{Error, Result};
use std::path::Path;

/// Runs one verb.
pub fn run(verb: &Verb, context: &Context) -> Result<()> {
    match verb {
        Verb::Eval { out, scene, .. } => eval(required(out)?, required(scene)?, context),
    }
}

/// clap guarantees presence unless `--print-config` was given, which never gets here.
fn required<T>(value: &Option<T>) -> Result<&T> {
    value.as_ref().ok_or_else(|| Error::Usage("an argument is missing; see --help".into()))
}

fn eval(_out: &Path, _scene: &Path, _context: &Context) -> Result<()> {
    Err(Error::Failed("the renderer that evaluation needs is not in this build".into()))
}
