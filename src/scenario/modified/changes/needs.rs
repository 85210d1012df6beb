//! `needs`: what the scenario must have.

use crate::modified::change::Change;
use crate::modified::draft::Draft;
use crate::modified::fault::Fault;
use serde::Deserialize;

/// Refuses scenarios that do not fit a modification.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::modified) struct Needs {
    /// Number of lanes of the ego's direction, from and to.
    own_lanes: Option<[usize; 2]>,
    /// Number of oncoming lanes, from and to.
    oncoming_lanes: Option<[usize; 2]>,
    /// Minimum distance that the recorded driver gets along the ego's path, meters.
    #[serde(default)]
    driven_m: f64,
    /// Minimum distance from the ego along its path to the next intersection, meters.
    #[serde(default)]
    road_m: f64,
    /// Where the lanes are counted: distance ahead of the ego, meters.
    #[serde(default)]
    ahead_m: f64,
}

impl Change for Needs {
    fn check(&self) -> Result<(), Fault> {
        let orders = [
            ("own_lanes", self.own_lanes),
            ("oncoming_lanes", self.oncoming_lanes),
        ];
        match orders
            .into_iter()
            .find(|(_, bounds)| bounds.is_some_and(|[low, high]| low > high))
        {
            Some((field, _)) => Err(Fault::new(
                field,
                "expected [FROM, TO], the lower number first",
            )),
            None => Ok(()),
        }
    }

    fn apply(&self, draft: &mut Draft) -> Result<(), Fault> {
        let map = &draft.scenario.map;
        let fits = |bounds: Option<[usize; 2]>, count: usize| {
            bounds.is_none_or(|[l, h]| (l..=h).contains(&count))
        };
        // One check after another with its own fault: the first that fails is what the user reads.
        let own = draft.lanes.own_direction(map, self.ahead_m)?.len();
        if !fits(self.own_lanes, own) {
            return Err(Fault::new("own_lanes", format!("the road has {own}")));
        }
        let oncoming = draft.lanes.oncoming(map, self.ahead_m)?.len();
        if !fits(self.oncoming_lanes, oncoming) {
            return Err(Fault::new(
                "oncoming_lanes",
                format!("the road has {oncoming}"),
            ));
        }
        let driven = draft.driven_m();
        if driven < self.driven_m {
            return Err(Fault::new(
                "driven_m",
                format!("the recorded driver gets {driven:.1} m far"),
            ));
        }
        if let Some(road) = draft
            .lanes
            .to_intersection(map)
            .filter(|&road| road < self.road_m)
        {
            return Err(Fault::new(
                "road_m",
                format!("an intersection begins {road:.1} m ahead of the ego"),
            ));
        }
        Ok(())
    }
}
