//! How the others may drive otherwise than forecast. A plan that is refused because of crossing
//! traffic may be good where that traffic yields, and one that passes may meet somebody who insists.

use planagent_score::pdm::{Forecast, ForecastObject};
use planagent_world::TrackToken;
use planagent_world::dynamics::IDM_AGENT;
use planagent_world::geometry::{Polyline, wrap_angle};
use std::collections::BTreeSet;

/// A vehicle nearer to the line of the ego's way drives along it, if its direction is that line's,
/// meters. Half a lane.
const BESIDE: f64 = 1.75;
/// Largest angle between the direction of a vehicle and that of the line that it drives along,
/// radians.
const ALONG: f64 = 0.5;

/// The score of a plan where the vehicles and bicycles beside the ego's way do not drive as
/// forecast.
#[derive(
    Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
pub struct BehaviorScores {
    /// Where they brake from now on.
    pub yields: f64,
    /// Where they accelerate from now on.
    pub insists: f64,
    /// The mean by which refused plans are compared: that they keep their course counts as much as
    /// both others together.
    /// Why: docs/decisions/153-refused-under-three-behaviors.md.
    pub expected: f64,
}

impl BehaviorScores {
    /// Of a plan that scores `keeps` where they keep their course.
    pub fn new(keeps: f64, yields: f64, insists: f64) -> Self {
        Self {
            yields,
            insists,
            expected: keeps / 2.0 + (yields + insists) / 4.0,
        }
    }
}

/// The forecasts of the other behaviors. Vehicles brake and accelerate as much as nuPlan's reactive
/// agents do at most.
pub(super) struct Behaviors {
    pub(super) yields: Forecast,
    pub(super) insists: Forecast,
}

impl Behaviors {
    /// Of a forecast, for an ego whose way is `line`.
    pub(super) fn from_forecast(forecast: &Forecast, line: &Polyline) -> Self {
        let is_beside = |object: &&ForecastObject| {
            let at = line.project(object.track.shape.center.position());
            let direction = object.velocity.y.atan2(object.velocity.x);
            let turned = wrap_angle(direction - at.heading).abs();
            at.lateral.abs() > BESIDE || turned > ALONG
        };
        let beside = forecast.objects().iter().filter(is_beside);
        let tokens: BTreeSet<TrackToken> = beside.map(|object| object.track.token).collect();
        let accelerated = |acceleration| {
            let is_one = |object: &ForecastObject| tokens.contains(&object.track.token);
            forecast.clone().accelerated(acceleration, is_one)
        };
        Self {
            yields: accelerated(-IDM_AGENT.decel_max),
            insists: accelerated(IDM_AGENT.accel_max),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::environment::CenterlineName;
    use crate::reflection::Ride;
    use crate::reflection::test_reports::judged_beside;
    use planagent_world::Scene;
    use std::f64::consts::FRAC_PI_2;

    /// The scores of a plan at the limit of an ego at 8 m/s, where a vehicle drives somewhere: if it
    /// keeps its course, yields, insists.
    fn scores(at: [f64; 2], heading: f64, speed: f64) -> [f64; 3] {
        let scene = Scene::builder()
            .lanes(1, [[-50.0, 0.0], [150.0, 0.0]])
            .ego([0.0, 0.0], 0.0, 8.0)
            .vehicle(at, heading, speed);
        let report = judged_beside(scene, CenterlineName::EgoLane, (Ride::Idm, Ride::Idm));
        let behaviors = report.behaviors;
        [report.score, behaviors.yields, behaviors.insists]
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
