//! One planning call on a hand-made scene: `cargo run --release --example plan_once`

#![allow(clippy::print_stdout, reason = "an example prints what it does")]

use planagent::{Agent, Scene};

fn main() -> planagent::Result<()> {
    // A road of two lanes. The ego drives 10 m/s in the right lane, 25 m behind a slow car.
    let scene = Scene::builder()
        .lanes(2, [[-50.0, 0.0], [300.0, 0.0]])
        .ego([0.0, -3.5], 0.0, 10.0)
        .vehicle([25.0, -3.5], 0.0, 4.0)
        .build()?;

    let mut agent = Agent::builder().model("nano").build()?;
    let trajectory = agent.plan(&scene, 0.0)?;

    for call in agent.calls() {
        println!(
            "the model read:\n{}\n",
            call.scene_text.as_deref().unwrap_or_default()
        );
        for attempt in &call.attempts {
            println!("the model wrote: {}", attempt.line().unwrap_or_default());
        }
    }
    for seconds in 1..=4 {
        let state = trajectory
            .at(seconds * 1_000_000)
            .map_err(planagent::planning::PlannerError::from)?;
        println!(
            "in {seconds} s: x = {:5.1} m, {:4.1} m/s",
            state.rear_axle.x, state.velocity.x
        );
    }
    Ok(())
}
