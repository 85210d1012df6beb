//! `traffic`: vehicles in a row on each lane, with drawn gaps (interPlan `agents_modifier.py`).

use super::stopped::{length, width};
use crate::modified::change::Change;
use crate::modified::changes::drivers::behavior;
use crate::modified::draft::Draft;
use crate::modified::fault::Fault;
use crate::modified::lanes::{OnLane, through};
use crate::modified::number::Number;
use planagent_world::dynamics::IDM_AGENT;
use serde::Deserialize;

/// Dense traffic. The ego takes a place in the row of its lane, and the speed of that place.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::modified) struct Traffic {
    /// own, beside, oncoming or all: the ego's lane, its direction without it, the other direction,
    /// every lane.
    lanes: String,
    /// From front to front, meters.
    gap_m: Number,
    /// How far the rows reach ahead of and behind the ego, meters.
    #[serde(default = "ahead")]
    ahead_m: Number,
    #[serde(default = "behind")]
    behind_m: Number,
    /// m/s; without it, what the gaps allow.
    speed: Option<Number>,
    /// default, assertive, cautious or mixed.
    driver: Option<String>,
    /// Whether the ego has its place in the row of its lane.
    #[serde(default = "yes")]
    ego_in_row: bool,
}

fn ahead() -> Number {
    Number::fixed(90.0)
}

fn behind() -> Number {
    Number::fixed(50.0)
}

fn yes() -> bool {
    true
}

/// Words of `lanes`.
const LANES: [&str; 4] = ["own", "beside", "oncoming", "all"];
/// A row nearer than this to the ego takes it into its order, meters.
const NEAR_EGO: f64 = 10.0;
/// Reaction time: mean, deviation and minimum, seconds; deviation of the speed, m/s (interPlan
/// `agents_modifier.py`).
const REACTION: (f64, f64, f64) = (0.25, 0.05, 0.1);
const SPEED_DEVIATION: f64 = 1.0;

impl Change for Traffic {
    fn check(&self) -> Result<(), Fault> {
        if !LANES.contains(&self.lanes.as_str()) {
            return Err(Fault::new(
                "lanes",
                format!("{:?} is none of {}", self.lanes, LANES.join(", ")),
            ));
        }
        self.gap_m.check("gap_m", 6.0..=300.0)?;
        self.ahead_m.check("ahead_m", 0.0..=100.0)?;
        self.behind_m.check("behind_m", 0.0..=100.0)?;
        self.speed
            .map_or(Ok(()), |speed| speed.check("speed", 0.0..=40.0))?;
        self.driver
            .as_deref()
            .map(|word| behavior("driver", word))
            .transpose()
            .map(|_| ())
    }

    fn apply(&self, draft: &mut Draft) -> Result<(), Fault> {
        let map = draft.scenario.map.clone();
        let own = draft.lanes.path.lane_at(draft.lanes.start_s);
        let (mut rows, wants): (Vec<(OnLane, bool)>, _) = (Vec::new(), |word: &str| {
            self.lanes == word || self.lanes == "all"
        });
        // Own lane first, then beside, then oncoming: rows draw from one stream, so their order is
        // fixed.
        let of_direction = draft.lanes.own_direction(&map, 0.0)?;
        rows.extend(
            of_direction
                .iter()
                .filter(|one| one.lane == own && wants("own"))
                .map(|&one| (one, false)),
        );
        rows.extend(
            of_direction
                .iter()
                .filter(|one| one.lane != own && wants("beside"))
                .map(|&one| (one, false)),
        );
        if wants("oncoming") {
            rows.extend(
                draft
                    .lanes
                    .oncoming(&map, 0.0)?
                    .into_iter()
                    .map(|one| (one, true)),
            );
        }
        if rows.is_empty() {
            return Err(Fault::new(
                "lanes",
                format!("the road has no {} lanes at the ego", self.lanes),
            ));
        }
        for (place, oncoming) in rows {
            self.fill(draft, place, oncoming, place.lane == own && self.ego_in_row)?;
        }
        Ok(())
    }
}

impl Traffic {
    /// Puts the row of one lane, from its far end back.
    fn fill(
        &self,
        draft: &mut Draft,
        place: OnLane,
        oncoming: bool,
        has_ego: bool,
    ) -> Result<(), Fault> {
        let (ahead, behind) = (
            self.ahead_m.draw(&mut draft.draws),
            self.behind_m.draw(&mut draft.draws),
        );
        let (behind, ahead) = if oncoming {
            (ahead, behind)
        } else {
            (behind, ahead)
        };
        let map = draft.scenario.map.clone();
        let (line, own_s) = through(&map, place.lane, place.pose.position(), behind, ahead);
        let limit = draft.limit(place.lane);
        let driver = self
            .driver
            .as_deref()
            .map(|word| behavior("driver", word))
            .transpose()?;
        let (mut s, mut before, mut with_ego) = (line.length(), None::<f64>, has_ego);
        loop {
            let gap = self.gap_m.draw(&mut draft.draws);
            let mut next = s - gap;
            let is_ego = with_ego && next < own_s + NEAR_EGO;
            if is_ego {
                // The ego stands where it stands; a vehicle that would be nearer is none.
                next = own_s;
                with_ego = false;
            }
            if next < 0.0 {
                return Ok(());
            }
            let speed = match self.speed {
                Some(speed) => speed.draw(&mut draft.draws),
                None => speed_behind(draft, before, s - next, line.length() - next, limit),
            };
            if is_ego {
                draft.ego_speed = Some(speed);
            } else {
                let size = (
                    length().draw(&mut draft.draws),
                    width().draw(&mut draft.draws),
                );
                draft.drive(line.pose_at(next), size, speed, driver);
            }
            (s, before) = (next, Some(speed));
        }
    }
}

/// The speed that a gap to a vehicle ahead allows, so that both can brake to a stop without a
/// collision.
fn speed_behind(draft: &mut Draft, lead: Option<f64>, gap: f64, to_end: f64, limit: f64) -> f64 {
    let (accel, decel) = (IDM_AGENT.accel_max, IDM_AGENT.decel_max);
    let speed = match lead {
        None => (2.0 / 3.0 * to_end * accel).sqrt().max(limit * 0.5),
        Some(lead) => {
            let alpha = (accel + decel) / (2.0 * decel);
            let (mean, deviation, least) = REACTION;
            let t = draft.draws.normal(mean, deviation).max(least);
            let v =
                (-t + (t * t + 4.0 * alpha * (alpha * lead * lead + gap)).sqrt()) / (2.0 * alpha);
            v.min(gap / 2.0)
        }
    };
    (speed + draft.draws.normal(0.0, SPEED_DEVIATION))
        .min(limit)
        .max(0.0)
}
