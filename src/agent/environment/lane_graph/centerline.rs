//! The centerlines that planner code may follow, with their limit, light and turn.

use super::AgentName;
use crate::environment::choice::choice;
use planagent_world::geometry::{Point, wrap_angle};
use planagent_world::{LaneId, LaneMap, LanePath, PACIFICA, Route, SceneView, SignalStatus};

/// Lights and turns further ahead of the ego's front bumper are not reported, meters.
pub(crate) const LIGHT_REACH: f64 = 60.0;
/// A centerline covers this time at the speed limit, seconds.
const AHEAD_SECONDS: f64 = 8.0;
/// Minimum length of a centerline ahead of the ego, meters.
const MIN_AHEAD: f64 = 100.0;
/// Limit assumed for that length where the map has none, m/s.
const UNKNOWN_LIMIT: f64 = 20.0;
/// A connector that turns by more than this is a turn, radians (30 degrees).
const TURN: f64 = std::f64::consts::FRAC_PI_6;
/// The ego's front may stand this far beyond a connector's start and still wait at its light,
/// meters.
const PAST_LINE: f64 = 2.0;
/// A stop line belongs to the start of its connector when it is at most this far from it, meters.
const STOP_LINE_REACH: f64 = 15.0;

choice! {
    /// Name of a centerline, as scene text and planner code write it.
    pub enum CenterlineName {
        /// The lane that the ego is on.
        EgoLane = "ego_lane",
        /// The lane to its left.
        LeftLane = "left_lane",
        /// The lane to its right.
        RightLane = "right_lane",
        /// Past what blocks the ego's lane, over the lane against traffic, and back.
        OncomingLane = "oncoming_lane",
    }
}

impl CenterlineName {
    /// Lane changes to it, positive to the left; 0 for the ego's lane, and for the oncoming one,
    /// from which the way leads back.
    pub fn lane_changes(self) -> i32 {
        match self {
            Self::LeftLane => 1,
            Self::RightLane => -1,
            Self::EgoLane | Self::OncomingLane => 0,
        }
    }
}

choice! {
    /// Which way the path goes at the next intersection.
    pub enum Turn {
        /// Straight on, or no intersection near.
        Straight = "straight",
        Left = "left",
        Right = "right",
    }
}

/// The next traffic light on a centerline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightAhead {
    /// The connector that it governs.
    pub connector: LaneId,
    /// What it shows; unknown where the map knows of a light but nothing was seen of it.
    pub status: SignalStatus,
    /// From the ego's front bumper to the stop line (else the connector's start) along the path,
    /// meters; 0 on it.
    pub distance: f64,
}

/// A centerline to follow.
#[derive(Debug, Clone, PartialEq)]
pub struct Centerline {
    pub name: CenterlineName,
    /// The way: from some meters behind the ego to at least 8 s at the limit and 100 m ahead of it,
    /// unless the road ends.
    pub path: LanePath,
    /// Where on the path the ego's box center is (or is beside), meters.
    pub ego_s: f64,
    /// The speed limit at the ego, m/s: of the lane there, else of the next lane of the path that
    /// has one.
    pub speed_limit: Option<f64>,
    /// The next light within [`LIGHT_REACH`].
    pub light: Option<LightAhead>,
    /// Where the first connector within [`LIGHT_REACH`] turns to, the one under the ego included.
    pub turn: Turn,
    /// Its lead agent, see [`super::LaneGraph::leader`].
    pub lead_agent: Option<AgentName>,
}

impl Centerline {
    /// The centerline through `lane`, seen from the ego; `behind` meters of it lie behind the ego
    /// where the map goes so far.
    pub(super) fn through(
        scene: &SceneView<'_>,
        name: CenterlineName,
        lane: LaneId,
        behind: f64,
    ) -> Self {
        let (map, ego) = (scene.map, scene.ego.center().position());
        let limit = map[lane].speed_limit.unwrap_or(UNKNOWN_LIMIT);
        let ahead = MIN_AHEAD.max(AHEAD_SECONDS * limit);
        let (path, ego_s) = path_through(map, scene.route, lane, ego, behind, ahead);
        let ego_place = path
            .lanes
            .iter()
            .position(|&l| l == lane)
            .expect("the path leads through its lane");
        let speed_limit = path.lanes[ego_place..]
            .iter()
            .find_map(|&l| map[l].speed_limit);
        let light = light_ahead(scene, &path, ego_s);
        let turn = turn_ahead(map, &path, ego_s);
        Self {
            name,
            path,
            ego_s,
            speed_limit,
            light,
            turn,
            lead_agent: None,
        }
    }

    /// Length of the path ahead of the ego's center, meters.
    pub fn ahead(&self) -> f64 {
        self.path.centerline.length() - self.ego_s
    }
}

