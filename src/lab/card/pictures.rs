//! Whether the picture matters for the first code: with that of another scene, and without one.

use super::outcome::Share;
use super::state_record::{Answered, StateRecord};
use planagent_runs::worker::statistics::{Bootstrap, PairedDifference};
use serde::Serialize;

/// The answers to another picture, compared with those to the own one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct PictureAnswers {
    /// What the model saw.
    pub(super) picture: &'static str,
    /// States with the same code.
    pub(super) same_code: Share,
    /// Mean regret of the codes, in the search's value; states without a plan are left out.
    pub(super) regret: Option<f64>,
    /// Its regret minus that with the own picture, with the bootstrap interval.
    pub(super) difference: Option<PairedDifference>,
}

/// The rows of both pictures.
pub(super) fn compare(records: &[StateRecord]) -> Vec<PictureAnswers> {
    let row = |picture, of: fn(&StateRecord) -> Option<&Answered>| {
        let asked: Vec<(&StateRecord, &Answered)> = records
            .iter()
            .filter_map(|record| Some((record, of(record)?)))
            .collect();
        // A code without a plan has no regret; how often that is stands among the planning calls.
        let regrets: Vec<f64> = asked
            .iter()
            .filter_map(|(record, answered)| record.regret(answered))
            .collect();
        let differences: Vec<f64> = asked
            .iter()
            .filter_map(|(record, answered)| {
                Some(record.regret(answered)? - record.regret(&record.own)?)
            })
            .collect();
        PictureAnswers {
            picture,
            same_code: Share::counted(&asked, |(record, answered)| {
                answered.code == record.own.code
            }),
            regret: (!regrets.is_empty())
                .then(|| regrets.iter().sum::<f64>() / regrets.len() as f64),
            difference: Bootstrap::default().difference(&differences),
        }
    };
    vec![
        row("own", |record| Some(&record.own)),
        row("another scene's", |record| record.other_picture.as_ref()),
        row("none", |record| record.no_picture.as_ref()),
    ]
}
