//! Where scenarios come from.

use crate::cli::help;
use crate::scenario::{DataRoots, Readers};
use clap::Args;
use std::path::PathBuf;

/// Folders of nuPlan's data.
#[derive(Debug, Args)]
pub(in crate::cli) struct DataArguments {
    /// Folder of nuPlan's logs, with subfolders [default: `$NUPLAN_DATA_ROOT`].
    #[arg(long, value_name = "FOLDER", hide_short_help = true)]
    data_root: Option<PathBuf>,
    /// Folder of nuPlan's maps [default: `$NUPLAN_MAPS_ROOT`].
    #[arg(long, value_name = "FOLDER", hide_short_help = true)]
    maps_root: Option<PathBuf>,
}

impl DataArguments {
    /// The folders of these flags, else of the environment.
    pub(in crate::cli) fn roots(&self) -> DataRoots {
        let known = DataRoots::from_environment();
        DataRoots { data: self.data_root.clone().or(known.data), maps: self.maps_root.clone().or(known.maps) }
    }

    /// The scenario readers, with nuPlan's data in these folders.
    pub(in crate::cli) fn readers(&self) -> Readers {
        Readers::new(&self.roots())
    }
}

/// Named lists of scenarios.
#[derive(Debug, Args)]
pub(in crate::cli) struct SplitArguments {
    #[arg(long = "split", value_name = "NAME", help = help::SPLITS_SHORT, long_help = help::splits())]
    pub(in crate::cli) splits: Vec<String>,
    #[command(flatten)]
    pub(in crate::cli) data: DataArguments,
}
