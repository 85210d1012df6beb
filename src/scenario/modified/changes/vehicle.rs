//! `vehicle`: a vehicle that drives along its lane.

use super::stopped::{length, width};
use crate::modified::change::Change;
use crate::modified::changes::drivers::behavior;
use crate::modified::draft::Draft;
use crate::modified::fault::Fault;
use crate::modified::lanes::LanePlace;
use crate::modified::number::Number;
use serde::Deserialize;

/// A vehicle under the intelligent driver model.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::modified) struct Vehicle {
    /// Its center ahead of the ego's center, meters.
    ahead_m: Number,
    #[serde(default)]
    lane: LanePlace,
    /// At the start, m/s.
    speed: Number,
    /// default, assertive, cautious or mixed.
    driver: Option<String>,
    #[serde(default = "length")]
    length_m: Number,
    #[serde(default = "width")]
    width_m: Number,
}

impl Change for Vehicle {
    fn check(&self) -> Result<(), Fault> {
        self.ahead_m.check("ahead_m", -100.0..=300.0)?;
        self.speed.check("speed", 0.0..=40.0)?;
        self.length_m.check("length_m", 0.5..=20.0)?;
        self.width_m.check("width_m", 0.3..=4.0)?;
        self.driver
            .as_deref()
            .map(|word| behavior("driver", word))
            .transpose()
            .map(|_| ())
    }

    fn apply(&self, draft: &mut Draft) -> Result<(), Fault> {
        let [ahead, speed, length, width] = [self.ahead_m, self.speed, self.length_m, self.width_m]
            .map(|number| number.draw(&mut draft.draws));
        let place = draft.lanes.place(&draft.scenario.map, ahead, self.lane)?;
        let driver = self
            .driver
            .as_deref()
            .map(|word| behavior("driver", word))
            .transpose()?;
        draft.drive(place.pose, (length, width), speed, driver);
        Ok(())
    }
}
