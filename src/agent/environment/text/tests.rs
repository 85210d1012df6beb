#[path = "../../../../tests/scene_text/mod.rs"]
mod scene_text;

use super::*;
use crate::environment;
use crate::environment::lane_graph::{
    AgentClass, AgentName, CenterlineName, DEFAULT_NODE_LENGTH, Heading, LaneGraph, NodePlace, Turn,
};
use crate::environment::sketch::{self, Drawn};
use planagent_world as world;
use planagent_world::{ObjectKind, SignalStatus};
use proptest::prelude::*;
use scene_text::{COMPACT_WORDS, parse};
use std::path::Path;

fn described(drawn: &Drawn) -> Description {
    Description::from_graph(&LaneGraph::build(&drawn.scene(), DEFAULT_NODE_LENGTH).unwrap())
}

fn road() -> Drawn {
    sketch::straight(3, 2, 1, 9.0)
        .put(ObjectKind::Vehicle, 18.0, 0.0, 0.0, 5.0)
        .put(ObjectKind::Vehicle, 33.0, 0.0, 0.0, 6.0)
        .put(ObjectKind::Vehicle, -9.0, 3.5, 0.0, 12.0)
        .put(ObjectKind::Vehicle, 8.0, 7.0, std::f64::consts::PI, 10.0)
        .put(ObjectKind::Bicycle, 12.0, -4.4, 0.0, 4.0)
        .put(ObjectKind::TrafficCone, 20.0, -3.5, 0.0, 0.0)
        .put(ObjectKind::Pedestrian, 24.0, -4.4, 1.57, 1.4)
}

fn crossing() -> Drawn {
    let (drawn, arms) = sketch::crossing(2, 0, 12.0, 7.0);
    let route = [
        arms.inbound[0][0],
        drawn.between(arms.inbound[0][0], arms.outbound[1][0]),
        arms.outbound[1][0],
    ];
    drawn
        .route_through(&route)
        .all_lights(SignalStatus::Red)
        .put(ObjectKind::Vehicle, 7.0, -3.5, 0.0, 3.0)
        .put(ObjectKind::Pedestrian, 13.0, -2.0, 1.57, 1.3)
        .put(ObjectKind::Vehicle, 30.0, 4.0, std::f64::consts::PI, 8.0)
}

#[test]
fn golden_texts() {
    let update = std::env::var_os("PLANAGENT_UPDATE_GOLDEN").is_some();
    let narrow = sketch::straight(1, 1, 0, 0.0);
    for (name, drawn) in [
        ("road", road()),
        ("crossing", crossing()),
        ("narrow", narrow),
    ] {
        for &set in TextForm::ALL {
            let path = Path::new(env!("CARGO_MANIFEST_DIR"))
                .join(format!("../../tests/golden/text/{name}.{set}.txt"));
            let text = write(&described(&drawn), set) + "\n";
            if update {
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(&path, &text).unwrap();
            }
            let golden = std::fs::read_to_string(&path)
                .unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            assert_eq!(golden, text, "{}", path.display());
        }
    }
}

#[test]
fn described_facts_are_parsed_back() {
    for drawn in [
        road(),
        crossing(),
        sketch::roundabout(16.0, 5.0, 4.0),
        sketch::curve(30.0, 5.0, 6.0),
    ] {
        let description = described(&drawn);
        assert_eq!(
            parse(&write(&description, TextForm::Paper), TextForm::Paper),
            Ok(description.clone())
        );
        assert_eq!(
            parse(&write(&description, TextForm::Brief), TextForm::Brief),
            Ok(description.nearest())
        );
        assert_eq!(
            parse(&write(&description, TextForm::Compact), TextForm::Compact),
            Ok(description.reduced())
        );
    }
}

