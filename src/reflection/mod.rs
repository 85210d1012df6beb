//! Stage 5: the Reflection module of the paper. A generated planner is rolled out over a short horizon and scored before it
//! may drive.

mod judge;
mod path;
mod report;
mod rollout;
mod watch;

pub use judge::{Judge, ReflectionError, needs_emergency_brake, steps_of};
pub use path::onto_centerline;
pub use report::{ProgressReference, ReflectionReport, SubScores, Verdict};
pub use rollout::{GeneratedPlanner, LeadPolicy, Rollout, Version};
pub use watch::{Choice, Watch};
