//! The front door of the library: an agent, a scenario, and a simulation of both.

mod agent;
mod error;
mod run;

pub use agent::{Agent, AgentBuilder};
pub use error::{Error, Result};
pub use run::{Run, Simulation, simulate};
