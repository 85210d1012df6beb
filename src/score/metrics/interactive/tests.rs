//! The numbers of interPlan's own functions.

use super::ego_sorts::passing_ratio;
use super::lane_changes_to_goal::counted;
use super::lane_changes_to_goal::lane_changes_score;
use super::neighbors::neighbors;
use super::neighbors::{LaneRelations, changes_between};
use super::sorted;
use crate::metrics::{METRICS, Weighting, combine};
use planagent_world::geometry::{OrientedBox, Point, Pose};
use planagent_world::{InteractionKind, LaneId, RoadblockId};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

const MAX_ERROR: f64 = 1e-6;

/// A file of the vectors, which `tests/fixtures/vectors/interplan/README.md` describes.
fn vectors(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/fixtures/vectors/interplan")
        .join(name);
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|number| number.as_f64().unwrap())
        .collect()
}

fn points(value: &Value) -> Vec<Point> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|point| Point::new(numbers(point)[0], numbers(point)[1]))
        .collect()
}

/// Lanes as the vectors give them.
struct Graph {
    names: Vec<String>,
    lanes: Vec<GraphLane>,
}

struct GraphLane {
    roadblock: RoadblockId,
    adjacent: [Option<LaneId>; 2],
    incoming: Vec<LaneId>,
    outgoing: Vec<LaneId>,
    left: Vec<Point>,
    right: Vec<Point>,
    baseline: Vec<Point>,
    is_connector: bool,
}

impl Graph {
    fn new(graph: &Value) -> Self {
        let lanes = graph["lanes"].as_array().unwrap();
        let names: Vec<String> = lanes
            .iter()
            .map(|lane| lane["id"].as_str().unwrap().to_owned())
            .collect();
        let id = |name: &Value| {
            LaneId(
                names
                    .iter()
                    .position(|known| Some(known.as_str()) == name.as_str())
                    .unwrap() as u32,
            )
        };
        let ids = |list: &Value| list.as_array().unwrap().iter().map(id).collect::<Vec<_>>();
        let mut blocks: Vec<&str> = Vec::new();
        let lanes = lanes
            .iter()
            .map(|lane| {
                let block = lane["roadblock"].as_str().unwrap();
                if !blocks.contains(&block) {
                    blocks.push(block);
                }
                let side = |i: usize| {
                    Some(&lane["adjacent_left_right"][i])
                        .filter(|side| !side.is_null())
                        .map(id)
                };
                GraphLane {
                    roadblock: RoadblockId(
                        blocks.iter().position(|&known| known == block).unwrap() as u32,
                    ),
                    adjacent: [side(0), side(1)],
                    incoming: ids(&lane["incoming"]),
                    outgoing: ids(&lane["outgoing"]),
                    left: points(&lane["left"]),
                    right: points(&lane["right"]),
                    baseline: points(&lane["baseline"]),
                    is_connector: lane["kind"] == "connector",
                }
            })
            .collect();
        Self { names, lanes }
    }

    fn id(&self, name: &Value) -> LaneId {
        LaneId(
            self.names
                .iter()
                .position(|known| Some(known.as_str()) == name.as_str())
                .unwrap() as u32,
        )
    }

    /// The lanes at each point of a path along x: where several connectors hold it, all.
    fn driven(&self, path: &[Point]) -> Vec<Vec<LaneId>> {
        let holds = |lane: &GraphLane, point: &Point| {
            let (from, to) = (lane.baseline[0], lane.baseline[lane.baseline.len() - 1]);
            (from.x..to.x).contains(&point.x) && {
                let center = Pose::new(f64::midpoint(from.x, to.x), from.y, 0.0);
                let shape = OrientedBox::new(center, to.x - from.x, 3.5);
                shape.contains(*point)
            }
        };
        let at = |point: &Point| {
            let found = (0..self.lanes.len()).filter(|&i| holds(&self.lanes[i], point));
            found.map(|i| LaneId(i as u32)).take(1).collect()
        };
        path.iter().map(at).collect()
    }
}

impl LaneRelations for Graph {
    fn adjacent(&self, lane: LaneId) -> [Option<LaneId>; 2] {
        self.lanes[lane.index()].adjacent
    }

    fn incoming(&self, lane: LaneId) -> &[LaneId] {
        &self.lanes[lane.index()].incoming
    }

    fn outgoing(&self, lane: LaneId) -> &[LaneId] {
        &self.lanes[lane.index()].outgoing
    }

    fn boundary_ends(&self, lane: LaneId) -> [Point; 2] {
        let lane = &self.lanes[lane.index()];
        [
            lane.left[lane.left.len() - 1],
            lane.right[lane.right.len() - 1],
        ]
    }

    fn roadblock(&self, lane: LaneId) -> RoadblockId {
        self.lanes[lane.index()].roadblock
    }

    fn needs_boundaries(&self) -> bool {
        true
    }
}

