//! `crossing`: a vehicle that drives straight across the ego's road from the start on.

use crate::modified::change::Change;
use crate::modified::draft::{CrossingPath, Draft};
use crate::modified::fault::Fault;
use crate::modified::lanes::LanePlace;
use crate::modified::number::Number;
use planagent_world::ObjectKind;
use serde::Deserialize;

/// A vehicle beside the road that drives across it and stops there. It follows no lane and yields
/// to nobody.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::modified) struct CrossingVehicle {
    /// Its way ahead of the ego's center, meters.
    ahead_m: Number,
    #[serde(default)]
    lane: LanePlace,
    /// Its center at the start, left of the centerline, meters.
    from_left_m: Number,
    /// Its center where it stops.
    to_left_m: Number,
    /// m/s.
    speed: Number,
    /// Whether it stays where it is.
    #[serde(default)]
    waits: bool,
}

/// Length and width, meters: a car.
const SIZE: (f64, f64) = (4.5, 1.9);
/// Nearer than everything: it drives at once.
const AT_ONCE: f64 = f64::INFINITY;

impl Change for CrossingVehicle {
    fn check(&self) -> Result<(), Fault> {
        self.ahead_m.check("ahead_m", 5.0..=300.0)?;
        self.from_left_m.check("from_left_m", -50.0..=50.0)?;
        self.to_left_m.check("to_left_m", -50.0..=50.0)?;
        self.speed.check("speed", 0.1..=20.0)
    }

    fn apply(&self, draft: &mut Draft) -> Result<(), Fault> {
        let [ahead_m, from_left_m, to_left_m, speed] =
            [self.ahead_m, self.from_left_m, self.to_left_m, self.speed]
                .map(|number| number.draw(&mut draft.draws));
        // The speed is drawn in any case, so that one that waits changes no other draw.
        let speed = if self.waits { 0.0 } else { speed };
        let lane = self.lane;
        let path = CrossingPath {
            ahead_m,
            lane,
            from_left_m,
            to_left_m,
            speed,
            trigger_m: AT_ONCE,
        };
        draft.cross(ObjectKind::Vehicle, SIZE, path)
    }
}
