//! Rules that turn a recording without nuPlan's map layers into a scenario, the same for all
//! sources.
//!
//! * `window`: the simulated steps, and the scenario; `motion`: velocities and accelerations;
//! * `lanes`, `trace`: recorded lanes with their relations, and rays that look for lines beside
//!   them;
//! * `junctions`, `roadblocks`, `map`: nuPlan's layers from the lanes, and the [`LaneMap`];
//! * `route`: the roadblocks that the recorded ego followed, and `onward` those after them;
//!   `error`: faults and their places.
//!
//! A source provides the connectors, the area of each lane and the drivable area beside the lanes.
//!
//! [`LaneMap`]: planagent_world::LaneMap

pub(super) mod error;
pub(super) mod junctions;
pub(super) mod lanes;
pub(super) mod map;
pub(super) mod motion;
mod onward;
pub(super) mod roadblocks;
pub(super) mod route;
pub(super) mod trace;
pub(super) mod window;
