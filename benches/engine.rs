//! What the engine costs, part by part: `cargo bench`.
#![allow(missing_docs, clippy::unwrap_used, reason = "a benchmark is no interface and may stop at an error")]

use criterion::{Criterion, criterion_group, criterion_main};
use planagent::environment::text::{self, Description};
use planagent::environment::{BevView, CenterlineName, DEFAULT_NODE_LENGTH, LaneGraph, bev};
use planagent::metrics::{Drive, evaluate};
use planagent::planner::{IdmPlanner, LogReplay, generated_planner};
use planagent::reasoning::PlannerCode;
use planagent::reflection::{Judge, LeadPolicy};
use planagent::scenario::generator::{DEFAULT, generate};
use planagent::simulation::{Challenge, ClosedLoop, simulate};
use planagent::world::EgoState;
use std::hint::black_box;

fn engine(c: &mut Criterion) {
    let scenario = generate(&DEFAULT).unwrap();
    let expert: Vec<EgoState> = scenario.expert().copied().collect();
    let drive = ClosedLoop::new(&scenario, Challenge::ClosedLoopReactiveAgents).unwrap();
    let scene = drive.scene();
    let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).unwrap();
    let code = PlannerCode {
        centerline: CenterlineName::EgoLane.to_string(),
        leader: None,
        target_speed: 10.0,
        accel_max: 1.5,
        decel_max: 3.0,
    };
    let planner = generated_planner(&scene, &graph, code, LeadPolicy::Nearest, 4.0).unwrap().unwrap();

    c.bench_function("generate a scenario", |b| b.iter(|| generate(black_box(&DEFAULT)).unwrap()));
    c.bench_function("draw the BEV map, 128 px", |b| b.iter(|| bev::render(black_box(&scene), &BevView::default())));
    c.bench_function("build the lane graph", |b| b.iter(|| LaneGraph::build(black_box(&scene), DEFAULT_NODE_LENGTH)));
    c.bench_function("write the compact text", |b| {
        b.iter(|| text::write(&Description::of(black_box(&graph)), text::TextForm::Compact));
    });
    c.bench_function("roll a planner out, 4 s", |b| b.iter(|| planner.roll_out(black_box(&scene), 40)));
    c.bench_function("reflect on a planner, proposals included", |b| {
        b.iter(|| Judge::new(black_box(&scene), &graph, 4.0).unwrap().reflect(&planner, 0.75).unwrap());
    });
    c.bench_function("drive 15 s, idm, reactive", |b| {
        b.iter(|| simulate(&scenario, &mut IdmPlanner::new(), Challenge::ClosedLoopReactiveAgents).unwrap());
    });
    let log = simulate(&scenario, &mut LogReplay::new(expert.clone()), Challenge::ClosedLoopNonreactiveAgents).unwrap();
    c.bench_function("metrics of a finished drive", |b| {
        b.iter(|| evaluate(&Drive { map: &scenario.map, samples: &log.samples, expert: &expert }).unwrap());
    });
}

criterion_group!(benches, engine);
criterion_main!(benches);
