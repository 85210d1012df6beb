//! Stage 8: nuPlan's metrics of a driven trajectory and their aggregation into scores.
//!
//! [`evaluate`] takes a [`EvaluatedSimulation`] (what a simulation saved and what the expert did) and gives the eight metrics of the
//! closed-loop challenges, [`evaluate_open_loop`] the five of `open_loop_boxes`, both with the unscored ones, with their
//! statistics, names, categories and units as nuPlan's devkit writes them, and the [`Score`]. [`aggregate`] joins the scores
//! of many scenarios.
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
mod ego_expert_l2_error;
mod ego_expert_l2_error_with_yaw;
mod ego_is_comfortable;
mod ego_is_making_progress;
mod ego_lane_change;
mod ego_mean_speed;
mod ego_progress_along_expert_route;
mod ego_stop_at_stop_line;
mod no_ego_at_fault_collisions;
mod open_loop;
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
pub use comfort::{Bound, ComfortQuantity, SavitzkyGolay, differentiated, mean_step_s, smoothed};
pub use corners::{CornerAgreement, CornerLanes, DrivenLanes};
pub use drivable_area_compliance::{MAX_DISTANCE_OUTSIDE, drivable_area_compliance};
pub use drive::{EvaluatedPlans, EvaluatedSimulation, Evaluation, MetricError, evaluate, evaluate_open_loop};
pub use driving_direction_compliance::{
    DIRECTION_COMPLIANCE, DIRECTION_VIOLATION, direction_score, driving_direction_compliance,
};
pub use ego_expert_l2_error::ego_expert_l2_error;
pub use ego_expert_l2_error_with_yaw::ego_expert_l2_error_with_yaw;
pub use ego_is_comfortable::ego_is_comfortable;
pub use ego_is_making_progress::{MIN_PROGRESS_RATIO, ego_is_making_progress};
pub use ego_lane_change::{LaneChange, ego_lane_change, find_lane_changes};
pub use ego_mean_speed::ego_mean_speed;
pub use ego_progress_along_expert_route::{
    RouteProgress, SCORE_PROGRESS, ego_progress_along_expert_route, progress_ratio,
};
pub use ego_stop_at_stop_line::ego_stop_at_stop_line;
pub use no_ego_at_fault_collisions::{find_collisions, no_ego_at_fault_collisions};
pub use open_loop::{
    COMPARISON_HORIZONS_S, FRAMES_PER_SECOND, HorizonErrors, MAX_AVERAGE_HEADING_ERROR, MAX_AVERAGE_L2_ERROR,
    MAX_DISPLACEMENTS, MAX_FINAL_HEADING_ERROR, MAX_FINAL_L2_ERROR, MAX_MISS_RATE, PlannerExpertErrors,
    compare_with_expert, planner_expert_average_heading_error_within_bound,
    planner_expert_average_l2_error_within_bound, planner_expert_final_heading_error_within_bound,
    planner_expert_final_l2_error_within_bound, planner_miss_rate_within_bound,
};
pub use result::{MetricCategory, MetricResult, ScoreUnit, Statistic, StatisticKind, TimeSeries};
pub use route::{driven_route, lanes_at};
pub use score::{MetricList, MetricName, Role, Score, ScoreError, ScorePart, Weighting, combine};
pub use speed_limit_compliance::{MAX_OVERSPEED, speed_limit_compliance};
pub use time_to_collision_within_bound::{
    MIN_TIME_TO_COLLISION, TTC_HORIZON_S, TTC_STEP_S, time_to_collision, time_to_collision_within_bound,
};
