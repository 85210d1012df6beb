//! The roads of a generated drive: lines, cross-sections, junctions, roundabouts, lights.

mod conflict;
mod junction;
mod layout;
mod line;
mod network;
mod roads;
mod roundabout;
mod signal;

pub(crate) use junction::{Control, Turn};
pub(crate) use layout::{CirclePlan, Course, CrossingPlan, Layout, RoadStyle};
pub(crate) use network::{Conflict, Passage};
pub(crate) use roads::Roads;
pub(crate) use signal::YELLOW;
