//! Results and tables of example simulations.

use super::*;
use crate::report::figure::figures;
use crate::report::{study_markdown, study_table};
use crate::study::{Figure, Quick, Reported, Study, find};
use planagent_agent::planner::PlannerName;
use planagent_agent::simulation::Challenge;
use planagent_runs::report::{LineWidth, MetricScore, SimulationRow};

/// Fails if the tables of a study are wider than a terminal.
fn assert_fits(study: &Study, results: &StudyResults) {
    for columns in [60, 80, 100, 160] {
        let table = study_table(study, results, LineWidth::terminal(columns));
        let wide = table
            .lines()
            .find(|line| line.chars().count() > usize::from(columns));
        assert!(wide.is_none(), "wider than {columns}: {wide:?}");
    }
}

/// A simulation of a scene; without a score it failed.
fn simulation(scene: usize, challenge: Challenge, score: Option<f64>) -> SimulationRow {
    let kind = if scene.is_multiple_of(2) {
        "changing_lane"
    } else {
        "stopping_with_lead"
    };
    SimulationRow::example(
        kind,
        scene,
        PlannerName::PLAN_AGENT.as_str(),
        challenge,
        score,
    )
}

/// Simulations of four scenes in both challenges with these scores.
fn simulated(scores: [Option<f64>; 4]) -> VariantSimulations {
    let of = |challenge| {
        scores
            .into_iter()
            .enumerate()
            .map(move |(scene, score)| simulation(scene, challenge, score))
    };
    let rows = Challenge::CLOSED_LOOP.into_iter().flat_map(of).collect();
    VariantSimulations {
        outcome: Outcome::Simulated {
            run: "../runs/a".to_owned(),
            rows,
        },
        parameters: Some(4_018_752),
    }
}

fn suite(name: &str, variants: Vec<VariantSimulations>) -> SuiteSimulations {
    SuiteSimulations {
        name: name.to_owned(),
        scenes: 4,
        blake3: "0".to_owned(),
        variants,
    }
}

const NOT_SIMULATED: VariantSimulations = VariantSimulations {
    outcome: Outcome::NotSimulated("no weights"),
    parameters: None,
};

#[test]
fn differences_are_paired_and_failed_simulations_do_not_count() {
    let study = find("interval").unwrap();
    let full = simulated([Some(1.0), Some(0.5), Some(0.75), Some(0.9)]);
    let other = simulated([Some(0.9), None, Some(0.75), Some(1.0)]);
    let results = StudyResults::new(
        &study,
        &[suite(
            "generated-test14-hard",
            vec![other, full.clone(), full],
        )],
        None,
        3,
        &[],
    );
    let variants = &results.suites[0].variants;
    let first = &variants[0].challenges[0];
    assert_eq!((first.simulations, first.failed), (3, 1));
    assert!((first.score.unwrap() - 88.333_333_333).abs() < 1e-6);
    let difference = first.difference.unwrap();
    assert_eq!(difference.pairs, 3);
    assert!(
        difference.mean.abs() < 1e-9
            && (difference.low + 10.0).abs() < 1e-9
            && (difference.high - 10.0).abs() < 1e-9
    );
    assert!((first.paper_difference.unwrap() - (71.85 - 72.51)).abs() < 1e-9);
    assert_eq!(
        (
            variants[1].challenges[0].difference,
            variants[1].challenges[0].paper
        ),
        (None, Some(72.51))
    );
    assert!(variants[2].challenges[1].difference.unwrap().mean.abs() < 1e-12);
    assert_eq!(
        (
            results.reference.as_str(),
            variants[0].calls_per_simulation,
            results.seed
        ),
        ("2 s", Some(8.0), 3)
    );
}

/// A simulation with these scores of metrics; the others are perfect.
fn with_metrics(scene: usize, challenge: Challenge, scores: &[(&str, f64)]) -> SimulationRow {
    let mut row = simulation(scene, challenge, Some(0.5));
    let score = |name: &str| scores.iter().find(|(own, _)| *own == name);
    row.metrics = row
        .scored()
        .into_iter()
        .map(|name| MetricScore {
            name: name.to_owned(),
            score: Some(score(name).map_or(1.0, |(_, score)| *score)),
        })
        .collect();
    row
}

