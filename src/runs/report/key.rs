//! The key to the compact texts: what the words of scene text, answers and feedback mean.
//! Transcripts begin with it, and docs/prompts.md and the page have it.

use super::call_record::CallRecord;
use planagent_agent::environment::TextForm;
use planagent_agent::environment::facts::{
    Ahead, CORRIDOR_MARGIN, EgoSpeed, ONCOMING_ASIDE, ONCOMING_REACH, Question, SAME_SPEED,
    SIDE_GAP, STOPPED,
};
use planagent_agent::environment::lane_graph::CROSSING_SECONDS;
use planagent_agent::environment::text::MAX_NUMBER;
use planagent_agent::planner::PlanningCall;
use planagent_agent::reasoning::{
    InstructionForm, Lateral, LateralReason, Longitudinal, LongitudinalReason, Round,
    UnderstandingForm,
};
use serde::Serialize;
use std::fmt::Write;

/// Key of the lateral motion in the compact answers of `instruction`.
const LATERAL_KEY: &str = "lat=";

/// Which parts of a simulation's texts are compact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct CompactParts {
    scene: bool,
    /// The form of the answers to round 1.
    understanding: Option<UnderstandingForm>,
    instruction: bool,
}

impl CompactParts {
    #[cfg(test)]
    const ALL: Self = Self {
        scene: true,
        understanding: Some(UnderstandingForm::Choices),
        instruction: true,
    };
    #[cfg(test)]
    const NANO: Self = Self {
        understanding: Some(UnderstandingForm::Choices2),
        ..Self::ALL
    };

    /// Those of the planning calls of a simulation.
    pub(super) fn from_calls(calls: &[PlanningCall]) -> Self {
        let forms = calls.iter().find_map(|call| call.forms);
        let asked = calls
            .iter()
            .any(|call| call.attempts.iter().any(|attempt| attempt.rounds.len() > 1));
        Self {
            scene: forms.is_some_and(|forms| forms.scene_text.is_for_small_models())
                && calls.iter().any(|call| call.scene_text.is_some()),
            understanding: forms
                .map(|forms| forms.understanding)
                .filter(|form| asked && !form.questions().is_empty()),
            instruction: asked
                && forms.is_some_and(|forms| forms.instruction == InstructionForm::Choices),
        }
    }

    /// Those of recorded calls. A record has the texts and not their forms, and the forms show in
    /// the texts.
    pub(super) fn seen_in(calls: &[CallRecord]) -> Self {
        let answers = |round: Round| {
            let rounds = calls
                .iter()
                .flat_map(|call| &call.attempts)
                .flat_map(|attempt| &attempt.rounds);
            rounds
                .filter(move |one| one.round == round.into())
                .map(|one| one.answer.as_str())
        };
        let is_choice = |answer: &str| {
            Question::ALL
                .iter()
                .any(|question| answer.starts_with(&format!("{question}=")))
        };
        let second = format!(" {}=", Question::CrossingVehicle);
        let form = |answer: &str| match (is_choice(answer), answer.contains(&second)) {
            (true, true) => Some(UnderstandingForm::Choices2),
            (true, false) => Some(UnderstandingForm::Choices),
            (false, _) => None,
        };
        Self {
            scene: calls
                .iter()
                .filter_map(|call| call.scene_text.as_deref())
                .any(TextForm::is_compact),
            understanding: answers(Round::Understanding).find_map(form),
            instruction: answers(Round::Instruction).any(|answer| answer.contains(LATERAL_KEY)),
        }
    }

    /// The tables of the key; none without compact texts.
    pub(super) fn tables(self) -> Vec<KeyTable> {
        let questions = self
            .understanding
            .map_or(&[][..], UnderstandingForm::questions);
        let understanding = || {
            questions
                .iter()
                .map(|&question| understanding(question))
                .collect()
        };
        let estimates = self.understanding == Some(UnderstandingForm::Choices2);
        let tables = [
            (self.scene, "scene text", scene(estimates)),
            (
                self.understanding.is_some(),
                "answers of `understanding`",
                understanding(),
            ),
            (self.instruction, "answers of `instruction`", instruction()),
            (self.scene, "prompts", prompts()),
        ];
        let shown = tables.into_iter().filter(|(is_shown, ..)| *is_shown);
        shown
            .map(|(_, title, rows)| KeyTable {
                title: title.to_owned(),
                rows,
            })
            .collect()
    }

