//! Learned planners as a user of the program meets them.

use super::vectors::{fixture, manifest_of, tensors};
use assert_cmd::Command;
use candle_core::Tensor;
use planagent_agent::planner::PlanAgentSettings;
use planagent_learned::dtpp::{Dtpp, DtppConfig};
use planagent_learned::gameformer::{GameFormer, GameFormerConfig};
use planagent_learned::gc_pgp::GcPgp;
use planagent_learned::pdm_open::{HIDDEN, PdmNetwork};
use std::collections::HashMap;
use std::path::Path;

fn simulate(work: &Path) -> Command {
    let mut command = Command::cargo_bin("planagent").unwrap();
    command.current_dir(work).args([
        "simulate",
        "--scenario",
        "generated/following_lane_with_lead/3",
    ]);
    command
}

/// What a refused command says.
fn refusal(command: &mut Command) -> String {
    let output = command.assert().code(2).get_output().clone();
    assert!(output.stdout.is_empty());
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn a_learned_planner_is_an_agent_of_the_library() {
    let agent = |checkpoint: Option<&str>| {
        let mut settings = PlanAgentSettings::default();
        if let Some(file) = checkpoint {
            settings.learned.set("plantf", file.to_owned());
        }
        planagent::Agent::builder()
            .planner("plantf")
            .settings(settings)
            .build()
    };
    let file = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/models/learned/plantf/model.safetensors"
    );
    let scenario = planagent::Scenario::open("generated/following_lane_with_lead/3").unwrap();
    let challenge = planagent::Challenge::NonReactive;
    let run = planagent::simulate(&scenario, &mut agent(Some(file)).unwrap(), challenge).unwrap();
    assert!((0.0..=1.0).contains(&run.score()));
    let error = agent(None).unwrap_err().to_string();
    assert!(error.contains("plantf needs a checkpoint"), "{error}");
}

#[test]
fn a_planner_without_a_usable_checkpoint_is_refused_before_the_run() {
    let work = tempfile::tempdir().unwrap();
    let said = refusal(simulate(work.path()).args(["--planner", "plantf"]));
    assert!(
        said.contains(
            "plantf needs a checkpoint; name its file by --checkpoint FILE, or by the setting learned.plantf"
        ),
        "{said}"
    );
    let said =
        refusal(simulate(work.path()).args(["--planner", "plantf", "--checkpoint", "none.ckpt"]));
    assert!(
        said.contains("cannot read the checkpoint") && said.contains("none.ckpt"),
        "{said}"
    );
    let other = fixture("checkpoints/lightning.ckpt");
    let said = refusal(
        simulate(work.path())
            .args(["--planner", "pdm-open", "--checkpoint"])
            .arg(&other),
    );
    assert!(
        said.contains("does not fit PDM-Open: 9 of another shape"),
        "{said}"
    );
    let said = refusal(simulate(work.path()).args(["--planner", "idm", "--checkpoint", "a.ckpt"]));
    assert!(said.contains("no learned planner is named"), "{said}");
    let said = refusal(simulate(work.path()).args([
        "--planner",
        "plantf,pdm-open",
        "--checkpoint",
        "a.ckpt",
    ]));
    assert!(
        said.contains("plantf and pdm-open are named; write --checkpoint PLANNER=FILE for each"),
        "{said}"
    );
    assert!(!work.path().join("runs").exists());
}

