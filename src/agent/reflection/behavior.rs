//! How the others may drive otherwise than forecast. A plan that is refused because of crossing
//! traffic may be good where that traffic yields, and one that passes may meet somebody who insists.

use planagent_score::pdm::{Forecast, ForecastObject};
use planagent_world::geometry::{Polyline, wrap_angle};

/// Braking of a vehicle that yields, m/s²: that of nuPlan's reactive agents (`IDMAgents`,
/// `decel_max`).
const YIELDS: f64 = -2.0;
/// Acceleration of a vehicle that insists, m/s²: that of nuPlan's reactive agents (`accel_max`).
const INSISTS: f64 = 1.0;
/// A vehicle nearer to the line of the ego's way drives along it, if its direction is that line's,
/// meters. Half a lane.
const BESIDE: f64 = 1.75;
/// Largest angle between the direction of a vehicle and that of the line that it drives along,
/// radians.
const ALONG: f64 = 0.5;

/// The score of a plan where the vehicles and bicycles beside the ego's way behave otherwise than
/// forecast. [`ReflectionReport::score`](super::ReflectionReport) is where they keep their course.
#[derive(
    Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
pub struct BehaviorScores {
    /// Where they brake from now on.
    pub yields: f64,
    /// Where they accelerate from now on.
    pub insists: f64,
}

impl BehaviorScores {
    /// The mean score over what crossing traffic may do, of a plan that scores `keeps` where it keeps
    /// its course. That counts as much as that it yields or insists.
    /// Why: docs/decisions/153-refused-under-three-behaviors.md.
    pub fn expected_beside(&self, keeps: f64) -> f64 {
        keeps / 2.0 + (self.yields + self.insists) / 4.0
    }
}

/// The forecasts of the other behaviors.
pub(super) struct Behaviors {
    pub(super) yields: Forecast,
    pub(super) insists: Forecast,
}

impl Behaviors {
    /// Of a forecast, for an ego whose way is `line`.
    pub(super) fn from_forecast(forecast: &Forecast, line: &Polyline) -> Self {
        let crosses = |object: &ForecastObject| {
            let at = line.project(object.track.shape.center.position());
            let direction = object.velocity.y.atan2(object.velocity.x);
            let turned = wrap_angle(direction - at.heading).abs();
            at.lateral.abs() > BESIDE || turned > ALONG
        };
        Self {
            yields: forecast.clone().accelerated(YIELDS, crosses),
            insists: forecast.clone().accelerated(INSISTS, crosses),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::environment::{CenterlineName, DEFAULT_NODE_LENGTH, GraphedScene, LaneGraph};
    use crate::reflection::{Judge, LeadPolicy, PlanBuilder, Ride};
    use planagent_score::pdm::PdmMemory;
    use planagent_world::Scene;
    use std::f64::consts::FRAC_PI_2;

    /// The scores of a plan at the limit of an ego at 8 m/s, where a vehicle drives somewhere: if it
    /// keeps its course, yields, insists.
    fn scores(at: [f64; 2], heading: f64, speed: f64) -> [f64; 3] {
        let scene = Scene::builder()
            .lanes(1, [[-50.0, 0.0], [150.0, 0.0]])
            .ego([0.0, 0.0], 0.0, 8.0)
            .vehicle(at, heading, speed)
            .build()
            .unwrap();
        let view = scene.view();
        let graph = LaneGraph::build(&view, DEFAULT_NODE_LENGTH).unwrap();
        let builder = PlanBuilder {
            lead_policy: LeadPolicy::Nearest,
            ride: Ride::Idm,
            horizon_s: 4.0,
        };
        let plan = builder
            .at_limit(GraphedScene::new(&view, &graph), CenterlineName::EgoLane)
            .unwrap()
            .unwrap();
        let report = Judge::new(&view, &graph, 4.0, &mut PdmMemory::default())
            .unwrap()
            .reflect(&plan, 0.75)
            .unwrap();
        [
            report.score,
            report.behaviors.yields,
            report.behaviors.insists,
        ]
    }

    #[test]
    fn a_plan_into_crossing_traffic_is_good_if_that_yields() {
        let [keeps, yields, _] = scores([28.0, -22.0], FRAC_PI_2, 8.0);
        assert!(keeps <= 0.0 && yields > 0.75, "{keeps} {yields}");
    }

    #[test]
    fn a_plan_before_crossing_traffic_is_bad_if_that_insists() {
        let [keeps, _, insists] = scores([26.0, -34.0], FRAC_PI_2, 9.0);
        assert!(keeps > insists, "{keeps} {insists}");
    }

    #[test]
    fn what_drives_along_the_egos_way_behaves_as_forecast() {
        let [keeps, yields, insists] = scores([30.0, 0.0], 0.0, 8.0);
        let apart = (yields - keeps).abs().max((insists - keeps).abs());
        assert!(keeps > 0.0 && apart < 1e-12, "{yields} {insists}");
    }
}
