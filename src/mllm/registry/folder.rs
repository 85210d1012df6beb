//! Folders of files that override those in the program.

use std::path::PathBuf;

/// Folder of model descriptions, beside the working directory or the program.
const MODELS: &str = "models";
/// Environment variable that names it.
const MODELS_VARIABLE: &str = "PLANAGENT_MODELS";

/// `$PLANAGENT_MODELS`, else `models` in the working directory, else beside the program or the
/// package being run.
pub fn models_folder() -> PathBuf {
    data_folder(MODELS_VARIABLE, MODELS)
}

/// The folder that an environment variable names; else `name` in the working directory, beside the
/// program, or in the package being run.
pub fn data_folder(variable: &str, name: &str) -> PathBuf {
    if let Some(folder) = std::env::var_os(variable) {
        return folder.into();
    }
    let beside_program = std::env::current_exe()
        .ok()
        .and_then(|exe| exe.parent().map(|folder| folder.join(name)));
    let package =
        std::env::var_os("CARGO_MANIFEST_DIR").map(|folder| PathBuf::from(folder).join(name));
    let places = [Some(PathBuf::from(name)), beside_program, package];
    places
        .into_iter()
        .flatten()
        .find(|folder| folder.is_dir())
        .unwrap_or_else(|| PathBuf::from(name))
}
