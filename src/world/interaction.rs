//! What a modified scenario adds to its simulation and score beyond its frames.

use super::{ObjectKind, TrackToken, TrackedObject};
use crate::geometry::{OrientedBox, Point, Polyline, Pose, Vector};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

/// The kinds of scenes that interPlan scores by its own weights (interPlan `scenario_utils.py`),
/// with its names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum InteractionKind {
    /// A goal that needs lane changes, in traffic with gaps of 10 to 100 m.
    LowTrafficDensity,
    /// The same with gaps of 10 to 50 m.
    MediumTrafficDensity,
    /// The same with gaps of 10 to 33 m.
    HighTrafficDensity,
    /// A parked vehicle that blocks the lane; passing it needs the oncoming lane.
    OvertakeParkedVehicle,
    /// A parked vehicle that leaves room in the lane.
    NudgeAroundParkedVehicle,
    /// Cars that crashed into each other.
    AvoidCrashedCars,
    /// A lane that cones close.
    ApproachingConstructionZone,
    /// A person who steps onto the road as the ego comes near.
    JaywalkingPedestrian,
}

impl InteractionKind {
    /// All kinds, in the order of their suites.
    pub const ALL: [Self; 8] = [
        Self::LowTrafficDensity,
        Self::MediumTrafficDensity,
        Self::HighTrafficDensity,
        Self::OvertakeParkedVehicle,
        Self::NudgeAroundParkedVehicle,
        Self::AvoidCrashedCars,
        Self::ApproachingConstructionZone,
        Self::JaywalkingPedestrian,
    ];

    /// interPlan's name, which is the scenario type of its scenes.
    pub fn name(self) -> &'static str {
        match self {
            Self::LowTrafficDensity => "low_traffic_density",
            Self::MediumTrafficDensity => "medium_traffic_density",
            Self::HighTrafficDensity => "high_traffic_density",
            Self::OvertakeParkedVehicle => "overtake_parked_vehicle",
            Self::NudgeAroundParkedVehicle => "nudge_around_parked_vehicle",
            Self::AvoidCrashedCars => "avoid_crashed_cars",
            Self::ApproachingConstructionZone => "approaching_construction_zone",
            Self::JaywalkingPedestrian => "jaywalking_pedestrian",
        }
    }

    /// The kind of a name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

impl fmt::Display for InteractionKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// How a reactive vehicle treats an ego that moves into its path (interPlan
/// `idm_modified_agent_manager.py`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DriverBehavior {
    /// Lets the ego in from a lane of its roadblock, and looks at no other road.
    #[default]
    Default,
    /// Does not let the ego in from a lane of its roadblock; yields to one that comes from another
    /// road.
    Assertive,
    /// Lets the ego in from any lane.
    Cautious,
    /// Assertive or cautious, as a coin says for each vehicle; interPlan tosses it at each step.
    Mixed,
}

impl FromStr for DriverBehavior {
    type Err = ();

    fn from_str(name: &str) -> Result<Self, ()> {
        match name {
            "default" => Ok(Self::Default),
            "assertive" => Ok(Self::Assertive),
            "cautious" => Ok(Self::Cautious),
            "mixed" => Ok(Self::Mixed),
            _ => Err(()),
        }
    }
}

/// A person or a vehicle that waits for the ego, unseen, then crosses the road in a straight line.
#[derive(Debug, Clone, PartialEq)]
pub struct CrossingActor {
    /// The track.
    pub token: TrackToken,
    /// A pedestrian, unless it is a vehicle.
    pub kind: ObjectKind,
    /// Length and width, meters.
    pub size: (f64, f64),
    /// Where it starts.
    pub from: Point,
    /// Where it stops and stays.
    pub to: Point,
    /// m/s; 0 for one that only looks towards `to`.
    pub speed: f64,
    /// The line along which the ego's progress counts.
    pub along: Arc<Polyline>,
    /// Progress of the crossing on that line, meters.
    pub at_s: f64,
    /// It starts when the ego is at most this far before the crossing, meters.
    pub trigger_m: f64,
}

/// Size of a walking person along and across the heading, meters (interPlan `agents_modifier.py`).
pub const WALKER_SIZE: (f64, f64) = (0.900_003, 0.791_390);

impl CrossingActor {
    /// Whether the center of an ego makes it start.
    pub(crate) fn starts_for(&self, ego: Point) -> bool {
        self.at_s - self.along.project(ego).s <= self.trigger_m
    }

    /// Its box so many seconds after the start.
    pub fn after(&self, seconds: f64) -> TrackedObject {
        let path = self.to - self.from;
        let length = path.norm();
        let walked = (self.speed * seconds).min(length);
        let direction = if length > 0.0 {
            path / length
        } else {
            Vector::zeros()
        };
        let center = Pose::at(
            self.from + direction * walked,
            direction.y.atan2(direction.x),
        );
        let velocity = if walked < length {
            direction * self.speed
        } else {
            Vector::zeros()
        };
        let shape = OrientedBox::new(center, self.size.0, self.size.1);
        TrackedObject {
            token: self.token,
            kind: self.kind,
            shape,
            velocity,
        }
    }
}

/// The place at which the scene ends.
#[derive(Debug, Clone, PartialEq)]
pub struct Goal {
    /// The line to the goal.
    pub along: Arc<Polyline>,
    /// Progress of the goal on that line, meters.
    pub at_s: f64,
}

/// The scene ends so far before the goal, meters (interPlan `interplan_simulation.py`).
const GOAL_TOLERANCE: f64 = 0.1;

impl Goal {
    /// Whether an ego with this center has reached it.
    pub fn is_reached(&self, ego: Point) -> bool {
        self.along.project(ego).s > self.at_s - GOAL_TOLERANCE
    }
}

/// What a modification adds to a scenario beyond its frames.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Interaction {
    /// The kind whose score applies; without one, nuPlan's.
    pub kind: Option<InteractionKind>,
    /// Vehicles that never move.
    pub standing: BTreeSet<TrackToken>,
    /// Who crosses the road as the ego comes near.
    pub crossing: Vec<CrossingActor>,
    /// Behavior of the reactive vehicles that [`Self::behaviors`] does not name.
    pub behavior: DriverBehavior,
    /// Behavior of single vehicles.
    pub behaviors: BTreeMap<TrackToken, DriverBehavior>,
    /// Vehicles that brake for the ego as for a wall.
    pub halting: BTreeSet<TrackToken>,
    /// Whether reactive vehicles change lanes (MOBIL).
    pub lane_changes: bool,
    /// Seed of the coins of mixed behavior.
    pub seed: u64,
    /// Where the scene ends early.
    pub goal: Option<Goal>,
    /// What the ego has to pass: centers of vehicles and cones, end points of walkers.
    pub obstacles: Vec<Point>,
}
