//! What the engine costs, part by part: `cargo bench`.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    reason = "a benchmark is no interface and may stop at an error"
)]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use planagent_agent::environment::text::{self, Description};
use planagent_agent::environment::{
    BevView, CenterlineName, DEFAULT_NODE_LENGTH, GraphedScene, LaneGraph, TextForm, bev,
};
use planagent_agent::planner::{
    CodeSource, IdmPlanner, LogReplay, PlanAgent, PlanAgentSettings, Planner, PlannerInput,
    PlannerName,
};
use planagent_agent::reasoning::PlannerCode;
use planagent_agent::reflection::{Judge, LeadPolicy, PlanBuilder, Ride};
use planagent_agent::simulation::{Challenge, ClosedLoop, simulate};
use planagent_lab::dataset::{RewardKind, StateName, rewards};
use planagent_scenario::generator::{DEFAULT, generate};
use planagent_scenario::nuplan::export::{ExportSettings, write_scenario};
use planagent_scenario::{DataRoots, Readers, Scenario};
use planagent_score::pdm::{
    Collided, PROPOSAL_STEPS, PdmInstant, PdmMemory, ReferencePath, plan_along, score_proposals,
    simulate_proposals,
};
use planagent_world::dynamics::IdmTraffic;
use planagent_world::geometry::{OrientedBox, Vector};
use planagent_world::{
    EgoState, LaneMap, ObjectKind, STEP_S, SceneView, TrackToken, TrackedObject, TrafficLights,
};
use std::hint::black_box;
use std::sync::Arc;

/// Agents in the bench of PDM-Closed.
const CROWD: u32 = 50;

/// [`CROWD`] cars, pedestrians and cones on the lanes around the ego, all within 50 m and none in
/// contact with it. A third drives, a sixth walks, half of them stand. The ego's path is clear.
fn crowd(scene: &SceneView<'_>, reference_path: &ReferencePath) -> Vec<TrackedObject> {
    let center = scene.ego.center();
    let lanes = scene.map.lanes_near(center.position(), 49.0);
    let places = lanes.iter().flat_map(|&lane| {
        let line = &scene.map[lane].centerline;
        (0..(line.length() / 7.0) as usize).map(|i| line.pose_at(3.5 + 7.0 * i as f64))
    });
    let near = places.filter(|pose| (14.0..49.0).contains(&pose.distance(&center)));
    let beside =
        near.flat_map(|pose| [0.0, 3.0, -3.0, 6.0, -6.0].map(|left| pose.translated(0.0, left)));
    let clear = beside.filter(|pose| {
        reference_path
            .centerline()
            .line()
            .distance_to(pose.position())
            > 3.0
    });
    let objects: Vec<TrackedObject> = clear
        .zip(0..CROWD)
        .map(|(pose, token)| {
            let (kind, length, width, speed) = match token % 6 {
                0 | 3 => (ObjectKind::Vehicle, 4.6, 1.9, 6.0),
                1 => (ObjectKind::TrafficCone, 0.4, 0.4, 0.0),
                2 => (ObjectKind::Pedestrian, 0.7, 0.7, 1.0),
                _ => (ObjectKind::Vehicle, 4.6, 1.9, 0.0),
            };
            let shape = OrientedBox::new(pose, length, width);
            let velocity: Vector = pose.direction() * speed;
            TrackedObject {
                token: TrackToken(token),
                kind,
                shape,
                velocity,
            }
        })
        .collect();
    assert_eq!(objects.len(), CROWD as usize, "the bench needs a crowd");
    objects
}

fn pdm_closed(c: &mut Criterion) {
    let scenario = generate(&DEFAULT).unwrap();
    let simulation = ClosedLoop::new(&scenario, Challenge::NonReactive).unwrap();
    let base = simulation.scene();
    let reference_path = ReferencePath::find(base.map, base.route, base.ego).unwrap();
    let objects = crowd(&base, &reference_path);
    let scene = SceneView {
        objects: &objects,
        ..base
    };
    let instant = PdmInstant::along(&reference_path, &scene, &mut Collided::default());
    let proposals = instant.proposals(&reference_path, scene.ego, PROPOSAL_STEPS);
    let simulated = simulate_proposals(scene.ego, proposals.all());

    c.bench_function("choose the reference path of pdm-closed", |b| {
        b.iter(|| ReferencePath::find(black_box(scene.map), scene.route, scene.ego));
    });
    c.bench_function("a step of pdm-closed, 50 agents", |b| {
        b.iter(|| {
            plan_along(&reference_path, black_box(&scene), &mut Collided::default()).unwrap()
        });
    });
    c.bench_function("a step of pdm-closed: look", |b| {
        b.iter(|| PdmInstant::along(&reference_path, black_box(&scene), &mut Collided::default()));
    });
    c.bench_function("a step of pdm-closed: generate", |b| {
        b.iter(|| instant.proposals(&reference_path, black_box(scene.ego), PROPOSAL_STEPS));
    });
    c.bench_function("a step of pdm-closed: simulate", |b| {
        b.iter(|| simulate_proposals(black_box(scene.ego), proposals.all()));
    });
    c.bench_function("a step of pdm-closed: score", |b| {
        b.iter(|| {
            score_proposals(
                &instant.scoring(reference_path.centerline().line(), 0.0),
                black_box(&simulated),
            )
            .unwrap()
        });
    });
}