    /// The key as Markdown; empty without compact texts.
    pub(super) fn key(self) -> String {
        let mut text = String::new();
        for KeyTable { title, rows } in self.tables() {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "| {title} | meaning |\n|---|---|");
            for (words, meaning) in rows {
                let _ = writeln!(text, "| {words} | {meaning} |");
            }
            text.push('\n');
        }
        text
    }
}

/// A table of the key. Words of prompts and answers stand between backticks.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(super) struct KeyTable {
    pub(super) title: String,
    /// Words and what they mean.
    pub(super) rows: Vec<(String, String)>,
}

fn row(words: &str, meaning: impl Into<String>) -> (String, String) {
    (words.to_owned(), meaning.into())
}

/// Numbers and names as `environment::text` writes them.
fn scene(estimates: bool) -> Vec<(String, String)> {
    let estimate = estimates.then(|| {
        row(
            "`limit ~11`",
            "the map has no limit; an estimate by lanes and traffic",
        )
    });
    let oncoming = estimates.then(|| {
        let meaning = "the oncoming lane leads past what blocks the ego's lane: meters from the front bumper to the blocked part and to \
                       its end, then meters and m/s of the next oncoming vehicle (`- -` without one)";
        row("`oncoming 12 17 46 8`", meaning)
    });
    let goal = estimates.then(|| {
        let meaning = "the goal: its side, lane changes to its lane, and meters along the lane; `goal ego 0 60` in the ego's lane";
        row("`goal left 2 60`", meaning)
    });
    let mut rows = vec![
        // In the order of the text, so that a reader finds each line where it stands.
        row(
            "`speed 7`",
            format!("speed of the ego, m/s; all numbers are whole and at most {MAX_NUMBER}"),
        ),
        row("`limit 11`", "speed limit, m/s; `-` where it is unknown"),
        row(
            "`light red 24`",
            "next light in the ego's lane (`green`, `yellow`, `red`, `unknown`), and meters from the front bumper to its stop \
             line; `none -` without a light",
        ),
        row(
            "`turn straight`",
            "where the route goes at the next intersection: `straight`, `left` or `right`",
        ),
        row(
            "`ego`, `front`, `back`",
            "parts of the ego's lane: under the ego, ahead of that, behind",
        ),
        row(
            "`left`, `front_left`, `back_left`",
            "parts of the lane to the left: beside the ego, ahead, behind",
        ),
        row(
            "`right`, `front_right`, `back_right`",
            "the same to the right",
        ),
        row(
            "`front vehicle1 14 7`",
            "the nearest agent on that part: its name (`vehicle`, `bicycle`, `pedestrian` or `obstacle`, and a number), meters \
             from bumper to bumper, m/s",
        ),
        row(
            "`front pedestrian1 14 crossing`",
            "in place of the speed: it moves across the lane (`crossing`) or against it (`oncoming`)",
        ),
        row("`front free - -`", "nobody is on that part"),
        row("`left none - -`", "there is no such lane"),
        row(
            "`rest 0`",
            "number of agents on these parts that the text does not name",
        ),
    ];
    rows.extend(estimate);
    rows.extend(oncoming);
    rows.extend(goal);
    rows
}