#[test]
fn all_agents_on_the_nodes_stand_in_the_paper_text_and_the_rest_is_counted_in_the_compact_one() {
    let drawn = road().put(ObjectKind::Vehicle, 26.0, -3.5, 0.0, 3.0);
    let graph = LaneGraph::build(&drawn.scene(), DEFAULT_NODE_LENGTH).unwrap();
    let text = write(&Description::from_graph(&graph), TextForm::Paper);
    assert!(graph.agents.len() >= 6);
    for agent in &graph.agents {
        assert!(
            text.contains(&agent.name.to_string()),
            "{} is missing in:\n{text}",
            agent.name
        );
    }
    let reduced = Description::from_graph(&graph).reduced();
    let named: usize = reduced
        .nodes
        .iter()
        .flatten()
        .map(|node| node.agents.len())
        .sum();
    assert_eq!(named + usize::from(reduced.rest), graph.agents.len());
}

#[test]
fn the_paper_text_holds_the_lights_of_all_lanes() {
    let description = described(&crossing());
    let red = |centerline| {
        description
            .light(centerline)
            .is_some_and(|light| light.status == SignalStatus::Red)
    };
    assert!(red(CenterlineName::EgoLane) && red(CenterlineName::RightLane));
    let text = write(&description, TextForm::Paper);
    assert!(text.contains("right_lane: light red in "), "{text}");
    assert_eq!(
        description.reduced().lights,
        [description.lights[0], None, None]
    );
}

/// A broken-down car on the only lane, and a car that comes towards it.
fn blocked() -> Drawn {
    sketch::straight(1, 1, 0, 8.0)
        .put(ObjectKind::Vehicle, 24.0, 0.0, 0.0, 0.0)
        .put(ObjectKind::Vehicle, 48.0, 3.5, std::f64::consts::PI, 9.0)
}

#[test]
fn the_oncoming_lane_stands_in_the_texts_that_may_name_it() {
    let drawn = blocked();
    let graph = LaneGraph::build(&drawn.scene(), DEFAULT_NODE_LENGTH).unwrap();
    let (plain, oncoming) = (
        Description::from_graph(&graph),
        Description::from_graph(&graph.with_oncoming_lane(&drawn.scene())),
    );
    assert_eq!(
        oncoming.oncoming,
        Some(OncomingDescription {
            blocked: (19, 24),
            next: Some((43, 9))
        })
    );
    for &form in TextForm::ALL {
        let (without, with) = (write(&plain, form), write(&oncoming, form));
        let more = with.strip_prefix(&without).unwrap();
        match form {
            TextForm::Compact => assert_eq!(more, ""),
            TextForm::Compact2 => assert_eq!(more, " oncoming 19 24 43 9"),
            TextForm::Paper | TextForm::Brief => {
                assert_eq!(
                    more,
                    "\noncoming_lane: past 19 m to 24 m; next vehicle 43 m 9 m/s."
                );
            }
        }
        assert_eq!(form.names_oncoming_lane(), !more.is_empty());
        let expected = match form {
            TextForm::Paper => oncoming.clone(),
            TextForm::Brief => oncoming.nearest(),
            TextForm::Compact => oncoming.reduced(),
            TextForm::Compact2 => oncoming.reduced_with_estimate(),
        };
        assert_eq!(parse(&with, form), Ok(expected));
    }
}

#[test]
fn the_goal_stands_in_the_texts_that_name_its_lane() {
    let plain = described(&road());
    for (changes, distance, readable, compact) in [
        (
            2,
            180,
            " Goal: 2 lanes to the left, in 180 m.",
            " goal left 2 60",
        ),
        (0, 35, " Goal: this lane, in 35 m.", " goal ego 0 35"),
        (
            -1,
            60,
            " Goal: 1 lane to the right, in 60 m.",
            " goal right 1 60",
        ),
    ] {
        let with = Description {
            goal: Some(GoalDescription { changes, distance }),
            ..plain.clone()
        };
        let first_line = write(&plain, TextForm::Paper)
            .lines()
            .next()
            .unwrap()
            .to_owned();
        assert_eq!(
            write(&with, TextForm::Paper).lines().next(),
            Some(format!("{first_line}{readable}").as_str())
        );
        assert_eq!(
            write(&with, TextForm::Compact),
            write(&plain, TextForm::Compact)
        );
        assert_eq!(
            write(&with, TextForm::Compact2),
            write(&plain, TextForm::Compact2) + compact
        );
        assert_eq!(
            parse(&write(&with, TextForm::Paper), TextForm::Paper),
            Ok(with.clone())
        );
    }
}

