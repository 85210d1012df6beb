//! The output form of six waypoints: their grammar, how they are read, and the trajectory through
//! them.

mod grammar;
mod read;
mod track;

pub(crate) use grammar::{any_of, text, waypoints as waypoint_grammar};
pub(crate) use read::{Motion, read_waypoints};
pub(crate) use track::WaypointTrack;

/// Time between two waypoints, seconds.
pub(crate) const SPACING_S: f64 = 0.5;
/// The same in steps of 0.1 s.
pub(crate) const SPACING_STEPS: usize = 5;
