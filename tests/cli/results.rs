//! `report` and `render`: the last run, all simulations, files and folders.

use super::{planagent, refused, run};
use std::fs;
use std::path::Path;
use std::process::Command;
use tempfile::TempDir;

/// Runs in a working directory; gives exit code, stdout and stderr.
fn run_in(folder: &Path, arguments: &[&str]) -> (i32, String, String) {
    let output = planagent()
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code().unwrap(),
        text(output.stdout),
        text(output.stderr),
    )
}

const SIMULATE: [&str; 8] = [
    "simulate",
    "--quiet",
    "--planner",
    "simple,idm",
    "--scenario",
    "generated/changing_lane/3",
    "--challenge",
    "both",
];

#[test]
fn without_a_run_the_last_one_is_taken() {
    let work = TempDir::new().unwrap();
    let (code, _, stderr) = run_in(work.path(), &["report"]);
    assert!(
        code == 2 && stderr.contains("there is no run in this folder"),
        "{stderr}"
    );
    for _ in 0..2 {
        assert_eq!(run_in(work.path(), &SIMULATE).0, 0);
    }
    // A study's folder is none of the numbered runs.
    fs::create_dir(work.path().join("runs/studies")).unwrap();
    let (code, stdout, stderr) = run_in(work.path(), &["report"]);
    assert_eq!(code, 0, "{stderr}");
    assert!(
        Path::new(stdout.trim()).ends_with("runs/0002/report.html"),
        "{stdout}"
    );
    assert!(
        work.path().join("runs/0002/report.html").is_file()
            && !work.path().join("runs/0001/report.html").exists()
    );

    let small = ["--pixels", "160"];
    let (code, stdout, stderr) = run_in(
        work.path(),
        &[&["render", "2", "--png", "one.png"], &small[..]].concat(),
    );
    assert!(code == 0 && stderr.contains("run runs/0002"), "{stderr}");
    assert_eq!(stdout.trim(), "one.png");
    // All simulations go to a folder.
    let (code, stdout, stderr) = run_in(
        work.path(),
        &[&["render", "--png", "all/sheets"], &small[..]].concat(),
    );
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(stdout.lines().count(), 4, "{stdout}");
    let name = "000001-generated_changing_lane_3-simple-reactive.png";
    assert!(
        image::open(work.path().join("all/sheets").join(name))
            .unwrap()
            .width()
            > 160
    );
    let some = [
        "render",
        "runs/0001",
        "changing_lane/3",
        "--planner",
        "idm",
        "--png",
        "some",
    ];
    let (code, stdout, stderr) = run_in(work.path(), &[&some[..], &small].concat());
    assert_eq!((code, stdout.lines().count()), (0, 2), "{stderr}");
}

#[test]
fn a_film_has_the_format_of_its_name() {
    let work = TempDir::new().unwrap();
    assert_eq!(run_in(work.path(), &SIMULATE).0, 0);
    for (option, name) in [
        ("--gif", "a.mp4"),
        ("--png", "a.gif"),
        ("--mp4", "a.gif"),
        ("--png", "a.jpg"),
    ] {
        let (code, _, stderr) = run_in(work.path(), &["render", "0", option, name]);
        let own = option.trim_start_matches("--");
        assert!(
            code == 2 && stderr.contains(&format!("must end in .{own}")),
            "{stderr}"
        );
    }
    let (code, _, stderr) = run_in(work.path(), &["render", "0", "--png", "nowhere/a.png"]);
    assert!(
        code == 2 && stderr.contains("there is no folder nowhere"),
        "{stderr}"
    );
    let (code, _, stderr) = run_in(
        work.path(),
        &["render", "generated/changing_lane/4", "--png", "a.png"],
    );
    assert!(
        code == 2 && stderr.contains("a similar simulation exists: 'generated/changing_lane/3'"),
        "{stderr}"
    );
}

