//! The files of a log, by the names of Argoverse 2.

use super::error::{Argoverse2Error, LogFault};
use crate::folders::files_below;
use std::io;
use std::path::{Path, PathBuf};

const POSES: &str = "city_SE3_egovehicle.feather";
const ANNOTATIONS: &str = "annotations.feather";

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum LogFiles {
    Sensor(SensorFiles),
    Forecasting { tracks: PathBuf, map: PathBuf },
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct SensorFiles {
    pub(super) poses: PathBuf,
    pub(super) annotations: PathBuf,
    pub(super) map: PathBuf,
}

impl LogFiles {
    /// The log in a folder. Fails if the folder is no log or a file of it is missing.
    pub(super) fn in_folder(folder: &Path) -> Result<Self, Argoverse2Error> {
        let missing = |file| Argoverse2Error::at(folder)(LogFault::Missing(file));
        let poses = folder.join(POSES);
        // The files that are there tell the kind of log, and so which file is missed.
        if poses.is_file() {
            let published = folder.join(ANNOTATIONS);
            let annotations = if published.is_file() {
                published
            } else {
                annotations_in(folder)?.ok_or_else(|| missing("annotations*.feather"))?
            };
            let maps = folder.join("map");
            let map = if maps.is_dir() { map_in(&maps)? } else { None };
            let map = map.ok_or_else(|| missing("map/log_map_archive_*.json"))?;
            return Ok(Self::Sensor(SensorFiles {
                poses,
                annotations,
                map,
            }));
        }
        if annotations_in(folder)?.is_some() {
            return Err(missing(POSES));
        }
        match (
            first_named(folder, "scenario_", ".parquet")?,
            map_in(folder)?,
        ) {
            (Some(tracks), Some(map)) => Ok(Self::Forecasting { tracks, map }),
            (Some(_), None) => Err(missing("log_map_archive_*.json")),
            (None, Some(_)) => Err(missing("scenario_*.parquet")),
            (None, None) => Err(Argoverse2Error::at(folder)(LogFault::NoLog)),
        }
    }

    /// All of them.
    pub(super) fn paths(self) -> Vec<PathBuf> {
        match self {
            Self::Sensor(SensorFiles {
                poses,
                annotations,
                map,
            }) => vec![poses, annotations, map],
            Self::Forecasting { tracks, map } => vec![tracks, map],
        }
    }
}

fn annotations_in(folder: &Path) -> Result<Option<PathBuf>, Argoverse2Error> {
    first_named(folder, "annotations", ".feather")
}

fn map_in(folder: &Path) -> Result<Option<PathBuf>, Argoverse2Error> {
    first_named(folder, "log_map_archive_", ".json")
}

/// The first file by name with this beginning and ending.
fn first_named(
    folder: &Path,
    beginning: &str,
    ending: &str,
) -> Result<Option<PathBuf>, Argoverse2Error> {
    let fits = |path: &PathBuf| {
        let name = path
            .file_name()
            .expect("an entry of a folder has a name")
            .to_string_lossy();
        name.starts_with(beginning) && name.ends_with(ending)
    };
    Ok(entries(folder)?.into_iter().find(fits))
}

/// The entries of a folder, by name.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, Argoverse2Error> {
    let listed = std::fs::read_dir(folder)
        .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect());
    let mut paths: Vec<PathBuf> =
        listed.map_err(|error: io::Error| Argoverse2Error::at(folder)(error))?;
    paths.sort();
    Ok(paths)
}

/// True if a folder is a log, complete or not: it has one of its files, unless that is the map in
/// the folder of maps of a log of sensors.
pub(crate) fn is_log(folder: &Path) -> bool {
    let has = |found: Result<Option<PathBuf>, Argoverse2Error>| matches!(found, Ok(Some(_)));
    folder.join(POSES).is_file()
        || has(first_named(folder, "scenario_", ".parquet"))
        || has(annotations_in(folder))
        || folder.file_name().is_some_and(|name| name != "map") && has(map_in(folder))
}

/// The logs in the folders below a folder, by path. A folder that cannot be listed is one of the
/// notes.
pub fn logs_in(folder: &Path, notes: &mut Vec<String>) -> Result<Vec<PathBuf>, Argoverse2Error> {
    let mut logs = Vec::new();
    let enter = |below: &Path| {
        let is_log = is_log(below);
        if is_log {
            logs.push(below.to_owned());
        }
        !is_log
    };
    files_below(folder, enter, notes).map_err(Argoverse2Error::at(folder))?;
    logs.sort();
    Ok(logs)
}

/// The city in the name of a sensor log's map: `MIA` of
/// `log_map_archive_ID____MIA_city_47894.json`.
pub(super) fn city_of(map: &Path) -> Option<&str> {
    let (_, rest) = map.file_stem()?.to_str()?.split_once("____")?;
    rest.split('_').next().filter(|city| !city.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cities_are_parsed_from_the_names_of_maps() {
        assert_eq!(
            city_of(Path::new("map/log_map_archive_a-b____MIA_city_47894.json")),
            Some("MIA")
        );
        assert_eq!(city_of(Path::new("log_map_archive_a-b.json")), None);
    }
}
