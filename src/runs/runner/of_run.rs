//! Settings that the folder of a run decides, and no user. The folder may come from elsewhere: what
//! opens a connection or an unknown file is used only when the user names it again.

use planagent_agent::planner::LearnedSettings;
use planagent_files::{quoted, word_of};
use planagent_mllm::ModelRegistry;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Key of the model.
pub(super) const MODEL: &str = "mllm.model";

/// What the folder of a run names, and no user.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum NotNamed {
    #[error(
        "the model of this run is '{model}', a server, a description or a model of the hub, which a run never opens by itself; \
         if you want it, name it again:\n  {line}"
    )]
    Model { model: String, line: String },
    #[error(
        "the checkpoint of this run is '{file}', which a run never opens by itself; if you want it, name it again:\n  {line}"
    )]
    Checkpoint { file: String, line: String },
    #[error(
        "the memory of this run is '{file}', which a run never opens by itself; if you want it, name it again:\n  {line}"
    )]
    Memory { file: String, line: String },
}

/// The folder of the run that a configuration comes from, and the keys that nobody named since.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct OfRun {
    folder: PathBuf,
    unnamed: BTreeSet<String>,
}

impl OfRun {
    /// The configuration comes from the run in a folder; these keys lead elsewhere.
    pub(super) fn new(folder: &Path, keys: impl IntoIterator<Item = String>) -> Self {
        Self {
            folder: folder.to_owned(),
            unnamed: keys.into_iter().collect(),
        }
    }

    /// A user names the value of a key, such as `mllm.model`.
    pub fn name(&mut self, key: &str) {
        self.unnamed.remove(key);
    }

    /// Refuses a model that leads elsewhere, and that only the run names.
    pub(super) fn check_model(
        &self,
        model: &str,
        registry: &ModelRegistry,
    ) -> Result<(), NotNamed> {
        if !self.unnamed.contains(MODEL) || !registry.leads_elsewhere(model) {
            return Ok(());
        }
        Err(NotNamed::Model {
            model: model.to_owned(),
            line: self.line(&[of_model(model)]),
        })
    }

    /// Refuses checkpoints that only the run names; `checkpoints` are planners with their files.
    pub(super) fn check_checkpoints<'a>(
        &self,
        checkpoints: impl Iterator<Item = (&'a str, &'a str)>,
    ) -> Result<(), NotNamed> {
        let unnamed: Vec<(&str, &str)> = checkpoints
            .filter(|(planner, _)| self.unnamed.contains(&checkpoint_key(planner)))
            .collect();
        let Some((_, first)) = unnamed.first() else {
            return Ok(());
        };
        let options: Vec<[String; 2]> = unnamed
            .iter()
            .map(|(planner, file)| of_checkpoint(planner, file))
            .collect();
        Err(NotNamed::Checkpoint {
            file: (*first).to_owned(),
            line: self.line(&options),
        })
    }

    /// Refuses memories that only the run names; `memories` are keys with their files.
    pub(super) fn check_memories<'a>(
        &self,
        memories: impl Iterator<Item = (String, &'a str)>,
    ) -> Result<(), NotNamed> {
        let unnamed: Vec<(String, &str)> = memories
            .filter(|(key, _)| self.unnamed.contains(key))
            .collect();
        let Some((_, first)) = unnamed.first() else {
            return Ok(());
        };
        let options: Vec<[String; 2]> = unnamed
            .iter()
            .map(|(key, file)| of_memory(key, file))
            .collect();
        Err(NotNamed::Memory {
            file: (*first).to_owned(),
            line: self.line(&options),
        })
    }

    /// The options that resume a run of these; without a model, or with one of this machine, none
    /// names it.
    pub(super) fn options<'a>(
        model: Option<&str>,
        checkpoints: impl Iterator<Item = (&'a str, &'a str)>,
        memories: impl Iterator<Item = (String, &'a str)>,
        registry: &ModelRegistry,
    ) -> Vec<[String; 2]> {
        model
            .filter(|model| registry.leads_elsewhere(model))
            .map(of_model)
            .into_iter()
            .chain(checkpoints.map(|(planner, file)| of_checkpoint(planner, file)))
            .chain(memories.map(|(key, file)| of_memory(&key, file)))
            .collect()
    }

    /// The line to type.
    fn line(&self, options: &[[String; 2]]) -> String {
        let folder = quoted(&word_of(self.folder.as_os_str()));
        let words = options.iter().flatten().map(|word| quoted(word));
        let words: Vec<String> = words.collect();
        format!("planagent simulate --resume {folder} {}", words.join(" "))
    }
}

fn of_model(model: &str) -> [String; 2] {
    ["--model".to_owned(), model.to_owned()]
}

fn of_checkpoint(planner: &str, file: &str) -> [String; 2] {
    ["--checkpoint".to_owned(), format!("{planner}={file}")]
}

fn of_memory(key: &str, file: &str) -> [String; 2] {
    ["--set".to_owned(), format!("{key}={file}")]
}

/// Key of the checkpoint of a planner.
pub(super) fn checkpoint_key(planner: &str) -> String {
    format!("learned.{}", LearnedSettings::key(planner))
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_mllm::HubAccess;

    #[test]
    fn what_leads_elsewhere_must_be_named_again() {
        let nowhere = tempfile::tempdir().unwrap();
        let hub = HubAccess {
            offline: true,
            ..HubAccess::default()
        };
        let registry = ModelRegistry::new(nowhere.path(), hub);
        let mut of_run = OfRun::new(Path::new("a run"), [MODEL.to_owned()]);
        let file = nowhere.path().to_str().unwrap();
        for own in ["nano", file, "no such model"] {
            of_run.check_model(own, &registry).unwrap();
        }
        for elsewhere in [
            "http://127.0.0.1:8080/v1",
            "org/model",
            "org/model/file.gguf",
            "/share/m.toml",
            "openai",
        ] {
            let error = of_run.check_model(elsewhere, &registry).unwrap_err();
            let line = format!("planagent simulate --resume 'a run' --model {elsewhere}");
            assert!(error.to_string().contains(&line), "{error}");
        }
        of_run.name(MODEL);
        of_run.check_model("openai", &registry).unwrap();
    }

    #[test]
    fn checkpoints_must_be_named_again() {
        let mut of_run = OfRun::new(Path::new("run"), ["learned.pdm_open".to_owned()]);
        let error = of_run
            .check_checkpoints([("pdm-open", "/a b.ckpt"), ("plantf", "c")].into_iter())
            .unwrap_err()
            .to_string();
        let line = "planagent simulate --resume run --checkpoint 'pdm-open=/a b.ckpt'";
        assert!(error.contains(line) && !error.contains("plantf"), "{error}");
        of_run.name("learned.pdm_open");
        of_run
            .check_checkpoints([("pdm-open", "/a b.ckpt")].into_iter())
            .unwrap();
    }

    #[test]
    fn a_memory_that_only_the_run_names_must_be_named_again() {
        let key = "language_agents.dilu.memory";
        let mut of_run = OfRun::new(Path::new("a run"), [key.to_owned()]);
        let memories = || [(key.to_owned(), "x/dilu.json")].into_iter();
        let error = of_run.check_memories(memories()).unwrap_err();
        let line = format!("planagent simulate --resume 'a run' --set {key}=x/dilu.json");
        assert!(error.to_string().contains(&line), "{error}");
        of_run.name(key);
        of_run.check_memories(memories()).unwrap();
    }
}