fn understanding(question: Question) -> (String, String) {
    let distance = format!(
        "`near` (under {} m), `mid` (under {} m), `far` (up to {} m), `none`",
        Ahead::NEAR,
        Ahead::MID,
        Ahead::FAR
    );
    let choices = || {
        question
            .choices()
            .iter()
            .map(|choice| format!("`{choice}`"))
            .collect::<Vec<_>>()
            .join(", ")
    };
    let listed = |what: &str| format!("{what}: {}", choices());
    // One match: an arm is a row of docs/prompts.md, with the limits that the code applies.
    let meaning = match question {
        Question::SceneType => listed("kind of place"),
        Question::Light => listed("next light"),
        Question::LaneCount => listed("lanes of the ego's direction"),
        Question::LaneIndex => listed("the ego's lane among them, from the left"),
        Question::Crosswalk => format!("next crosswalk on the path: {distance}"),
        Question::LeadDistance => format!("nearest vehicle or bicycle on the path: {distance}"),
        Question::LeadSpeed => format!(
            "its speed: `stopped` (under {STOPPED} m/s), `slower` (than the ego by more than {SAME_SPEED} m/s), \
             `same_or_faster`, `none`"
        ),
        Question::Pedestrian => {
            format!(
                "nearest pedestrian within {CORRIDOR_MARGIN} m beside the ego's path: {distance}"
            )
        }
        Question::Blocked => format!("nearest obstacle or stopped vehicle on the path: {distance}"),
        Question::LeftLane => {
            format!(
                "lane to the left: `none`, `free`, `occupied` (an object within {SIDE_GAP} m of the ego's bumpers)"
            )
        }
        Question::RightLane => "the same to the right: `none`, `free`, `occupied`".to_owned(),
        Question::VehicleCount => listed("other vehicles in the picture"),
        Question::Oncoming => {
            format!(
                "whether a lane of the other direction is within {ONCOMING_REACH} m: {}",
                choices()
            )
        }
        Question::EgoSpeed => format!(
            "speed of the ego: `stopped` (under {STOPPED} m/s), `slow` (under {} m/s), `medium` (under {} m/s), `fast`",
            EgoSpeed::SLOW,
            EgoSpeed::MEDIUM
        ),
        Question::Turn => listed("where the route goes at the next intersection"),
        Question::CrossingVehicle => {
            format!("nearest vehicle or bicycle that moves across the path: {distance}")
        }
        Question::OncomingVehicle => {
            format!(
                "nearest oncoming vehicle or bicycle within {ONCOMING_ASIDE} m beside the path: {distance}"
            )
        }
        Question::PersonOnPath => {
            format!(
                "nearest pedestrian on the ego's path, or there within {CROSSING_SECONDS} s: {distance}"
            )
        }
    };
    (format!("`{question}=`"), meaning)
}

fn instruction() -> Vec<(String, String)> {
    let words = |texts: &[&str]| {
        texts
            .iter()
            .map(|text| format!("`{text}`"))
            .collect::<Vec<_>>()
            .join(", ")
    };
    // In the order in which the answer is written: a reason stands before what it explains.
    vec![
        row(
            &format!("`{LATERAL_KEY}`"),
            format!("motion across the road: {}", words(Lateral::TEXTS)),
        ),
        row(
            "`why=` before it",
            format!(
                "its reason: {} (the lane follows the route, is blocked, has a slow lead agent, or the other lane is faster or the \
                 goal's)",
                words(LateralReason::TEXTS)
            ),
        ),
        row(
            "`lon=`",
            format!("motion along the road: {}", words(Longitudinal::TEXTS)),
        ),
        row(
            "`why=` before it",
            format!(
                "its reason, the strongest limit: {}",
                words(LongitudinalReason::TEXTS)
            ),
        ),
    ]
}

