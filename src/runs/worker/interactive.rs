//! The interactive suites: modified scenarios of interPlan's eight kinds, drawn before any was
//! simulated.

use super::seeds::Split as Seeds;
use super::split::SplitError;
use planagent_files::word_of;
use planagent_scenario::generator::{Spec, types};
use planagent_scenario::modified::{ModifiedName, ReadModification, to_intersection};
use planagent_scenario::{MissingTokens, RECORDINGS, ReaderError, Readers, ScenarioRef, Split};
use planagent_world::InteractionKind;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Name of the suite of generated scenarios.
pub const GENERATED: &str = "interactive-generated";
/// Name of the suite of recordings.
pub const RECORDED: &str = "interactive-recorded";
/// Names of both.
pub const NAMES: [&str; 2] = [GENERATED, RECORDED];

/// Scenarios of each kind in [`GENERATED`].
pub const SCENARIOS: usize = 100;
/// First test seed of [`GENERATED`]: those before belong to other suites. Each kind has a block of
/// seeds of its own.
const FIRST_SEED: u64 = 10_000;
const SEEDS_OF_KIND: u64 = 300;
/// Road before the next intersection that the maneuver of a kind takes, meters: a change of lanes,
/// or the way past what stands. In [`RECORDED`] the road is what it is.
const fn road_m(kind: InteractionKind) -> f64 {
    use InteractionKind as Kind;
    match kind {
        Kind::LowTrafficDensity | Kind::MediumTrafficDensity | Kind::HighTrafficDensity => 60.0,
        Kind::AvoidCrashedCars => 75.0,
        Kind::ApproachingConstructionZone => 80.0,
        Kind::OvertakeParkedVehicle
        | Kind::NudgeAroundParkedVehicle
        | Kind::JaywalkingPedestrian => 0.0,
    }
}

/// Scenarios that are tried out at once; the order of the list does not depend on it.
const BATCH: usize = 28;

/// Environment variable that names a folder of recordings.
const DATA: &str = "PLANAGENT_DATA";

const GENERATED_LIST: &str = include_str!("../../../suites/interactive-generated.txt");
const RECORDED_LIST: &str = include_str!("../../../suites/interactive-recorded.txt");
const GENERATED_HEADER: &str = "\
# interactive-generated: of each of the eight kinds the first 100 scenarios that it fits, with room for its maneuver before the next
# intersection, seed by seed and type by type.
# Drawn before any was simulated, by: planagent scenarios interactive --seeds test
";
const RECORDED_HEADER: &str = "\
# interactive-recorded: the recordings of a folder of data that each kind fits, by their paths in that folder.
# Drawn before any was simulated, by: planagent scenarios interactive --recordings FOLDER
";

/// The lines of a list without its comments.
fn words(list: &'static str) -> impl Iterator<Item = &'static str> {
    list.lines()
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
}

/// The words of a suite; `None` for other names. Those of recordings are paths in the folder of
/// data.
pub fn suite_words(name: &str) -> Option<Vec<&'static str>> {
    match name {
        GENERATED => Some(words(GENERATED_LIST).collect()),
        RECORDED => Some(words(RECORDED_LIST).collect()),
        _ => None,
    }
}

/// The scenarios of a suite; `None` for other names. Recordings that the folder of data lacks are
/// missing.
pub fn split(name: &str, readers: &Readers) -> Option<Result<Split, SplitError>> {
    let words = suite_words(name)?;
    let found = |words: Vec<String>| -> Result<Vec<ScenarioRef>, ReaderError> {
        let lists = words.iter().map(|word| readers.find(word));
        Ok(lists.collect::<Result<Vec<_>, _>>()?.concat())
    };
    if name == GENERATED {
        let scenarios = found(words.into_iter().map(str::to_owned).collect());
        return Some(scenarios.map(Split::from_scenarios).map_err(Into::into));
    }
    let data = std::env::var_os(DATA)
        .filter(|folder| !folder.is_empty())
        .map(PathBuf::from);
    let (mut here, mut absent) = (Vec::new(), Vec::new());
    for word in &words {
        // Only the recording's own file must exist; what follows it in the word is a modification.
        let base = ModifiedName::in_word(word).map_or(*word, |(base, _)| base);
        match data
            .as_ref()
            .map(|data| data.join(base))
            .filter(|path| path.exists())
        {
            Some(_) => here.extend(
                data.as_ref()
                    .map(|data| word_of(data.join(word).as_os_str())),
            ),
            None => absent.push((*word).to_owned()),
        }
    }
    let missing = MissingTokens {
        split: name.to_owned(),
        wanted: words.len(),
        absent,
        excluded: Vec::new(),
    };
    let notes = if data.is_none() {
        vec![format!(
            "${DATA} is not set; it names the folder of the recordings"
        )]
    } else {
        Vec::new()
    };
    let split = |scenarios| Split::from_scenarios(scenarios).lacking(missing, notes);
    Some(found(here).map(split).map_err(Into::into))
}

