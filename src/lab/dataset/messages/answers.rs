//! The answers of the teacher in the forms of any prompt set, from the facts of the scene and the
//! search.

use crate::dataset::label::Instruction;
use planagent_agent::environment::facts::{Ahead, LeadSpeed, Light, Question, SceneType, SideLane};
use planagent_agent::environment::text::Description;
use planagent_agent::environment::{CenterlineName, LaneGraph, SceneFacts};
use planagent_agent::reasoning::{
    InstructionForm, Lateral, LateralReason, LongitudinalReason, UnderstandingForm,
};
use planagent_world::SignalStatus;

/// What answers are made from.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub(super) graph: &'a LaneGraph,
    pub(super) facts: &'a SceneFacts,
}

/// The answer of round 1.
pub(super) fn understanding(form: UnderstandingForm, seen: Seen<'_>) -> String {
    match form {
        UnderstandingForm::Choices | UnderstandingForm::Choices2 => {
            let answers: Vec<String> = form
                .questions()
                .iter()
                .map(|&question: &Question| format!("{question}={}", seen.facts.answer(question)))
                .collect();
            answers.join(" ")
        }
        UnderstandingForm::Short => short_understanding(seen),
        UnderstandingForm::Free => free_understanding(seen),
    }
}

/// The answer of round 2.
pub(super) fn instruction(form: InstructionForm, decided: Instruction) -> String {
    let Instruction {
        lateral,
        why_lateral,
        longitudinal,
        why_longitudinal,
    } = decided;
    let (across, along) = (
        lateral_reason(why_lateral),
        longitudinal_reason(why_longitudinal),
    );
    match form {
        InstructionForm::Choices => {
            format!("why={why_lateral} lat={lateral} why={why_longitudinal} lon={longitudinal}")
        }
        InstructionForm::Short => {
            let reason = if lateral == Lateral::Keep {
                along
            } else {
                across
            };
            format!("Speed: {longitudinal}\nLane: {lateral}\nReason: {reason}")
        }
        InstructionForm::Reasoned => format!(
            "Longitudinal: {longitudinal}, because {along}\nLateral: {lateral}, because {across}"
        ),
    }
}

fn longitudinal_reason(reason: LongitudinalReason) -> &'static str {
    match reason {
        LongitudinalReason::FreeRoad => "the road ahead is free",
        LongitudinalReason::SpeedLimit => "the speed limit allows no more",
        LongitudinalReason::Lead => "there is traffic ahead in the lane",
        LongitudinalReason::Light => "the light ahead is not green",
        LongitudinalReason::Person => "somebody on foot is near the path",
        LongitudinalReason::Obstacle => "something stands on the path",
    }
}

fn lateral_reason(reason: LateralReason) -> &'static str {
    match reason {
        LateralReason::LaneServes => "the lane leads along the route",
        LateralReason::Blocked => "the lane is blocked",
        LateralReason::SlowLead => "the traffic ahead in the lane is slow",
        LateralReason::FasterLane => "the other lane is faster",
        LateralReason::GoalLane => "the goal is in the other lane",
    }
}

/// What is ahead in the ego's lane, as the grammar of the short form names it.
fn ahead(seen: Seen<'_>) -> &'static str {
    seen.graph
        .lead_agent(CenterlineName::EgoLane)
        .map_or("nothing", |agent| agent.name.class.as_str())
}

fn short_understanding(seen: Seen<'_>) -> String {
    let SceneFacts {
        light,
        left_lane,
        right_lane,
        ..
    } = seen.facts;
    let note = danger(seen.facts).unwrap_or("Nothing else limits the next seconds");
    format!(
        "Ahead: {}\nLight: {light}\nLeft lane: {left_lane}\nRight lane: {right_lane}\nNote: {note}",
        ahead(seen)
    )
}

/// The strongest danger of a scene in a few words, if there is one.
fn danger(facts: &SceneFacts) -> Option<&'static str> {
    let near = |place: Ahead| place != Ahead::None;
    let dangers = [
        (near(facts.person_on_path), "Somebody is on the path"),
        (
            near(facts.pedestrian),
            "Somebody on foot is beside the path",
        ),
        (near(facts.crossing_vehicle), "A vehicle crosses the path"),
        (near(facts.blocked), "The lane is blocked ahead"),
        (near(facts.oncoming_vehicle), "A vehicle comes towards us"),
        (
            matches!(facts.light, Light::Red | Light::Yellow),
            "The light ahead may stop us",
        ),
        (near(facts.lead_distance), "Traffic ahead sets the speed"),
        (near(facts.crosswalk), "A crosswalk is ahead"),
    ];
    dangers
        .into_iter()
        .find_map(|(is_there, words)| is_there.then_some(words))
}

