//! One TOML file whose every key is a flag; flags given on the command line win.
//!
//! Options live with the modules that use them (`clap::Args` + `serde`); this file only merges
//! values: the file is read into the same structures, and each flag that was really typed replaces
//! its key. Nothing is merged as text.

use super::verb_args::ExportVerb;
use crate::alignment::AlignmentOptions;
use crate::error::{Error, Result};
use crate::pipeline::SolveRequest;
use crate::programs::bake::BakeOptions;
use crate::programs::evaluate::EvalOptions;
use crate::programs::prepare::PrepareOptions;
use crate::programs::synth::SynthOptions;
use crate::programs::view::ViewOptions;
use crate::render::{RelightOptions, RenderOptions};
use crate::scene::{LoadOptions, ScanOptions};
use clap::ArgMatches;
use clap::parser::ValueSource;
use serde::{Deserialize, Serialize};
use std::path::Path;
use toml::{Table, Value};

/// Everything the program can be told except which files to work on: the content of a `--config`
/// file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Worker threads; absent = all cores.
    pub threads: Option<usize>,
    /// Key of every random number; absent = the verb's own.
    pub seed: Option<u64>,
    /// No progress on the terminal.
    pub quiet: bool,
    /// Results as JSON.
    pub json: bool,
    /// How a scene is read, by every verb that reads one.
    pub scene: LoadOptions,
    /// Options of `unbake prepare`.
    pub prepare: PrepareOptions,
    /// How `unbake delight` reads a scan.
    pub scan: ScanOptions,
    /// What `unbake check` and `unbake solve` do about poses that do not fit the mesh.
    pub alignment: AlignmentOptions,
    /// Options of `unbake synth`.
    pub synth: SynthOptions,
    /// Options of `unbake solve`.
    pub solve: SolveRequest,
    /// Options of `unbake eval`.
    pub eval: EvalOptions,
    /// Options of `unbake render`.
    pub render: RenderOptions,
    /// Options of `unbake relight`.
    pub relight: RelightOptions,
    /// Options of `unbake export`.
    pub export: ExportVerb,
    /// Options of `unbake bake`.
    pub bake: BakeOptions,
    /// Options of `unbake view`.
    pub view: ViewOptions,
}

impl Config {
    /// Reads a configuration file; a misspelt key is an error that names its line.
    ///
    /// # Errors
    /// If the file cannot be read, is no TOML, or holds an unknown key or value.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| {
            Error::input(
                path,
                format!("cannot be read ({e}); give --config an existing TOML file"),
            )
        })?;
        toml::from_str(&text).map_err(|e| {
            Error::input(
                path,
                format!("is not a valid configuration: {e}\n`unbake --print-config` prints every key with its meaning"),
            )
        })
    }

    /// This configuration with every flag that was typed on the command line replaced by the value
    /// in `flags`.
    ///
    /// `tables` are those the verb reads; `matches` are its matches, which contain the global flags
    /// as well.
    ///
    /// # Errors
    /// If the result is no valid configuration.
    pub fn overlaid(&self, flags: &Self, tables: &[&str], matches: &ArgMatches) -> Result<Self> {
        let failed = |e: String| Error::Failed(format!("merging options: {e}"));
        let mut base = Table::try_from(self).map_err(|e| failed(e.to_string()))?;
        let given = Table::try_from(flags).map_err(|e| failed(e.to_string()))?;
        for id in matches
            .ids()
            .filter(|id| matches.value_source(id.as_str()) == Some(ValueSource::CommandLine))
        {
            let key = id.as_str().replace('_', "-");
            if let Some(value) = given.get(&key).filter(|v| !v.is_table()) {
                base.insert(key, value.clone());
                continue;
            }
            for table in tables {
                let into = base
                    .entry(*table)
                    .or_insert_with(|| Value::Table(Table::new()));
                if let (Some(Value::Table(from)), Value::Table(into)) = (given.get(*table), into) {
                    copy_leaf(from, into, &key);
                }
            }
        }
        base.try_into()
            .map_err(|e: toml::de::Error| failed(e.to_string()))
    }

    /// The configuration as TOML with each option's help above it; a verb restricts it to what it
    /// reads.
    ///
    /// # Errors
    /// If the configuration cannot be written as TOML.
    pub fn documented(&self, command: &clap::Command, verb: Option<&str>) -> Result<String> {
        let failed = |e: String| Error::Failed(format!("printing the configuration: {e}"));
        let text = toml::to_string(self).map_err(|e| failed(e.to_string()))?;
        let mut out = String::from(
            "# unbake configuration: every key is also a flag; flags override this file\n",
        );
        for (key, set) in [
            ("threads", self.threads.is_some()),
            ("seed", self.seed.is_some()),
        ] {
            if !set {
                let help = help_of(command, None, key).unwrap_or_default();
                out.push_str(&format!("# {help}\n# {key} =\n"));
            }
        }
        let mut table: Option<String> = None;
        for line in text.lines() {
            if let Some(header) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
                if wanted(verb, table.as_deref()) && table.as_deref() == Some("solve") {
                    out.push_str(&self.left_to_the_preset(command)?);
                }
                table = header.split('.').next().map(str::to_owned);
                if wanted(verb, table.as_deref()) {
                    out.push_str(&format!("\n[{header}]\n"));
                }
                continue;
            }
            if !wanted(verb, table.as_deref()) || line.is_empty() {
                continue;
            }
            let key = line.split('=').next().unwrap_or_default().trim();
            let help = help_of(command, table.as_deref(), key);
            for paragraph in help.unwrap_or_default().lines() {
                out.push_str(&format!("# {paragraph}\n"));
            }
            out.push_str(line);
            out.push('\n');
        }
        Ok(out)
    }
}

