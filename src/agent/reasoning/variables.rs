//! The variables of the templates of a prompt set. docs/prompts.md lists them; a test holds the
//! list equal to this file.

use super::code::{ACCEL_MAX, DECEL_MAX, FUNCTION, Names, TARGET_SPEED};
use super::engine::Feedback;
use super::question::FreeQuestion;
use minijinja::{Value, context};

/// Variables of `system`: the same for all calls of a run. `legend` is the meaning of the image's
/// colors, empty for a model that reads text alone.
pub(super) fn system(legend: &str) -> Value {
    context! {
        function => FUNCTION,
        legend => legend,
        ranges => context! {
            v0 => TARGET_SPEED.to_string(), acc => ACCEL_MAX.to_string(), dec => DECEL_MAX.to_string(),
        },
    }
}

/// Variables of the three rounds.
pub(super) fn round(names: &Names, scene_text: Option<&str>, feedback: Option<&str>) -> Value {
    fn words<T: ToString>(names: &[T]) -> Vec<String> {
        names.iter().map(T::to_string).collect()
    }
    context! {
        scene_text => scene_text.unwrap_or_default(),
        feedback => feedback,
        centerlines => words(&names.centerlines),
        leaders => words(&names.lead_agents),
    }
}

/// Variables of `feedback`.
pub(super) fn feedback(feedback: &Feedback) -> Value {
    let rounded = |value: f64| format!("{value:.2}");
    context! {
        code => &feedback.code,
        score => feedback.score.map(rounded),
        threshold => (feedback.threshold * 100.0).round() / 100.0,
        parts => feedback.parts.iter().map(|(name, value)| (name.clone(), rounded(*value))).collect::<Vec<_>>(),
        errors => feedback.errors.iter().map(ToString::to_string).collect::<Vec<_>>(),
    }
}

/// Variables of `ask`. `compact` says whether the model reads compact texts.
pub(super) fn ask(question: &FreeQuestion<'_>, compact: bool) -> Value {
    let FreeQuestion {
        question,
        scene_text,
        legend,
    } = *question;
    context! { compact => compact, question => question.trim(), scene_text => scene_text, legend => legend }
}

/// Variables of LLM-ASSIST's `system`.
pub(super) fn assist_system(signature: &str, compact: bool) -> Value {
    context! { compact => compact, signature => signature }
}

