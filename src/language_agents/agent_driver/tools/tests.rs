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
        (Group::Map, "drivable_at([((7,1))])", "no list of places"),
        (Group::Map, "drivable_at([(7,1])", "not closed"),
        (Group::Map, "drivable_at([])", "the list is empty"),
        (
            Group::Map,
            "drivable_at([(\u{ff17},1)])",
            "no list of places",
        ),
        (
            Group::Map,
            "drivable_at([(1,1),,(2,2)])",
            "no list of places",
        ),
        (
            Group::Map,
            "drivable_at(locations=[(1,1)], locations=[(2,2)])",
            "one argument too many",
        ),
        (
            Group::Prediction,
            "futures_of([0.5])",
            "there is no object 0.5",
        ),
        (
            Group::Prediction,
            "futures_of([1e-20])",
            "there is no object 0.0000",
        ),
        (
            Group::Prediction,
            "futures_of([1e300])",
            "there is no object 1000",
        ),
        (
            Group::Prediction,
            "futures_of([-1])",
            "there is no object -1",
        ),
        (Group::Detection, "lead_object(,,)", "an argument is empty"),
        (
            Group::Detection,
            "objects_in_area(0,, 1, 0, 9)",
            "an argument is empty",
        ),
        (
            Group::Detection,
            "objects_in_area(x_start=0, x_start=1, y_start=0, y_end=9)",
            "'x_start' stands where x_end is expected",
        ),
        (
            Group::Detection,
            "objects_in_area(inf, 1, 0, 9)",
            "x_start = 'inf' is no number",
        ),
        (Group::Detection, "Lead_Object()", "no detection tool"),
        (
            Group::Detection,
            "I call lead_object()",
            "no name of a tool",
        ),
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

#[test]
fn a_call_without_end_gets_a_short_error() {
    let held = HeldScenario::Shared(Arc::new(default_scene()));
    let simulation = ClosedLoop::new(held, Challenge::NonReactive).unwrap();
    let scene = simulation.scene();
    let facts = Facts::from_scene(&scene);
    let many = "(1,1),".repeat(20_000);
    for (text, why) in [
        (format!("drivable_at([{many}(2,2)])"), "64 are the limit"),
        (format!("drivable_at([{many}"), "not closed"),
        (format!("drivable_at({many}1)"), "no list of places"),
        (format!("{}()", "a".repeat(100_000)), "no map tool"),
        ("drivable_at(".repeat(20_000), "not closed"),
        ("drivable_at([(1,1)]) ".repeat(20_000), "one tool"),
        (
            format!("drivable_at({}=1)", "x".repeat(100_000)),
            "stands where",
        ),
    ] {
        let tool = facts.answer(Group::Map, &text);
        let beginning: String = text.chars().take(30).collect();
        assert!(
            tool.failed && tool.result.contains(why) && tool.result.len() < 400,
            "{beginning}: {}",
            tool.result
        );
    }
}
