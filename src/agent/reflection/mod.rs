//! Stage 5: the Reflection module of the paper. It builds the plan of a planner code, rolls it out
//! over a short horizon and scores it before it becomes active.

mod behavior;
mod handover;
mod idm_plan;
mod judge;
mod monitor;
mod overtake;
mod path;
mod plan_builder;
mod plan_paths;
mod reach;
mod report;
mod ride;
mod road;
mod rollout;
mod shift;
#[cfg(test)]
mod test_reports;

pub use behavior::BehaviorScores;
pub use idm_plan::{IdmPlan, LeadPolicy};
pub use judge::{Judge, ReflectionError, needs_emergency_brake, steps_of};
pub use monitor::{Choice, MonitoredStep, PlanMonitor};
pub use overtake::OvertakeRules;
pub(crate) use overtake::allowed_overtake;
pub use plan_builder::PlanBuilder;
pub use report::{ProgressReference, ReflectionReport, SubScores, Verdict};
pub use ride::Ride;
pub use rollout::{Rollout, Version};
