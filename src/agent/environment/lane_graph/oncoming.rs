//! The way past what blocks the ego's lane: over the lane against traffic beside it, and back.

use super::standing::{CLEARANCE_BEHIND, STANDING, edges};
use super::{BlockedStretch, Centerline, CenterlineName};
use planagent_world::geometry::{Polyline, Vector, wrap_angle};
use planagent_world::{LaneId, LanePath, ObjectKind, PACIFICA, SceneView};
use std::f64::consts::PI;

/// Time in which the ego moves over at its speed, and back at the limit, seconds. Bounds of the
/// lengths of both, meters.
const MOVE_OVER_S: f64 = 2.4;
const MOVE_BACK_S: f64 = 2.0;
const MIN_MOVE_OVER: f64 = 12.0;
const MAX_MOVE_OVER: f64 = 30.0;
/// Distance to what is passed, beside it, meters.
/// Why: docs/decisions/114-oncoming-lane.md.
const CLEARANCE: f64 = 0.5;
/// Distance from the border of the lanes at which the oncoming lane is looked for, and between two
/// such places, meters.
const BESIDE_BORDER: f64 = 1.0;
const STATION_STEP: f64 = 4.0;
/// A lane is against traffic when its direction differs from the opposite one by at most this,
/// radians (36 degrees).
const AGAINST: f64 = 0.2 * PI;
/// Length of road ahead on which oncoming traffic is seen, meters. A shorter one would allow no
/// pass at 50 km/h. The picture of the model shows 32 m; the planner knows all tracks.
/// Why: docs/decisions/114-oncoming-lane.md.
pub(crate) const ONCOMING_SIGHT: f64 = 150.0;
/// Distance of the vertices of the way, meters.
const SPACING: f64 = 1.0;
/// An object beside the middle of a lane by at most this is on it, meters.
const HALF_LANE: f64 = 1.9;
/// A vehicle that stands beside the middle of its lane by at most this is not parked, meters.
const IN_MIDDLE: f64 = 0.6;

/// The way past what blocks the ego's lane.
#[derive(Debug, Clone, PartialEq)]
pub struct OncomingLane {
    /// The way: along the ego's lane, over the oncoming one, and back. Its lanes are those of the
    /// ego's lane.
    pub centerline: Centerline,
    /// The centerline of the ego's lane.
    pub own: Polyline,
    /// What is passed; arc lengths on [`Self::own`].
    pub blocked: BlockedStretch,
    /// The border of the two lanes beside [`Self::own`], positive to the left, meters.
    pub border: f64,
    /// The lanes against traffic.
    pub lanes: Vec<LaneId>,
    /// Their centerline in the direction of their traffic, with the lanes that lead to them.
    pub traffic: Polyline,
    /// Their speed limit, m/s.
    pub speed_limit: Option<f64>,
    /// The nearest agent that comes towards the ego: distance of the bumpers, meters, and speed,
    /// m/s.
    pub next: Option<(f64, f64)>,
}

/// A vehicle or bicycle on the oncoming lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OncomingAgent {
    /// Arc length of its front on the line of its traffic, meters.
    pub front_s: f64,
    /// Its length, meters.
    pub length: f64,
    /// Its speed along the lane, m/s.
    pub speed: f64,
}

impl OncomingLane {
    /// The way past, to the left or else to the right, where a lane against traffic is beside the
    /// ego's all along the blocked stretch.
    pub(super) fn find(
        scene: &SceneView<'_>,
        lane: &Centerline,
        blocked: BlockedStretch,
    ) -> Option<Self> {
        [1.0, -1.0]
            .into_iter()
            .find_map(|side| Self::on_side(scene, lane, blocked, side))
    }

    /// The oncoming lane on one side: lanes against the ego's, with room for the path past what
    /// blocks it and back.
    /// Why: docs/decisions/114-oncoming-lane.md.
    fn on_side(
        scene: &SceneView<'_>,
        lane: &Centerline,
        blocked: BlockedStretch,
        side: f64,
    ) -> Option<Self> {
        let own = &lane.path.centerline;
        let length = (scene.ego.speed() * MOVE_OVER_S).clamp(MIN_MOVE_OVER, MAX_MOVE_OVER);
        let back =
            (lane.speed_limit.unwrap_or(0.0) * MOVE_BACK_S).clamp(MIN_MOVE_OVER, MAX_MOVE_OVER);
        // Places of the rear axle: nothing stands beside the ego before the first, or behind it
        // after the second.
        let beside = blocked.from_s - PACIFICA.front_length;
        let past = blocked.to_s + PACIFICA.rear_length + CLEARANCE_BEHIND;
        if past + back > own.length() {
            return None;
        }
        let (right, left) = edges(
            scene,
            &lane.path,
            f64::midpoint(blocked.from_s, blocked.to_s),
        );
        let border = if side > 0.0 { left } else { right };
        let stretch = (beside - length / 2.0, past + back / 2.0);
        let lanes = lanes_against(scene, own, stretch, border + side * BESIDE_BORDER)?;
        let reach = if side > 0.0 {
            blocked.across.1
        } else {
            -blocked.across.0
        };
        let aside = side * (reach + CLEARANCE + PACIFICA.width / 2.0);
        let outer = aside + side * PACIFICA.width / 2.0;
        if !scene
            .map
            .is_drivable(own.frenet_to_map(blocked.from_s, outer))
        {
            return None;
        }
        let share = |s: f64| smooth((s - (beside - length)) / length) - smooth((s - past) / back);
        let count = (own.length() / SPACING).ceil() as usize;
        let stations = (0..=count).map(|i| (i as f64 * SPACING).min(own.length()));
        let path = Polyline::new(stations.map(|s| own.frenet_to_map(s, aside * share(s)))).ok()?;
        let ego_s = path.project(scene.ego.center().position()).s;
        let traffic = traffic_line(scene, &lanes)?;
        let speed_limit = lanes.iter().find_map(|&lane| scene.map[lane].speed_limit);
        let path = LanePath {
            centerline: path,
            ..lane.path.clone()
        };
        let name = CenterlineName::OncomingLane;
        let centerline = Centerline {
            name,
            path,
            ego_s,
            lead_agent: None,
            ..lane.clone()
        };
        let oncoming = Self {
            centerline,
            own: own.clone(),
            blocked,
            border,
            lanes,
            traffic,
            speed_limit,
            next: None,
        };
        Some(Self {
            next: oncoming.next_agent(scene),
            ..oncoming
        })
    }

