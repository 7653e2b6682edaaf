//! `unbake completions SHELL` and `unbake man`: what shells and `man` know of the command line.

use crate::cli::args::Cli;
use crate::cli::context::{Context, print};
use crate::core::formats::atomic_write;
use crate::error::{Error, Result};
use clap::CommandFactory;
use clap_complete::Shell;
use std::path::Path;

/// Prints the completion script of a shell.
pub(crate) fn completions(shell: Shell) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "unbake", &mut script);
    print(&String::from_utf8_lossy(&script))
}

/// Prints the manual page or, with a folder, writes one for the program and one for every verb.
pub(crate) fn manual(to: Option<&Path>, context: &Context) -> Result<()> {
    let mut command = Cli::command();
    command.build(); // gives the verbs their full names and the global options
    let Some(folder) = to else {
        return print(&page(&command)?);
    };
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
    let verbs = command.get_subcommands().filter(|v| !v.is_hide_set());
    let mut files = Vec::new();
    for pages in std::iter::once(&command).chain(verbs.filter(|v| v.get_name() != "help")) {
        let name = pages.get_display_name().unwrap_or(pages.get_name());
        let file = format!("{name}.1");
        atomic_write(folder.join(&file), page(pages)?.as_bytes())?;
        files.push(file);
    }
    let text = format!("{} manual pages in {}\n", files.len(), folder.display());
    context.result(
        &text,
        &serde_json::json!({"folder": folder, "files": files}),
    )
}

/// A command as roff.
fn page(command: &clap::Command) -> Result<String> {
    let mut text = Vec::new();
    clap_mangen::Man::new(command.clone())
        .source(concat!("unbake ", env!("CARGO_PKG_VERSION")))
        .render(&mut text)
        .map_err(|e| Error::io("the manual page", e))?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}
