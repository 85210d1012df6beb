//! The true answers to the questions of the first round, from map and objects alone. Training uses
//! them as labels, evaluation as the truth.
//!
//! Only what the view of [`VIEW_METERS`] shows counts. The light and the turn of the route, which
//! no image shows, are those of the scene text. *The path* is the ego's centerline of the
//! lane graph from the ego's box center on, as far as it is in view. Distances are along the
//! path from the ego's front bumper, in three steps (see [`Ahead`]).

mod answers;
mod road;
mod roundabout;
mod traffic;

pub use answers::{
    Ahead, EgoSpeed, LaneCount, LaneIndex, LeadSpeed, Light, Oncoming, Question, SceneType,
    SideLane, VehicleCount,
};
pub use road::ONCOMING_REACH;
pub use traffic::{CORRIDOR_MARGIN, ONCOMING_ASIDE, SAME_SPEED, SIDE_GAP, STOPPED};

use super::bev::BevView;
use super::lane_graph::{GraphedScene, Turn};
use planagent_world::SignalStatus;
use planagent_world::geometry::{OrientedBox, Point, Pose};

/// Side of the square around the ego's box center, along its heading, in which things count,
/// meters: the default BEV view.
pub(crate) const VIEW_METERS: f64 = BevView::DEFAULT_METERS;

/// The true answers for one scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct SceneFacts {
    /// Kind of place: the first that applies of roundabout, intersection, curve, straight.
    pub scene_type: SceneType,
    /// The next light on the ego's path, as in the scene text; `none` also when it is not observed.
    pub light: Light,
    /// Lanes of the ego's direction side by side at its place.
    pub lane_count: LaneCount,
    /// The number of the ego's lane, from the left.
    pub lane_index: LaneIndex,
    /// Where the path next meets a crosswalk.
    pub crosswalk: Ahead,
    /// The nearest vehicle or bicycle that moves along the path, or stands on it, and blocks it.
    pub lead_distance: Ahead,
    pub lead_speed: LeadSpeed,
    /// The nearest pedestrian with its center in the corridor of the path: the ego's width and
    /// [`CORRIDOR_MARGIN`] to both sides.
    pub pedestrian: Ahead,
    /// The nearest static obstacle or stopped vehicle that blocks the path.
    pub blocked: Ahead,
    /// Whether there is a lane to the left, and an object on it within [`SIDE_GAP`] of the ego's
    /// bumpers.
    pub left_lane: SideLane,
    /// The same to the right.
    pub right_lane: SideLane,
    /// Other vehicles with their center in view.
    pub vehicle_count: VehicleCount,
    /// Whether a lane of the opposite direction passes beside the ego within [`ONCOMING_REACH`].
    pub oncoming: Oncoming,
    pub ego_speed: EgoSpeed,
    /// Turn of the route at the next intersection, as in the scene text.
    pub turn: Turn,
    /// The nearest vehicle or bicycle that moves across the path, on it or toward it.
    pub crossing_vehicle: Ahead,
    /// The nearest vehicle or bicycle that moves against the path within [`ONCOMING_ASIDE`] of it.
    pub oncoming_vehicle: Ahead,
    /// The nearest pedestrian who is on the strip that the ego sweeps, or will be within two
    /// seconds.
    pub person_on_path: Ahead,
}

impl SceneFacts {
    /// The facts of a scene.
    pub fn from_scene(seen: GraphedScene<'_>) -> Self {
        let GraphedScene { scene, graph } = seen;
        let view = View {
            center: scene.ego.center(),
        };
        // An unknown light counts as none: a model cannot see its state either.
        let light = match graph.ego_lane().light.map(|light| light.status) {
            Some(SignalStatus::Green) => Light::Green,
            Some(SignalStatus::Yellow) => Light::Yellow,
            Some(SignalStatus::Red) => Light::Red,
            Some(SignalStatus::Unknown) | None => Light::None,
        };
        let (lane_count, lane_index) = road::lanes_abreast(seen);
        let traffic = traffic::seen(seen, view);
        Self {
            scene_type: road::scene_type(seen, view),
            light,
            lane_count,
            lane_index,
            crosswalk: road::crosswalk(seen, view),
            lead_distance: traffic.lead_distance,
            lead_speed: traffic.lead_speed,
            pedestrian: traffic.pedestrian,
            blocked: traffic.blocked,
            left_lane: traffic.left_lane,
            right_lane: traffic.right_lane,
            vehicle_count: traffic.vehicle_count,
            oncoming: road::oncoming(seen),
            ego_speed: EgoSpeed::from_speed(scene.ego.speed()),
            turn: graph.ego_lane().turn,
            crossing_vehicle: traffic.crossing_vehicle,
            oncoming_vehicle: traffic.oncoming_vehicle,
            person_on_path: traffic.person_on_path,
        }
    }

    /// The answer to one question: one of [`Question::choices`].
    pub fn answer(&self, question: Question) -> &'static str {
        match question {
            Question::SceneType => self.scene_type.as_str(),
            Question::Light => self.light.as_str(),
            Question::LaneCount => self.lane_count.as_str(),
            Question::LaneIndex => self.lane_index.as_str(),
            Question::Crosswalk => self.crosswalk.as_str(),
            Question::LeadDistance => self.lead_distance.as_str(),
            Question::LeadSpeed => self.lead_speed.as_str(),
            Question::Pedestrian => self.pedestrian.as_str(),
            Question::Blocked => self.blocked.as_str(),
            Question::LeftLane => self.left_lane.as_str(),
            Question::RightLane => self.right_lane.as_str(),
            Question::VehicleCount => self.vehicle_count.as_str(),
            Question::Oncoming => self.oncoming.as_str(),
            Question::EgoSpeed => self.ego_speed.as_str(),
            Question::Turn => self.turn.as_str(),
            Question::CrossingVehicle => self.crossing_vehicle.as_str(),
            Question::OncomingVehicle => self.oncoming_vehicle.as_str(),
            Question::PersonOnPath => self.person_on_path.as_str(),
        }
    }
}

#[derive(Debug, Clone, Copy)]
struct View {
    center: Pose,
}

impl View {
    fn holds(self, point: Point) -> bool {
        let local = self.center.to_local(point);
        local.x.abs() <= VIEW_METERS / 2.0 && local.y.abs() <= VIEW_METERS / 2.0
    }

    /// Whether the center or a corner of a box is in view.
    fn shows(self, shape: &OrientedBox) -> bool {
        self.holds(shape.center.position())
            || shape.corners().iter().any(|&corner| self.holds(corner))
    }
}

#[cfg(test)]
mod tests;
