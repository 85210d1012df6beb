//! Stage 8: nuPlan's metrics of a simulation, and their aggregation into scores.
//!
//! [`METRICS`] is the table of all metrics: name, role in the score, category, unit, and the
//! function that computes each. [`evaluate`] computes the metrics of one [`MetricList`] for an
//! [`EvaluatedSimulation`] (the simulated samples and the expert) and joins them to a [`Score`]. A
//! [`MetricRegistry`] does so with metrics of your own. Statistics, names, categories and units are
//! those of nuPlan's devkit. [`aggregate`] joins the scores of many scenarios.
//!
//! To add a metric, write one file with a `SPEC` and add it to [`METRICS`].
//!
//! Thresholds and quirks are those of `motional/nuplan-devkit` at `e924167`. A comment marks
//! behavior that looks unintended but decides scores. One deviation: nuPlan asserts that at most
//! one lane contains a point. Maps derived from recordings may have several; then the best by
//! heading and distance counts (see [`lanes_at`]).

mod aggregate;
mod collision;
mod comfort;
mod common;
mod corners;
mod drivable_area_compliance;
mod driving_direction_compliance;
mod ego_lane_change;
mod ego_progress_along_expert_route;
mod ego_stop_at_stop_line;
mod error;
mod expert_comparison;
mod input;
mod interactive;
mod no_ego_at_fault_collisions;
mod open_loop;
mod registry;
mod result;
mod route;
mod route_progress;
mod score;
mod spec;
mod speed_limit_compliance;
mod time_to_collision_within_bound;

pub use aggregate::distinct;
pub use aggregate::{AggregateRow, FINAL_SCORE, ScenarioRow, aggregate};
pub use collision::{
    Collision, CollisionGroup, CollisionType, delta_v, find_collisions, is_ahead, is_behind,
};
pub(crate) use collision::{classify_collision, in_collision};
pub(crate) use comfort::{ACCELERATION_WINDOW, YAW_WINDOW, mean_step_s};
pub use comfort::{Bound, ComfortQuantity, SavitzkyGolay, ego_is_comfortable};
#[cfg(test)]
pub(crate) use comfort::{differentiated, smoothed};
pub use common::{ego_expert_l2_error, ego_expert_l2_error_with_yaw, ego_mean_speed};
pub use corners::{CornerAgreement, CornerLanes, DrivenLanes};
pub(crate) use drivable_area_compliance::MAX_DISTANCE_OUTSIDE;
pub use drivable_area_compliance::{corners_in_drivable_area, drivable_area_compliance};
pub(crate) use driving_direction_compliance::direction_score;
pub use driving_direction_compliance::driving_direction_compliance;
pub use ego_lane_change::{LaneChange, ego_lane_change, find_lane_changes};
pub use ego_progress_along_expert_route::{
    ego_is_making_progress, ego_progress_along_expert_route,
};
pub use ego_stop_at_stop_line::ego_stop_at_stop_line;
pub use error::MetricError;
pub use expert_comparison::{HorizonErrors, PlannerExpertErrors, compare_with_expert};
pub use input::{EvaluatedSimulation, MetricInput};
pub use interactive::sorted;
pub use no_ego_at_fault_collisions::no_ego_at_fault_collisions;
pub use open_loop::{
    planner_expert_average_heading_error_within_bound,
    planner_expert_average_l2_error_within_bound, planner_expert_final_heading_error_within_bound,
    planner_expert_final_l2_error_within_bound, planner_miss_rate_within_bound,
};
pub use registry::{Evaluation, METRICS, MetricRegistry, evaluate, metric, scored_metrics};
pub use result::{MetricCategory, MetricResult, ScoreUnit, Statistic, StatisticKind, TimeSeries};
pub use route::{driven_route, lanes_at};
pub use route_progress::{RouteProgress, progress_ratio};
pub use score::{Score, ScorePart, Weighting, combine};
pub use spec::{Compute, MetricList, MetricSpec, Role};
pub use speed_limit_compliance::speed_limit_compliance;
pub use time_to_collision_within_bound::{
    TTC_HORIZON_S, time_to_collision, time_to_collision_within_bound,
};