/// Draws the scenarios of [`GENERATED`] among the seeds of a split: the first that fit each kind.
///
/// # Errors
/// When too few fit a kind.
pub fn draw_generated(seeds: Seeds, per_kind: usize) -> Result<Vec<String>, ReaderError> {
    let mut all = Vec::new();
    for (place, kind) in InteractionKind::ALL.into_iter().enumerate() {
        let modification = modification(kind)?;
        let first = seeds.seeds().start + FIRST_SEED + place as u64 * SEEDS_OF_KIND;
        let of_seed =
            |seed| types::nuplan14().map(move |scenario_type| Spec::new(scenario_type, seed));
        let candidates: Vec<Spec> = (first..first + SEEDS_OF_KIND).flat_map(of_seed).collect();
        let mut own = Vec::new();
        for batch in candidates.chunks(BATCH) {
            let fits = |spec: &Spec| fitting(&modification, (*spec).into(), road_m(kind));
            own.extend(batch.par_iter().filter_map(fits).collect::<Vec<_>>());
            if own.len() >= per_kind {
                break;
            }
        }
        own.truncate(per_kind);
        all.extend(own);
    }
    Ok(all)
}

/// What was drawn in a folder of recordings.
#[derive(Debug)]
pub struct RecordedDraw {
    /// The scenarios, by their paths in the folder.
    pub words: Vec<String>,
    /// The recordings that cannot be opened, each with the reason.
    pub refused: Vec<String>,
}

/// Draws the scenarios of [`RECORDED`] in a folder of data: every recording with every kind that
/// fits it.
///
/// # Errors
/// When no recording of the folder can be opened, or no kind fits one.
pub fn draw_recorded(data: &Path, readers: &Readers) -> Result<RecordedDraw, ReaderError> {
    let folders: Vec<PathBuf> = RECORDINGS
        .map(|folder| data.join(folder))
        .into_iter()
        .filter(|folder| folder.is_dir())
        .collect();
    if folders.is_empty() {
        return Err(if data.is_dir() {
            ReaderError::Empty {
                path: data.to_owned(),
                looked_for: vec![format!(
                    "it has none of the folders {}; name the folder that holds them",
                    RECORDINGS.join(", ")
                )],
            }
        } else {
            ReaderError::Missing(data.to_owned())
        });
    }
    let (mut recordings, mut refused) = (Vec::new(), Vec::new());
    for folder in folders {
        match readers.find(&word_of(folder.as_os_str())) {
            Ok(found) => recordings.extend(found),
            Err(error) => refused.push(error.to_string()),
        }
    }
    // A kind that does not fit is no fault, a recording that cannot be opened is one.
    let problems: Vec<Option<String>> = recordings.par_iter().map(problem_of).collect();
    let mut problems = problems.into_iter();
    recordings.retain(|_| match problems.next().flatten() {
        Some(problem) => {
            refused.push(problem);
            false
        }
        None => true,
    });
    if recordings.is_empty() {
        let first = refused
            .into_iter()
            .next()
            .expect("each folder gives recordings or an error");
        return Err(ReaderError::Unreadable(first));
    }
    let prefix = format!("{}/", word_of(data.as_os_str()).trim_end_matches('/'));
    let mut words = Vec::new();
    for kind in InteractionKind::ALL {
        let modification = modification(kind)?;
        let fits = |recording: &ScenarioRef| fitting(&modification, recording.clone(), 0.0);
        let own: Vec<String> = recordings.par_iter().filter_map(fits).collect();
        words.extend(
            own.into_iter()
                .map(|word| word.strip_prefix(&prefix).unwrap_or(&word).to_owned()),
        );
    }
    if words.is_empty() {
        return Err(ReaderError::Unreadable(format!(
            "no kind fits a recording of {}: {} were opened",
            data.display(),
            recordings.len()
        )));
    }
    Ok(RecordedDraw { words, refused })
}

/// Why a recording cannot be opened, with its name.
fn problem_of(recording: &ScenarioRef) -> Option<String> {
    let problem = recording.open().err()?.to_string();
    let word = recording.to_string();
    let file = word.split('#').next().unwrap_or(&word);
    Some(if problem.contains(file) {
        problem
    } else {
        format!("{word}: {problem}")
    })
}

fn modification(kind: InteractionKind) -> Result<ReadModification, ReaderError> {
    ModifiedName::for_kind(kind)
        .read()
        .map_err(ReaderError::new)
}

