//! The scenes that experiments drive.

use crate::cli::Printer;
use crate::cli::args::ExperimentArguments;
use crate::cli::commands::simulate::selection::{Found, find};
use crate::experiment::study::{Quick, SuiteName};
use crate::report::ScenarioList;
use crate::scenario::{DataRoots, Readers, ScenarioRef, absolute_path};
use anyhow::{Context, bail};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Name of the suite of recordings.
pub(super) const RECORDED: &str = "recorded";
/// Environment variable that names a folder of recordings,
const DATA: &str = "PLANAGENT_DATA";
/// and where they lie in it.
const RECORDINGS: [&str; 3] = ["womd", "argoverse2/sensor", "argoverse2/motion_forecasting"];

/// Scenes with a name.
pub(super) struct Suite {
    /// The name.
    pub(super) name: String,
    /// The scenes.
    pub(super) sources: Vec<ScenarioRef>,
    /// The same, as a run's manifest tells of them.
    pub(super) list: ScenarioList,
}

/// The suites of a session; each is looked for once.
pub(super) struct Suites<'a> {
    flags: &'a ExperimentArguments,
    printer: Printer,
    roots: DataRoots,
    readers: Readers,
    found: BTreeMap<String, Rc<Suite>>,
}

impl<'a> Suites<'a> {
    /// Finds suites by the flags.
    ///
    /// # Errors
    /// When the working directory, which relative folders lie in, is gone.
    pub(super) fn new(flags: &'a ExperimentArguments, printer: Printer) -> anyhow::Result<Self> {
        let DataRoots { data, maps } = flags.data.roots();
        let absolute = |folder: Option<PathBuf>| folder.map(std::path::absolute).transpose();
        let roots = DataRoots { data: absolute(data)?, maps: absolute(maps)? };
        Ok(Self { flags, printer, readers: Readers::new(&roots), roots, found: BTreeMap::new() })
    }

    /// The suites of an experiment: those that the flags name, else its own, recordings only where some are at hand.
    ///
    /// # Errors
    /// When one is unknown, empty or cannot be read.
    pub(super) fn of(&mut self, experiment: &str, own: &[SuiteName]) -> anyhow::Result<Vec<Rc<Suite>>> {
        let flags = self.flags;
        if !flags.suites.is_empty() {
            return flags.suites.iter().map(|name| self.named(name)).collect();
        }
        let mut suites = Vec::new();
        for suite in own {
            match suite.split() {
                Some(name) => suites.push(self.named(name)?),
                None if self.recordings().is_empty() => {
                    self.printer.note(format!("{experiment}: no recordings: neither --scenario nor ${DATA} names any"));
                }
                None => suites.push(self.named(RECORDED)?),
            }
        }
        Ok(suites)
    }

    fn named(&mut self, name: &str) -> anyhow::Result<Rc<Suite>> {
        if let Some(suite) = self.found.get(name) {
            return Ok(Rc::clone(suite));
        }
        let suite = Rc::new(self.find(name).with_context(|| format!("suite {name}"))?);
        self.found.insert(name.to_owned(), Rc::clone(&suite));
        Ok(suite)
    }

    fn find(&self, name: &str) -> anyhow::Result<Suite> {
        let (mut words, splits) =
            if name == RECORDED { (self.recordings(), Vec::new()) } else { (Vec::new(), vec![name.to_owned()]) };
        if words.is_empty() && splits.is_empty() {
            bail!(
                "no recordings: name some by --scenario, or a folder with {} in it by ${DATA}",
                RECORDINGS.join(", ")
            );
        }
        let Found { mut sources, mut splits, missing } = find(&words, &splits, None, &self.readers, self.printer)?;
        if self.flags.quick {
            sources = Quick::DEFAULT.of(sources);
            (words, splits) = (sources.iter().map(ToString::to_string).collect(), Vec::new());
        }
        sources.iter().try_for_each(ScenarioRef::check)?;
        let list = ScenarioList {
            words,
            splits,
            data_root: self.roots.data.clone(),
            maps_root: self.roots.maps.clone(),
            limit: None,
            count: sources.len(),
            blake3: ScenarioList::digest(sources.iter().map(ToString::to_string)),
            missing,
        };
        // A filter file goes by its name without the folder and the ending.
        let name =
            Path::new(name).file_stem().map_or_else(|| name.to_owned(), |stem| stem.to_string_lossy().into_owned());
        Ok(Suite { name, sources, list })
    }

    /// The words that name recordings.
    fn recordings(&self) -> Vec<String> {
        if !self.flags.scenarios.is_empty() {
            return self.flags.scenarios.iter().map(|word| self.readers.absolute_word(word)).collect();
        }
        let data = std::env::var_os(DATA).filter(|folder| !folder.is_empty()).map(PathBuf::from);
        let folders = data.into_iter().flat_map(|data| RECORDINGS.map(|folder| data.join(folder)));
        let words = folders.filter(|folder| folder.is_dir()).map(|folder| folder.to_string_lossy().into_owned());
        words.map(|word| absolute_path(&word)).collect()
    }
}
