//! The agent in a simulator of your own with steps of 0.05 s: `cargo run --release --example
//! own_simulator`

#![allow(clippy::print_stdout, reason = "an example prints what it does")]

use planagent::planning::PlannerError;
use planagent::road::Vector;
use planagent::traffic::{TrackedObject, follow};
use planagent::{Agent, Scene};

const STEP_US: i64 = 50_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // The lead car starts 40 m ahead at 8 m/s and brakes with 1 m/s² after four seconds.
    let mut scene = Scene::builder()
        .lane([[-50.0, 0.0], [400.0, 0.0]])
        .ego([0.0, 0.0], 0.0, 10.0)
        .vehicle([40.0, 0.0], 0.0, 8.0)
        .build()?;
    let mut agent = Agent::builder().model("nano").build()?;

    for step in 0..240 {
        let trajectory = agent.plan(&scene, scene.time_s())?;
        if step % 20 == 0 {
            let gap = scene.objects[0].shape.center.x - scene.ego.center().x;
            println!(
                "{:5.2} s: ego {:4.1} m/s, lead agent {:5.1} m ahead",
                scene.time_s(),
                scene.ego.speed(),
                gap
            );
        }
        // The ego follows its trajectory through a bicycle model; any vehicle model will do.
        let ego =
            follow(&scene.ego, &trajectory, STEP_US).map_err(|source| PlannerError::Failed {
                doing: "tracking",
                source: source.into(),
            })?;
        let braking = scene.time_s() >= 4.0;
        let objects: Vec<TrackedObject> = scene
            .objects
            .iter()
            .map(|car| moved(*car, braking))
            .collect();
        scene.advance(ego, objects);
    }
    println!("{} planning calls", agent.calls().len());
    Ok(())
}

fn moved(mut car: TrackedObject, braking: bool) -> TrackedObject {
    let seconds = STEP_US as f64 * 1e-6;
    if braking {
        car.velocity = Vector::new((car.velocity.x - seconds).max(0.0), 0.0);
    }
    car.shape.center.x += car.velocity.x * seconds;
    car
}