/// One line for each of the paper's questions.
fn free_understanding(seen: Seen<'_>) -> String {
    let facts = seen.facts;
    let description = Description::from_graph(seen.graph);
    let danger = danger(facts).unwrap_or("Nothing special");
    let lanes = match facts.lane_count.as_str() {
        "1" => "one lane goes our way".to_owned(),
        many => format!("{many} lanes go our way"),
    };
    let crosswalk = match facts.crosswalk {
        Ahead::None => "No crosswalk is near",
        Ahead::Near => "A crosswalk is close",
        Ahead::Mid | Ahead::Far => "A crosswalk is ahead",
    };
    let limit = match (description.limit, description.limit_estimate) {
        (Some(limit), _) => format!("the limit is {limit} m/s"),
        (None, Some(limit)) => format!("the limit is unknown, about {limit} m/s"),
        (None, None) => "the limit is unknown".to_owned(),
    };
    // A line has the number of its question, so that round 2 can be read beside the prompt.
    let lines = [
        format!("1. {}; {lanes}.", place(facts.scene_type)),
        format!("2. {}. {crosswalk}.", light(&description)),
        format!("3. {danger}."),
        format!(
            "4. We drive {} m/s in lane {} from the left; {limit}.",
            description.speed, facts.lane_index
        ),
        format!("5. {}.", lead(seen)),
        format!(
            "6. Left lane: {}. Right lane: {}.",
            side(facts.left_lane),
            side(facts.right_lane)
        ),
        format!("7. {}.", beside(facts)),
    ];
    lines.join("\n")
}

fn place(scene_type: SceneType) -> &'static str {
    match scene_type {
        SceneType::Straight => "A straight road",
        SceneType::CurveLeft => "A curve to the left",
        SceneType::CurveRight => "A curve to the right",
        SceneType::Intersection => "An intersection",
        SceneType::Roundabout => "A roundabout",
    }
}

fn light(description: &Description) -> String {
    let [_, own, _] = lights(description);
    match own {
        None => "No light is ahead".to_owned(),
        Some((status, distance)) => format!("The light in {distance} m is {status}"),
    }
}

/// The lights of the left, the ego's and the right lane, in words.
fn lights(description: &Description) -> [Option<(&'static str, u8)>; 3] {
    let place = |name| {
        let index = CenterlineName::ALL
            .iter()
            .position(|other| *other == name)?;
        let light = description.lights.get(index).copied().flatten()?;
        let status = match light.status {
            SignalStatus::Green => "green",
            SignalStatus::Yellow => "yellow",
            SignalStatus::Red => "red",
            SignalStatus::Unknown => "unknown",
        };
        Some((status, light.distance))
    };
    [
        place(CenterlineName::LeftLane),
        place(CenterlineName::EgoLane),
        place(CenterlineName::RightLane),
    ]
}

fn lead(seen: Seen<'_>) -> String {
    let Some(agent) = seen.graph.lead_agent(CenterlineName::EgoLane) else {
        return "Nobody is ahead in our lane".to_owned();
    };
    let speed = match seen.facts.lead_speed {
        LeadSpeed::Stopped => ", and it stands",
        LeadSpeed::Slower => ", and it is slower than us",
        LeadSpeed::SameOrFaster | LeadSpeed::None => "",
    };
    format!(
        "{} is ahead in our lane, {:.0} m away, at {:.0} m/s{speed}",
        agent.name, agent.gap, agent.speed
    )
}

fn side(lane: SideLane) -> &'static str {
    match lane {
        SideLane::None => "there is none",
        SideLane::Free => "it is free beside us",
        SideLane::Occupied => "somebody is beside us",
    }
}

