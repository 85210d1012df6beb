//! The files of a log, by the names that Argoverse 2 gives them.

use super::error::Argoverse2Error;
use std::io;
use std::path::{Path, PathBuf};

/// Ego poses of a sensor log.
const POSES: &str = "city_SE3_egovehicle.feather";
/// Annotations of a sensor log, as published.
const ANNOTATIONS: &str = "annotations.feather";

/// Where a log has what.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum LogFiles {
    /// A log of the sensor dataset.
    Sensor {
        /// Ego poses.
        poses: PathBuf,
        /// Annotated boxes.
        annotations: PathBuf,
        /// Vector map.
        map: PathBuf,
    },
    /// A scenario of the motion-forecasting dataset.
    Forecasting {
        /// Tracks.
        tracks: PathBuf,
        /// Vector map.
        map: PathBuf,
    },
}

impl LogFiles {
    /// What lies in a folder.
    ///
    /// # Errors
    /// When the folder is no log, or a file of it is missing.
    pub(super) fn of(folder: &Path) -> Result<Self, Argoverse2Error> {
        let missing = |file| Argoverse2Error::Missing { folder: folder.to_owned(), file };
        let poses = folder.join(POSES);
        if poses.is_file() {
            let published = folder.join(ANNOTATIONS);
            let annotations = if published.is_file() {
                published
            } else {
                first_named(folder, "annotations", ".feather")?.ok_or_else(|| missing("annotations*.feather"))?
            };
            let maps = folder.join("map");
            let map = if maps.is_dir() { map_in(&maps)? } else { None };
            let map = map.ok_or_else(|| missing("map/log_map_archive_*.json"))?;
            return Ok(Self::Sensor { poses, annotations, map });
        }
        let tracks = first_named(folder, "scenario_", ".parquet")?;
        let tracks = tracks.ok_or_else(|| Argoverse2Error::NoLog { folder: folder.to_owned() })?;
        let map = map_in(folder)?.ok_or_else(|| missing("log_map_archive_*.json"))?;
        Ok(Self::Forecasting { tracks, map })
    }
}

fn map_in(folder: &Path) -> Result<Option<PathBuf>, Argoverse2Error> {
    first_named(folder, "log_map_archive_", ".json")
}

/// The first file by name that begins and ends so.
fn first_named(folder: &Path, beginning: &str, ending: &str) -> Result<Option<PathBuf>, Argoverse2Error> {
    let fits = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with(beginning) && name.ends_with(ending)
    };
    Ok(entries(folder)?.into_iter().find(fits))
}

/// What a folder holds, by name.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, Argoverse2Error> {
    let failed = |source| Argoverse2Error::Read { path: folder.to_owned(), source };
    let listed = std::fs::read_dir(folder).map_err(failed)?;
    let mut paths = listed.map(|entry| entry.map(|e| e.path())).collect::<io::Result<Vec<_>>>().map_err(failed)?;
    paths.sort();
    Ok(paths)
}

/// Whether a folder is a log, be it complete or not.
pub fn is_log(folder: &Path) -> bool {
    folder.join(POSES).is_file() || matches!(first_named(folder, "scenario_", ".parquet"), Ok(Some(_)))
}

/// The logs in a folder and in the folders right below it (`sensor/val/LOG` for `sensor`), by name; none where there are none.
///
/// # Errors
/// When a folder cannot be listed.
pub fn logs_in(folder: &Path) -> Result<Vec<PathBuf>, Argoverse2Error> {
    let mut logs = Vec::new();
    for below in folders_in(folder)? {
        if is_log(&below) {
            logs.push(below);
        } else {
            logs.extend(folders_in(&below)?.into_iter().filter(|path| is_log(path)));
        }
    }
    Ok(logs)
}

fn folders_in(folder: &Path) -> Result<Vec<PathBuf>, Argoverse2Error> {
    Ok(entries(folder)?.into_iter().filter(|path| path.is_dir()).collect())
}

/// The city in the name of a sensor log's map: `MIA` of `log_map_archive_ID____MIA_city_47894.json`.
pub(super) fn city_of(map: &Path) -> Option<&str> {
    let (_, rest) = map.file_stem()?.to_str()?.split_once("____")?;
    rest.split('_').next().filter(|city| !city.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cities_are_read_off_the_names_of_maps() {
        assert_eq!(city_of(Path::new("map/log_map_archive_a-b____MIA_city_47894.json")), Some("MIA"));
        assert_eq!(city_of(Path::new("log_map_archive_a-b.json")), None);
    }
}
