//! UrbanDriver's elements: the ego, vehicles and map lines, each as up to twenty points.

use candle_core::{Device, Result, Tensor};

/// Points of an element.
pub const POINTS: usize = 20;
/// History frames: the present and 0.4, 0.8, 1.2 and 1.6 s before.
pub const FRAMES: usize = 5;
/// Columns of a point.
const COLUMNS: usize = 8;
/// Columns of a point that says where and how a vehicle or the ego is.
const EGO_COLUMNS: usize = 3;
/// Rows of the kind table: ego, vehicle, lane, left boundary, right boundary, stop line, crosswalk,
/// route lane.
pub(super) const KINDS: [u32; 8] = [0, 1, 4, 7, 8, 5, 6, 9];

/// The map layers, in the order of the elements.
pub const LAYERS: [&str; 6] = [
    "LANE",
    "LEFT_BOUNDARY",
    "RIGHT_BOUNDARY",
    "STOP_LINE",
    "CROSSWALK",
    "ROUTE_LANES",
];

/// Largest numbers of elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ElementLimits {
    /// Vehicles.
    pub vehicles: usize,
    /// Elements of each of [`LAYERS`].
    pub layers: [usize; 6],
}

impl ElementLimits {
    /// Those of the published model.
    pub const PUBLISHED: Self = Self {
        vehicles: 30,
        layers: [30, 30, 30, 20, 20, 30],
    };
}

/// A point of a map line, in the frame of the rear axle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MapPoint {
    /// x and y, meters.
    pub place: [f32; 2],
    /// Green, yellow, red, unknown; zeros where the layer has no lights.
    pub light: [f32; 4],
}

/// Features of one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct UrbanDriverFeatures {
    /// x, y, heading of the ego, oldest first, relative to the rear axle now.
    pub ego: [[f32; EGO_COLUMNS]; FRAMES],
    /// x, y, heading, velocity, yaw rate, length and width of each vehicle, oldest first.
    pub vehicles: Vec<[[f32; COLUMNS]; FRAMES]>,
    /// The elements of each of [`LAYERS`]: their available points.
    pub layers: [Vec<Vec<MapPoint>>; 6],
}

/// The elements of a batch.
#[derive(Debug, Clone)]
pub struct Elements {
    /// Points (B, E, 20, 8).
    pub points: Tensor,
    /// Which are available (B, E, 20), u8.
    pub available: Tensor,
    /// Elements of the ego, the vehicles and each layer.
    pub counts: [usize; 8],
}

impl Elements {
    /// Packs scenes; what exceeds the limits is cut.
    ///
    /// # Errors
    /// When there is no scene.
    pub fn from_scenes(scenes: &[UrbanDriverFeatures], limits: ElementLimits) -> Result<Self> {
        let [a, b, c, d, e, f] = limits.layers;
        let counts = [1, limits.vehicles, a, b, c, d, e, f];
        let rows: usize = counts.iter().sum();
        let mut points = vec![0f32; scenes.len() * rows * POINTS * COLUMNS];
        let mut available = vec![0u8; scenes.len() * rows * POINTS];
        for (i, scene) in scenes.iter().enumerate() {
            let mut put = |element: usize, point: usize, values: &[f32]| {
                let place = (i * rows + element) * POINTS + point;
                points[place * COLUMNS..][..values.len()].copy_from_slice(values);
                available[place] = 1;
            };
            // Upstream's points go back in time, the present first.
            for (point, state) in scene.ego.iter().rev().enumerate() {
                put(0, point, state);
            }
            for (vehicle, states) in scene.vehicles.iter().take(limits.vehicles).enumerate() {
                states
                    .iter()
                    .rev()
                    .enumerate()
                    .for_each(|(point, state)| put(1 + vehicle, point, state));
            }
            let mut first = 1 + limits.vehicles;
            for (layer, limit) in scene.layers.iter().zip(limits.layers) {
                for (element, line) in layer.iter().take(limit).enumerate() {
                    for (
                        point,
                        MapPoint {
                            place: [x, y],
                            light: [g, w, r, u],
                        },
                    ) in line.iter().take(POINTS).enumerate()
                    {
                        put(first + element, point, &[*x, *y, *g, *w, *r, *u]);
                    }
                }
                first += limit;
            }
        }
        let points = Tensor::from_vec(points, (scenes.len(), rows, POINTS, COLUMNS), &Device::Cpu)?;
        let available = Tensor::from_vec(available, (scenes.len(), rows, POINTS), &Device::Cpu)?;
        Ok(Self {
            points,
            available,
            counts,
        })
    }
}
