//! The numbers of interPlan's own functions.

use super::name::NameFault;
use super::{Density, InterPlanName, PythonRandom, Row, fill_row};
use planagent_world::geometry::{Point, Polyline};
use serde_json::Value;
use std::path::Path;

const MAX_ERROR: f64 = 1e-6;

/// A file of the vectors, which `tests/fixtures/vectors/interplan/README.md` describes.
fn vectors(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/fixtures/vectors/interplan")
        .join(name);
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().unwrap().iter()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

#[test]
fn names_are_read_as_interplan_reads_them() {
    let file = vectors("parse.json");
    for row in list(&file["suffixes"]) {
        let suffix = row["suffix"].as_str().unwrap();
        let parsed = InterPlanName::parse(suffix);
        match row["error"].as_str() {
            Some("IndexError") => assert!(matches!(parsed, Err(NameFault::NoValue(_))), "{row}"),
            Some("KeyError") => {
                assert!(matches!(parsed, Err(NameFault::UnknownLetter(_))), "{row}");
            }
            Some(_) => assert!(matches!(parsed, Err(NameFault::Amount(_))), "{row}"),
            None => {
                let name = parsed.unwrap();
                assert_eq!(
                    name.to_string(),
                    row["to_string"].as_str().unwrap(),
                    "{row}"
                );
                assert_eq!(
                    name.changes_agents(),
                    row["augment_agents"].as_bool().unwrap(),
                    "{row}"
                );
                let of = |value: Option<char>| value.map(|value| Value::from(value.to_string()));
                let theirs = |key: &str| row["dictionary"].get(key).cloned();
                assert_eq!(of(name.density), theirs("density"), "{row}");
                assert_eq!(of(name.goal), theirs("goal"), "{row}");
                assert_eq!(of(name.observation), theirs("observation"), "{row}");
                assert_eq!(
                    name.special().map(Value::from),
                    theirs("special_scenario"),
                    "{row}"
                );
                assert_eq!(
                    name.amount.map(Value::from),
                    theirs("amount_of_agents"),
                    "{row}"
                );
            }
        }
    }
    for row in list(&file["scenario_types"]) {
        let name = InterPlanName::parse(row["suffix"].as_str().unwrap()).unwrap();
        if name.special().is_none() {
            let kind = name
                .kind()
                .map_or("standard_modified_nuplan_scenario", |kind| kind.name());
            assert_eq!(kind, row["scenario_type"].as_str().unwrap(), "{row}");
        }
    }
}

#[test]
fn random_numbers_are_pythons() {
    let rows = vectors("python_random.json");
    for row in list(&rows["rows"]) {
        let fresh = || PythonRandom::seeded(row["seed"].as_str().unwrap());
        let mut random = fresh();
        for word in list(&row["getrandbits32"]) {
            assert_eq!(random.bits(32), u128::from(word.as_u64().unwrap()), "{row}");
        }
        let mut random = fresh();
        assert!(list(&row["random"]).all(|value| (random.unit() - number(value)).abs() < 1e-15));
        for (key, high) in [
            ("randrange_10_33", 33),
            ("randrange_10_50", 50),
            ("randrange_10_100", 100),
        ] {
            let mut random = fresh();
            assert!(
                list(&row[key]).all(|value| random.range(10, high) == value.as_u64().unwrap()),
                "{key}"
            );
        }
        let mut random = fresh();
        assert!(
            list(&row["gauss_0_1"])
                .all(|value| (random.gauss(0.0, 1.0) - number(value)).abs() < 1e-12)
        );
        for count in [3, 7, 25, 60] {
            let theirs: Vec<usize> = list(&row[format!("sample_all_of_{count}").as_str()])
                .map(|v| v.as_u64().unwrap() as usize)
                .collect();
            assert_eq!(fresh().permutation(count), theirs);
        }
    }
}

/// The line of some lanes of a world one after another.
fn line(world: &Value, names: &Value) -> Polyline {
    let lane = |name: &str| -> Vec<Point> {
        let (block, place) = name.split_at(1);
        let points = &world["roadblocks"][block]["lanes"][place.parse::<usize>().unwrap()];
        list(points)
            .map(|point| Point::new(number(&point[0]), number(&point[1])))
            .collect()
    };
    Polyline::new(list(names).flat_map(|name| lane(name.as_str().unwrap()))).unwrap()
}

#[test]
fn rows_of_cars_are_interplans_to_the_last_draw() {
    let file = vectors("density_spawning.json");
    let accelerations = (number(&file["accel_max"]), number(&file["decel_max"]));
    let mut compared = 0;
    for case in list(&file["cases"]) {
        let world = &file["worlds"][case["world"].as_str().unwrap()];
        let density = match case["density"].as_str().unwrap() {
            "l" => Density::Low,
            "m" => Density::Medium,
            _ => Density::High,
        };
        let mut random = PythonRandom::seeded(case["seed"].as_str().unwrap());
        random.permutation(case["logged_boxes_lwh"].as_array().unwrap().len());
        let ego_lane = world["ego_lane"].as_str().unwrap();
        let ego_block = &ego_lane[..1];
        let successors = list(&world["rb_edges"])
            .filter(|edge| edge[0] == ego_block)
            .count();
        let mut requests =
            list(&case["requests"]).filter(|request| request["behavior"] == "DEFAULT");
        let mut ego_speed = number(&world["ego_center_pose_speed"][3]);
        for (name, of_lane) in case["lines"].as_object().unwrap() {
            let line = line(world, &of_lane["extended"]);
            assert!((line.length() - number(&of_lane["length"])).abs() < MAX_ERROR);
            let row = Row {
                length: line.length(),
                ego_s: number(&of_lane["ego_progress"]),
                is_ego_lane: name == ego_lane,
                limit: world["roadblocks"][&name[..1]]["limit"].as_f64(),
                leads_on: successors == 1,
                accelerations,
            };
            for place in fill_row(&mut random, density, &row) {
                if place.is_ego {
                    // A speed of 0 changes nothing.
                    ego_speed = if place.speed == 0.0 {
                        ego_speed
                    } else {
                        place.speed
                    };
                    continue;
                }
                let request = requests.next().unwrap();
                let point = line.point_at(place.s);
                let theirs = Point::new(number(&request["pose"][0]), number(&request["pose"][1]));
                assert!(
                    (point - theirs).norm() < MAX_ERROR,
                    "{name} {request} {point}"
                );
                assert!(
                    (place.speed - number(&request["speed_drawn"])).abs() < MAX_ERROR,
                    "{name} {request}"
                );
                compared += 1;
            }
        }
        assert!(requests.next().is_none(), "{}", case["world"]);
        assert!(
            (ego_speed - number(&case["ego_speed_after"])).abs() < MAX_ERROR,
            "{}",
            case["world"]
        );
    }
    assert!(compared > 250, "{compared}");
}
