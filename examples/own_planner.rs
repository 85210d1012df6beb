//! A planner of your own in nuPlan's closed loop: `cargo run --release --example own_planner`

#![allow(clippy::print_stdout, reason = "an example prints what it does")]

use planagent::planning::{PlannerError, PlannerInitialization, PlannerInput, TrajectoryState};
use planagent::road::Pose;
use planagent::{Challenge, Planner, Scenario, Trajectory, simulate};

/// Follows the lane under the ego at constant speed.
struct CruiseInLane;

impl Planner for CruiseInLane {
    fn name(&self) -> &'static str {
        "cruise-in-lane"
    }

    fn initialize(&mut self, _: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let (ego, map) = (input.scene.ego, input.scene.map);
        let speed = ego.speed();
        let lane = map
            .lane_of(ego.rear_axle, 3.0)
            .ok_or(PlannerError::EmptyRoute)?;
        let line = &map[lane].centerline;
        let here = line.project(ego.rear_axle.position()).s;
        // Nine states, half a second apart. Beyond the end of the lane, straight ahead.
        let at = |step: i64| {
            let meters = speed * 0.5 * step as f64;
            let end = line.pose_at(line.length());
            let pose = if here + meters <= line.length() {
                line.pose_at(here + meters)
            } else {
                Pose::at(
                    end.position() + end.direction() * (here + meters - line.length()),
                    end.heading,
                )
            };
            let rear_axle = if step == 0 { ego.rear_axle } else { pose };
            TrajectoryState::moving(ego.time_us + step * 500_000, rear_axle, speed, 0.0)
        };
        Ok(Trajectory::new((0..=8).map(at).collect())?)
    }
}

fn main() -> planagent::Result<()> {
    let scenario = Scenario::open("generated/following_lane_with_lead/3")?;
    for challenge in [Challenge::NonReactive, Challenge::Reactive] {
        let run = simulate(&scenario, &mut CruiseInLane, challenge)?;
        println!("{challenge}: score {:.3}", run.score());
        for part in &run.evaluation.score.parts {
            println!("  {:<32} {:.2}", part.name, part.score);
        }
    }
    Ok(())
}
