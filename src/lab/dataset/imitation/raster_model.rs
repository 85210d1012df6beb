//! Samples of RasterModel: rasters of one byte a pixel, twice its value.

use super::tensors::Columns;
use super::{Moment, futures};
use planagent_learned::raster_model::{Raster, SIDE};

/// The raster and the target (16, 3).
pub(super) fn sample(moment: &Moment<'_>) -> Columns {
    let raster = Raster::from_scene(&moment.scene);
    let pixels: Vec<u8> = raster
        .channels
        .iter()
        .flatten()
        .map(|&value| (2.0 * value) as u8)
        .collect();
    let target = futures::half_seconds(moment);
    Columns::default()
        .with_small("raster", &[raster.channels.len(), SIDE, SIDE], pixels)
        .with("speed", &[], vec![moment.scene.ego.velocity.x as f32])
        .with("target", &[target.len() / 3, 3], target)
}
