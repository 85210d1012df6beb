//! A metric of your own beside nuPlan's: `cargo run --release --example own_metric`

#![allow(clippy::print_stdout, reason = "an example prints what it does")]

use planagent::evaluation::{MetricList, MetricRegistry, MetricSpec, Statistic, StatisticKind};
use planagent::planning::PdmClosed;
use planagent::{Challenge, Scenario, Simulation};

/// 1 when the ego keeps at least 2 m to everything ahead; it multiplies the score.
const KEEPS_DISTANCE: MetricSpec = MetricSpec::new("ego_keeps_distance", |input| {
    let gaps = input.simulation.samples.iter().flat_map(|sample| {
        let ego = sample.ego.center();
        let ahead = sample.objects.iter().filter(move |object| {
            let local = ego.to_local(object.shape.center.position());
            local.x > 0.0 && local.y.abs() < 1.5
        });
        ahead.map(move |object| sample.ego.footprint().distance(&object.shape))
    });
    let least = gaps.fold(f64::INFINITY, f64::min);
    let statistic = Statistic::new(StatisticKind::Min, "min_distance_ahead", "meters", least);
    Ok(Some(KEEPS_DISTANCE.scored(
        f64::from(u8::from(least >= 2.0)),
        vec![statistic],
    )))
})
.only(MetricList::ClosedLoop)
.multiplier()
.label("gap");

fn main() -> planagent::Result<()> {
    let scenario = Scenario::open("generated/following_lane_with_lead/3")?;
    let metrics = MetricRegistry::default().with(KEEPS_DISTANCE);
    let run = Simulation::new(&scenario)
        .challenge(Challenge::Reactive)
        .metrics(metrics)
        .run(&mut PdmClosed::default())?;
    for part in &run.evaluation.score.parts {
        println!("{:<32} {:.2}", part.name, part.score);
    }
    if let Some(metric) = run.evaluation.metric("ego_keeps_distance") {
        println!("least distance ahead: {:.1} m", metric.statistics[0].value);
    }
    println!("score: {:.3}", run.score());
    Ok(())
}
