//! The runs that a page is made of.

use crate::report::error::{ReportError, ReportFault};
use crate::report::manifest::Manifest;
use crate::report::run_files::{RunFiles, SimulationFolder};
use crate::report::run_folder::{CompletedSimulations, RunFolder};
use crate::report::simulation_row::SimulationRow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A run with its completed simulations.
#[derive(Debug)]
pub(super) struct RunSimulations {
    /// Name of its folder.
    pub(super) name: String,
    pub(super) manifest: Manifest,
    /// Its simulations by number.
    pub(super) rows: Vec<SimulationRow>,
    /// Their folders by number.
    pub(super) folders: BTreeMap<usize, SimulationFolder>,
}

impl RunSimulations {
    /// Reads the folders of runs; gives the folders of damaged simulations beside them.
    pub(super) fn read_all(paths: &[PathBuf]) -> Result<(Vec<Self>, Vec<PathBuf>), ReportError> {
        let mut all_damaged = Vec::new();
        let runs = paths
            .iter()
            .zip(names(paths)?)
            .map(|(path, name)| Self::read(path, name, &mut all_damaged));
        let runs = runs.collect::<Result<_, _>>()?;
        Ok((runs, all_damaged))
    }

    fn read(
        path: &Path,
        name: String,
        all_damaged: &mut Vec<PathBuf>,
    ) -> Result<Self, ReportError> {
        let files = RunFiles::open(path)?;
        let manifest = RunFolder::manifest_in(&files)?;
        let CompletedSimulations { mut rows, damaged } = RunFolder::completed_in(&files)?;
        all_damaged.extend(damaged);
        let folders = files.folders()?;
        // Another process may discard a simulation at this moment.
        rows.retain(|row| folders.contains_key(&row.number));
        if rows.is_empty() {
            return Err(ReportError::at(path)(ReportFault::NoSimulations));
        }
        Ok(Self {
            name,
            manifest,
            rows,
            folders,
        })
    }

    /// A number of the configuration, by its dotted key.
    pub(super) fn setting(&self, key: &str) -> Option<f64> {
        let value = self.value(key)?;
        value
            .as_float()
            .or_else(|| value.as_integer().map(|whole| whole as f64))
    }

    /// A word of the configuration, by its dotted key.
    pub(super) fn word(&self, key: &str) -> Option<&str> {
        self.value(key)?.as_str()
    }

    /// Whether a switch of the configuration is on, by its dotted key.
    pub(super) fn is_on(&self, key: &str) -> bool {
        self.value(key)
            .and_then(toml::Value::as_bool)
            .unwrap_or(false)
    }

    fn value(&self, key: &str) -> Option<&toml::Value> {
        let (table, name) = match key.rsplit_once('.') {
            Some((above, name)) => (
                above
                    .split('.')
                    .try_fold(&self.manifest.config, |t, part| t.get(part)?.as_table())?,
                name,
            ),
            None => (&self.manifest.config, key),
        };
        table.get(name)
    }

    /// Name of the model, if the run has one, and whether it reads text alone.
    pub(super) fn model(&self) -> Option<String> {
        let model = self.manifest.model.as_ref()?;
        let name = model.get("name")?.as_str()?;
        let sees = model.contains_key("image_size");
        let remark = if sees {
            ""
        } else {
            " (text alone, no BEV map)"
        };
        Some(format!("{name}{remark}"))
    }
}

/// Names of runs: those of their folders. Equal names get the parent folder as prefix.
pub(super) fn names(paths: &[PathBuf]) -> Result<Vec<String>, ReportError> {
    let absolute = |path: &PathBuf| std::path::absolute(path).map_err(ReportError::read(path));
    let paths: Vec<PathBuf> = paths.iter().map(absolute).collect::<Result<_, _>>()?;
    let own = |path: &Path| {
        path.file_name().map_or_else(
            || "run".to_owned(),
            |name| name.to_string_lossy().into_owned(),
        )
    };
    let names: Vec<String> = paths.iter().map(|path| own(path)).collect();
    let name = |path: &PathBuf| {
        let name = own(path);
        let above = path.parent().and_then(Path::file_name);
        match above.filter(|_| names.iter().filter(|other| **other == name).count() > 1) {
            Some(above) => format!("{}/{name}", above.to_string_lossy()),
            None => name,
        }
    };
    Ok(paths.iter().map(name).collect())
}