fn error_at(text: &str, set: TextForm) -> (usize, usize) {
    let errors = parse(text, set).unwrap_err();
    (errors[0].line, errors[0].column)
}

#[test]
fn errors_say_where() {
    let text = write(&described(&road()), TextForm::Paper);
    assert_eq!(error_at("", TextForm::Paper), (1, 1));
    assert_eq!(
        error_at(&text.replace("Ego: 9", "Ego: 99"), TextForm::Paper),
        (1, 6)
    );
    assert_eq!(
        error_at(&text.replace("left_lane", "over_lane"), TextForm::Paper),
        (3, 1)
    );
    assert_eq!(error_at(&format!("{text} more"), TextForm::Paper).0, 4);
    let two = text
        .replace("Ego: 9", "Ego: ?")
        .replace("left_lane: left", "left_lane: lift");
    let lines: Vec<usize> = parse(&two, TextForm::Paper)
        .unwrap_err()
        .iter()
        .map(|e| e.line)
        .collect();
    assert_eq!(lines, [1, 3]);
    let compact = write(&described(&road()), TextForm::Compact);
    assert_eq!(
        error_at(&compact.replace("speed 9", "speed -1"), TextForm::Compact),
        (1, 7)
    );
    assert_eq!(
        error_at(&format!("{compact} 5"), TextForm::Compact),
        (1, compact.len() + 2)
    );
}

fn agents() -> impl Strategy<Value = Vec<AgentDescription>> {
    let class = prop::sample::select(AgentClass::ALL);
    let heading = prop::sample::select(Heading::ALL);
    let agent = (class, 1..500u16, 0..=MAX_NUMBER, 0..=MAX_NUMBER, heading).prop_map(
        |(class, number, distance, speed, heading)| AgentDescription {
            name: AgentName { class, number },
            distance,
            speed,
            heading,
        },
    );
    prop::collection::vec(agent, 0..4)
}

fn node() -> impl Strategy<Value = NodeDescription> {
    (any::<bool>(), agents()).prop_map(|(apart, agents)| NodeDescription { apart, agents })
}

fn description() -> impl Strategy<Value = Description> {
    use SignalStatus::{Green, Red, Unknown, Yellow};
    let status = prop::sample::select(vec![Green, Yellow, Red, Unknown]);
    let light = (status, 0..=MAX_NUMBER)
        .prop_map(|(status, distance)| LightDescription { status, distance });
    let number = 0..=MAX_NUMBER;
    let lights = prop::array::uniform3(prop::option::of(light));
    let nodes = (node(), prop::collection::vec(prop::option::of(node()), 8));
    let turn = prop::sample::select(Turn::ALL);
    let limit = prop_oneof![
        number.clone().prop_map(|limit| (Some(limit), None)),
        prop::option::of(number.clone()).prop_map(|estimate| (None, estimate)),
    ];
    let blocked = (number.clone(), number.clone());
    let oncoming = (blocked, prop::option::of((number.clone(), number.clone())));
    let oncoming = prop::option::of(
        oncoming.prop_map(|(blocked, next)| OncomingDescription { blocked, next }),
    );
    let goal = (-8..=8i8, 0..=400u16)
        .prop_map(|(changes, distance)| GoalDescription { changes, distance });
    let goal = prop::option::of(goal);
    (
        number.clone(),
        limit,
        lights,
        turn,
        nodes,
        number,
        oncoming,
        goal,
    )
        .prop_map(
            |(speed, limit, mut lights, turn, (ego, others), rest, oncoming, goal)| {
                let mut nodes: [Option<NodeDescription>; 9] = std::array::from_fn(|_| None);
                // An estimate stands where there is no limit.
                let (limit, limit_estimate) = limit;
                nodes[0] = Some(ego);
                nodes[1..].clone_from_slice(&others);
                for (light, &centerline) in lights.iter_mut().zip(CenterlineName::ALL) {
                    if NodePlace::on(centerline)
                        .iter()
                        .flatten()
                        .all(|&place| nodes[place as usize].is_none())
                    {
                        *light = None;
                    }
                }
                Description {
                    speed,
                    limit,
                    limit_estimate,
                    lights,
                    turn,
                    nodes,
                    rest,
                    oncoming,
                    goal,
                }
            },
        )
}

