//! `stopped`: a vehicle that never moves.

use crate::modified::change::Change;
use crate::modified::draft::Draft;
use crate::modified::fault::Fault;
use crate::modified::lanes::LanePlace;
use crate::modified::number::Number;
use planagent_world::ObjectKind;
use serde::Deserialize;

/// A parked or broken-down vehicle.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::modified) struct Stopped {
    /// Its center ahead of the ego's center along the lane, meters.
    ahead_m: Number,
    #[serde(default)]
    lane: LanePlace,
    /// Left of the centerline, meters.
    #[serde(default = "zero")]
    left_m: Number,
    /// Against the direction of the lane, degrees, counter-clockwise.
    #[serde(default = "zero")]
    heading_deg: Number,
    #[serde(default = "length")]
    length_m: Number,
    #[serde(default = "width")]
    width_m: Number,
}

fn zero() -> Number {
    Number::fixed(0.0)
}

pub(super) fn length() -> Number {
    Number::between(4.2, 5.0)
}

pub(super) fn width() -> Number {
    Number::between(1.8, 2.0)
}

impl Change for Stopped {
    fn check(&self) -> Result<(), Fault> {
        self.ahead_m.check("ahead_m", -100.0..=300.0)?;
        self.left_m.check("left_m", -20.0..=20.0)?;
        self.heading_deg.check("heading_deg", -180.0..=180.0)?;
        self.length_m.check("length_m", 0.5..=20.0)?;
        self.width_m.check("width_m", 0.3..=4.0)
    }

    fn apply(&self, draft: &mut Draft) -> Result<(), Fault> {
        let [ahead, left, heading, length, width] = [
            self.ahead_m,
            self.left_m,
            self.heading_deg,
            self.length_m,
            self.width_m,
        ]
        .map(|n| n.draw(&mut draft.draws));
        let place = draft.lanes.place(&draft.scenario.map, ahead, self.lane)?;
        let mut center = place.pose.translated(0.0, left);
        center.heading += heading.to_radians();
        draft.stand(ObjectKind::Vehicle, center, (length, width));
        Ok(())
    }
}
