//! The two scenes of the vectors.

use super::vectors::json;
use planagent_world::geometry::{OrientedBox, Point, Polygon, Polyline, Pose, Vector};
use planagent_world::{
    EgoState, History, HistorySample, Lane, LaneId, LaneKind, LaneMap, MapParts, Neighbor,
    ObjectKind, Roadblock, RoadblockId, Route, Scene, SignalStatus, StopLine, TrackToken,
    TrackedObject, TrafficLights,
};
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A scene of `scenes/NAME.json`.
pub(super) fn scene(name: &str) -> Scene {
    let file = json(&format!("scenes/{name}.json"));
    let lane_ids = places(&file["lanes"]);
    let block_ids = places(&file["roadblocks"]);
    let map = Arc::new(map(&file, &lane_ids, &block_ids));
    let egos: Vec<EgoState> = list(&file["ego_history"]).iter().map(ego).collect();
    let tokens: BTreeMap<&str, u32> = {
        let all = list(&file["objects"])
            .iter()
            .flat_map(list)
            .map(|object| text(&object["token"]));
        let sorted: std::collections::BTreeSet<&str> = all.collect();
        sorted.into_iter().zip(0..).collect()
    };
    let frames: Vec<Arc<[TrackedObject]>> = list(&file["objects"])
        .iter()
        .map(|frame| {
            list(frame)
                .iter()
                .map(|object| tracked(object, &tokens))
                .collect()
        })
        .collect();
    let mut history = History::default();
    for (&ego, objects) in egos.iter().zip(&frames) {
        history.push(HistorySample {
            ego,
            objects: Arc::clone(objects),
        });
    }
    let light = |light: &Value| {
        let connector = light["lane_connector_id"].as_i64().unwrap().to_string();
        let status = match text(&light["status"]) {
            "RED" => SignalStatus::Red,
            "GREEN" => SignalStatus::Green,
            other => panic!("{other}"),
        };
        (LaneId(lane_ids[&connector]), status)
    };
    let lights: TrafficLights = list(&file["traffic_lights"]).iter().map(light).collect();
    let roadblocks = list(&file["route_roadblock_ids"])
        .iter()
        .map(|id| RoadblockId(block_ids[text(id)]))
        .collect();
    let mut scene = Scene::builder()
        .map(map)
        .ego_state(*egos.last().unwrap())
        .build()
        .unwrap();
    scene.route = Route {
        roadblocks,
        goal: None,
        goal_lane: None,
    };
    scene.objects = Arc::clone(frames.last().unwrap());
    scene.lights = lights;
    scene.history = history;
    scene
}