/// The path through a lane, and where on it `point` falls.
fn path_through(
    map: &LaneMap,
    route: &Route,
    lane: LaneId,
    point: Point,
    behind: f64,
    ahead: f64,
) -> (LanePath, f64) {
    let on_lane = map[lane].centerline.project(point).s;
    let onward = LanePath::along(map, route, lane, on_lane + ahead);
    let mut before: Vec<LaneId> = vec![];
    let mut covered = on_lane;
    while covered < behind {
        let first = before.last().copied().unwrap_or(lane);
        let Some(previous) = predecessor(map, route, first) else {
            break;
        };
        // Lanes may form a ring, and a path meets each lane once.
        if before.contains(&previous) || onward.lanes.contains(&previous) {
            break;
        }
        covered += map[previous].centerline.length();
        before.push(previous);
    }
    let lanes: Vec<LaneId> = before
        .into_iter()
        .rev()
        .chain(onward.lanes.iter().copied())
        .collect();
    let path = LanePath::from_lanes(map, lanes).expect("the path leads through its lane");
    let place = path
        .lanes
        .iter()
        .position(|&l| l == lane)
        .expect("the path leads through its lane");
    let start = path.starts[place];
    let ego_s = start + on_lane;
    (path, ego_s)
}

/// The lane that leads into this one: on the route if possible, then the straightest.
fn predecessor(map: &LaneMap, route: &Route, lane: LaneId) -> Option<LaneId> {
    let off_route = |id: LaneId| !route.contains(map[id].roadblock);
    let turn = |id: LaneId| heading_change(map, id).abs();
    map[lane].incoming.iter().copied().min_by(|&a, &b| {
        off_route(a)
            .cmp(&off_route(b))
            .then(turn(a).total_cmp(&turn(b)))
            .then(a.cmp(&b))
    })
}

/// From a lane's start to its end, radians in [−π, π), positive to the left.
fn heading_change(map: &LaneMap, lane: LaneId) -> f64 {
    let line = &map[lane].centerline;
    wrap_angle(line.heading_at(line.length()) - line.heading_at(0.0))
}

fn front_s(ego_s: f64) -> f64 {
    ego_s + PACIFICA.length() / 2.0
}

/// The lanes of a path that begin ahead of `from`, up to [`LIGHT_REACH`], with the arc lengths of
/// their starts.
fn lanes_ahead(path: &LanePath, from: f64) -> impl Iterator<Item = (LaneId, f64)> + '_ {
    let starts = path.lanes.iter().copied().zip(path.starts.iter().copied());
    starts.filter(move |&(_, start)| start >= from && start <= from + LIGHT_REACH)
}

fn light_ahead(scene: &SceneView<'_>, path: &LanePath, ego_s: f64) -> Option<LightAhead> {
    let front = front_s(ego_s);
    lanes_ahead(path, front - PAST_LINE).find_map(|(lane, start)| {
        let recorded = scene.lights.status(lane);
        let status = recorded.or(scene.map[lane]
            .has_traffic_lights
            .then_some(SignalStatus::Unknown))?;
        let distance = (stop_s(scene.map, path, lane, start) - front).max(0.0);
        (distance <= LIGHT_REACH).then_some(LightAhead {
            connector: lane,
            status,
            distance,
        })
    })
}

/// Where to stop for a light: the stop line nearest to the start of its connector, else that start.
fn stop_s(map: &LaneMap, path: &LanePath, connector: LaneId, start: f64) -> f64 {
    let stop_lines = map[connector]
        .stop_lines
        .iter()
        .map(|&id| &map[id])
        .filter(|line| !line.stop_sign);
    let window = path
        .centerline
        .slice(start - STOP_LINE_REACH, start + STOP_LINE_REACH);
    let from = (start - STOP_LINE_REACH).max(0.0);
    window
        .and_then(|window| {
            stop_lines
                .map(|line| window.project(line.polygon.centroid()).s + from)
                .min_by(|a, b| (a - start).abs().total_cmp(&(b - start).abs()))
        })
        .unwrap_or(start)
}

fn turn_ahead(map: &LaneMap, path: &LanePath, ego_s: f64) -> Turn {
    let here = path.lane_at(ego_s);
    let ahead = lanes_ahead(path, ego_s).map(|(lane, _)| lane);
    let Some(connector) = std::iter::once(here)
        .chain(ahead)
        .find(|&lane| map[lane].is_connector())
    else {
        return Turn::Straight;
    };
    let change = heading_change(map, connector);
    if change > TURN {
        Turn::Left
    } else if change < -TURN {
        Turn::Right
    } else {
        Turn::Straight
    }
}
