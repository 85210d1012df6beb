//! GC-PGP (`tuplan_garage` `pgp/`, after `nachiket92/PGP`): a policy over the lane graph, walks
//! drawn of it, and clusters of the trajectories along them.

mod aggregator;
mod clusters;
mod encoder;
mod features;
mod lane_graph;
mod network;
mod planner;
mod traversals;
mod visited;
mod waypoints;

pub use clusters::{Clusters, ranks, scores};
pub use features::{AgentSteps, GcPgpFeatures};
pub use lane_graph::{LaneNodes, Node};
pub use network::{GcPgp, GcPgpInputs, GcPgpScene};
pub(crate) use planner::entry;
pub use traversals::TraversalSampler;
pub use visited::{Visited, visited};
pub use waypoints::poses;
