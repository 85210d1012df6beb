//! The paths that a plan and its versions follow.

use super::path::{Pace, onto_centerline};
use super::ride::{Bends, Ride};
use super::shift::shift;
use crate::reasoning::PlannerCode;
use planagent_score::pdm::LATERAL_OFFSETS;
use planagent_world::geometry::{GeometryError, Point, Polyline};
use planagent_world::{LanePath, SceneView};

/// Length of path beyond the end of the fastest roll-out, meters.
const PATH_MARGIN: f64 = 30.0;

/// Paths of the rear axle from the ego's place on, long enough for the fastest roll-out.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PlanPaths {
    /// One for each of the [`LATERAL_OFFSETS`] from the centerline. The first is the code's, which
    /// keeps a distance from what stands at the edge of the lane.
    paths: [Polyline; LATERAL_OFFSETS.len()],
    /// Where the first has come onto its line.
    pub(super) settled: Point,
    /// How quickly it comes there.
    pub(super) pace: Pace,
    /// The bends along the paths.
    pub(super) bends: Bends,
}

impl PlanPaths {
    /// The paths of a code along lanes, onto their lines as [`onto_centerline`] says.
    ///
    /// # Errors
    /// When the ego's pose is not finite.
    pub(super) fn lay(
        scene: &SceneView<'_>,
        (code, lanes, ride): (&PlannerCode, &LanePath, Ride),
        horizon_s: f64,
        onto: (Option<Point>, Pace),
    ) -> Result<Self, GeometryError> {
        let (line, ego) = (&lanes.centerline, scene.ego);
        let length = code.target_speed.max(ego.speed()) * horizon_s + PATH_MARGIN;
        let [on, right, left] = LATERAL_OFFSETS;
        let on = on + shift(scene, lanes);
        let [on, right, left] =
            [on, right, left].map(|beside| onto_centerline(ego, line, (beside, length), onto));
        let on = on?;
        let bends = match ride {
            Ride::Idm => Bends::default(),
            Ride::Comfortable => {
                let here = line.project(ego.rear_axle.position()).s;
                Bends::along(line, here, on.path.length())
            }
        };
        Ok(Self {
            paths: [on.path, right?.path, left?.path],
            settled: on.settled,
            pace: onto.1,
            bends,
        })
    }

    /// The code's own path.
    pub(super) fn own(&self) -> &Polyline {
        &self.paths[0]
    }

    /// All of them.
    pub(super) fn each(&self) -> [&Polyline; LATERAL_OFFSETS.len()] {
        self.paths.each_ref()
    }

    /// The path of one of the [`LATERAL_OFFSETS`], or else the code's own.
    pub(super) fn get(&self, index: usize) -> &Polyline {
        self.paths.get(index).unwrap_or(self.own())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{CenterlineName, DEFAULT_NODE_LENGTH, GraphedScene, LaneGraph};
    use crate::reflection::{LeadPolicy, PlanBuilder};
    use planagent_world::Scene;

    /// Whether a plan for the left lane leads past a car that stands ahead of an ego at 14 m/s, and
    /// where it is on the line of that lane.
    fn plan(car: f64, ride: Ride) -> (bool, f64) {
        let scene = Scene::builder()
            .lanes(2, [[-50.0, 0.0], [250.0, 0.0]])
            .ego([0.0, -3.5], 0.0, 14.0)
            .vehicle([car, -3.5], 0.0, 0.0)
            .build()
            .unwrap();
        let view = scene.view();
        let graph = LaneGraph::build(&view, DEFAULT_NODE_LENGTH).unwrap();
        let (seen, builder) = (
            GraphedScene::new(&view, &graph),
            PlanBuilder {
                lead_policy: LeadPolicy::Nearest,
                ride,
                horizon_s: 8.0,
            },
        );
        let plan = builder.at_limit(seen, CenterlineName::LeftLane);
        let plan = plan.unwrap().unwrap();
        let settled = plan
            .path()
            .vertices()
            .iter()
            .find(|vertex| vertex.y > -0.01)
            .unwrap();
        (plan.leads_past(seen), settled.x)
    }

    #[test]
    fn a_plan_swerves_where_a_usual_lane_change_comes_too_late_to_pass() {
        let (passes_far, usual) = plan(59.0, Ride::Comfortable);
        let (passes, quick) = plan(26.0, Ride::Comfortable);
        assert!(
            passes_far && passes && quick < usual - 3.0,
            "{quick} {usual}"
        );
        let (passes_nearer, quicker) = plan(22.0, Ride::Comfortable);
        assert!(passes_nearer && quicker < quick, "no more than it must");
        assert!(!plan(26.0, Ride::Idm).0, "as in the paper");
        let (too_near, gives_up) = plan(14.0, Ride::Comfortable);
        assert!(!too_near && (gives_up - usual).abs() < 1.5, "{gives_up}");
    }
}