/// Who is on foot, and what stands.
fn beside(facts: &SceneFacts) -> String {
    let distance = |place: Ahead| match place {
        Ahead::None => None,
        Ahead::Near => Some("close ahead"),
        Ahead::Mid => Some("ahead"),
        Ahead::Far => Some("far ahead"),
    };
    let person = distance(facts.pedestrian).map(|place| format!("somebody on foot is {place}"));
    let obstacle = distance(facts.blocked).map(|place| format!("something stands {place}"));
    let found: Vec<String> = person.into_iter().chain(obstacle).collect();
    if found.is_empty() {
        return "Nobody and nothing is near our way".to_owned();
    }
    let text = found.join(", and ");
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(letters).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::environment::{DEFAULT_NODE_LENGTH, GraphedScene};
    use planagent_agent::reasoning::{Longitudinal, MotionInstruction, PromptSet};
    use planagent_agent::simulation::{Challenge, ClosedLoop};
    use planagent_scenario::generator::{self, Spec, types};

    /// Facts of the first scenes of some types.
    fn with_scenes(mut check: impl FnMut(Seen<'_>)) {
        for kind in [
            types::changing_lane::TYPE,
            types::waiting_for_pedestrian_to_cross::TYPE,
            types::traversing_roundabout::TYPE,
            types::stopping_with_lead::TYPE,
        ] {
            for seed in 0..3 {
                let Ok(scenario) = generator::generate(&Spec::new(kind, seed)) else {
                    continue;
                };
                let simulation = ClosedLoop::new(&scenario, Challenge::CLOSED_LOOP[0]).unwrap();
                let scene = simulation.scene();
                let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).unwrap();
                let facts = SceneFacts::from_scene(GraphedScene::new(&scene, &graph));
                check(Seen {
                    graph: &graph,
                    facts: &facts,
                });
            }
        }
    }

    #[test]
    fn a_short_answer_has_the_words_of_its_grammar() {
        with_scenes(|seen| {
            let answer = understanding(UnderstandingForm::Short, seen);
            let lines: Vec<(&str, &str)> = answer
                .lines()
                .map(|line| line.split_once(": ").unwrap())
                .collect();
            let keys: Vec<&str> = lines.iter().map(|(key, _)| *key).collect();
            assert_eq!(keys, ["Ahead", "Light", "Left lane", "Right lane", "Note"]);
            let kinds = ["nothing", "vehicle", "bicycle", "pedestrian", "obstacle"];
            assert!(kinds.contains(&lines[0].1), "{answer}");
            assert!(Light::TEXTS.contains(&lines[1].1), "{answer}");
            assert!(SideLane::TEXTS.contains(&lines[2].1), "{answer}");
            // SHORT_REASON of the grammar: a letter and up to 48 characters.
            assert!((3..=49).contains(&lines[4].1.len()), "{answer}");
        });
    }

    #[test]
    fn a_free_answer_has_a_line_for_each_question_of_the_paper() {
        let asked = PromptSet::open("paper").unwrap();
        assert_eq!(asked.forms().understanding, UnderstandingForm::Free);
        with_scenes(|seen| {
            let answer = understanding(UnderstandingForm::Free, seen);
            for (number, line) in (1..=7).zip(answer.lines()) {
                assert!(line.starts_with(&format!("{number}. ")), "{answer}");
                assert!(line.ends_with('.') && !line.contains(".."), "{answer}");
            }
            assert_eq!(answer.lines().count(), 7);
        });
    }

    #[test]
    fn instructions_of_all_forms_are_read_again() {
        for (lateral, why_lateral) in Lateral::ALL
            .iter()
            .flat_map(|&lateral| LateralReason::ALL.iter().map(move |&why| (lateral, why)))
        {
            for (&longitudinal, &why_longitudinal) in
                Longitudinal::ALL.iter().zip(LongitudinalReason::ALL)
            {
                let decided = Instruction {
                    lateral,
                    why_lateral,
                    longitudinal,
                    why_longitudinal,
                };
                for form in [
                    InstructionForm::Choices,
                    InstructionForm::Short,
                    InstructionForm::Reasoned,
                ] {
                    let answer = instruction(form, decided);
                    let expected = MotionInstruction {
                        longitudinal,
                        lateral,
                    };
                    assert_eq!(MotionInstruction::find(&answer), Some(expected), "{answer}");
                    if form == InstructionForm::Short {
                        let reason = answer.split("Reason: ").nth(1).unwrap();
                        assert!((3..=49).contains(&reason.len()), "{reason}");
                    }
                }
            }
        }
    }
}
