//! Roads of a generated scenario: lines, cross-sections, junctions, roundabouts, traffic lights.

mod conflict;
mod junction;
mod layout;
mod line;
mod network;
mod roads;
mod roundabout;
mod signal;

pub(crate) use junction::{Control, Turn};
pub(crate) use layout::{CirclePlan, Course, CrossingPlan};
pub(crate) use layout::{Layout, RoadStyle};
pub(crate) use network::{Conflict, ExtraWidths, MAX_LANES, Passage};
pub(crate) use roads::Roads;
pub(crate) use signal::YELLOW;
