//! What the scenario types share: roads, the ego's place on them, and the agents and objects around
//! it.
//!
//! * `setting`: roads, start of the ego, its traffic light; `builder`: vehicles, objects and
//!   pedestrians on the roads;
//! * `clutter`: parked cars, cyclists, pedestrians, cones; `obstacles`: what blocks the ego's lane;
//! * `crossing`, `stream`: what several types have in common;
//! * `wide`, `habits`, `recorded_map`: wider ranges of draws, and maps as recordings have them.

pub(crate) mod builder;
mod clutter;
pub(crate) mod crossing;
mod habits;
pub(crate) mod obstacles;
pub(crate) mod recorded_map;
pub mod setting;
pub(crate) mod stream;
mod wide;
