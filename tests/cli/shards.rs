//! `--limit`, `--type`, `--shuffle`, `--shard`, `merge`, `compare` and `--csv`.

use super::{planagent, read_json, refused, run};
use crate::runner::simulations;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Simulates with a quick planner; gives the names of the scenarios in their order.
fn simulated(out: &Path, flags: &[&str]) -> Vec<String> {
    let base = [
        "simulate",
        "--planner",
        "simple",
        "--quiet",
        "--out",
        out.to_str().unwrap(),
    ];
    let (code, _, stderr) = run(&[&base[..], flags].concat());
    assert_eq!(code, 0, "{stderr}");
    let rows = read_json(&out.join("summary.json"))["scenarios"]
        .as_array()
        .unwrap()
        .clone();
    rows.iter()
        .map(|row| row["id"].as_str().unwrap().to_owned())
        .collect()
}

fn type_of(name: &str) -> &str {
    name.split('/').nth(1).unwrap()
}

#[test]
fn scenarios_are_drawn_evenly_by_type_and_at_random() {
    let work = TempDir::new().unwrap();
    let of = |name: &str, flags: &[&str]| simulated(&work.path().join(name), flags);
    let even = of("even", &["--split", "generated", "--limit", "16"]);
    assert_eq!(
        (
            even.len(),
            even.iter()
                .map(|name| type_of(name))
                .collect::<BTreeSet<_>>()
                .len()
        ),
        (16, 16)
    );
    assert!(even.iter().all(|name| name.ends_with("/0")), "{even:?}");
    let typed = of(
        "typed",
        &["--type", "changing_lane,stopping_with_lead", "--limit", "3"],
    );
    assert_eq!(typed.len(), 3);
    assert!(
        typed
            .iter()
            .all(|name| ["changing_lane", "stopping_with_lead"].contains(&type_of(name))),
        "{typed:?}"
    );
    let random = |name: &str, seed: &str| of(name, &["--limit", "4", "--shuffle", "--seed", seed]);
    let one = random("one", "1");
    assert_eq!(one, random("again", "1"));
    assert_ne!(one, random("two", "2"));
    // A resumed run finds the same scenarios.
    let folder = work.path().join("one");
    let (code, _, stderr) = run(&["simulate", "--resume", folder.to_str().unwrap(), "--quiet"]);
    assert_eq!(code, 0, "{stderr}");
}

/// Everything in a run's folder but measured times and the stamp of the start, by name.
fn timeless(run: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![run.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let name = path.strip_prefix(run).unwrap().to_str().unwrap().to_owned();
            let bytes = fs::read(&path).unwrap();
            let text = || String::from_utf8(bytes.clone()).unwrap();
            let file = path.file_name().unwrap().to_str().unwrap();
            let bytes = match file {
                ".lock" | "timing.json" | "runner_report.parquet" => continue,
                "manifest.toml" => without(&text(), |key| key == "started"),
                "record.toml" => without(&text(), |key| {
                    ["started_s", "ended_s", "planner_s"].contains(&key)
                }),
                _ => bytes,
            };
            // nuPlan's name of the file of the means ends in the start.
            let name = name.split("_metrics_").next().unwrap().to_owned();
            assert!(found.insert(name, bytes).is_none());
        }
    }
    found
}

/// The lines of a TOML file without some keys.
fn without(text: &str, left_out: impl Fn(&str) -> bool) -> Vec<u8> {
    let kept = text
        .lines()
        .filter(|line| !left_out(line.split(" = ").next().unwrap()));
    kept.collect::<Vec<_>>().join("\n").into_bytes()
}