#[test]
fn a_part_of_a_scenario_that_no_other_has_names_it() {
    let work = TempDir::new().unwrap();
    let scenarios: Vec<String> = (1..8)
        .map(|seed| format!("generated/stopping_with_lead/{seed}"))
        .collect();
    let words: Vec<&str> = scenarios.iter().map(String::as_str).collect();
    let flags = [
        "simulate",
        "--quiet",
        "--planner",
        "simple",
        "--scenario",
        "generated/changing_lane/3",
    ];
    assert_eq!(run_in(work.path(), &[&flags[..], &words].concat()).0, 0);
    let render = |word: &str| {
        run_in(
            work.path(),
            &["render", word, "--png", "a.png", "--pixels", "160"],
        )
    };
    // The seed of a scenario is found too where it is no number of a simulation.
    for part in ["changing", "lane/3", "g_lane/", "generated/changing_lane/3"] {
        let (code, _, stderr) = render(part);
        assert!(
            code == 0 && work.path().join("a.png").is_file(),
            "{part}: {stderr}"
        );
        fs::remove_file(work.path().join("a.png")).unwrap();
    }
    let (code, _, stderr) = render("stopping");
    assert!(
        code == 2
            && stderr.contains("'stopping' is in the names of 7 scenarios; name one of them:"),
        "{stderr}"
    );
    assert_eq!(
        stderr.matches("\n  generated/stopping_with_lead/").count(),
        5,
        "{stderr}"
    );
    let (code, _, stderr) = render("Changing");
    assert!(
        code == 2 && stderr.contains("has no simulation 'Changing'"),
        "{stderr}"
    );
    let (code, _, stderr) = run_in(
        work.path(),
        &["report", "--scenario", "generated/chaning_lane/3"],
    );
    assert!(
        code == 2 && stderr.contains("a similar scenario exists: 'generated/changing_lane/3'"),
        "{stderr}"
    );
    let (code, _, stderr) = run_in(work.path(), &["report", "--scenario", "changing"]);
    assert!(
        code == 0 && stderr.contains("8 simulations, 1 with replay"),
        "{stderr}"
    );
}

/// What is wrong with paths is said before the model is loaded, which takes long.
#[test]
fn paths_are_checked_before_a_model_is_loaded() {
    let work = TempDir::new().unwrap();
    let path = |name: &str| work.path().join(name).to_str().unwrap().to_owned();
    let old = work.path().join("old");
    fs::create_dir(&old).unwrap();
    fs::write(old.join("manifest.toml"), "planagent = \"0.0.1\"\n").unwrap();
    let never_loaded = |arguments: &[&str]| {
        let error = refused(arguments);
        assert!(!error.contains("model nano"), "{error}");
        error
    };
    let format = never_loaded(&["simulate", "--out", old.to_str().unwrap()]);
    assert!(
        format.contains("a run of format version 0") && !format.contains("--resume"),
        "{format}"
    );
    let image = never_loaded(&["plan", "--image", &path("nowhere/bev.png")]);
    assert!(image.contains("there is no folder"), "{image}");
    fs::write(path("file"), "").unwrap();
    assert!(
        never_loaded(&["simulate", "--out", &path("file/run")]).contains("is a file and no folder")
    );
    let out = path("run");
    assert_eq!(
        run(&["simulate", "--planner", "simple", "--quiet", "--out", &out]).0,
        0
    );
    let other = never_loaded(&["simulate", "--resume", &out, "--planner", "plan-agent"]);
    assert!(
        other.contains("other planners: was simple, is plan-agent") && !other.contains("was none"),
        "{other}"
    );
    let prompts = never_loaded(&[
        "simulate",
        "--prompt-set",
        &path("nowhere"),
        "--out",
        &path("new"),
    ]);
    assert!(prompts.contains("nowhere"), "{prompts}");
    let foreign = never_loaded(&["dataset", "--driven", "--out", &out]);
    assert!(foreign.contains("holds other files"), "{foreign}");
}

/// No user can create a file in /proc.
#[cfg(target_os = "linux")]
#[test]
fn outputs_that_cannot_be_written_are_found_before_a_model_is_loaded() {
    let work = TempDir::new().unwrap();
    let weights = work.path().join("nano.gguf");
    for arguments in [
        &["simulate", "--out", "/proc/run"][..],
        &["plan", "--image", "/proc/scene.png"],
        &["ask", "what?", "--image", "/proc/scene.png"],
        &["dataset", "--driven", "--out", "/proc/data"],
        &["study", "main", "--quick", "--out", "/proc/studies"],
        &["bench", "--out", "/proc/bench"],
        &[
            "bench",
            "--out",
            work.path().to_str().unwrap(),
            "--vs",
            "llama.cpp",
            "--weights",
            "/proc/weights",
        ],
        &[
            "models",
            "quantize",
            "nano",
            "--to",
            "q8_0",
            "--out",
            "/proc/nano.gguf",
        ],
    ] {
        let error = refused(arguments);
        assert!(
            error.contains("/proc/") && error.contains("cannot write"),
            "{error}"
        );
        assert!(
            !error.contains("model nano") && !error.contains("loads the model"),
            "{error}"
        );
    }
    // A run without a name goes below the working directory.
    let output = planagent()
        .args(["simulate"])
        .current_dir("/proc")
        .output()
        .unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.code() == Some(2) && !error.contains("model nano"),
        "{error}"
    );
    // What is there already stays as it is.
    fs::write(&weights, "mine").unwrap();
    let quantize = [
        "models",
        "quantize",
        "nowhere",
        "--to",
        "q8_0",
        "--force",
        "--out",
        weights.to_str().unwrap(),
    ];
    refused(&quantize);
    assert_eq!(fs::read(&weights).unwrap(), b"mine");
}

