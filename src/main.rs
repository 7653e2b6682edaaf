//! The `unbake` program.

use std::process::ExitCode;

fn main() -> ExitCode {
    // a panic is a defect of ours: its message is on stderr already, and the exit code stays within
    // the contract
    std::panic::catch_unwind(|| unbake::cli::run(std::env::args_os().collect()))
        .unwrap_or(ExitCode::from(1))
}
