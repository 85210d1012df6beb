use super::*;
use crate::tests::default_scene;
use planagent_agent::simulation::{Challenge, ClosedLoop};
use planagent_scenario::HeldScenario;
use std::sync::Arc;

#[test]
fn right_calls_are_answered_and_wrong_ones_get_what_is_wrong() {
    let held = HeldScenario::Shared(Arc::new(default_scene()));
    let simulation = ClosedLoop::new(held, Challenge::NonReactive).unwrap();
    let scene = simulation.scene();
    let facts = Facts::from_scene(&scene);
    for (group, call) in [
        (Group::Detection, "lead_object()"),
        (
            Group::Detection,
            "objects_in_area(x_start=-9, x_end=9, y_start=0, y_end=30)",
        ),
        (Group::Detection, "all_objects()"),
        (Group::Prediction, "futures_of(object_ids=[0])"),
        (Group::Prediction, "places_at([0], 6)"),
        (Group::Prediction, "all_futures()"),
        (
            Group::Occupancy,
            "occupied_at(locations=[(0,10), (3,0)], timestep=4)",
        ),
        (Group::Map, "drivable_at([(0,0)])"),
        (Group::Map, "line_at(locations=[(0,0)])"),
        (Group::Map, "shoulder_here()"),
        (Group::Map, "divider_at([(0, 5)])"),
        (Group::Map, "nearest_crosswalk()"),
    ] {
        let tool = facts.answer(group, call);
        assert!(!tool.failed && !tool.result.is_empty(), "{call}: {tool:?}");
    }
    assert_eq!(
        facts.answer(Group::Map, "drivable_at([(0,0)])").result,
        "(0.00,0.00): drivable"
    );
    for (group, call, why) in [
        (Group::Map, "lead_object()", "no map tool 'lead_object'"),
        (Group::Detection, "YES", "is no call"),
        (Group::Detection, "lead_object(", "not closed"),
        (Group::Detection, "lead_object() all_objects()", "one tool"),
        (Group::Detection, "lead_object(3)", "too many"),
        (
            Group::Detection,
            "objects_in_area(1, 2, 3)",
            "y_end is missing",
        ),
        (
            Group::Detection,
            "objects_in_area(0, 1, 0, 99)",
            "y_end must lie in",
        ),
        (
            Group::Detection,
            "objects_in_area(5, 1, 0, 9)",
            "starts before",
        ),
        (
            Group::Prediction,
            "futures_of([999])",
            "there is no object 999",
        ),
        (Group::Prediction, "futures_of(first)", "no list of numbers"),
        (Group::Prediction, "futures_of([nan])", "no list of numbers"),
        (
            Group::Prediction,
            "places_at([0], 7)",
            "timestep must be one of 1 to 6",
        ),
        (
            Group::Prediction,
            "places_at(timestep=1, object_ids=[0])",
            "is expected",
        ),
        (
            Group::Occupancy,
            "occupied_at([(0,1)], 1.5)",
            "timestep must be",
        ),
        (Group::Map, "drivable_at([(0,51)])", "farther than 50 m"),
        (Group::Map, "drivable_at([7])", "no list of places"),
    ] {
        let tool = facts.answer(group, call);
        assert!(tool.failed && tool.result.contains(why), "{call}: {tool:?}");
    }
}

#[test]
fn any_text_gets_an_answer() {
    let held = HeldScenario::Shared(Arc::new(default_scene()));
    let simulation = ClosedLoop::new(held, Challenge::NonReactive).unwrap();
    let scene = simulation.scene();
    let facts = Facts::from_scene(&scene);
    for text in [
        "",
        "(",
        ")",
        "((",
        "a(]",
        "é(ü)",
        "f([(])",
        "f(,,)",
        "x(=)",
        "\n\n",
        "all_objects()é(",
    ] {
        for group in Group::ALL {
            assert!(!facts.answer(group, text).result.is_empty(), "{text}");
        }
    }
}
