//! Folders of files that override those in the program.

use std::path::PathBuf;

/// The folder that an environment variable names; else `name` in the working directory, beside the program, or in the package
/// being run.
pub fn data_folder(variable: &str, name: &str) -> PathBuf {
    if let Some(folder) = std::env::var_os(variable) {
        return folder.into();
    }
    let beside_program = std::env::current_exe().ok().and_then(|exe| exe.parent().map(|folder| folder.join(name)));
    let package = std::env::var_os("CARGO_MANIFEST_DIR").map(|folder| PathBuf::from(folder).join(name));
    let places = [Some(PathBuf::from(name)), beside_program, package];
    places.into_iter().flatten().find(|folder| folder.is_dir()).unwrap_or_else(|| PathBuf::from(name))
}