#[test]
fn a_checkpoint_controls_the_ego_and_belongs_to_the_run() {
    let work = tempfile::tempdir().unwrap();
    let file: HashMap<String, Tensor> =
        tensors(&manifest_of(|weights| PdmNetwork::open(weights, HIDDEN)))
            .into_iter()
            .collect();
    candle_core::safetensors::save(&file, work.path().join("pdm.safetensors")).unwrap();
    let run = [
        "--planner",
        "pdm-open",
        "--checkpoint",
        "pdm.safetensors",
        "--out",
        "run",
    ];
    simulate(work.path()).args(run).assert().success();
    let manifest = std::fs::read_to_string(work.path().join("run/manifest.toml")).unwrap();
    assert!(
        manifest.contains("[config.learned]") && manifest.contains("pdm.safetensors\" = \""),
        "{manifest}"
    );
    let resume = |more: &[&str]| {
        let mut command = Command::cargo_bin("planagent").unwrap();
        command
            .current_dir(work.path())
            .args(["simulate", "--resume", "run"])
            .args(more);
        command
    };
    // A run folder may come from elsewhere: it chooses no file to open.
    let said = refusal(&mut resume(&[]));
    let named = format!(
        "--checkpoint pdm-open={}",
        work.path().join("pdm.safetensors").display()
    );
    assert!(said.contains(&named), "{said}");
    let again = ["--checkpoint", "pdm-open=pdm.safetensors"];
    let table = resume(&[&again[..], &["--csv"]].concat())
        .assert()
        .success()
        .get_output()
        .stdout
        .clone();
    let table = String::from_utf8(table).unwrap();
    assert!(
        table.lines().any(|line| line.contains("pdm-open")),
        "{table}"
    );
    let mut changed = file;
    let bias = changed["planner_head.5.bias"].clone();
    changed.insert("planner_head.5.bias".to_owned(), (bias * 2.0).unwrap());
    candle_core::safetensors::save(&changed, work.path().join("pdm.safetensors")).unwrap();
    let said = refusal(&mut resume(&again));
    assert!(
        said.contains("model changed: ") && said.contains("pdm.safetensors"),
        "{said}"
    );
}

/// Generated weights plan nonsense; what counts is that simulations with them run from start to
/// end.
#[test]
fn planners_that_search_paths_simulate_from_start_to_end() {
    let work = tempfile::tempdir().unwrap();
    let save = |name: &str, manifest: Vec<(String, Vec<usize>)>| {
        let file: HashMap<String, Tensor> = tensors(&manifest).into_iter().collect();
        candle_core::safetensors::save(&file, work.path().join(name)).unwrap();
    };
    save("gc_pgp.safetensors", manifest_of(GcPgp::take));
    let gameformer = |weights: &mut _| GameFormer::take(weights, GameFormerConfig::PUBLISHED);
    save("gameformer.safetensors", manifest_of(gameformer));
    save(
        "dtpp.safetensors",
        manifest_of(|weights: &mut _| Dtpp::take(weights, DtppConfig::PUBLISHED)),
    );
    // From twelve seconds on: DTPP's tree takes most of a second in a build without optimization.
    let mut command = Command::cargo_bin("planagent").unwrap();
    command.current_dir(work.path()).args([
        "simulate",
        "--scenario",
        "generated/following_lane_with_lead/3@12",
    ]);
    command.args([
        "--planner",
        "gc-pgp,gameformer,dtpp",
        "--out",
        "run",
        "--csv",
    ]);
    for planner in ["gc-pgp=gc_pgp", "gameformer=gameformer", "dtpp=dtpp"] {
        command.args(["--checkpoint", &format!("{planner}.safetensors")]);
    }
    let table = String::from_utf8(command.assert().success().get_output().stdout.clone()).unwrap();
    for planner in ["gc-pgp", "gameformer", "dtpp"] {
        assert!(table.lines().any(|line| line.contains(planner)), "{table}");
    }
}

#[test]
fn samples_for_imitation_are_written_and_resumed() {
    let work = tempfile::tempdir().unwrap();
    let dataset = |planner: &str| {
        let mut command = Command::cargo_bin("planagent").unwrap();
        let arguments = [
            "dataset",
            "--for",
            "imitation",
            "--planner",
            planner,
            "--states",
            "1",
            "--validation",
            "1",
        ];
        command
            .current_dir(work.path())
            .args(arguments)
            .args(["--out", "data", "--json"]);
        command
    };
    let first = dataset("pdm-open")
        .assert()
        .success()
        .get_output()
        .stdout
        .clone();
    let shard = work.path().join("data/train-00000.safetensors");
    let written = std::fs::metadata(&shard).unwrap().modified().unwrap();
    assert_eq!(
        dataset("pdm-open").assert().success().get_output().stdout,
        first
    );
    assert_eq!(
        std::fs::metadata(&shard).unwrap().modified().unwrap(),
        written,
        "a complete shard stays"
    );
    let shard = candle_core::safetensors::load(&shard, &candle_core::Device::Cpu).unwrap();
    let samples = shard["target"].dim(0).unwrap();
    assert!(samples > 100, "{samples}");
    assert_eq!(shard["centerline"].dims(), [samples, 120, 3]);
    let said = refusal(&mut dataset("plantf"));
    assert!(
        said.contains("holds other files, or a dataset with other settings"),
        "{said}"
    );
}
