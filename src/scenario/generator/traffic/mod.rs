//! Reactive traffic of the generator.

mod driver;
mod lane_change;
mod mover;
mod right_of_way;
mod state;
mod step;
mod track;
mod walker;

pub(crate) use lane_change::LaneCommand;
pub(crate) use mover::{Act, DriverProfile, Mover, Shift, Steering, Sway};
pub(crate) use state::Traffic;
pub(crate) use track::Track;
pub(crate) use walker::{Departure, Walker};
