//! UrbanDriver as nuPlan trains it in open loop (nuplan-devkit `urban_driver_open_loop_model.py`).

mod elements;
mod features;
mod network;
mod planner;

pub use elements::{
    ElementLimits, Elements, FRAMES, LAYERS, MapPoint, POINTS, UrbanDriverFeatures,
};
pub use network::{UrbanDriver, UrbanDriverConfig};
pub(crate) use planner::entry;