/// The word of a scenario that a modification fits, with so much road before the next intersection.
fn fitting(modification: &ReadModification, base: ScenarioRef, road_m: f64) -> Option<String> {
    let modified = modification.modify(base);
    let opened = modified.open().ok()?;
    to_intersection(&opened)
        .is_none_or(|road| road >= road_m)
        .then(|| modified.to_string())
}

/// The text of `suites/interactive-generated.txt`.
pub fn generated_list(words: &[String]) -> String {
    listed(GENERATED_HEADER, words)
}

/// The text of a list of other seeds, or of another number of scenarios.
pub fn other_list(words: &[String], seeds: Seeds, count: usize) -> String {
    let header = format!(
        "# Of each of the eight kinds the first {count} scenarios that it fits, seed by seed and type by type.\n\
         # Drawn by: planagent scenarios interactive --seeds {seeds} --count {count}\n",
        seeds = seeds.as_str()
    );
    listed(&header, words)
}

/// The text of `suites/interactive-recorded.txt`.
pub fn recorded_list(words: &[String]) -> String {
    listed(RECORDED_HEADER, words)
}

fn listed(header: &str, words: &[String]) -> String {
    words
        .iter()
        .fold(header.to_owned(), |list, word| format!("{list}{word}\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_scenario::{DataRoots, ScenarioReader};
    use std::collections::BTreeSet;

    #[test]
    fn each_kind_has_its_scenarios_of_test_seeds_of_its_own() {
        let words = suite_words(GENERATED).unwrap();
        assert_eq!(words.len(), 8 * SCENARIOS);
        let mut seen = BTreeSet::new();
        for (chunk, kind) in words.chunks(SCENARIOS).zip(InteractionKind::ALL) {
            for word in chunk {
                let (base, name) = ModifiedName::in_word(word).unwrap();
                assert_eq!(name, ModifiedName::for_kind(kind));
                let spec: Spec = base.parse().unwrap();
                assert!(
                    Seeds::Test.seeds().contains(&spec.seed) && seen.insert(spec),
                    "{word}"
                );
                assert!(
                    spec.seed >= Seeds::Test.seeds().start + FIRST_SEED,
                    "{word}"
                );
            }
        }
    }

    #[test]
    fn the_lists_are_as_they_are_written() {
        let owned = |name| {
            suite_words(name)
                .unwrap()
                .into_iter()
                .map(str::to_owned)
                .collect::<Vec<_>>()
        };
        assert_eq!(generated_list(&owned(GENERATED)), GENERATED_LIST);
        assert_eq!(recorded_list(&owned(RECORDED)), RECORDED_LIST);
    }

    #[test]
    fn a_folder_without_recordings_is_an_error() {
        let readers = Readers::new(&DataRoots::default());
        let folder = tempfile::tempdir().unwrap();
        let error = |path: &Path| draw_recorded(path, &readers).unwrap_err().to_string();
        let empty = error(folder.path());
        assert!(empty.contains("none of the folders womd"), "{empty}");
        let absent = error(&folder.path().join("absent"));
        assert!(absent.contains("there is no file or folder"), "{absent}");
        // A folder of the right name without recordings.
        std::fs::create_dir(folder.path().join("womd")).unwrap();
        assert!(error(folder.path()).contains("holds no scenarios"));
    }

    /// One recording opens, the other does not.
    #[derive(Debug)]
    struct HalfBroken;

    impl ScenarioReader for HalfBroken {
        fn recognizes(&self, word: &str) -> bool {
            word.ends_with("womd")
        }

        fn list(&self, word: &str) -> Result<Vec<ScenarioRef>, ReaderError> {
            let good: Spec = "generated/following_lane_with_lead/3"
                .parse()
                .expect("a name of a scene");
            let broken = ScenarioRef::unreadable(&Path::new(word).join("b"), "cut".to_owned());
            Ok(vec![good.into(), broken])
        }
    }

    #[test]
    fn a_recording_that_cannot_be_opened_is_told_and_hides_no_other() {
        let readers = Readers::new(&DataRoots::default()).with(HalfBroken);
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("womd")).unwrap();
        let drawn = draw_recorded(folder.path(), &readers).unwrap();
        assert!(!drawn.words.is_empty());
        let [refused] = &drawn.refused[..] else {
            panic!("{drawn:?}")
        };
        assert!(refused.contains("womd/b: cut"), "{refused}");
    }

    #[test]
    fn scenarios_of_the_generated_suite_open() {
        let readers = Readers::new(&DataRoots::default());
        let scenarios = split(GENERATED, &readers).unwrap().unwrap().scenarios;
        for scenario in scenarios.iter().step_by(SCENARIOS) {
            let opened = scenario.open().unwrap();
            assert_eq!(Some(opened.id.as_str()), scenario.id());
            assert_eq!(
                Some(opened.scenario_type.as_str()),
                scenario.scenario_type()
            );
        }
    }
}
