//! One recipe a scenario type: its roads, its cast, and what must have come about for the drive to be of that type.

mod cases;
mod clutter;
mod crossing;
mod follow;
mod lanes;
mod people;
mod setting;
mod speed;
mod stage;

pub(crate) use setting::{LEAD_IN, SETTLING, Setting};
pub(crate) use stage::{Stage, prepare};

use super::log::GeneratedLog;
use super::rng::SeededRng;
use super::{ScenarioType, expert::Task};
use crate::geometry::GeometryError;

/// Draws the roads of a scenario type.
///
/// # Errors
/// When a course has no extent.
pub(super) fn setting(kind: ScenarioType, rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    match kind {
        ScenarioType::StartingLeftTurn => crossing::left_turn(rng),
        ScenarioType::StartingRightTurn => crossing::right_turn(rng),
        ScenarioType::StartingStraightTrafficLightIntersectionTraversal => crossing::straight_at_light(rng),
        ScenarioType::TraversingIntersection => crossing::unsignalled(rng),
        ScenarioType::TraversingRoundabout => crossing::roundabout(rng),
        ScenarioType::StoppingWithLead => follow::stopping(rng),
        ScenarioType::FollowingLaneWithLead => follow::following(rng),
        ScenarioType::BehindLongVehicle => follow::behind_long(rng),
        ScenarioType::StationaryInTraffic => follow::stationary(rng),
        ScenarioType::NearMultipleVehicles => follow::near_many(rng),
        ScenarioType::LowMagnitudeSpeed => follow::low_speed(rng),
        ScenarioType::HighMagnitudeSpeed => speed::high_speed(rng),
        ScenarioType::HighLateralAcceleration => speed::high_lateral(rng),
        ScenarioType::ChangingLane => lanes::changing(rng),
        ScenarioType::WaitingForPedestrianToCross => people::waiting(rng),
        ScenarioType::TraversingPickupDropoff => people::pickup(rng),
        ScenarioType::CaseRoundabout => cases::roundabout(rng),
        ScenarioType::CaseRedLight => cases::red_light(rng),
    }
}

/// Puts everybody on the roads; the task is the setting's, changed where the cast asks for it.
pub(super) fn cast(kind: ScenarioType, stage: &mut Stage<'_, '_>, task: Task) -> Task {
    match kind {
        ScenarioType::StartingLeftTurn
        | ScenarioType::StartingRightTurn
        | ScenarioType::StartingStraightTrafficLightIntersectionTraversal
        | ScenarioType::TraversingIntersection
        | ScenarioType::TraversingRoundabout => crossing::cast(stage, task),
        ScenarioType::StoppingWithLead => follow::cast_stopping(stage, task),
        ScenarioType::FollowingLaneWithLead => follow::cast_following(stage, task),
        ScenarioType::BehindLongVehicle => follow::cast_behind_long(stage, task),
        ScenarioType::StationaryInTraffic => follow::cast_stationary(stage, task),
        ScenarioType::NearMultipleVehicles => follow::cast_near_many(stage, task),
        ScenarioType::LowMagnitudeSpeed => follow::cast_low_speed(stage, task),
        ScenarioType::HighMagnitudeSpeed | ScenarioType::HighLateralAcceleration => speed::cast(stage, task),
        ScenarioType::ChangingLane => lanes::cast(stage, task),
        ScenarioType::WaitingForPedestrianToCross => people::cast_waiting(stage, task),
        ScenarioType::TraversingPickupDropoff => people::cast_pickup(stage, task),
        ScenarioType::CaseRoundabout => cases::cast_roundabout(stage, task),
        ScenarioType::CaseRedLight => cases::cast_red_light(stage, task),
    }
}

/// Whether the drive is what its type says, at some moment of the log.
pub(super) fn holds(kind: ScenarioType, log: &GeneratedLog) -> bool {
    match kind {
        ScenarioType::StartingLeftTurn => log.turns(0.9),
        ScenarioType::StartingRightTurn => log.turns(-0.9),
        ScenarioType::StartingStraightTrafficLightIntersectionTraversal => log.crosses_a_light(),
        ScenarioType::TraversingIntersection | ScenarioType::TraversingRoundabout => log.in_intersection(),
        ScenarioType::StoppingWithLead => log.stops_behind_lead(),
        ScenarioType::FollowingLaneWithLead => log.follows(25.0, 3.0),
        ScenarioType::BehindLongVehicle => log.behind_long(),
        ScenarioType::StationaryInTraffic => log.stands_in_traffic(),
        ScenarioType::NearMultipleVehicles => log.near_vehicles(5),
        ScenarioType::LowMagnitudeSpeed => log.slow(2.5),
        ScenarioType::HighMagnitudeSpeed => log.fast(9.0),
        ScenarioType::HighLateralAcceleration => log.lateral(1.2),
        ScenarioType::ChangingLane => log.changes_lane(),
        ScenarioType::WaitingForPedestrianToCross => log.waits_for_pedestrian(),
        ScenarioType::TraversingPickupDropoff => log.passes_bay(),
        ScenarioType::CaseRoundabout => log.changes_lane() && log.in_intersection(),
        ScenarioType::CaseRedLight => log.stops_before_red(),
    }
}
