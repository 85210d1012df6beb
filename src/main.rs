//! The `planagent` program; everything lives in the library.

fn main() {}