    /// The agents that move on the oncoming lane, and the vehicles that stand in the middle of it:
    /// they may start again.
    pub fn agents(&self, scene: &SceneView<'_>) -> impl Iterator<Item = OncomingAgent> {
        scene
            .objects
            .iter()
            .filter(|object| object.kind.is_agent())
            .filter_map(|object| {
                let foot = self.traffic.project(object.shape.center.position());
                let speed =
                    Vector::new(foot.heading.cos(), foot.heading.sin()).dot(&object.velocity);
                let length = object.shape.length;
                let waits = object.kind == ObjectKind::Vehicle
                    && speed.abs() < STANDING
                    && foot.distance <= IN_MIDDLE
                    && wrap_angle(object.shape.center.heading - foot.heading).abs() <= AGAINST;
                let comes = speed >= STANDING || waits;
                let is_on_lane = foot.distance <= HALF_LANE && comes;
                is_on_lane.then_some(OncomingAgent {
                    front_s: foot.s + length / 2.0,
                    length,
                    speed: speed.max(0.0),
                })
            })
    }

    fn next_agent(&self, scene: &SceneView<'_>) -> Option<(f64, f64)> {
        let here = self
            .traffic
            .project(PACIFICA.front_of(scene.ego.rear_axle))
            .s;
        let moving = self.agents(scene).filter(|agent| agent.speed >= STANDING);
        let ahead = moving.map(|agent| (here - agent.front_s, agent.speed));
        ahead
            .filter(|(gap, _)| (0.0..=ONCOMING_SIGHT).contains(gap))
            .min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

/// 0 before 0, 1 behind 1, between them the quintic without slope or curvature at both ends.
fn smooth(share: f64) -> f64 {
    let u = share.clamp(0.0, 1.0);
    u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
}

/// The lanes of the other direction along a line, at a distance beside it; `None` where one is
/// missing.
fn lanes_against(
    scene: &SceneView<'_>,
    own: &Polyline,
    (from, to): (f64, f64),
    lateral: f64,
) -> Option<Vec<LaneId>> {
    let (map, from) = (scene.map, from.max(0.0));
    let count = ((to - from) / STATION_STEP).ceil().max(1.0) as u32;
    let mut lanes: Vec<LaneId> = Vec::new();
    for station in 0..=count {
        let s = (from + f64::from(station) * STATION_STEP).min(to);
        let (point, heading) = (own.frenet_to_map(s, lateral), own.heading_at(s));
        let is_against = |&lane: &LaneId| {
            let there = map[lane].centerline.project(point).heading;
            let is_opposite = wrap_angle(there - heading).abs() >= PI - AGAINST;
            is_opposite && !map[lane].is_connector() && !scene.route.contains(map[lane].roadblock)
        };
        let found = map.lanes_at(point).into_iter().find(is_against)?;
        if lanes.last() != Some(&found) {
            lanes.push(found);
        }
    }
    Some(lanes)
}

/// The centerline of oncoming traffic up to the last of its lanes, from [`ONCOMING_SIGHT`] before
/// the first, as far as the map has it.
fn traffic_line(scene: &SceneView<'_>, lanes: &[LaneId]) -> Option<Polyline> {
    let map = scene.map;
    let mut chain = lanes.to_vec();
    let mut covered = 0.0;
    while covered < ONCOMING_SIGHT {
        let bend = |lane: &LaneId| map[*lane].centerline.curvature_at(0.0).abs();
        let before = map[*chain.last()?]
            .incoming
            .iter()
            .copied()
            .filter(|lane| !chain.contains(lane));
        let Some(before) = before.min_by(|a, b| bend(a).total_cmp(&bend(b))) else {
            break;
        };
        covered += map[before].centerline.length();
        chain.push(before);
    }
    chain
        .into_iter()
        .rev()
        .map(|lane| map[lane].centerline.clone())
        .reduce(|line, next| line.joined(&next))
}
