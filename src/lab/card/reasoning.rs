//! Whether the reasoning matters: how often the code agrees with a changed answer.

use super::changes::CHANGES;
use super::outcome::{Part, Share};
use super::state_record::{ChangedAnswer, StateRecord};
use planagent_agent::reasoning::{PromptForms, Round, UnderstandingForm};
use planagent_runs::worker::statistics::{Bootstrap, PairedDifference};
use serde::Serialize;

/// How the codes follow changed answers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Reasoning {
    /// States with the same code where the model's own answers were given: what is below 100 % is
    /// no effect of a change.
    pub(super) unchanged: Share,
    /// The rounds whose answers are changed.
    pub(super) rounds: Vec<RoundAgreement>,
    /// The changes, in the order of their table.
    pub(super) changes: Vec<ChangeAgreement>,
}

/// All changes of a round.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct RoundAgreement {
    pub(super) round: Round,
    /// The share of codes that agree, percent, with the bootstrap interval over states; or why it
    /// is not known.
    pub(super) agree_percent: Part<PairedDifference>,
}

/// One change.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct ChangeAgreement {
    pub(super) change: &'static str,
    pub(super) round: Round,
    /// The codes that agree, in words.
    pub(super) agreeing: String,
    /// Of the states that allow the change, those whose code agrees with it.
    pub(super) agree: Share,
    /// Those whose code is another one at all.
    pub(super) differ: Share,
}

impl Reasoning {
    pub(super) fn new(records: &[StateRecord], rounds: &[Round], forms: &PromptForms) -> Self {
        let changes = CHANGES.iter().map(|change| {
            let asked = answers_to(records, change.name);
            ChangeAgreement {
                change: change.name,
                round: change.round,
                agreeing: change.expected.in_words(),
                agree: Share::counted(&asked, |(_, changed)| changed.agrees),
                differ: Share::counted(&asked, |(record, changed)| changed.code != record.own.code),
            }
        });
        let of_round = |round: Round| RoundAgreement {
            round,
            agree_percent: match agreement(records, round) {
                Some(share) => Part::Known(share),
                None => Part::missing(why_none(round, rounds, forms)),
            },
        };
        Self {
            unchanged: Share::counted(records, |record| record.again == record.own.code),
            rounds: [Round::Understanding, Round::Instruction]
                .map(of_round)
                .to_vec(),
            changes: changes.collect(),
        }
    }
}

/// The states that allowed a change, with what came of it.
fn answers_to<'a>(
    records: &'a [StateRecord],
    name: &str,
) -> Vec<(&'a StateRecord, &'a ChangedAnswer)> {
    let of_record = |record: &'a StateRecord| {
        let own = record.changes.iter().find(|changed| changed.change == name);
        own.map(|changed| (record, changed))
    };
    records.iter().filter_map(of_record).collect()
}

/// Percent of the changes of a round with which the code agrees. The changes of a state are drawn
/// together: they share its code.
fn agreement(records: &[StateRecord], round: Round) -> Option<PairedDifference> {
    let is_of_round = |changed: &&ChangedAnswer| {
        CHANGES
            .iter()
            .any(|change| change.name == changed.change && change.round == round)
    };
    let clusters: Vec<Vec<f64>> = records
        .iter()
        .map(|record| {
            let own = record.changes.iter().filter(is_of_round);
            own.map(|changed| if changed.agrees { 100.0 } else { 0.0 })
                .collect()
        })
        .collect();
    Bootstrap::default().clustered(&clusters)
}

fn why_none(round: Round, rounds: &[Round], forms: &PromptForms) -> String {
    if !rounds.contains(&round) {
        return format!("the model is not asked the round {round}");
    }
    if round == Round::Understanding && forms.understanding == UnderstandingForm::Free {
        return "the prompt set asks for understanding in free sentences, in which no fact has a fixed place"
            .to_owned();
    }
    "no answer has a value that a change could replace".to_owned()
}

#[cfg(test)]
mod tests {
    use super::super::state_record::Answered;
    use super::*;
    use planagent_agent::reasoning::PromptSet;

    fn record(scene: &str, changes: &[(&str, Option<&str>, bool)]) -> StateRecord {
        StateRecord {
            scene: scene.to_owned(),
            time_s: 0.0,
            challenge: "reactive".to_owned(),
            best: "best".to_owned(),
            best_value: 1.0,
            own: Answered {
                code: Some("own".to_owned()),
                ..Answered::default()
            },
            again: Some("own".to_owned()),
            other_picture: None,
            no_picture: None,
            changes: changes
                .iter()
                .map(|&(change, code, agrees)| ChangedAnswer {
                    change: change.to_owned(),
                    code: code.map(str::to_owned),
                    agrees,
                })
                .collect(),
        }
    }

    #[test]
    fn shares_are_of_the_states_that_allow_a_change() {
        let (red, slow) = ("the light is red", "the speed becomes decelerate");
        let records = [
            record("a", &[(red, Some("new"), true), (slow, Some("own"), false)]),
            record("b", &[(red, Some("new"), false)]),
            record("c", &[(slow, None, false)]),
        ];
        let forms = *PromptSet::open("compact-2").unwrap().forms();
        let found = Reasoning::new(&records, Round::ALL, &forms);
        let of = |name: &str| {
            let row = found.changes.iter().find(|row| row.change == name).unwrap();
            let counts = |share: Share| (share.count, share.of);
            (counts(row.agree), counts(row.differ))
        };
        assert_eq!(of(red), ((1, 2), (2, 2)));
        // A code that cannot be read differs, and agrees with nothing.
        assert_eq!(of(slow), ((0, 2), (1, 2)));
        assert_eq!((found.unchanged.count, found.unchanged.of), (3, 3));
        let shares: Vec<f64> = found
            .rounds
            .iter()
            .map(|round| round.agree_percent.known().unwrap().mean)
            .collect();
        assert_eq!(shares, [50.0, 0.0]);
        // Wilson's interval of one of two.
        let [low, high] = found.changes[3].agree.interval;
        assert!(
            (low - 9.45).abs() < 0.1 && (high - 90.55).abs() < 0.1,
            "{low} {high}"
        );
    }

    #[test]
    fn a_round_that_cannot_be_changed_has_a_reason() {
        let why = |set: &str, rounds: &[Round]| {
            let forms = *PromptSet::open(set).unwrap().forms();
            let found = Reasoning::new(&[record("a", &[])], rounds, &forms);
            found.rounds[0].agree_percent.why_not().unwrap()
        };
        assert!(why("paper", Round::ALL).contains("free sentences"));
        assert!(why("brief", &[Round::Code]).contains("not asked the round understanding"));
        assert!(why("brief", Round::ALL).contains("no answer has a value"));
    }
}
