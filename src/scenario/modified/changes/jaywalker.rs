//! `jaywalker`: a person who crosses as the ego comes near.

use crate::modified::change::Change;
use crate::modified::draft::{CrossingPath, Draft};
use crate::modified::fault::Fault;
use crate::modified::lanes::LanePlace;
use crate::modified::number::Number;
use planagent_world::{ObjectKind, WALKER_SIZE};
use serde::Deserialize;

/// A person beside the ego's path.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::modified) struct CrossingPerson {
    /// The crossing ahead of the ego's center, meters.
    ahead_m: Number,
    #[serde(default)]
    lane: LanePlace,
    /// Where the person starts, left of the centerline, meters.
    from_left_m: Number,
    /// Where the person stops.
    to_left_m: Number,
    /// The person starts when the ego's center is so far before the crossing, meters.
    trigger_m: Number,
    /// m/s.
    #[serde(default = "walking")]
    speed: Number,
}

fn walking() -> Number {
    Number::between(1.0, 1.6)
}

impl Change for CrossingPerson {
    fn check(&self) -> Result<(), Fault> {
        self.ahead_m.check("ahead_m", 0.0..=300.0)?;
        self.from_left_m.check("from_left_m", -30.0..=30.0)?;
        self.to_left_m.check("to_left_m", -30.0..=30.0)?;
        self.trigger_m.check("trigger_m", 0.0..=300.0)?;
        self.speed.check("speed", 0.1..=6.0)
    }

    fn apply(&self, draft: &mut Draft) -> Result<(), Fault> {
        let [ahead_m, from_left_m, to_left_m, trigger_m, speed] = [
            self.ahead_m,
            self.from_left_m,
            self.to_left_m,
            self.trigger_m,
            self.speed,
        ]
        .map(|number| number.draw(&mut draft.draws));
        let path = CrossingPath {
            ahead_m,
            lane: self.lane,
            from_left_m,
            to_left_m,
            speed,
            trigger_m,
        };
        draft.cross(ObjectKind::Pedestrian, WALKER_SIZE, path)
    }
}
