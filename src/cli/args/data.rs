//! Where scenarios come from.

use crate::help;
use crate::words::path_word;
use anyhow::Context;
use clap::Args;
use planagent_scenario::modified::ModifiedName;
use planagent_scenario::{DEFAULT_SCENARIO, DataRoots, Readers, generator};
use planagent_world::InteractionKind;
use std::path::PathBuf;

/// Folders of nuPlan's data.
#[derive(Debug, Args)]
pub(crate) struct DataArguments {
    /// Folder of nuPlan's logs, with subfolders [default: `$NUPLAN_DATA_ROOT`].
    #[arg(long, value_name = "FOLDER", hide_short_help = true)]
    data_root: Option<PathBuf>,
    /// Folder of nuPlan's maps [default: `$NUPLAN_MAPS_ROOT`].
    #[arg(long, value_name = "FOLDER", hide_short_help = true)]
    maps_root: Option<PathBuf>,
    /// Modify the scenarios: a TOML file, or the name of a kind.
    ///
    /// FILE.toml or KIND, with a seed as FILE.toml.SEED or KIND.SEED. A scenario SCENARIO~FILE.toml
    /// says the same of one. docs/modified.md has the tables of the file and the names of the
    /// kinds.
    #[arg(long, value_name = "FILE", value_parser = path_word(), hide_short_help = true)]
    modify: Option<String>,
}

impl DataArguments {
    /// Whether there is a modification.
    pub(crate) fn modifies(&self) -> bool {
        self.modify.is_some()
    }

    /// The words of scenarios or splits, with the modification.
    pub(crate) fn modified(&self, words: &[String]) -> anyhow::Result<Vec<String>> {
        let Some(word) = &self.modify else {
            return Ok(words.to_vec());
        };
        let known = || InteractionKind::ALL.map(InteractionKind::name).join(", ");
        let name = ModifiedName::parse(word).with_context(|| {
            format!(
                "--modify {word}: neither a file whose name ends in .toml nor one of {}",
                known()
            )
        })?;
        Ok(words.iter().map(|word| name.mark(word)).collect())
    }

    /// The scenarios of a command, with the modification. Where no word names one, it is the default
    /// scenario, or the one that the modification changes.
    pub(crate) fn modified_or_default(&self, words: &[String]) -> anyhow::Result<Vec<String>> {
        match &self.modify {
            Some(_) if words.is_empty() => self.modified(&[generator::DEFAULT.to_string()]),
            None if words.is_empty() => Ok(vec![DEFAULT_SCENARIO.to_owned()]),
            _ => self.modified(words),
        }
    }

    /// The folders of these flags, else of the environment.
    pub(crate) fn roots(&self) -> DataRoots {
        let known = DataRoots::from_environment();
        DataRoots {
            data: self.data_root.clone().or(known.data),
            maps: self.maps_root.clone().or(known.maps),
        }
    }

    /// The scenario readers, with nuPlan's data in these folders.
    pub(crate) fn readers(&self) -> Readers {
        Readers::new(&self.roots())
    }
}

/// Named lists of scenarios.
#[derive(Debug, Args)]
pub(crate) struct SplitArguments {
    #[arg(long = "split", value_name = "NAME", help = help::SPLITS_SHORT, long_help = help::splits())]
    pub(crate) splits: Vec<String>,
    #[command(flatten)]
    pub(crate) data: DataArguments,
}
