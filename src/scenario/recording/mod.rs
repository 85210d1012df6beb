//! What every recording without nuPlan's map layers is made a drive by: one definition of each rule for all such sources.
//!
//! * `window`: which steps are driven; `motion`: velocities and accelerations from what was recorded;
//! * `lanes`, `trace`: recorded lanes with their relations, and rays that look for lines beside them;
//! * `crossings`, `junctions`, `roadblocks`, `exclusive`: nuPlan's layers from the lanes; `map`: all of it as a [`LaneMap`];
//! * `route`: the roadblocks that the recorded ego followed.
//!
//! A source says which lanes are connectors, what area each has and what is drivable beside them; the rest follows.
//!
//! [`LaneMap`]: crate::world::LaneMap

pub(super) mod crossings;
pub(super) mod exclusive;
pub(super) mod junctions;
pub(super) mod lanes;
pub(super) mod map;
pub(super) mod motion;
pub(super) mod roadblocks;
pub(super) mod route;
pub(super) mod trace;
pub(super) mod window;
