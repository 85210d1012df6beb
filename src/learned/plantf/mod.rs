//! PlanTF (Cheng et al. 2024, "Rethinking Imitation-based Planner for Autonomous Driving";
//! `jchengai/planTF`).

mod crosswalk;
mod features;
mod history_encoder;
mod map_encoder;
mod map_features;
mod network;
mod planner;

pub use features::{AgentHistory, PlanTfFeatures};
pub use map_features::{LineFeatures, MapFeatures, PolygonFeatures, VECTORS};
pub use network::{PlanTf, PlanTfConfig, PlanTfInputs, PlanTfMap, PlanTfOutputs};
pub(crate) use planner::entry;
