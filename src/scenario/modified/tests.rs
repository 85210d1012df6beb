//! Modifications of generated scenarios.

use super::file::Modification;
use super::kinds::kind_texts;
use super::word::ModifiedName;
use crate::{DataRoots, Readers, Scenario};
use planagent_world::{InteractionKind, ObjectKind};

fn readers() -> Readers {
    Readers::new(&DataRoots::default())
}

fn opened(word: &str) -> Scenario {
    readers().find(word).unwrap().swap_remove(0).open().unwrap()
}

/// A text as a file of a folder of its own.
fn file(text: &str) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.toml");
    std::fs::write(&path, text).unwrap();
    let word = path.to_str().unwrap().to_owned();
    (folder, word)
}

#[test]
fn every_kind_is_a_file_that_parses() {
    for (kind, text) in kind_texts() {
        let modification = Modification::parse(kind.name(), kind.name(), text).unwrap();
        assert_eq!(
            (modification.kind, modification.name.as_str()),
            (Some(kind), kind.name())
        );
    }
}

#[test]
fn words_name_kinds_and_files_with_seeds() {
    let (base, name) =
        ModifiedName::in_word("generated/changing_lane/2~jaywalking_pedestrian.3").unwrap();
    assert_eq!(base, "generated/changing_lane/2");
    assert_eq!(
        name.mark(base),
        "generated/changing_lane/2~jaywalking_pedestrian.3"
    );
    assert!(
        ModifiedName::in_word("a~b/mine.toml").is_some()
            && ModifiedName::in_word("a~b/mine.toml.12").is_some()
    );
    for plain in [
        "a~b",
        "~/x.tfrecord",
        "~jaywalking_pedestrian",
        "a~jaywalking_pedestrian.x",
    ] {
        assert_eq!(ModifiedName::in_word(plain), None, "{plain}");
    }
}

#[test]
fn a_modified_scenario_has_what_its_file_says() {
    let (_folder, path) = file(
        "[[remove]]\nvehicles = true\n\n[[stopped]]\nahead_m = 40\n\n[[cones]]\nahead_m = 60\n\n[[jaywalker]]\nahead_m = 30\n\
        from_left_m = -6\nto_left_m = 0\ntrigger_m = 25\n",
    );
    let (base, modified) = (
        opened("generated/changing_lane/2"),
        opened(&format!("generated/changing_lane/2~{path}")),
    );
    assert_eq!(modified.id, "generated/changing_lane/2~mine");
    assert_eq!(
        (modified.iterations(), modified.start),
        (base.iterations(), base.start)
    );
    let first = modified.frame(0).unwrap();
    let vehicles: Vec<_> = first
        .objects
        .iter()
        .filter(|object| object.kind == ObjectKind::Vehicle)
        .collect();
    assert_eq!(vehicles.len(), 1);
    let ahead = first
        .ego
        .center()
        .to_local(vehicles[0].shape.center.position())
        .x;
    assert!((ahead - 40.0).abs() < 2.0, "{ahead}");
    assert!(
        first
            .objects
            .iter()
            .filter(|object| object.kind == ObjectKind::TrafficCone)
            .count()
            > 5
    );
    let people = |frame: &crate::Frame| {
        frame
            .objects
            .iter()
            .filter(|object| object.kind == ObjectKind::Pedestrian)
            .count()
    };
    let of_base = people(base.frame(0).unwrap());
    assert_eq!(people(first), of_base, "unseen until the ego is near");
    assert!(modified.frames.iter().any(|frame| people(frame) > of_base));
}

#[test]
fn the_same_word_gives_the_same_scene_and_another_seed_another() {
    let word = "generated/near_multiple_vehicles/0~high_traffic_density";
    let boxes = |word: &str| {
        opened(word)
            .frame(0)
            .unwrap()
            .objects
            .iter()
            .map(|object| object.shape.center)
            .collect::<Vec<_>>()
    };
    assert_eq!(boxes(word), boxes(word));
    assert_ne!(boxes(word), boxes(&format!("{word}.1")));
    let scenario = opened(word);
    assert_eq!(scenario.scenario_type, "high_traffic_density");
    assert_eq!(
        scenario.interaction.as_ref().unwrap().kind,
        Some(InteractionKind::HighTrafficDensity)
    );
    assert!(scenario.interaction.as_ref().unwrap().goal.is_some());
}

