//! Opening a scenario by a word.

use super::{DataRoots, ReaderError, Readers, Scenario};

/// Why a word opens no scenario.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum OpenError {
    #[error(transparent)]
    Reader(#[from] ReaderError),
    #[error("'{word}' names {count} scenarios; use Scenario::open_all")]
    ManyScenarios { word: String, count: usize },
}

type Result<T, E = OpenError> = std::result::Result<T, E>;

impl Scenario {
    /// Opens the scenario that a word names, as on the command line: a generated scenario
    /// (`generated/changing_lane/2`), a Waymo TFRecord file of one scenario, a nuPlan log with a
    /// token, a folder of an Argoverse 2 scenario.
    ///
    /// ```
    /// # use planagent_scenario::Scenario;
    /// let scenario = Scenario::open("generated/changing_lane/2")?;
    /// assert_eq!(scenario.scenario_type, "changing_lane");
    /// # Ok::<(), planagent_scenario::OpenError>(())
    /// ```
    ///
    /// # Errors
    /// When the word names no scenario or several, or the scenario cannot be read.
    pub fn open(word: &str) -> Result<Self> {
        let found = Readers::new(&DataRoots::from_environment()).find(word)?;
        match found.as_slice() {
            [one] => Ok(one.open()?),
            several => Err(OpenError::ManyScenarios {
                word: word.to_owned(),
                count: several.len(),
            }),
        }
    }

    /// Opens all scenarios that a word names, for example those of a folder, one by one.
    ///
    /// # Errors
    /// When the word names no scenario.
    pub fn open_all(word: &str) -> Result<impl Iterator<Item = Result<Self>>> {
        let found = Readers::new(&DataRoots::from_environment()).find(word)?;
        Ok(found.into_iter().map(|scenario| Ok(scenario.open()?)))
    }
}
