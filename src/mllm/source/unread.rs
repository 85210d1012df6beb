//! Forms of checkpoints that are not read, each with what to take instead.

use super::ModelFiles;
use crate::MllmError;
use crate::adapter::PEFT_CONFIG as ADAPTER;
use crate::checkpoint::{ConfigObject, read_json, safetensors_folder};
use std::path::Path;

/// Keys of LLaVA's own repositories, whose tensors have other names and whose towers lie elsewhere.
const ORIGINAL_LLAVA: [&str; 2] = ["mm_vision_tower", "mm_projector_type"];

/// Checks that a folder holds a model, not an adapter alone.
pub(super) fn check_folder(folder: &Path) -> Result<(), MllmError> {
    if safetensors_folder::has_safetensors(folder) {
        return Ok(());
    }
    check_without_adapter(folder)
}

/// Checks that a folder holds no adapter, where none is named.
pub(super) fn check_without_adapter(folder: &Path) -> Result<(), MllmError> {
    let path = folder.join(ADAPTER);
    if !path.is_file() {
        return Ok(());
    }
    let adapter = read_json(&path)?;
    let root = ConfigObject::root(&path, &adapter)?;
    let base: Option<String> = root.value("base_model_name_or_path")?;
    let base = base.map_or_else(
        || "its base model".to_owned(),
        |base| format!("'{}'", base.escape_debug()),
    );
    let problem = format!(
        "this folder holds an adapter for {base}; name that model, and the folder as its adapter: --adapter {}",
        folder.display()
    );
    Err(root.error("base_model_name_or_path", problem))
}

/// Checks that the configuration of a folder is one of transformers.
pub(super) fn check_config(files: &ModelFiles) -> Result<(), MllmError> {
    let json = files.required_json("config.json")?;
    let path = files.path("config.json");
    let root = ConfigObject::root(&path, &json)?;
    if let Some(key) = ORIGINAL_LLAVA.into_iter().find(|key| root.contains(key)) {
        let problem = "this is a repository in LLaVA's original layout, which is not read; take the same model in the layout of \
                       transformers, for example llava-hf/llava-1.5-7b-hf";
        return Err(root.error(key, problem));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problem(file: &str, text: &str) -> String {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(file), text).unwrap();
        let checked = check_folder(folder.path())
            .and_then(|()| check_config(&ModelFiles::folder(folder.path()).unwrap()));
        checked.unwrap_err().to_string()
    }

    #[test]
    fn what_is_not_read_is_named_with_what_to_take() {
        for (file, text, said) in [
            (
                ADAPTER,
                r#"{"base_model_name_or_path": "org/base"}"#,
                ["'org/base'", "--adapter"],
            ),
            (
                "config.json",
                r#"{"model_type": "llava", "mm_vision_tower": "x"}"#,
                ["original layout", "llava-hf/"],
            ),
        ] {
            let found = problem(file, text);
            assert!(
                found.contains(file) && said.iter().all(|said| found.contains(said)),
                "{found}"
            );
        }
    }
}