#[test]
fn neighbors_and_lane_changes_are_interplans() {
    let file = vectors("lane_changes_to_goal.json");
    let mut pairs = 0;
    for (name, value) in file["graphs"].as_object().unwrap() {
        let graph = Graph::new(value);
        for (lane, sides) in value["get_adjacent_lanes_left_right"].as_object().unwrap() {
            let own = graph.id(&Value::from(lane.as_str()));
            let theirs = [0, 1].map(|i| {
                Some(&sides[i])
                    .filter(|side| !side.is_null())
                    .map(|side| graph.id(side))
            });
            assert_eq!(neighbors(&graph, own), theirs, "{name} {lane}");
        }
        for row in value["changes_current_goal_n"].as_array().unwrap() {
            let count = changes_between(&graph, graph.id(&row[0]), graph.id(&row[1]));
            assert_eq!(
                count,
                row[2].as_u64().map(|count| count as usize),
                "{name} {row}"
            );
            pairs += 1;
        }
    }
    assert!(pairs > 300, "{pairs}");
}

#[test]
fn scores_of_lane_changes_are_interplans() {
    let file = vectors("lane_changes_to_goal.json");
    let count = |value: &Value| value.as_u64().map(|count| count as usize);
    for row in file["compute_score_n0_n_value"].as_array().unwrap() {
        // Where interPlan fails, ours is 0.
        let theirs = row[2].as_f64().unwrap_or(0.0);
        assert!(
            (lane_changes_score(count(&row[0]), count(&row[1])) - theirs).abs() < MAX_ERROR,
            "{row}"
        );
    }
    for case in file["compute"].as_array().unwrap() {
        let graph = Graph::new(&file["graphs"][case["graph"].as_str().unwrap()]);
        assert!(graph.lanes.iter().any(|lane| !lane.is_connector));
        let (expert, ego) = (points(&case["expert"]), points(&case["ego"]));
        let cut = expert.len().min(ego.len());
        let (at_start, at_end) =
            counted(&graph, &graph.driven(&expert[..cut]), &graph.driven(&ego));
        assert_eq!(
            (at_start, at_end),
            (count(&case["n0"]), count(&case["n"])),
            "{}",
            case["name"]
        );
    }
}

#[test]
fn obstacles_are_passed_where_interplan_says() {
    let file = vectors("ego_sorts.json");
    for case in file["cases"].as_array().unwrap() {
        let wanted = match case["obstacle_type"].as_str().unwrap() {
            "stopped_vehicle" => "stopped",
            "cone" => "cone",
            _ => "",
        };
        let objects = case["objects"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|object| object[0] == wanted);
        let mut obstacles: Vec<Point> = objects
            .map(|o| Point::new(o[1].as_f64().unwrap(), o[2].as_f64().unwrap()))
            .collect();
        let walkers = case["walkers"].as_array().unwrap().iter().map(numbers);
        obstacles.extend(walkers.map(|walker| Point::new(walker[2], walker[3])));
        // interPlan fails without an obstacle and without a way.
        let Some(threshold) = case["threshold_recomputed"].as_f64() else {
            continue;
        };
        let needed = passing_ratio(&points(&case["expert"]), &obstacles);
        assert!(
            (needed - threshold).abs() < MAX_ERROR,
            "{}: {needed} {threshold}",
            case["name"]
        );
        for row in case["ratio_value"].as_array().unwrap() {
            let (ratio, value) = (row[0].as_f64().unwrap(), row[1].as_f64().unwrap());
            // The recomputed threshold may differ in its last bits.
            if (ratio - needed).abs() > MAX_ERROR {
                assert!(
                    (sorted(ratio, needed) - value).abs() < MAX_ERROR,
                    "{} {row}",
                    case["name"]
                );
            }
        }
    }
}

#[test]
fn scores_of_scenes_are_interplans() {
    let file = vectors("aggregator.json");
    let mut compared = 0;
    for (name, cases) in file["cases"].as_object().unwrap() {
        let kind = InteractionKind::named(name);
        // The type without a kind is scored as those of traffic density are.
        let kind = kind.or_else(|| {
            (name == "standard_modified_nuplan_scenario")
                .then_some(InteractionKind::LowTrafficDensity)
        });
        let weighting = Weighting::of_kind(kind.unwrap(), &METRICS);
        for case in cases.as_array().unwrap() {
            let metrics: BTreeMap<&str, Option<f64>> = case["metrics"]
                .as_object()
                .unwrap()
                .iter()
                .map(|(name, score)| (name.as_str(), score.as_f64()))
                .collect();
            let score = combine(
                metrics.iter().map(|(&name, &score)| (name, score)),
                &weighting,
            );
            assert!(
                (score - case["score"].as_f64().unwrap()).abs() < MAX_ERROR,
                "{name} {score} {}",
                case["score"]
            );
            compared += 1;
        }
    }
    assert_eq!(compared, 180);
}
