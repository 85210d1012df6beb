//! RasterModel: timm's `resnet50` on a raster of four channels (nuplan-devkit `raster_model.py`).

mod convolution;
mod drawing;
mod features;
mod network;
mod planner;

pub use drawing::{Canvas, Vertex};
pub use features::{Raster, SIDE};
pub use network::{RasterModel, RasterModelConfig};
pub(crate) use planner::entries;