impl Config {
    /// The reconstruction's numbers that the preset decides, as comments.
    fn left_to_the_preset(&self, command: &clap::Command) -> Result<String> {
        let failed =
            |e: toml::ser::Error| Error::Failed(format!("printing the configuration: {e}"));
        let asked = Table::try_from(&self.solve).map_err(failed)?;
        let effective =
            Table::try_from(self.solve.options(0, std::time::Instant::now())).map_err(failed)?;
        let mut out = String::new();
        for (key, value) in effective
            .iter()
            .filter(|(key, _)| !asked.contains_key(*key))
        {
            let help = help_of(command, Some("solve"), key).unwrap_or_default();
            out.push_str(&format!("# {help}\n# {key} = {value}\n"));
        }
        Ok(out)
    }
}

/// The tables that a verb reads.
#[must_use]
pub fn tables_of(verb: &str) -> &'static [&'static str] {
    match verb {
        "synth" => &["synth"],
        "prepare" => &["prepare"],
        "check" => &["scene", "alignment"],
        "delight" => &["scan", "solve", "scene"],
        "solve" | "batch" => &["solve", "scene", "alignment"],
        "eval" => &["eval", "scene"],
        "render" => &["render", "scene"],
        "edit" => &["scene"],
        "export" => &["export", "scene"],
        "relight" => &["relight", "scene"],
        "view" => &["view", "scene"],
        "bake" => &["bake"],
        _ => &[],
    }
}

/// Keys outside any table are printed always, a table only for the verbs that read it.
fn wanted(verb: Option<&str>, table: Option<&str>) -> bool {
    match (verb, table) {
        (Some(verb), Some(table)) => tables_of(verb).contains(&table),
        _ => true,
    }
}

/// The help sentence of the flag that sets `key`.
fn help_of(command: &clap::Command, table: Option<&str>, key: &str) -> Option<String> {
    let find = |c: &clap::Command| {
        let arg = c
            .get_arguments()
            .find(|a| a.get_id().as_str().replace('_', "-") == key)?;
        Some(arg.get_help()?.to_string())
    };
    match table {
        None => find(command),
        Some(table) => command
            .get_subcommands()
            .filter(|c| tables_of(c.get_name()).contains(&table))
            .find_map(find),
    }
}

/// Copies the leaf `key` from wherever it lies in the nested table `from` to the same place in
/// `into`.
fn copy_leaf(from: &Table, into: &mut Table, key: &str) -> bool {
    if let Some(value) = from.get(key).filter(|v| !v.is_table()) {
        into.insert(key.into(), value.clone());
        return true;
    }
    for (name, value) in from {
        let Value::Table(inner) = value else { continue };
        if !holds(inner, key) {
            continue;
        }
        if let Value::Table(into) = into
            .entry(name.clone())
            .or_insert_with(|| Value::Table(Table::new()))
        {
            return copy_leaf(inner, into, key);
        }
    }
    false
}

/// Whether `key` is a leaf somewhere in the table.
fn holds(table: &Table, key: &str) -> bool {
    table.iter().any(|(name, value)| match value {
        Value::Table(inner) => holds(inner, key),
        _ => name == key,
    })
}
