//! Stage 5: the Reflection module of the paper. A generated planner is rolled out over a short horizon and scored before it
//! may drive.

mod path;
mod rollout;

pub use path::onto_centerline;
pub use rollout::{GeneratedPlanner, LeadPolicy, Rollout};
