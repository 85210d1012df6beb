//! The build script of the crates whose unit tests read outside data: tells the compiler whether it is there.
#![allow(clippy::print_stdout, reason = "Cargo reads its instructions from stdout")]

use std::env;
use std::path::{Path, PathBuf};

fn main() {
    println!("cargo::rustc-check-cfg=cfg(outside_data)");
    println!("cargo::rerun-if-env-changed=PLANAGENT_DATA");
    println!("cargo::rerun-if-changed=Cargo.toml");
    let package = env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from).unwrap_or_default();
    let beside = |folder: &Path| folder.join("../shared/data").is_dir();
    if env::var_os("PLANAGENT_DATA").map_or_else(|| package.ancestors().any(beside), |data| Path::new(&data).is_dir()) {
        println!("cargo::rustc-cfg=outside_data");
    }
}