#[test]
fn a_damaged_simulation_is_named_wherever_it_is_left_out() {
    let work = TempDir::new().unwrap();
    assert_eq!(run_in(work.path(), &SIMULATE).0, 0);
    let damaged = "runs/0001/simulations/000001-generated_changing_lane_3-simple-reactive";
    fs::write(work.path().join(damaged).join("metrics.toml"), "").unwrap();
    for arguments in [
        &["report"][..],
        &["compare", "runs/0001", "runs/0001"],
        &["render", "--png", "sheets", "--pixels", "160"],
    ] {
        let (code, _, stderr) = run_in(work.path(), arguments);
        assert!(
            code == 0 && stderr.contains(&format!("{damaged} is damaged and left out")),
            "{arguments:?}: {stderr}"
        );
    }
    let (_, stdout, _) = run_in(work.path(), &["report", "--json"]);
    let contents: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(
        (&contents["simulations"], &contents["damaged"][0]),
        (&3.into(), &damaged.into())
    );
}

#[test]
fn a_run_of_failures_is_not_the_last_one_and_a_page_needs_no_browser() {
    let work = TempDir::new().unwrap();
    assert_eq!(run_in(work.path(), &SIMULATE).0, 0);
    let failing = [
        "simulate",
        "--quiet",
        "--planner",
        "idm",
        "--scenario",
        "generated/changing_lane/2~overtake_parked_vehicle",
    ];
    let (code, _, stderr) = run_in(work.path(), &failing);
    assert_eq!(code, 1, "{stderr}");
    assert!(work.path().join("runs/0002/summary.json").is_file());
    let output = planagent()
        .args(["report", "--open"])
        .env("PATH", "")
        .env_remove("BROWSER")
        .current_dir(work.path())
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
    let (stdout, stderr) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{stderr}");
    assert!(stdout.trim().ends_with("runs/0001/report.html"), "{stdout}");
    assert!(stderr.contains("cannot open a browser"), "{stderr}");
    // A run that is named is shown all the same.
    let (code, _, stderr) = run_in(work.path(), &["report", "runs/0002"]);
    assert_eq!(code, 0, "{stderr}");
}

#[test]
fn a_run_says_what_to_do_next_and_each_line_works() {
    let work = TempDir::new().unwrap();
    let flags: Vec<&str> = SIMULATE
        .into_iter()
        .filter(|flag| *flag != "--quiet")
        .collect();
    let (code, _, stderr) = run_in(work.path(), &flags);
    assert_eq!(code, 0, "{stderr}");
    let (_, next) = stderr.split_once("next:\n").unwrap();
    assert!(
        next.contains("  planagent report runs/0001 --open\n"),
        "{next}"
    );
    assert!(next.lines().all(|line| line.len() <= 80), "{next}");
    // Planners without a model have no transcript to read.
    assert!(!next.contains("transcript.md"), "{next}");
    let with_model = [
        "simulate",
        "--planner",
        "plan-agent",
        "--out",
        "with a space",
        "--scenario",
        "generated/changing_lane/3",
    ];
    let (code, _, stderr) = run_in(work.path(), &with_model);
    assert_eq!(code, 0, "{stderr}");
    let (_, next) = stderr.split_once("next:\n").unwrap();
    let command = "  planagent report 'with a space' --open\n";
    assert!(next.contains(command), "{next}");
    let transcript = next
        .lines()
        .find(|line| line.ends_with("transcript.md"))
        .unwrap();
    // The line is what a shell takes, quotes and star included.
    let shown = Command::new("sh")
        .args(["-c", &format!("test -f {}", transcript.trim())])
        .current_dir(work.path())
        .status()
        .unwrap();
    assert!(shown.success(), "{transcript}");
    let advised: Vec<&str> = next
        .lines()
        .filter_map(|line| line.strip_prefix("  planagent "))
        .collect();
    assert_eq!(advised, ["report 'with a space' --open", "models list"]);
    assert_eq!(run_in(work.path(), &["models", "list"]).0, 0);
}