#[test]
fn merged_shards_are_the_run_of_one_process() {
    let work = TempDir::new().unwrap();
    let path = |name: &str| work.path().join(name);
    let flags = [
        "--split",
        "generated",
        "--limit",
        "8",
        "--planner",
        "log-replay",
        "--challenge",
        "both",
    ];
    let whole = simulated(&path("whole"), &flags);
    let mut shared = Vec::new();
    for shard in ["1/3", "2/3", "3/3"] {
        let name = shard.replace('/', "-of-");
        shared.extend(simulated(
            &path(&name),
            &[&flags[..], &["--shard", shard]].concat(),
        ));
    }
    shared.sort();
    let mut sorted = whole.clone();
    sorted.sort();
    assert_eq!(shared, sorted, "every simulation is in one shard");
    let folders =
        ["3-of-3", "1-of-3", "2-of-3"].map(|name| path(name).to_str().unwrap().to_owned());
    let [third, first, second] = folders.each_ref().map(String::as_str);
    let merged = path("merged");
    let out = merged.to_str().unwrap();

    let missing = refused(&["merge", third, first, "--out", out]);
    assert!(missing.contains("missing shards (2/3)"), "{missing}");
    let (code, stdout, stderr) = run(&["merge", third, first, second, first, "--out", out]);
    assert_eq!(code, 0, "{stderr}");
    assert!(stdout.contains("log-replay"), "{stdout}");
    let (one, other) = (timeless(&path("whole")), timeless(&merged));
    assert!(one.len() > 100, "{}", one.len());
    let differing: Vec<&String> = one
        .keys()
        .chain(other.keys())
        .filter(|name| one.get(*name) != other.get(*name))
        .collect();
    assert!(differing.is_empty(), "these differ: {differing:?}");
    // A shard is resumed as a shard, and the merged run as a whole.
    for (folder, count) in [(first, simulations(&path("1-of-3")).len()), (out, 32)] {
        let (code, _, stderr) = run(&["simulate", "--resume", folder]);
        assert!(
            code == 0 && stderr.contains(&format!("{count} of {count} simulations")),
            "{stderr}"
        );
    }

    // Other settings, and other results of one simulation, are refused.
    let other_seed = path("other-seed");
    simulated(
        &other_seed,
        &[&flags[..], &["--shard", "2/3", "--seed", "1"]].concat(),
    );
    let settings = refused(&["merge", first, other_seed.to_str().unwrap()]);
    assert!(settings.contains("config.seed: was 0, is 1"), "{settings}");
    let record = simulations(&path("1-of-3"))[0].join("record.toml");
    let text = fs::read_to_string(&record).unwrap();
    fs::write(
        &record,
        text.replace("planning_calls = 0", "planning_calls = 1"),
    )
    .unwrap();
    let overlap = refused(&[
        "merge",
        out,
        first,
        "--out",
        path("never").to_str().unwrap(),
    ]);
    assert!(
        overlap.contains("both hold simulation") && overlap.contains("different results"),
        "{overlap}"
    );
    assert!(!path("never").exists());
    fs::write(&record, &text[..text.len() / 2]).unwrap();
    let damaged = refused(&[
        "merge",
        first,
        second,
        third,
        "--out",
        path("never").to_str().unwrap(),
    ]);
    assert!(damaged.contains("is damaged"), "{damaged}");
}