fn prompts() -> Vec<(String, String)> {
    vec![
        row(
            "`scene?` `motion?` `code?`",
            "the questions of the three rounds: `understanding`, `instruction`, `code`",
        ),
        row(
            "`again: collision=0.00 …`",
            "the last code was refused; the parts of its score, each from 0 to 1: `collision` (no collision at fault), `area` \
             (on drivable area), `direction` (not in oncoming lanes), `progress`, `ttc` (time to collision), `comfort`",
        ),
        row("`again: unread`", "the last answer held no code"),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::CallTimes;
    use planagent_agent::reasoning::{Feedback, Names, PromptSet, feedback_text, round_prompt};
    use planagent_mllm::TokenCounts;
    use std::collections::BTreeSet;
    use std::path::Path;

    const BEGIN: &str = "<!-- key: begin -->\n";
    const END: &str = "<!-- key: end -->\n";

    #[test]
    fn the_documented_key_is_that_of_transcripts() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/prompts.md");
        let text = std::fs::read_to_string(&path).unwrap();
        let (before, rest) = text.split_once(BEGIN).unwrap();
        let (documented, after) = rest.split_once(END).unwrap();
        let key = CompactParts::NANO.key();
        if std::env::var_os("PLANAGENT_UPDATE_DOCS").is_some_and(|value| value == "1") {
            std::fs::write(&path, format!("{before}{BEGIN}{key}{END}{after}")).unwrap();
            return;
        }
        assert_eq!(
            documented, key,
            "docs/prompts.md is out of date: PLANAGENT_UPDATE_DOCS=1 cargo test --lib key"
        );
    }

    #[test]
    fn the_forms_of_recorded_calls_show_in_their_texts() {
        let round = |round: Round, answer: &str| {
            serde_json::json!({
                "round": round, "prompt": "", "prompt_hash": "", "answer": answer, "finish": "complete",
                "constraint": "unconstrained", "tokens": TokenCounts::default(),
            })
        };
        let call = |scene_text: &str, answers: [&str; 2]| -> CallRecord {
            let rounds = [
                round(Round::Understanding, answers[0]),
                round(Round::Instruction, answers[1]),
            ];
            let attempt = serde_json::json!({"rounds": rounds, "instruction": null, "code": null, "errors": [], "reflection": null});
            let times = serde_json::json!({"call": CallTimes::default(), "attempts": []});
            serde_json::from_value(serde_json::json!({
                "scenario": "s", "planner": "p", "iteration": 0, "at_s": 0.0, "image_blake3": null,
                "scene_text": scene_text, "attempts": [attempt], "decision": {"kind": "gated", "score": 1.0},
                "emergency_brakes": 0, "time": times,
            }))
            .unwrap()
        };
        let compact = call(
            "speed 9 limit 13 light none - turn straight",
            [
                "scene_type=straight light=none",
                "why=lane_serves lat=keep why=lead lon=maintain",
            ],
        );
        assert_eq!(CompactParts::seen_in(&[compact]), CompactParts::ALL);
        let sentences = call(
            "Ego: 9 m/s, limit 13 m/s.",
            ["A straight road.", "Longitudinal: maintain, because of it"],
        );
        assert!(CompactParts::seen_in(&[sentences]).tables().is_empty());
        assert!(!TextForm::is_compact("speed limits do not matter") && !TextForm::is_compact(""));
    }

    /// The words of a text, without the numbers of agents.
    fn words(text: &str) -> BTreeSet<String> {
        let words = text.split(|c: char| {
            !(c.is_alphanumeric() || c == '_' || c == '-' || c == '+' || c == '?')
        });
        let bare = words.map(|word| {
            word.trim_end_matches(|c: char| c.is_ascii_digit())
                .to_owned()
        });
        bare.filter(|word| word.chars().any(char::is_alphabetic))
            .collect()
    }

    #[test]
    fn the_key_has_every_word_of_the_compact_texts() {
        let key = CompactParts::ALL.key();
        let quoted: BTreeSet<String> = key.split('`').skip(1).step_by(2).flat_map(words).collect();
        let mut used = BTreeSet::new();
        let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/text");
        for scene in ["crossing", "narrow", "road"] {
            used.extend(words(
                &std::fs::read_to_string(golden.join(format!("{scene}.compact.txt"))).unwrap(),
            ));
        }
        used.extend(
            Question::first_version()
                .iter()
                .flat_map(|question| question.choices())
                .flat_map(|choice| words(choice)),
        );
        used.extend(
            Question::first_version()
                .iter()
                .flat_map(|question| words(question.as_str())),
        );
        for texts in [
            Lateral::TEXTS,
            LateralReason::TEXTS,
            Longitudinal::TEXTS,
            LongitudinalReason::TEXTS,
        ] {
            used.extend(texts.iter().flat_map(|text| words(text)));
        }
        let set = PromptSet::open("compact").unwrap();
        for &round in Round::ALL {
            used.extend(words(
                &round_prompt(&set, round, &Names::default(), None, None).unwrap(),
            ));
        }
        let parts = planagent_agent::reflection::SubScores {
            no_collision: 0.0,
            drivable_area: 0.0,
            driving_direction: 0.0,
            progress: 0.0,
            time_to_collision: 0.0,
            comfort: 0.0,
        };
        for score in [None, Some(0.0)] {
            let parts = parts
                .named()
                .map(|(name, value)| (name.to_owned(), value))
                .to_vec();
            let feedback = Feedback {
                code: None,
                score,
                threshold: 0.75,
                parts,
                is_slow: false,
                errors: Vec::new(),
            };
            used.extend(words(&feedback_text(&set, &feedback).unwrap()));
        }
        let missing: Vec<&String> = used.difference(&quoted).collect();
        assert!(
            used.len() > 60 && missing.is_empty(),
            "the key lacks {missing:?}"
        );
    }
}