#[test]
fn a_metric_costs_what_the_score_would_gain_without_its_loss() {
    let study = find("ceilings").unwrap();
    let (comfort, collisions) = ("ego_is_comfortable", "no_ego_at_fault_collisions");
    let reactive = Challenge::Reactive;
    let variant = |rows| VariantSimulations {
        outcome: Outcome::Simulated {
            run: "../runs/a".to_owned(),
            rows,
        },
        parameters: None,
    };
    let losing = variant(vec![
        with_metrics(0, reactive, &[(comfort, 0.0)]),
        // Behind a collision, comfort alone would gain nothing.
        with_metrics(1, reactive, &[(comfort, 0.0), (collisions, 0.0)]),
        with_metrics(2, reactive, &[]),
        with_metrics(3, reactive, &[]),
        simulation(4, reactive, None),
    ]);
    let perfect = variant(vec![with_metrics(0, reactive, &[])]);
    let suites = [suite("generated-test14-hard", vec![losing, perfect])];
    let results = StudyResults::new(&study, &suites, None, 0, &[]);
    let lost = |metric: &str| {
        let losses = &results.suites[0].variants[0].lost;
        losses
            .iter()
            .find(|loss| loss.metric == metric)
            .unwrap()
            .points
    };
    // Comfort weighs 2 of 16.
    assert!((lost(comfort) - 100.0 * 2.0 / 16.0 / 4.0).abs() < 1e-9);
    assert!((lost(collisions) - 100.0 * 14.0 / 16.0 / 4.0).abs() < 1e-9);
    assert!(lost("drivable_area_compliance").abs() < 1e-9);
    let table = study_table(&study, &results, LineWidth::terminal(160));
    let head = table
        .lines()
        .find(|line| line.contains("calls/sim"))
        .unwrap();
    assert!(
        head.contains("coll R") && head.contains("comf R"),
        "{table}"
    );
    assert!(!head.contains("area") && !head.contains("NR"), "{table}");
    assert_fits(&study, &results);
}

