//! `goal`: a goal in another lane.

use crate::modified::change::Change;
use crate::modified::draft::{Draft, GoalPath};
use crate::modified::fault::Fault;
use crate::modified::lanes::LanePlace;
use crate::modified::number::Number;
use planagent_world::{LanePath, RoadblockId, STEP_S};
use serde::Deserialize;

/// A goal that needs lane changes. The expert of the score drives to it, and the scene ends there.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::modified) struct LaneGoal {
    /// Number of lane changes.
    lane_changes: Number,
    /// left, right or either.
    #[serde(default = "either")]
    side: String,
    /// The goal ahead of the ego's center, meters; without it, as far as a share of the speed limit
    /// leads in the scene's time.
    distance_m: Option<Number>,
}

fn either() -> String {
    "either".to_owned()
}

/// Share of the speed limit that dense traffic allows. Ours: interPlan's goals lie up to 30 s at
/// the limit ahead.
const PACE: f64 = 0.6;
/// Road behind the goal, and the shortest way to it, meters.
const BEYOND: f64 = 10.0;
const MIN_LENGTH: f64 = 40.0;

impl Change for LaneGoal {
    fn check(&self) -> Result<(), Fault> {
        self.lane_changes.check("lane_changes", 0.0..=8.0)?;
        if !["left", "right", "either"].contains(&self.side.as_str()) {
            return Err(Fault::new(
                "side",
                format!("{:?} is none of left, right, either", self.side),
            ));
        }
        self.distance_m.map_or(Ok(()), |distance| {
            distance.check("distance_m", MIN_LENGTH..=300.0)
        })
    }

    fn apply(&self, draft: &mut Draft) -> Result<(), Fault> {
        let wanted = self.lane_changes.draw_whole(&mut draft.draws);
        let sides: &[i32] = match self.side.as_str() {
            "left" => &[1],
            "right" => &[-1],
            _ if draft.draws.whole(0, 1) == 0 => &[1, -1],
            _ => &[-1, 1],
        };
        let place = |side: &i32| {
            draft
                .lanes
                .place(&draft.scenario.map, 0.0, LanePlace::Beside(side * wanted))
                .ok()
        };
        let found = sides.iter().find_map(place);
        let Some(place) = found else {
            return Err(Fault::new(
                "lane_changes",
                format!("there is no lane {wanted} lanes beside the ego's"),
            ));
        };
        let scenario = &draft.scenario;
        let duration = (scenario.iterations() - 1) as f64 * STEP_S;
        let length = match self.distance_m {
            Some(distance) => distance.draw(&mut draft.draws),
            None => PACE * draft.limit(place.lane) * duration,
        };
        let map = &draft.scenario.map;
        let from_s = map[place.lane].centerline.project(place.pose.position()).s;
        let path = LanePath::along(
            map,
            &draft.scenario.route,
            place.lane,
            from_s + length + BEYOND,
        );
        // The path must go on beyond the goal, so that a planner at the goal still has a lane
        // ahead.
        let length = length.min(path.centerline.length() - BEYOND - from_s);
        if length < MIN_LENGTH {
            return Err(Fault::new(
                "distance_m",
                format!("the lane of the goal ends {length:.1} m ahead of the ego"),
            ));
        }
        let mut roadblocks: Vec<RoadblockId> =
            path.lanes.iter().map(|&lane| map[lane].roadblock).collect();
        roadblocks.dedup();
        draft.goal = Some(GoalPath {
            path,
            from_s,
            length,
            roadblocks,
        });
        Ok(())
    }
}
