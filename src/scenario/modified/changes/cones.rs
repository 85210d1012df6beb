//! `cones`: a line of cones, first across the lane, then along it.

use crate::modified::change::Change;
use crate::modified::draft::Draft;
use crate::modified::fault::Fault;
use crate::modified::lanes::LanePlace;
use crate::modified::number::Number;
use planagent_world::ObjectKind;
use serde::Deserialize;

/// Cones that narrow or close a lane.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::modified) struct Cones {
    /// The first cone ahead of the ego's center, meters.
    ahead_m: Number,
    #[serde(default)]
    lane: LanePlace,
    /// The first cone, left of the centerline, meters.
    #[serde(default = "right_edge")]
    from_left_m: Number,
    /// The line along the lane, left of the centerline, meters.
    #[serde(default = "left_edge")]
    to_left_m: Number,
    /// Length of the taper between them, meters.
    #[serde(default = "taper")]
    taper_m: Number,
    /// Length of the line along the lane, meters.
    #[serde(default = "along")]
    length_m: Number,
    /// Between two cones, meters.
    #[serde(default = "spacing")]
    spacing_m: Number,
}

fn right_edge() -> Number {
    Number::fixed(-1.6)
}

fn left_edge() -> Number {
    Number::fixed(1.4)
}

fn taper() -> Number {
    Number::fixed(12.0)
}

fn along() -> Number {
    Number::fixed(15.0)
}

fn spacing() -> Number {
    Number::fixed(2.5)
}

/// Side of a cone's box, meters (interPlan `agents_modifier.py`).
const SIZE: (f64, f64) = (0.5, 0.5);

impl Change for Cones {
    fn check(&self) -> Result<(), Fault> {
        self.ahead_m.check("ahead_m", 2.0..=300.0)?;
        self.from_left_m.check("from_left_m", -20.0..=20.0)?;
        self.to_left_m.check("to_left_m", -20.0..=20.0)?;
        self.taper_m.check("taper_m", 0.0..=100.0)?;
        self.length_m.check("length_m", 0.0..=200.0)?;
        self.spacing_m.check("spacing_m", 0.6..=20.0)
    }

    fn apply(&self, draft: &mut Draft) -> Result<(), Fault> {
        let [ahead, from, to, taper, length, spacing] = [
            self.ahead_m,
            self.from_left_m,
            self.to_left_m,
            self.taper_m,
            self.length_m,
            self.spacing_m,
        ]
        .map(|number| number.draw(&mut draft.draws));
        let mut along = 0.0;
        while along <= taper + length {
            let left = if along < taper {
                from + (to - from) * along / taper
            } else {
                to
            };
            let place = draft
                .lanes
                .place(&draft.scenario.map, ahead + along, self.lane)?;
            draft.stand(
                ObjectKind::TrafficCone,
                place.pose.translated(0.0, left),
                SIZE,
            );
            along += spacing;
        }
        Ok(())
    }
}
