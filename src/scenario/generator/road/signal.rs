//! Traffic lights with fixed phases.

use planagent_world::{LaneId, SignalStatus, TrafficLights};

/// Duration of yellow, seconds.
pub(crate) const YELLOW: f64 = 3.0;
/// Duration of red for all between two phases, seconds.
const ALL_RED: f64 = 1.5;

/// Traffic lights of a junction: each connector is green in one window of the cycle, then yellow,
/// else red.
#[derive(Debug, Clone, Default)]
pub(crate) struct SignalPlan {
    /// Connector, start and end of green in the cycle, seconds.
    windows: Vec<(LaneId, f64, f64)>,
    cycle: f64,
    offset: f64,
}

impl SignalPlan {
    /// A plan that gives each group of connectors green in turn, for its number of seconds.
    pub(crate) fn new(phases: &[(Vec<LaneId>, f64)]) -> Self {
        let mut plan = Self::default();
        for (connectors, green) in phases {
            let (from, to) = (plan.cycle, plan.cycle + green);
            plan.windows
                .extend(connectors.iter().map(|&connector| (connector, from, to)));
            plan.cycle = to + YELLOW + ALL_RED;
        }
        plan
    }

    pub(crate) fn connectors(&self) -> impl Iterator<Item = LaneId> + '_ {
        self.windows.iter().map(|&(connector, _, _)| connector)
    }

    /// Moves the cycle so that the green of `connector` begins at `time` seconds.
    pub(crate) fn start_green_at(&mut self, connector: LaneId, time: f64) {
        if let Some(&(_, from, _)) = self.windows.iter().find(|w| w.0 == connector) {
            self.offset = from - time;
        }
    }

    /// Moves the cycle so that the green of `connector` ends (yellow begins) at `time` seconds.
    pub(crate) fn end_green_at(&mut self, connector: LaneId, time: f64) {
        if let Some(&(_, _, to)) = self.windows.iter().find(|w| w.0 == connector) {
            self.offset = to - time;
        }
    }

    /// Sets the state of every connector at `time` seconds.
    pub(crate) fn show(&self, time: f64, lights: &mut TrafficLights) {
        let into = (time + self.offset).rem_euclid(self.cycle.max(f64::MIN_POSITIVE));
        for &(connector, from, to) in &self.windows {
            let status = if into >= from && into < to {
                SignalStatus::Green
            } else if into >= to && into < to + YELLOW {
                SignalStatus::Yellow
            } else {
                SignalStatus::Red
            };
            lights.set(connector, status);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use SignalStatus::{Green, Red, Yellow};

    #[test]
    fn phases_follow_one_another() {
        let (a, b) = (LaneId(0), LaneId(1));
        let mut plan = SignalPlan::new(&[(vec![a], 10.0), (vec![b], 8.0)]);
        plan.start_green_at(b, 4.0);
        let at = |time: f64| {
            let mut lights = TrafficLights::default();
            plan.show(time, &mut lights);
            (lights.status(a), lights.status(b))
        };
        assert_eq!(at(3.9), (Some(Red), Some(Red)));
        assert_eq!(at(0.0), (Some(Yellow), Some(Red)));
        assert_eq!(at(4.0), (Some(Red), Some(Green)));
        assert_eq!(at(12.5), (Some(Red), Some(Yellow)));
        assert_eq!(at(17.0), (Some(Green), Some(Red)));
        assert!((0..400).all(|i| {
            let (a, b) = at(f64::from(i) * 0.1);
            a == Some(Red) || b == Some(Red)
        }));
    }
}