/// Vehicles in the bench of reactive agents.
const TRAFFIC: usize = 100;

/// [`TRAFFIC`] reactive agents: moving cars in the lanes around the ego.
fn busy_road(map: &Arc<LaneMap>, ego: &EgoState) -> IdmTraffic {
    let center = ego.center();
    let lanes = map.lanes_near(center.position(), 95.0);
    let places = lanes
        .iter()
        .filter(|&&lane| !map[lane].is_connector())
        .flat_map(|&lane| {
            let line = &map[lane].centerline;
            (0..(line.length() / 7.0) as usize).map(|i| line.pose_at(3.5 + 7.0 * i as f64))
        });
    let near = places.filter(|pose| (10.0..95.0).contains(&pose.distance(&center)));
    let cars: Vec<TrackedObject> = near
        .zip(0..)
        .map(|(pose, token)| TrackedObject {
            token: TrackToken(token),
            kind: ObjectKind::Vehicle,
            shape: OrientedBox::new(pose, 4.6, 1.9),
            velocity: pose.direction() * 5.0,
        })
        .collect();
    // Overlapping cars are dropped, so this finds the smallest number of cars with enough agents.
    let counts = TRAFFIC..=cars.len();
    let traffic = counts
        .map(|count| IdmTraffic::new(map, &cars[..count], ego))
        .find(|t| t.agent_count() == TRAFFIC);
    traffic.expect("the bench needs a busy road")
}

/// One step of the loop, for planners and for reactive agents.
fn steps(c: &mut Criterion) {
    let scenario = generate(&DEFAULT).unwrap();
    let simulation = ClosedLoop::new(&scenario, Challenge::NonReactive).unwrap();
    let scene = simulation.scene();
    let mut idm = IdmPlanner::new();
    simulation.initialize(&mut idm).unwrap();
    c.bench_function("a step of idm", |b| {
        b.iter(|| {
            idm.compute_trajectory(&PlannerInput {
                iteration: 1,
                scene: black_box(scene),
            })
            .unwrap()
        });
    });

    let roundabout = generate(&"generated/traversing_intersection/1".parse().unwrap()).unwrap();
    let ego = roundabout.frames[roundabout.start].ego;
    let traffic = busy_road(&roundabout.map, &ego);
    c.bench_function("a step of 100 reactive agents", |b| {
        b.iter_batched_ref(
            || traffic.clone(),
            |traffic| traffic.step(black_box(&ego), &[], &TrafficLights::default(), STEP_S),
            criterion::BatchSize::SmallInput,
        );
    });
}

/// A step of the agent between two planning calls, which needs no model: the plan of a written code
/// is judged beside its versions.
fn agent_steps(c: &mut Criterion) {
    let scenario = generate(&DEFAULT).unwrap();
    let simulation = ClosedLoop::new(&scenario, Challenge::NonReactive).unwrap();
    let base = simulation.scene();
    let reference_path = ReferencePath::find(base.map, base.route, base.ego).unwrap();
    let objects = crowd(&base, &reference_path);
    let code = "Generate_IDM_Planner(c=ego_lane, la=None, v0=10, acc=1.5, dec=3)";
    let settings = PlanAgentSettings::default();
    let of_paper = settings.clone().in_form_of_paper();
    for (name, settings) in [
        ("a step of plan-agent, 50 agents", settings),
        ("a step of plan-agent-paper, 50 agents", of_paper),
    ] {
        let source = CodeSource::Written(code.to_owned());
        let mut agent = PlanAgent::new(PlannerName::PLAN_AGENT, source, settings).layered();
        simulation.initialize(&mut agent).unwrap();
        let mut step = |iteration| {
            let scene = SceneView {
                objects: &objects,
                ..base
            };
            agent
                .compute_trajectory(&PlannerInput { iteration, scene })
                .unwrap()
        };
        step(0);
        c.bench_function(name, |b| b.iter(|| step(black_box(1))));
    }
}

