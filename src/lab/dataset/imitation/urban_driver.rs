//! Samples of UrbanDriver. Vehicles and map lines of all samples are concatenated; `agents` and
//! `polygons` count those of each.

use super::tensors::Columns;
use super::{Moment, futures};
use planagent_learned::urban_driver::{
    ElementLimits, FRAMES, LAYERS, MapPoint, POINTS, UrbanDriverFeatures,
};

/// Columns of a map point: x, y, four of the light.
const MAP: usize = 6;
/// Columns of a vehicle's frame.
const VEHICLE: usize = 8;

/// Features within the published limits, and the target (16, 3).
pub(super) fn sample(moment: &Moment<'_>) -> Option<Columns> {
    let UrbanDriverFeatures {
        ego,
        mut vehicles,
        layers,
    } = UrbanDriverFeatures::from_scene(&moment.scene);
    let limits = ElementLimits::PUBLISHED;
    // The published network takes no more, so neither does training.
    vehicles.truncate(limits.vehicles);
    let (mut points, mut available, mut kinds) = (Vec::new(), Vec::new(), Vec::new());
    for (layer, (lines, limit)) in layers.iter().zip(limits.layers).enumerate() {
        for line in lines.iter().take(limit) {
            kinds.push(u8::try_from(layer).ok()?);
            for point in 0..POINTS {
                let MapPoint {
                    place: [x, y],
                    light: [green, yellow, red, unknown],
                } = line.get(point).copied().unwrap_or_default();
                points.extend([x, y, green, yellow, red, unknown]);
                available.push(u8::from(point < line.len()));
            }
        }
    }
    debug_assert!(kinds.iter().all(|&kind| usize::from(kind) < LAYERS.len()));
    let target = futures::half_seconds(moment);
    let speed = moment.scene.ego.velocity.x as f32;
    Some(
        Columns::default()
            .with("target", &[target.len() / 3, 3], target)
            .with("speed", &[], vec![speed])
            .with("ego", &[FRAMES, 3], ego.as_flattened().to_vec())
            .with_small("agents", &[], vec![u8::try_from(vehicles.len()).ok()?])
            .with("polygons", &[], vec![kinds.len() as f32])
            .with(
                "agent.frame",
                &[FRAMES, VEHICLE],
                vehicles.as_flattened().as_flattened().to_vec(),
            )
            .with("map.point", &[POINTS, MAP], points)
            .with_small("map.available", &[POINTS], available)
            .with_small("map.layer", &[], kinds),
    )
}