#[test]
fn a_slurm_array_or_a_node_names_its_shard() {
    let work = TempDir::new().unwrap();
    let names = [
        "SLURM_ARRAY_TASK_ID",
        "SLURM_ARRAY_TASK_MIN",
        "SLURM_ARRAY_TASK_MAX",
        "SLURM_ARRAY_TASK_STEP",
    ];
    let shard = |out: &str, variables: &[(&str, &str)]| {
        let mut command = planagent();
        for name in names {
            command.env_remove(name);
        }
        command
            .env_remove("SLURM_ARRAY_TASK_COUNT")
            .env_remove("NODE_RANK")
            .env_remove("NUM_NODES");
        command
            .envs(variables.iter().copied())
            .current_dir(work.path());
        let flags = [
            "simulate",
            "--split",
            "generated",
            "--limit",
            "8",
            "--planner",
            "simple",
            "--shard",
            "auto",
        ];
        let output = command
            .args(flags)
            .args(["--quiet", "--out", out])
            .output()
            .unwrap();
        (
            output.status.code(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    let task = [
        ("SLURM_ARRAY_TASK_ID", "5"),
        ("SLURM_ARRAY_TASK_MIN", "4"),
        ("SLURM_ARRAY_TASK_COUNT", "3"),
    ];
    for (out, variables) in [
        ("task", &task[..]),
        ("node", &[("NODE_RANK", "1"), ("NUM_NODES", "3")]),
    ] {
        let (code, stderr) = shard(out, variables);
        assert_eq!(code, Some(0), "{stderr}");
        let manifest = fs::read_to_string(work.path().join(out).join("manifest.toml")).unwrap();
        assert!(manifest.contains("index = 2\nof = 3\n"), "{manifest}");
    }
    for (variables, why) in [
        (&[][..], "neither SLURM_ARRAY_TASK_ID nor NODE_RANK is set"),
        (
            &[("SLURM_ARRAY_TASK_ID", "2")],
            "SLURM_ARRAY_TASK_COUNT is not",
        ),
        (
            &[("NODE_RANK", "two"), ("NUM_NODES", "3")],
            "NODE_RANK is 'two'",
        ),
    ] {
        let (code, stderr) = shard("never", variables);
        assert!(code == Some(2) && stderr.contains(why), "{stderr}");
    }
}

#[test]
fn an_empty_shard_is_a_run_without_simulations() {
    let work = TempDir::new().unwrap();
    let scene = ["--scenario", "generated/changing_lane/3"];
    let counts: Vec<usize> = (1..=2)
        .map(|index| {
            let shard = format!("{index}/2");
            simulated(
                &work.path().join(index.to_string()),
                &[&scene[..], &["--shard", &shard]].concat(),
            )
            .len()
        })
        .collect();
    assert_eq!(counts.iter().sum::<usize>(), 1, "{counts:?}");
    let [one, two, out] =
        ["1", "2", "out"].map(|name| work.path().join(name).to_str().unwrap().to_owned());
    let (code, _, stderr) = run(&["merge", &one, &two, "--out", &out]);
    assert_eq!(code, 0, "{stderr}");
}

#[test]
fn two_runs_are_compared_on_common_scenes() {
    let work = TempDir::new().unwrap();
    let [one, two] = ["one", "two"].map(|name| work.path().join(name));
    simulated(
        &one,
        &[
            "--type",
            "changing_lane,stopping_with_lead",
            "--limit",
            "6",
            "--planner",
            "idm",
        ],
    );
    simulated(&two, &["--type", "changing_lane", "--limit", "4"]);
    let [a, b] = [&one, &two].map(|path| path.to_str().unwrap());
    let (code, stdout, stderr) = run(&["compare", a, b, "--by-type"]);
    assert_eq!(code, 0, "{stderr}");
    let shown = stdout.replace(a, "[A]").replace(b, "[B]");
    insta::with_settings!({prepend_module_to_snapshot => false}, {
        insta::assert_snapshot!("compare", shown);
    });
    let (_, json, _) = run(&["compare", a, b, "--json"]);
    let found: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(found["scores"][0]["difference"]["pairs"], 3);
    let (_, csv, _) = run(&["compare", a, b, "--csv"]);
    assert_eq!(csv.lines().count(), 4);
    assert!(
        csv.starts_with(
            "scenario,scenario_type,planners.first,planners.second,challenge,first,second\n"
        ),
        "{csv}"
    );
    let (code, own, _) = run(&["compare", a, a, "--planner", "simple,idm"]);
    assert_eq!(code, 0);
    assert!(own.contains("simple / idm"), "{own}");
    let unknown = refused(&["compare", a, b, "--planner", "idm,smple"]);
    assert!(
        unknown.contains("has no planner 'smple'") && unknown.contains("'simple'"),
        "{unknown}"
    );
}

#[test]
fn tables_are_printed_as_csv() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let flags = [
        "simulate",
        "--planner",
        "simple",
        "--quiet",
        "--out",
        out.to_str().unwrap(),
        "--csv",
    ];
    let (code, csv, stderr) = run(&flags);
    assert_eq!(code, 0, "{stderr}");
    assert!(
        csv.starts_with("id,scenario_type,log_name,planner,challenge,succeeded,score,")
            && csv.lines().count() == 2
    );
    let (_, models, _) = run(&["models", "list", "--csv"]);
    assert!(
        models.starts_with(
            "model,family,source,server,place,bytes,problem,description,prompt_set,prompts,license,"
        ),
        "{models}"
    );
    assert!(models.contains("\nnano,llava,"), "{models}");
    let (_, scenarios, _) = run(&["scenarios", "list", "generated/changing_lane/3", "--csv"]);
    assert!(
        scenarios.contains("\ngenerated/changing_lane/3,generated/changing_lane/3,changing_lane,"),
        "{scenarios}"
    );
    assert!(refused(&["scenarios", "list", "--csv", "--json"]).contains("cannot be used with"));
}