/// Opens a scenario in nuPlan's formats, with and without reading its map.
fn open_scenario(c: &mut Criterion) {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("export");
    write_scenario(
        &generate(&DEFAULT).unwrap(),
        &target,
        &ExportSettings::default(),
    )
    .unwrap();
    let roots = || DataRoots {
        data: Some(target.join("data")),
        maps: Some(target.join("maps")),
    };
    let open = |readers: &Readers| {
        let sources = readers
            .find(&target.join("data").to_string_lossy())
            .unwrap();
        sources[0].open().unwrap()
    };
    c.bench_function("open a nuPlan scenario, map included", |b| {
        b.iter(|| open(&Readers::new(&roots())));
    });
    let warm = Readers::new(&roots());
    c.bench_function("open a nuPlan scenario, map loaded", |b| {
        b.iter(|| open(&warm));
    });
}

fn engine(c: &mut Criterion) {
    let scenario = generate(&DEFAULT).unwrap();
    let expert: Vec<EgoState> = scenario.expert().copied().collect();
    let simulation = ClosedLoop::new(&scenario, Challenge::Reactive).unwrap();
    let scene = simulation.scene();
    let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).unwrap();
    let code = PlannerCode {
        centerline: CenterlineName::EgoLane,
        lead_agent: None,
        target_speed: 10.0,
        accel_max: 1.5,
        decel_max: 3.0,
    };
    let planner = PlanBuilder {
        lead_policy: LeadPolicy::Nearest,
        ride: Ride::Idm,
        horizon_s: 4.0,
    }
    .build(GraphedScene::new(&scene, &graph), code)
    .unwrap()
    .unwrap();

    c.bench_function("generate a scenario", |b| {
        b.iter(|| generate(black_box(&DEFAULT)).unwrap());
    });
    c.bench_function("draw the BEV image, 128 px", |b| {
        b.iter(|| bev::render(black_box(&scene), &BevView::default()));
    });
    c.bench_function("build the lane graph", |b| {
        b.iter(|| LaneGraph::build(black_box(&scene), DEFAULT_NODE_LENGTH));
    });
    c.bench_function("write the compact text", |b| {
        b.iter(|| {
            text::write(
                &Description::from_graph(black_box(&graph)),
                text::TextForm::Compact,
            )
        });
    });
    c.bench_function("roll out an IDM plan, 4 s", |b| {
        b.iter(|| planner.roll_out(black_box(&scene), 40));
    });
    c.bench_function("reflect on a plan, proposals included", |b| {
        b.iter(|| {
            Judge::new(black_box(&scene), &graph, 4.0, &mut PdmMemory::default())
                .unwrap()
                .reflect(&planner, 0.75)
                .unwrap()
        });
    });
    c.bench_function("simulate 15 s, idm, non-reactive", |b| {
        b.iter(|| simulate(&scenario, &mut IdmPlanner::new(), Challenge::NonReactive).unwrap());
    });
    c.bench_function("simulate 15 s, idm, reactive", |b| {
        b.iter(|| simulate(&scenario, &mut IdmPlanner::new(), Challenge::Reactive).unwrap());
    });
    let log = simulate(
        &scenario,
        &mut LogReplay::new(expert.clone()),
        Challenge::NonReactive,
    )
    .unwrap();
    c.bench_function("metrics of a simulation", |b| {
        b.iter(|| log.evaluate(&scenario).unwrap());
    });
}

/// Rewards of a batch as a trainer asks for them: answers of a group at each of some states.
fn batch_of_rewards(c: &mut Criterion) {
    const STATES: usize = 8;
    const GROUP: u32 = 8;
    let opens = |seed: &u64| Scenario::open(&format!("generated/changing_lane/{seed}")).is_ok();
    let questions: Vec<(StateName, String)> = (0_u64..)
        .filter(opens)
        .take(STATES)
        .flat_map(|seed| (0..GROUP).map(move |answer| (seed, answer)))
        .map(|(seed, answer)| {
            let state = StateName {
                scenario: format!("generated/changing_lane/{seed}"),
                seed: 0,
                time_s: 0.0,
                challenge: "nonreactive".to_owned(),
                scene_text: TextForm::Compact2,
                driven: String::new(),
            };
            let speed = 6 + answer;
            let line =
                format!("Generate_IDM_Planner(c=ego_lane, la=None, v0={speed}, acc=1.5, dec=3)");
            (state, line)
        })
        .collect();
    let mut group = c.benchmark_group("rewards, 8 states with 8 answers");
    group.throughput(Throughput::Elements(questions.len() as u64));
    for (name, kind) in RewardKind::NAMED {
        group.bench_function(name, |b| {
            b.iter(|| rewards(black_box(&questions), kind).unwrap());
        });
    }
    group.finish();
}

criterion_group!(
    benches,
    engine,
    steps,
    agent_steps,
    pdm_closed,
    open_scenario,
    batch_of_rewards
);
criterion_main!(benches);
