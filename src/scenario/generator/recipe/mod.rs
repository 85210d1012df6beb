//! One recipe a scenario type: its roads, its cast, and what must have come about for the drive to be of that type.

mod cases;
mod crossing;
mod follow;
mod garnish;
mod lanes;
mod people;
mod setting;
mod speed;
mod stage;

pub(crate) use setting::{LEAD_IN, SETTLING, Setting};
pub(crate) use stage::{Stage, prepare};

use super::dice::Dice;
use super::drive::Drive;
use super::{ScenarioType, expert::Task};
use crate::geometry::GeometryError;

/// Draws the roads of a scenario type.
///
/// # Errors
/// When a course has no extent.
pub(super) fn setting(kind: ScenarioType, dice: &mut Dice) -> Result<Setting, GeometryError> {
    match kind {
        ScenarioType::StartingLeftTurn => crossing::left_turn(dice),
        ScenarioType::StartingRightTurn => crossing::right_turn(dice),
        ScenarioType::StartingStraightTrafficLightIntersectionTraversal => crossing::straight_at_light(dice),
        ScenarioType::TraversingIntersection => crossing::unsignalled(dice),
        ScenarioType::TraversingRoundabout => crossing::roundabout(dice),
        ScenarioType::StoppingWithLead => follow::stopping(dice),
        ScenarioType::FollowingLaneWithLead => follow::following(dice),
        ScenarioType::BehindLongVehicle => follow::behind_long(dice),
        ScenarioType::StationaryInTraffic => follow::stationary(dice),
        ScenarioType::NearMultipleVehicles => follow::near_many(dice),
        ScenarioType::LowMagnitudeSpeed => follow::low_speed(dice),
        ScenarioType::HighMagnitudeSpeed => speed::high_speed(dice),
        ScenarioType::HighLateralAcceleration => speed::high_lateral(dice),
        ScenarioType::ChangingLane => lanes::changing(dice),
        ScenarioType::WaitingForPedestrianToCross => people::waiting(dice),
        ScenarioType::TraversingPickupDropoff => people::pickup(dice),
        ScenarioType::CaseRoundabout => cases::roundabout(dice),
        ScenarioType::CaseRedLight => cases::red_light(dice),
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
pub(super) fn holds(kind: ScenarioType, drive: &Drive) -> bool {
    match kind {
        ScenarioType::StartingLeftTurn => drive.turns(0.9),
        ScenarioType::StartingRightTurn => drive.turns(-0.9),
        ScenarioType::StartingStraightTrafficLightIntersectionTraversal => drive.crosses_a_light(),
        ScenarioType::TraversingIntersection | ScenarioType::TraversingRoundabout => drive.in_intersection(),
        ScenarioType::StoppingWithLead => drive.stops_behind_lead(),
        ScenarioType::FollowingLaneWithLead => drive.follows(25.0, 3.0),
        ScenarioType::BehindLongVehicle => drive.behind_long(),
        ScenarioType::StationaryInTraffic => drive.stands_in_traffic(),
        ScenarioType::NearMultipleVehicles => drive.near_vehicles(5),
        ScenarioType::LowMagnitudeSpeed => drive.slow(2.5),
        ScenarioType::HighMagnitudeSpeed => drive.fast(9.0),
        ScenarioType::HighLateralAcceleration => drive.lateral(1.2),
        ScenarioType::ChangingLane => drive.changes_lane(),
        ScenarioType::WaitingForPedestrianToCross => drive.waits_for_pedestrian(),
        ScenarioType::TraversingPickupDropoff => drive.passes_bay(),
        ScenarioType::CaseRoundabout => drive.changes_lane() && drive.in_intersection(),
        ScenarioType::CaseRedLight => drive.stops_before_red(),
    }
}
