//! Stage 5: the Reflection module of the paper. A generated planner is rolled out over a short horizon and scored before it
//! may drive.

mod judge;
mod monitor;
mod path;
mod report;
mod rollout;

pub use judge::{Judge, ReflectionError, needs_emergency_brake, steps_of};
pub use monitor::{Choice, PlanMonitor};
pub use path::onto_centerline;
pub use report::{ProgressReference, ReflectionReport, SubScores, Verdict};
pub use rollout::{IdmPlan, LeadPolicy, Rollout, Version};