proptest! {
    #[test]
    fn paper_text_round_trips(description in description()) {
        let text = write(&description, TextForm::Paper);
        let back = parse(&text, TextForm::Paper);
        prop_assert_eq!(back.as_ref(), Ok(&description));
        prop_assert_eq!(write(&back.unwrap(), TextForm::Paper), text);
    }

    #[test]
    fn brief_text_round_trips(description in description()) {
        let text = write(&description, TextForm::Brief);
        let back = parse(&text, TextForm::Brief);
        prop_assert_eq!(back, Ok(description.nearest()));
    }

    #[test]
    fn compact_text_round_trips_with_the_same_number_of_words(description in description()) {
        let text = write(&description, TextForm::Compact);
        prop_assert_eq!(text.split_whitespace().count(), COMPACT_WORDS);
        let back = parse(&text, TextForm::Compact);
        prop_assert_eq!(back.as_ref(), Ok(&description.reduced()));
        prop_assert_eq!(write(&back.unwrap(), TextForm::Compact), text);
    }

    #[test]
    fn the_second_compact_text_adds_the_estimate(description in description()) {
        let (first, second) = (write(&description, TextForm::Compact), write(&description, TextForm::Compact2));
        let more = 5 * usize::from(description.oncoming.is_some()) + 4 * usize::from(description.goal.is_some());
        prop_assert_eq!(second.split_whitespace().count(), COMPACT_WORDS + more);
        let back = parse(&second, TextForm::Compact2);
        prop_assert_eq!(back, Ok(description.reduced_with_estimate()));
        if description.limit_estimate.is_none() {
            prop_assert!(second.starts_with(&first) && (second == first) == (more == 0));
        } else {
            prop_assert!(first.contains(" limit - ") && second.contains(" limit ~"));
        }
    }

    #[test]
    fn compact_words_stand_at_fixed_places(a in description(), b in description()) {
        let (a, b) = (write(&a, TextForm::Compact), write(&b, TextForm::Compact));
        for (i, (x, y)) in a.split(' ').zip(b.split(' ')).enumerate() {
            let label = x == "speed" || x == "limit" || x == "light" || x == "turn" || x == "rest"
                || (i >= 9 && (i - 9) % 4 == 0 && x.parse::<NodePlace>().is_ok());
            if label {
                prop_assert_eq!(x, y);
            }
        }
    }

    #[test]
    fn any_text_is_read_without_panic(text in "[ -~\\n\u{e9}]{0,200}") {
        for &set in TextForm::ALL {
            prop_assert!(parse(&text, set).is_err());
        }
    }

    #[test]
    fn damaged_text_is_read_without_panic(description in description(), at in 0..400usize, put in "[ -~\u{e9}\\n]{0,3}") {
        for &set in TextForm::ALL {
            let mut text = write(&description, set);
            let at = at.min(text.len());
            text.replace_range(at..(at + 2).min(text.len()), &put);
            if let Ok(read) = parse(&text, set) {
                prop_assert_eq!(parse(&write(&read, set), set), Ok(read));
            }
        }
    }
}