fn list(value: &Value) -> &Vec<Value> {
    value.as_array().unwrap()
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn places(items: &Value) -> BTreeMap<String, u32> {
    list(items)
        .iter()
        .map(|item| text(&item["id"]).to_owned())
        .zip(0..)
        .collect()
}

fn points(value: &Value) -> impl Iterator<Item = Point> {
    list(value)
        .iter()
        .map(|point| Point::new(number(&point[0]), number(&point[1])))
}

fn polygon(value: &Value) -> Polygon {
    Polygon::new(points(value)).unwrap()
}

fn map(
    file: &Value,
    lane_ids: &BTreeMap<String, u32>,
    block_ids: &BTreeMap<String, u32>,
) -> LaneMap {
    let kind = |item: &Value| {
        if item["is_connector"] == true {
            LaneKind::Connector
        } else {
            LaneKind::Lane
        }
    };
    let lanes_of = |ids: &Value| {
        list(ids)
            .iter()
            .map(|id| LaneId(lane_ids[text(id)]))
            .collect()
    };
    let blocks_of = |ids: &Value| {
        list(ids)
            .iter()
            .map(|id| RoadblockId(block_ids[text(id)]))
            .collect()
    };
    let lane = |lane: &Value| Lane {
        id: LaneId(lane_ids[text(&lane["id"])]),
        source_id: text(&lane["id"]).parse().unwrap(),
        kind: kind(lane),
        centerline: Polyline::new(points(&lane["baseline"])).unwrap(),
        polygon: polygon(&lane["polygon"]),
        incoming: lanes_of(&lane["incoming"]),
        outgoing: lanes_of(&lane["outgoing"]),
        left: beside(lane, "left_neighbour", lane_ids),
        right: beside(lane, "right_neighbour", lane_ids),
        roadblock: RoadblockId(block_ids[text(&lane["roadblock"])]),
        speed_limit: lane["speed_limit"].as_f64(),
        has_traffic_lights: lane["has_traffic_lights"] == true,
        stop_lines: vec![],
    };
    let block = |block: &Value| Roadblock {
        id: RoadblockId(block_ids[text(&block["id"])]),
        source_id: text(&block["id"]).parse().unwrap(),
        kind: kind(block),
        lanes: lanes_of(&block["interior"]),
        areas: vec![polygon(&block["polygon"])],
        incoming: blocks_of(&block["incoming"]),
        outgoing: blocks_of(&block["outgoing"]),
    };
    let layer = |name: &str| {
        list(&file["polygons"][name])
            .iter()
            .map(|item| polygon(&item["polygon"]))
            .collect()
    };
    let stop_lines: Vec<Polygon> = layer("STOP_LINE");
    LaneMap::new(MapParts {
        lanes: list(&file["lanes"]).iter().map(lane).collect(),
        roadblocks: list(&file["roadblocks"]).iter().map(block).collect(),
        stop_lines: stop_lines
            .into_iter()
            .map(|polygon| StopLine {
                polygon,
                lanes: vec![],
                stop_sign: false,
            })
            .collect(),
        intersections: layer("INTERSECTION"),
        crosswalks: layer("CROSSWALK"),
        carparks: layer("CARPARK_AREA"),
        ..MapParts::default()
    })
    .unwrap()
}

fn beside(lane: &Value, side: &str, lane_ids: &BTreeMap<String, u32>) -> Vec<Neighbor> {
    let neighbor = |id: &str| Neighbor {
        lane: LaneId(lane_ids[id]),
        from_s: 0.0,
        to_s: f64::INFINITY,
    };
    lane[side].as_str().map(neighbor).into_iter().collect()
}

fn ego(state: &Value) -> EgoState {
    let of = |key: &str| number(&state[key]);
    EgoState {
        time_us: state["time_us"].as_i64().unwrap(),
        rear_axle: Pose::new(of("x"), of("y"), of("heading")),
        velocity: Vector::new(of("rear_vx"), of("rear_vy")),
        acceleration: Vector::new(of("rear_ax"), of("rear_ay")),
        steering_angle: of("tire_steering_angle"),
        steering_rate: 0.0,
        angular_velocity: of("angular_velocity"),
        angular_acceleration: of("angular_acceleration"),
    }
}

fn tracked(object: &Value, tokens: &BTreeMap<&str, u32>) -> TrackedObject {
    let of = |key: &str| number(&object[key]);
    let kind = match text(&object["type"]) {
        "VEHICLE" => ObjectKind::Vehicle,
        "PEDESTRIAN" => ObjectKind::Pedestrian,
        "BICYCLE" => ObjectKind::Bicycle,
        "TRAFFIC_CONE" => ObjectKind::TrafficCone,
        "BARRIER" => ObjectKind::Barrier,
        "CZONE_SIGN" => ObjectKind::CzoneSign,
        "GENERIC_OBJECT" => ObjectKind::GenericObject,
        other => panic!("{other}"),
    };
    TrackedObject {
        token: TrackToken(tokens[text(&object["token"])]),
        kind,
        shape: OrientedBox::new(
            Pose::new(of("x"), of("y"), of("heading")),
            of("length"),
            of("width"),
        ),
        velocity: Vector::new(of("vx"), of("vy")),
    }
}
