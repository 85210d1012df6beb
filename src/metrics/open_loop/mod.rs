//! The open-loop metrics: what the planner wanted at every second of the log, beside what the recorded driver did.
//!
//! All five read one comparison, [`PlannerExpertErrors`].

mod comparison;
mod planner_expert_average_heading_error_within_bound;
mod planner_expert_average_l2_error_within_bound;
mod planner_expert_final_heading_error_within_bound;
mod planner_expert_final_l2_error_within_bound;
mod planner_miss_rate_within_bound;

pub use comparison::{
    COMPARISON_HORIZONS_S, FRAMES_PER_SECOND, HorizonErrors, PlannerExpertErrors, compare_with_expert,
};
pub use planner_expert_average_heading_error_within_bound::{
    MAX_AVERAGE_HEADING_ERROR, planner_expert_average_heading_error_within_bound,
};
pub use planner_expert_average_l2_error_within_bound::{
    MAX_AVERAGE_L2_ERROR, planner_expert_average_l2_error_within_bound,
};
pub use planner_expert_final_heading_error_within_bound::{
    MAX_FINAL_HEADING_ERROR, planner_expert_final_heading_error_within_bound,
};
pub use planner_expert_final_l2_error_within_bound::{MAX_FINAL_L2_ERROR, planner_expert_final_l2_error_within_bound};
pub use planner_miss_rate_within_bound::{MAX_DISPLACEMENTS, MAX_MISS_RATE, planner_miss_rate_within_bound};
