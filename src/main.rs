//! The `unbake` program.

fn main() {}
