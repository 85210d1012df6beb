//! What all drivers of a scene share, so that scenes differ from each other as recordings do.

use crate::generator::rng::SeededRng;

/// Habits of the drivers of a scene, and how exact its boxes are.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Habits {
    /// Where drivers keep in their lanes, meters to the left of the middle.
    pub(super) bias: f64,
    /// Farthest to the side within what a wide lane leaves, meters.
    pub(super) max_aside: f64,
    /// How much farther than the lane leaves, meters at most.
    pub(super) beyond: f64,
    /// Angle of a box to its course, radians at most.
    pub(super) max_skew: f64,
    /// Factor of how far drivers sway.
    pub(super) sway: f64,
    /// Widths of cars, meters.
    pub(super) car_widths: [f64; 2],
}

/// Mean width of cars in still wider ranges, meters.
const CAR_WIDTH: f64 = 2.115;

impl Habits {
    /// Those of a scene; they differ in still wider ranges alone.
    pub(super) fn new(rng: &mut SeededRng) -> Self {
        if !rng.is_wider() {
            return Self {
                bias: 0.0,
                max_aside: 0.8,
                beyond: 0.0,
                max_skew: 0.0,
                sway: 1.0,
                car_widths: [1.9, 2.3],
            };
        }
        // Most boxes of recordings are turned by less than a degree, those of some by several.
        let max_skew_deg = 0.5 * 14f64.powf(rng.unit());
        let bias = rng.sign() * 0.5 * rng.unit();
        let beyond = 0.8 * rng.unit().powi(2);
        let sway = rng.uniform(0.2, 1.2);
        let spread = rng.uniform(0.15, 0.4);
        Self {
            bias,
            max_aside: 1.6,
            beyond,
            max_skew: max_skew_deg.to_radians(),
            sway,
            car_widths: [CAR_WIDTH - spread, CAR_WIDTH + spread],
        }
    }
}