#[test]
fn faults_name_file_field_and_line() {
    for (text, wanted) in [
        (
            "[[stopped]]\nahead_m = 4000\n",
            "line 1: stopped.ahead_m: 4000 must be from",
        ),
        ("\n\n[[stopped]]\nahead = 40\n", "line 4"),
        (
            "[[stopped]]\nahead_m = \"far\"\n",
            "a number, or [LOW, HIGH]",
        ),
        ("[[stopped]]\nahead_m = [5, 2]\n", "the lower one first"),
        (
            "kind = \"jaywalking\"\n",
            "line 1: kind: \"jaywalking\" is none of low_traffic_density",
        ),
        (
            "seed = 1\nname = \"a b\"\n",
            "line 2: name: \"a b\" must be",
        ),
        (
            "[goal]\nlane_changes = 2\n",
            "expected a table in double brackets, as in [[goal]]",
        ),
        (
            "[[drivers]]\nbehavior = \"rude\"\n",
            "drivers.behavior: \"rude\" is none of default",
        ),
        ("[[stopped]]\nahead_m = 40\nlane = \"left\"\n", "oncoming"),
        (
            "[[goal]]\nlane_changes = 8\n",
            "goal.lane_changes: there is no lane 8 lanes beside",
        ),
        (
            "[[stopped]]\nahead_m = 1\n",
            "stands in the ego at the start",
        ),
        ("[[remove]]\n", "nothing is removed"),
        (
            "[[needs]]\nroad_m = 2000\n",
            "needs.road_m: an intersection begins",
        ),
    ] {
        let (_folder, path) = file(text);
        let word = format!("generated/changing_lane/2~{path}");
        let error = readers()
            .find(&word)
            .and_then(|mut found| found.swap_remove(0).open().map(|_| ()))
            .unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains(wanted) && error.contains("mine.toml"),
            "{error}"
        );
    }
    let missing = readers()
        .find("generated/changing_lane/2~nowhere.toml")
        .unwrap_err()
        .to_string();
    assert!(missing.contains("nowhere.toml"), "{missing}");
}

#[test]
fn drivers_change_lanes_where_that_gains() {
    let moved_sideways = |lane_changes: bool| {
        let (_folder, path) = file(&format!(
            "[[remove]]\nvehicles = true\n\n[[vehicle]]\nahead_m = 25\nspeed = 8\n\n[[stopped]]\nahead_m = 70\n\n[[drivers]]\n\
            lane_changes = {lane_changes}\n",
        ));
        let scenario = opened(&format!("generated/changing_lane/2~{path}"));
        let standing = &scenario.interaction.as_ref().unwrap().standing;
        let of = |frame: &crate::Frame| {
            let driving = |object: &&planagent_world::TrackedObject| {
                object.kind == ObjectKind::Vehicle && !standing.contains(&object.token)
            };
            frame
                .objects
                .iter()
                .find(driving)
                .map(|object| object.shape.center)
        };
        let start = of(scenario.frame(0).unwrap()).unwrap();
        let line = &scenario.map[scenario.map.lane_of(start, 1.0).unwrap()].centerline;
        let aside = scenario.frames[scenario.start..].iter().filter_map(of);
        aside
            .map(|center| line.project(center.position()).lateral.abs())
            .fold(0.0, f64::max)
    };
    assert!(moved_sideways(false) < 0.5, "{}", moved_sideways(false));
    assert!(moved_sideways(true) > 2.0, "{}", moved_sideways(true));
}

#[test]
fn interplans_letters_draw_its_traffic() {
    let scenario = opened("generated/changing_lane/2~dhom");
    assert_eq!(
        (scenario.id.as_str(), scenario.scenario_type.as_str()),
        ("generated/changing_lane/2~dhom", "high_traffic_density")
    );
    assert!(scenario.frame(0).unwrap().objects.len() > 4);
    assert_eq!(
        scenario.interaction.as_ref().unwrap().behavior,
        planagent_world::DriverBehavior::Mixed
    );
    let special = readers()
        .find("generated/changing_lane/2~s3")
        .unwrap_err()
        .to_string();
    assert!(special.contains("special scene s3"), "{special}");
}

#[test]
fn twins_differ_in_one_lane_and_are_drawn_alike() {
    let centers = |word: &str, kind: ObjectKind| {
        let scenario = opened(word);
        let first = scenario.frame(0).unwrap();
        let ego = first.ego.center();
        let of_kind = first.objects.iter().filter(|object| object.kind == kind);
        of_kind
            .map(|object| ego.to_local(object.shape.center.position()))
            .collect::<Vec<_>>()
    };
    let base = "generated/near_multiple_vehicles/0";
    let [own, beside] = ["a", "b"].map(|part| {
        centers(
            &format!("{base}~twin_hidden_left_{part}"),
            ObjectKind::Vehicle,
        )
    });
    let ([own], [beside]) = (own.as_slice(), beside.as_slice()) else {
        panic!("{own:?} {beside:?}")
    };
    assert!(
        (own.x - beside.x).abs() < 2.0,
        "at the same distance: {own} {beside}"
    );
    assert!(beside.y - own.y > 2.0, "in the lane beside: {own} {beside}");
    let cones = |part: &str| {
        centers(
            &format!("{base}~twin_hidden_left_{part}"),
            ObjectKind::TrafficCone,
        )
    };
    assert_eq!(cones("a"), cones("b"));
    assert!(ModifiedName::parse("twin_hidden_left_c").is_none());
}

#[test]
fn a_crossing_vehicle_drives_at_once_unless_it_waits() {
    let moved = |waits: bool| {
        let (_folder, path) = file(&format!(
            "[[remove]]\nvehicles = true\n\n[[crossing]]\nahead_m = 25\nfrom_left_m = -9\nto_left_m = 0\nspeed = 4\nwaits = {waits}\n"
        ));
        let scenario = opened(&format!("generated/changing_lane/2~{path}"));
        let of = |iteration: usize| {
            let objects = &scenario.frame(iteration).unwrap().objects;
            objects
                .iter()
                .find(|object| object.kind == ObjectKind::Vehicle)
                .map(|object| object.shape.center.position())
        };
        (of(30).unwrap() - of(0).unwrap()).norm()
    };
    assert!((moved(false) - 9.0).abs() < 1e-6, "{}", moved(false));
    assert!(moved(true) < 1e-9, "{}", moved(true));
}