/// Variables of LLM-ASSIST's `question`: the scene and the score of PDM-Closed's best proposal, and
/// feedback on the last answer.
pub(super) fn assist_question(
    scene_text: &str,
    score: f64,
    feedback: Option<&str>,
    compact: bool,
) -> Value {
    let score = format!("{score:.2}");
    context! { compact => compact, scene_text => scene_text, score => score, feedback => feedback }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::CenterlineName;
    use crate::environment::bev::Palette;
    use crate::reasoning::call_parser::ParseError;
    use crate::reasoning::known_variables;
    use crate::reasoning::{PromptSet, feedback_text};
    use minijinja::value::ValueKind;
    use std::collections::BTreeMap;

    #[test]
    fn a_plan_that_needs_no_change_of_lanes_is_said_in_words() {
        let refused = Feedback {
            code: None,
            score: Some(1.0),
            threshold: 1.0195,
            parts: vec![("progress".to_owned(), 1.0)],
            is_slow: false,
            errors: Vec::new(),
        };
        for set in ["brief", "paper"] {
            let prompts = PromptSet::open(set).unwrap();
            let text = feedback_text(&prompts, &refused).unwrap();
            let words = "own lane is no worse";
            assert!(
                text.contains(words) && !text.contains("is needed"),
                "{text}"
            );
        }
    }

    /// The call that the examples of docs/prompts.md are from, and one in which everything optional
    /// is missing.
    fn contexts() -> [(&'static str, [Value; 2]); 6] {
        let names = Names {
            centerlines: vec![CenterlineName::EgoLane, CenterlineName::LeftLane],
            lead_agents: vec!["vehicle1".parse().unwrap(), "pedestrian1".parse().unwrap()],
            speed_limit: Some(13),
        };
        let refused = Feedback {
            code: Some(
                "Generate_IDM_Planner(c=left_lane, la=None, v0=11, acc=1.5, dec=3)".to_owned(),
            ),
            score: Some(0.414),
            threshold: 0.75,
            parts: vec![("collision".to_owned(), 1.0), ("progress".to_owned(), 0.2)],
            is_slow: true,
            errors: Vec::new(),
        };
        let error = ParseError {
            span: 0..4,
            message: "no call".to_owned(),
            hint: "write one line".to_owned(),
        };
        let unread = Feedback {
            code: None,
            score: None,
            threshold: 0.75,
            parts: Vec::new(),
            is_slow: false,
            errors: vec![error],
        };
        let scene = "Ego: 9 m/s, limit 13 m/s, route straight, light red in 24 m.";
        let last = "Your last planner was refused.";
        let legend = Palette::legend();
        let free = FreeQuestion {
            question: "What blocks us?",
            scene_text: Some(scene),
            legend: &legend,
        };
        let line = "Tune_PDM(v0, gap, headway, acc, dec, brake)";
        [
            ("system", [system(&legend), system("")]),
            (
                "rounds",
                [
                    round(&names, Some(scene), Some(last)),
                    round(&Names::default(), None, None),
                ],
            ),
            ("feedback", [feedback(&refused), feedback(&unread)]),
            (
                "ask",
                [
                    ask(&free, false),
                    ask(
                        &FreeQuestion {
                            scene_text: None,
                            ..free
                        },
                        false,
                    ),
                ],
            ),
            (
                "LLM-ASSIST's system",
                [false, false].map(|compact| assist_system(line, compact)),
            ),
            (
                "LLM-ASSIST's question",
                [Some(last), None].map(|last| assist_question(scene, 0.414, last, false)),
            ),
        ]
    }

    #[test]
    fn the_known_variables_are_those_of_the_contexts() {
        for (template, [context, _]) in contexts() {
            let mut found = BTreeMap::new();
            variables("", &context, &mut found);
            let known = match template {
                "ask" => known_variables::of_question("ask", "question"),
                "LLM-ASSIST's system" => known_variables::of_question("llm_assist_unc", "system"),
                "LLM-ASSIST's question" => {
                    known_variables::of_question("llm_assist_par", "question")
                }
                of_set => known_variables::of_template(of_set),
            };
            let known: Vec<&str> = known.to_vec();
            let mut sorted = known.clone();
            sorted.sort_unstable();
            assert_eq!(
                sorted,
                found.keys().map(String::as_str).collect::<Vec<_>>(),
                "{template}"
            );
        }
    }

    /// Names, types and examples of all values of a context; those of a map with its name before a
    /// point.
    fn variables(prefix: &str, value: &Value, found: &mut BTreeMap<String, (Vec<String>, String)>) {
        for key in value.try_iter().unwrap() {
            let (name, value) = (format!("{prefix}{key}"), value.get_item(&key).unwrap());
            if value.kind() == ValueKind::Map {
                variables(&format!("{name}."), &value, found);
                continue;
            }
            let (kinds, example) = found.entry(name).or_default();
            let kind = match value.kind() {
                ValueKind::Seq if value.len() == Some(0) => continue,
                ValueKind::Seq if value.get_item_by_index(0).unwrap().kind() == ValueKind::Seq => {
                    "list of pairs"
                }
                ValueKind::Seq => "list of strings",
                ValueKind::None => "none",
                ValueKind::Number => "number",
                ValueKind::Bool => "true or false",
                ValueKind::String => "string",
                other => panic!("{other}"),
            };
            if !kinds.iter().any(|known| known == kind) {
                kinds.push(kind.to_owned());
            }
            if example.is_empty() {
                *example = value.to_string();
            }
        }
    }

    /// Rows `| name | template | type | meaning | example |` of the first table with these columns.
    fn documented() -> BTreeMap<(String, String), (String, String)> {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/prompts.md");
        let text = std::fs::read_to_string(path).unwrap();
        let rows = text
            .lines()
            .skip_while(|line| !line.starts_with("| variable | template"))
            .skip(2);
        let rows = rows.take_while(|line| line.starts_with('|'));
        rows.map(|row| {
            let cells: Vec<&str> = row
                .trim_matches('|')
                .split(" | ")
                .map(|cell| cell.trim().trim_matches('`'))
                .collect();
            let [name, template, kind, _, example] = cells[..] else {
                panic!("not five cells: {row}")
            };
            (
                (template.to_owned(), name.to_owned()),
                (kind.to_owned(), example.to_owned()),
            )
        })
        .collect()
    }

    #[test]
    fn the_documented_variables_are_those_of_the_code() {
        let documented = documented();
        let mut names = Vec::new();
        for (template, values) in contexts() {
            let mut found = BTreeMap::new();
            for value in values {
                variables("", &value, &mut found);
            }
            for (name, (kinds, example)) in found {
                let row = documented.get(&(template.to_owned(), name.clone()));
                let (kind, shown) =
                    row.unwrap_or_else(|| panic!("docs/prompts.md lacks `{name}` of {template}"));
                assert_eq!(*kind, kinds.join(" or "), "type of {name}");
                let start = shown.trim_end_matches('…');
                assert!(
                    example == *shown || (shown.ends_with('…') && example.starts_with(start)),
                    "{name}: {example}"
                );
                names.push((template.to_owned(), name));
            }
        }
        names.sort();
        assert_eq!(names, documented.into_keys().collect::<Vec<_>>());
    }
}