#[test]
fn the_tables_read_well_in_80_columns() {
    let study = find("reasoning").unwrap();
    let full = simulated([Some(1.0), Some(0.5), Some(0.75), Some(0.9)]);
    let worse = simulated([Some(0.0), Some(0.5), Some(0.25), Some(0.9)]);
    let variants = vec![
        worse.clone(),
        simulated([Some(1.0), None, Some(0.75), Some(0.95)]),
        worse,
        full,
    ];
    let results = StudyResults::new(
        &study,
        &[suite("generated-test14-hard", variants)],
        Some(Quick::DEFAULT),
        0,
        &[],
    );
    let table = study_table(&study, &results, LineWidth::PIPE);
    assert_fits(&study, &results);
    assert!(
        table.lines().all(|line| line.chars().count() <= 80),
        "{table}"
    );
    insta::assert_snapshot!(table, @r#"
    Rounds of the model, and whether its plans are scored

    generated-test14-hard, non-reactive agents: 4 scenes
    understanding  instruction  reflection     NR    diff   95 % interval  paper
    no             yes          yes         41.25  -37.50  -75.00 to 0.00  70.09
    yes            no           yes         90.00   +1.67   0.00 to +5.00  70.60
    yes            yes          no          41.25  -37.50  -75.00 to 0.00  69.84
    yes            yes          yes         78.75       -       reference  72.51

    generated-test14-hard, reactive agents: 4 scenes
    understanding  instruction  reflection      R    diff   95 % interval  paper
    no             yes          yes         41.25  -37.50  -75.00 to 0.00  75.26
    yes            no           yes         90.00   +1.67   0.00 to +5.00  75.39
    yes            yes          no          41.25  -37.50  -75.00 to 0.00  74.08
    yes            yes          yes         78.75       -       reference  76.82

    Quick: only the first 2 scenes of each type; intervals are wide.
    NR, R = non-reactive, reactive agents; nuPlan's score x 100. diff = score minus
    that of the whole agent on the same scenes. Its 95 % interval is a percentile
    bootstrap over scenes (10000 resamples, seed 0).
    paper = the paper's result on nuPlan's Test14-hard. Its scenes differ from
    generated-test14-hard: compare only the direction.
    2 simulations of no instruction on generated-test14-hard failed and do not
    count.
    "#);
}

#[test]
fn a_challenge_that_was_not_simulated_has_no_table_and_an_empty_label_no_name() {
    let study = find("interactive").unwrap();
    let mut reactive = simulated([Some(1.0), Some(0.5), Some(0.75), Some(0.9)]);
    if let Outcome::Simulated { rows, .. } = &mut reactive.outcome {
        rows.retain(|row| row.challenge == Challenge::Reactive);
    }
    let variants = vec![reactive; study.variants.len()];
    let results = StudyResults::new(
        &study,
        &[suite("interactive-generated", variants)],
        None,
        0,
        &[],
    );
    let names: Vec<&str> = results.suites[0]
        .variants
        .iter()
        .map(|variant| variant.name.as_str())
        .collect();
    assert_eq!(
        names[1..4],
        [
            "planner: plan-agent, BEV: another scene's",
            "planner: plan-agent, BEV: none",
            "planner: pdm-closed"
        ]
    );
    let table = study_table(&study, &results, LineWidth::PIPE);
    assert_fits(&study, &results);
    let one_panel = figures(&study, &results);
    assert!(
        one_panel[0].1.contains("R: reactive agents") && !one_panel[0].1.contains("NR:"),
        "{}",
        one_panel[0].1
    );
    assert!(
        table.contains("interactive-generated, reactive agents")
            && !table.contains("non-reactive agents:"),
        "{table}"
    );
    let text = study_markdown(&study, &results, "planagent study interactive", &[]);
    assert!(
        text.contains("| planner | BEV | R | diff | 95 % interval |"),
        "{text}"
    );
}

#[test]
fn modified_scenes_of_one_recording_are_drawn_together() {
    let study = find("interactive").unwrap();
    let variant = |scores: [f64; 3]| {
        let sources = [
            "a.tfrecord~jaywalking_pedestrian",
            "a.tfrecord~low_traffic_density",
            "b.tfrecord~avoid_crashed_cars",
        ];
        let rows = sources
            .into_iter()
            .zip(scores)
            .map(|(source, score)| recorded(source, "plan-agent", score))
            .collect();
        VariantSimulations {
            outcome: Outcome::Simulated {
                run: "../runs/a".to_owned(),
                rows,
            },
            parameters: None,
        }
    };
    let mut variants = vec![variant([1.0; 3]); study.variants.len()];
    variants[1] = variant([0.5, 0.5, 1.0]);
    let results = StudyResults::new(
        &study,
        &[suite("interactive-recorded", variants)],
        None,
        0,
        &[],
    );
    let difference = results.suites[0].variants[1].challenges[0]
        .difference
        .unwrap();
    // A draw may have either recording twice.
    assert_eq!(
        (difference.low, difference.high, difference.pairs),
        (-50.0, 0.0, 3)
    );
}

#[test]
fn unsimulated_models_have_a_reason_and_types_stand_on_lines_of_their_own() {
    let full = simulated([Some(1.0), Some(0.5), Some(0.75), Some(0.9)]);
    let study = find("mllm").unwrap();
    let mut variants = vec![full.clone(), full.clone()];
    variants.resize(study.variants.len(), NOT_SIMULATED);
    let mllm = StudyResults::new(
        &study,
        &[suite("generated-test14-hard", variants)],
        None,
        0,
        &[],
    );
    let table = study_table(&study, &mllm, LineWidth::PIPE);
    assert_fits(&study, &mllm);
    assert!(
        table.lines().all(|line| line.chars().count() <= 80),
        "{table}"
    );
    let of = |name: &str| -> Vec<&str> {
        table
            .lines()
            .filter(|line| line.starts_with(name))
            .collect()
    };
    let words: Vec<&str> = of("llava-1.5-7b")[0].split_whitespace().collect();
    assert_eq!(words, ["llava-1.5-7b", "no", "weights", "-", "-", "67.73"]);
    let costs: Vec<&str> = of("nano")[2].split_whitespace().collect();
    assert_eq!(costs, ["nano", "4.0", "M", "-", "-", "-"]);

    let study = find("scenario-types").unwrap();
    let better = simulated([Some(1.0), Some(1.0), Some(1.0), Some(1.0)]);
    let types = StudyResults::new(
        &study,
        &[suite("generated-test14-hard", vec![full, better])],
        None,
        0,
        &[],
    );
    let table = study_table(&study, &types, LineWidth::PIPE);
    assert_fits(&study, &types);
    assert!(table.contains("\nchanging_lane\n"), "{table}");
    assert!(table.lines().any(|line| {
        line.split_whitespace()
            .eq(["2", "87.50", "100.00", "+12.50", "0.00", "to", "+25.00"])
    }));
}

#[test]
fn markdown_has_both_challenges_and_the_paper_and_every_study_has_a_figure() {
    let full = simulated([Some(1.0), Some(0.5), Some(0.75), Some(0.9)]);
    for study in crate::study::all().unwrap() {
        let variants = vec![full.clone(); study.variants.len()];
        let results = StudyResults::new(
            &study,
            &[suite("generated-test14-hard", variants)],
            None,
            0,
            &[],
        );
        let drawn = figures(&study, &results);
        assert!(
            drawn.iter().all(|(name, svg)| {
                ["generated-test14-hard.svg", "agreement.svg"].contains(&name.as_str())
                    && !svg.contains("NaN")
            }),
            "{}",
            study.name
        );
        let reported = study
            .variants
            .iter()
            .any(|variant| variant.reported != Reported::default());
        assert_eq!(drawn.len(), 1 + usize::from(reported), "{}", study.name);
        let text = study_markdown(
            &study,
            &results,
            "planagent study",
            &["generated-test14-hard.svg".to_owned()],
        );
        assert!(text.contains("(generated-test14-hard.svg)"), "{text}");
        let head = text.lines().find(|line| line.starts_with("| ")).unwrap();
        if study.figure == Figure::Differences {
            let columns = if reported {
                "| NR | diff | 95 % interval | paper NR | paper diff | R | diff | 95 % interval | paper R | paper diff |"
            } else {
                "| NR | diff | 95 % interval |"
            };
            assert!(head.contains(columns), "{}: {head}", study.name);
        }
    }
}

/// A simulation of a recording from a start, with this score and a metric of the same value.
fn recorded(start: &str, planner: &str, score: f64) -> SimulationRow {
    let row = SimulationRow::example("unknown", 0, planner, Challenge::NonReactive, Some(score));
    let metrics = vec![MetricScore {
        name: "ego_is_comfortable".to_owned(),
        score: Some(score),
    }];
    SimulationRow {
        source: start.to_owned(),
        scenario: start.to_owned(),
        metrics,
        off_route_calls: 2,
        ..row
    }
}

#[test]
fn recordings_are_drawn_together_and_have_a_row_each() {
    let study = find("recorded").unwrap();
    let starts = ["a", "a@3", "b", "b@3", "b@6"];
    let variant = |planner: &str, scores: [f64; 5]| VariantSimulations {
        outcome: Outcome::Simulated {
            run: "../runs/a".to_owned(),
            rows: starts
                .iter()
                .zip(scores)
                .map(|(start, score)| recorded(start, planner, score))
                .collect(),
        },
        parameters: None,
    };
    let (worse, full) = ([1.0, 1.0, 0.5, 0.5, 0.5], [1.0; 5]);
    let variants = vec![
        variant("plan-agent", worse),
        variant("pdm-closed", full),
        variant("fixed-code", full),
        variant("oracle-code", full),
    ];
    let results = StudyResults::new(&study, &[suite("recorded", variants)], None, 0, &[]);
    let [suite] = &results.suites[..] else {
        panic!("{results:?}")
    };
    let difference = suite.variants[0].challenges[0].difference.unwrap();
    // Of two recordings without a difference and with -50, a draw may have either one twice.
    assert_eq!(
        (
            difference.mean,
            difference.low,
            difference.high,
            difference.pairs
        ),
        (-30.0, -50.0, 0.0, 5)
    );
    let [a, b] = &suite.recordings[..] else {
        panic!("{:?}", suite.recordings)
    };
    assert_eq!(
        (a.recording.as_str(), a.starts, &a.challenges[0].loss),
        ("a", 2, &None)
    );
    assert_eq!(
        (b.recording.as_str(), b.starts, b.challenges[0].scores[0]),
        ("b", 3, Some(50.0))
    );
    assert_eq!(b.challenges[0].loss.as_deref(), Some("ego_is_comfortable"));
    let calls = suite.variants[0].calls.as_ref().unwrap();
    assert_eq!(
        (calls.planning_calls, calls.off_route, calls.off_area),
        (40, 10, 0)
    );
    let text = study_markdown(&study, &results, "planagent study recorded", &[]);
    assert!(
        text.contains("| plan-agent | 0 | 0 | 40 | 25.0 % | 0.0 % |"),
        "{text}"
    );
    assert!(
        text.contains("bootstrap over recordings") && text.contains("| b | 3 | 50.00 | 100.00 |"),
        "{text}"
    );
    let table = study_table(&study, &results, LineWidth::PIPE);
    assert_fits(&study, &results);
    assert!(
        table.lines().all(|line| line.chars().count() <= 80),
        "{table}"
    );
}

#[test]
fn a_figure_has_no_row_without_a_point() {
    let study = find("main").unwrap();
    let scores = simulated([Some(0.9), Some(0.8), Some(1.0), Some(0.9)]);
    let mut variants = vec![scores; 3];
    variants.resize(study.variants.len(), NOT_SIMULATED);
    let results = StudyResults::new(&study, &[suite("recorded", variants)], None, 0, &[]);
    let drawn = figures(&study, &results);
    let (_, svg) = &drawn[0];
    assert!(
        svg.contains(">idm<") && !svg.contains("random-code"),
        "{svg}"
    );
}

#[test]
fn orders_are_compared_with_reported_ones_where_planners_were_simulated() {
    let study = find("main").unwrap();
    // In the order of the study; the first three are log-replay, idm and pdm-closed.
    let mut variants = vec![
        simulated([Some(0.9), Some(0.8), Some(1.0), Some(0.9)]),
        simulated([Some(0.5), Some(0.6), Some(0.5), None]),
        simulated([Some(0.7), Some(0.8), Some(0.6), Some(0.7)]),
    ];
    variants.resize(study.variants.len(), NOT_SIMULATED);
    let results = StudyResults::new(&study, &[suite("generated-test14", variants)], None, 0, &[]);
    let found = &results.suites[0].agreement;
    let cases: Vec<(&str, usize, f64)> = found
        .iter()
        .map(|a| (a.benchmark.name(), a.planners.len(), a.kendall.unwrap().tau))
        .collect();
    // Reported: log-replay, pdm-closed, idm without reactive agents; pdm-closed before log-replay
    // with them.
    let reactive = 1.0 / 3.0;
    let expected = [
        ("Test14-random", 1.0),
        ("Test14-random", reactive),
        ("Val14", 1.0),
        ("Val14", reactive),
    ];
    assert_eq!(cases.len(), expected.len());
    for ((name, planners, tau), (benchmark, expected)) in cases.into_iter().zip(expected) {
        assert_eq!((name, planners), (benchmark, 3));
        assert!((tau - expected).abs() < 1e-12, "{benchmark}: {tau}");
    }
    assert_eq!(
        found[0].kendall.unwrap().scenes,
        3,
        "only scenes that all have a score of"
    );
    let text = study_markdown(
        &study,
        &results,
        "planagent study main",
        &["agreement.svg".to_owned()],
    );
    assert!(
        text.contains("## Reported scores") && text.contains("(agreement.svg)"),
        "{text}"
    );
    assert!(text.contains("Test14-random in PlanTF's README"), "{text}");
    let table = study_table(&study, &results, LineWidth::PIPE);
    assert_fits(&study, &results);
    assert!(
        table.lines().all(|line| line.chars().count() <= 80),
        "{table}"
    );
    assert!(
        table.contains("no checkpoint") || table.contains("no weights"),
        "{table}"
    );
}
