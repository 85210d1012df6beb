//! The agent of the paper and other planners, and the closed loop that they drive in.
//!
//! [`environment`] turns a scene into prompts, [`reasoning`] asks a model, [`reflection`] judges
//! the plan, [`planner`] has the planners, [`simulation`] closes the loop, and
//! [`planner_registry`] has the planners by name.

#[allow(missing_docs, reason = "the root names little of it")]
pub mod environment;
pub mod planner;
pub mod planner_registry;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod reasoning;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod reflection;
pub mod simulation;

#[cfg(test)]
#[path = "../world/dynamics/test_road.rs"]
mod test_road;
