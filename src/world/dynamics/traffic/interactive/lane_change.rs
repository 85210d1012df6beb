//! Lane changes of reactive vehicles by MOBIL (Kesting, Treiber, Helbing 2007).

use super::{Driver, InteractiveTraffic};
use crate::dynamics::idm::{IdmParameters, Lead};
use crate::geometry::Point;
use crate::{EgoState, LaneId, PACIFICA};

/// Politeness: the weight of what other vehicles gain or lose.
const POLITENESS: f64 = 0.3;
/// Minimum gain of a change, m/s².
const THRESHOLD: f64 = 0.2;
/// Maximum deceleration of the follower in the new lane, m/s².
const MAX_BRAKING: f64 = 2.0;
/// Time between two decisions of a vehicle, and from a change to the next decision, seconds.
const EVERY_S: f64 = 1.0;
const AFTER_CHANGE_S: f64 = 6.0;
/// Vehicles farther along a lane do not count, meters.
const REACH: f64 = 80.0;

/// A vehicle on a lane: its progress there, speed and length.
#[derive(Clone, Copy)]
struct OnLane {
    s: f64,
    speed: f64,
    length: f64,
}

impl OnLane {
    /// The acceleration behind another vehicle, or on a free lane.
    fn behind(self, law: &IdmParameters, ahead: Option<Self>) -> f64 {
        let lead = ahead.map(|ahead| Lead {
            gap: ahead.s - self.s - f64::midpoint(ahead.length, self.length),
            speed: ahead.speed,
        });
        law.acceleration(self.speed, lead)
    }
}

impl InteractiveTraffic {
    /// Lets a vehicle change lanes where it gains more than others lose, and where the follower can
    /// brake.
    pub(super) fn consider_lane_change(&mut self, index: usize, ego: &EgoState, dt: f64) {
        let driver = &mut self.drivers[index];
        driver.patience_s -= dt;
        if driver.patience_s > 0.0 {
            return;
        }
        driver.patience_s = EVERY_S;
        let Some(lane) = driver
            .agent
            .lane(&self.map)
            .filter(|&lane| !self.map[lane].is_connector())
        else {
            return;
        };
        let center = self.drivers[index].agent.pose().position();
        let s = self.map[lane].centerline.project(center).s;
        let sides = [self.map[lane].left_at(s), self.map[lane].right_at(s)];
        let gain = |target: LaneId| Some((self.gain(index, lane, target, ego)?, target));
        let best = sides
            .into_iter()
            .flatten()
            .filter_map(gain)
            .max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((gain, target)) = best
            && gain > THRESHOLD
            && self.drivers[index].agent.change_lane(&self.map, target)
        {
            self.drivers[index].patience_s = AFTER_CHANGE_S;
        }
    }

    /// What a change from `lane` to `target` gains, m/s²; `None` where it is unsafe.
    fn gain(&self, index: usize, lane: LaneId, target: LaneId, ego: &EgoState) -> Option<f64> {
        let (Driver { agent, .. }, law) = (&self.drivers[index], self.drivers[index].agent.law());
        let on = |lane: LaneId| OnLane {
            s: self.map[lane].centerline.project(agent.pose().position()).s,
            speed: agent.speed(),
            length: agent.length(),
        };
        let (own, new) = (on(lane), on(target));
        let (old_ahead, old_behind) = self.around(index, lane, own.s, ego);
        let (new_ahead, new_behind) = self.around(index, target, new.s, ego);
        let overlaps = |other: Option<OnLane>| {
            other.is_some_and(|o| {
                (o.s - new.s).abs() < f64::midpoint(o.length, new.length) + law.min_gap
            })
        };
        if overlaps(new_ahead) || overlaps(new_behind) {
            return None;
        }
        let follower_then = new_behind.map(|follower| follower.behind(law, Some(new)));
        if follower_then.is_some_and(|acceleration| acceleration <= -MAX_BRAKING) {
            return None;
        }
        let others = follower_then
            .zip(new_behind)
            .map_or(0.0, |(then, f)| then - f.behind(law, new_ahead))
            + old_behind.map_or(0.0, |f| f.behind(law, old_ahead) - f.behind(law, Some(own)));
        Some(new.behind(law, new_ahead) - own.behind(law, old_ahead) + POLITENESS * others)
    }

    /// The nearest vehicles on a lane ahead of and behind a place.
    fn around(
        &self,
        index: usize,
        lane: LaneId,
        s: f64,
        ego: &EgoState,
    ) -> (Option<OnLane>, Option<OnLane>) {
        let others = self
            .drivers
            .iter()
            .enumerate()
            .filter(|&(i, _)| i != index)
            .map(|(_, driver)| {
                (
                    driver.agent.pose().position(),
                    driver.agent.speed(),
                    driver.agent.length(),
                )
            });
        let standing = self
            .others
            .iter()
            .map(|o| (o.shape.center.position(), 0.0, o.shape.length));
        // The ego counts like an agent, so that MOBIL's safety criterion holds for its gap too.
        let ego = std::iter::once((ego.center().position(), ego.speed(), PACIFICA.length()));
        let on_lane = |(center, speed, length): (Point, f64, f64)| {
            let foot = self.map[lane].centerline.project(center);
            let is_on = self.map[lane].polygon.contains(center) && (foot.s - s).abs() < REACH;
            is_on.then_some(OnLane {
                s: foot.s,
                speed,
                length,
            })
        };
        let all: Vec<OnLane> = others
            .chain(standing)
            .chain(ego)
            .filter_map(on_lane)
            .collect();
        let ahead = all
            .iter()
            .copied()
            .filter(|o| o.s >= s)
            .min_by(|a, b| a.s.total_cmp(&b.s));
        let behind = all
            .iter()
            .copied()
            .filter(|o| o.s < s)
            .max_by(|a, b| a.s.total_cmp(&b.s));
        (ahead, behind)
    }
}
