//! Stage 8: nuPlan's closed-loop metrics of a driven trajectory and their aggregation into scores.
//!
//! [`evaluate`] takes a [`Drive`] (what a simulation saved and what the expert did) and gives the eight scored metrics
//! with their statistics, names and units as nuPlan's devkit writes them, and the [`Score`]. [`aggregate`] joins the
//! scores of many scenarios.
//!
//! Thresholds and quirks are those of `motional/nuplan-devkit` at `e924167`; where a behaviour looks unintended but
//! decides scores, it is kept and the comment says so. One deviation: nuPlan asserts that at most one lane holds a
//! point; maps derived from recordings without nuPlan's layers may hold several, and then the best by heading and
//! distance counts (see [`lanes_at`]).

mod aggregate;
mod collision;
mod comfort;
mod corners;
mod drivable_area_compliance;
mod drive;
mod driving_direction_compliance;
mod ego_is_making_progress;
mod ego_lane_change;
mod ego_progress_along_expert_route;
mod no_ego_at_fault_collisions;
mod result;
mod route;
mod score;
mod speed_limit_compliance;
mod time_to_collision_within_bound;

pub use aggregate::{AggregateRow, RowKind, ScenarioRow, aggregate};
pub use collision::{
    AHEAD_ANGLE, BEHIND_ANGLE, Collision, CollisionGroup, CollisionType, STOPPED_SPEED, classify_collision, delta_v,
    in_collision, is_ahead, is_behind,
};
pub(crate) use comfort::{ACCELERATION_WINDOW, YAW_WINDOW};
pub use comfort::{Bound, ComfortQuantity, SavitzkyGolay, differentiated, ego_is_comfortable, mean_step_s, smoothed};
pub use corners::{CornerAgreement, CornerLanes, DrivenLanes};
pub use drivable_area_compliance::{MAX_DISTANCE_OUTSIDE, drivable_area_compliance};
pub use drive::{Drive, Evaluation, MetricError, evaluate};
pub use driving_direction_compliance::{
    DIRECTION_COMPLIANCE, DIRECTION_VIOLATION, direction_score, driving_direction_compliance,
};
pub use ego_is_making_progress::{MIN_PROGRESS_RATIO, ego_is_making_progress};
pub use ego_lane_change::{LaneChange, ego_lane_change, find_lane_changes};
pub use ego_progress_along_expert_route::{
    RouteProgress, SCORE_PROGRESS, ego_progress_along_expert_route, progress_ratio,
};
pub use no_ego_at_fault_collisions::{find_collisions, no_ego_at_fault_collisions};
pub use result::{MetricResult, Statistic, StatisticKind, TimeSeries};
pub use route::{driven_route, lanes_at};
pub use score::{MetricName, Score, ScoreError, Weighting, combine};
pub use speed_limit_compliance::{MAX_OVERSPEED, speed_limit_compliance};
pub use time_to_collision_within_bound::{
    LEAST_MIN_TTC, TTC_HORIZON_S, TTC_STEP_S, time_to_collision, time_to_collision_within_bound,
};
