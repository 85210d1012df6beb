//! `crash`: cars that ran into each other.

use super::stopped::{length, width};
use crate::modified::change::Change;
use crate::modified::draft::Draft;
use crate::modified::fault::Fault;
use crate::modified::lanes::LanePlace;
use crate::modified::number::Number;
use planagent_world::ObjectKind;
use serde::Deserialize;

/// Cars in a row that stand askew, each against the next.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::modified) struct Crash {
    /// Center of the first car ahead of the ego's center, meters.
    ahead_m: Number,
    #[serde(default)]
    lane: LanePlace,
    /// Number of cars.
    #[serde(default = "two")]
    cars: Number,
    /// Left of the centerline, meters, for each car.
    #[serde(default = "beside")]
    left_m: Number,
    /// Against the direction of the lane, degrees, to a side that is drawn for each car.
    #[serde(default = "askew")]
    heading_deg: Number,
}

fn two() -> Number {
    Number::fixed(2.0)
}

fn beside() -> Number {
    Number::between(-0.6, 0.6)
}

fn askew() -> Number {
    Number::between(15.0, 60.0)
}

/// Between the centers of two cars, as a share of their mean length.
const SPACING: f64 = 0.95;

impl Change for Crash {
    fn check(&self) -> Result<(), Fault> {
        self.ahead_m.check("ahead_m", 5.0..=300.0)?;
        self.cars.check("cars", 1.0..=6.0)?;
        self.left_m.check("left_m", -20.0..=20.0)?;
        self.heading_deg.check("heading_deg", 0.0..=180.0)
    }

    fn apply(&self, draft: &mut Draft) -> Result<(), Fault> {
        let mut ahead = self.ahead_m.draw(&mut draft.draws);
        for _ in 0..self.cars.draw_whole(&mut draft.draws) {
            let [left, turn, length, width] = [self.left_m, self.heading_deg, length(), width()]
                .map(|number| number.draw(&mut draft.draws));
            let side = if draft.draws.whole(0, 1) == 0 {
                -1.0
            } else {
                1.0
            };
            let mut center = draft
                .lanes
                .place(&draft.scenario.map, ahead, self.lane)?
                .pose
                .translated(0.0, left);
            center.heading += side * turn.to_radians();
            draft.stand(ObjectKind::Vehicle, center, (length, width));
            ahead += SPACING * length;
        }
        Ok(())
    }
}
