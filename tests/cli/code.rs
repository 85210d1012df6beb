//! `plan --code`: a planner code that a person wrote.

use super::{SCENE, refused, run};
use serde_json::Value;
use tempfile::TempDir;

/// A time at which the ego's lane is free, seconds.
const AT: &str = "10";

/// Runs `plan --code` with a model that does not exist: none may be loaded.
fn judged(code: &str, more: &[&str]) -> (i32, String, String) {
    let flags = [
        "plan",
        "--scenario",
        SCENE,
        "--at",
        AT,
        "--set",
        "mllm.model=nowhere",
        "--code",
        code,
    ];
    run(&[&flags[..], more].concat())
}

fn json(code: &str, more: &[&str]) -> Value {
    let (exit, stdout, stderr) = judged(code, &[more, &["--json"]].concat());
    assert_eq!(exit, 0, "{stderr}");
    serde_json::from_str(&stdout).unwrap()
}

#[test]
fn a_good_code_is_executed_and_a_bad_one_is_refused_with_its_reason() {
    let good = json("Generate_IDM_Planner(ego_lane, None, 8, 1.5, 3)", &[]);
    assert_eq!(
        (good["executed"].as_bool(), good["threshold"].as_f64()),
        (Some(true), Some(0.75)),
        "{good}"
    );
    assert!(good["score"].as_f64().unwrap() >= 0.75);
    let metrics = good["metrics"].as_array().unwrap();
    let names: Vec<&str> = metrics
        .iter()
        .map(|metric| metric["name"].as_str().unwrap())
        .collect();
    assert_eq!(
        names,
        [
            "no at-fault collision",
            "drivable area",
            "driving direction",
            "progress",
            "time to collision",
            "comfort"
        ]
    );
    assert_eq!(good["rollout"].as_array().unwrap().len(), 41);
    // Standing still on a free road makes no progress.
    let idle = json(
        "Generate_IDM_Planner(c=ego_lane, la=None, v0=0, acc=1, dec=3)",
        &[],
    );
    assert_eq!(idle["executed"], false, "{idle}");
    assert!(
        idle["reason"]
            .as_str()
            .unwrap()
            .contains("of the best proposal (progress: -"),
        "{idle}"
    );
    let (exit, text, stderr) = judged("Generate_IDM_Planner(ego_lane, None, 0, 1, 3)", &[]);
    assert_eq!((exit, stderr.as_str()), (0, ""));
    assert!(
        text.contains("Refused: ") && text.contains("threshold") && text.contains("weight 5"),
        "{text}"
    );
    // The same call with a threshold that the plan meets.
    let lax = json(
        "Generate_IDM_Planner(ego_lane, None, 0, 1, 3)",
        &["--set", "reflection.threshold=0.1"],
    );
    assert_eq!(
        (lax["executed"].as_bool(), &lax["score"]),
        (Some(true), &idle["score"])
    );
}

/// The score is that which Reflection gives the agent's own codes.
#[test]
fn a_code_of_the_agent_gets_the_score_that_the_agent_got() {
    let flags = ["plan", "--scenario", SCENE, "--at", AT, "--json"];
    let (exit, stdout, stderr) = run(&flags);
    assert_eq!(exit, 0, "{stderr}");
    let call: Value = serde_json::from_str(&stdout).unwrap();
    let attempt = &call["attempts"][0];
    let own = json(
        attempt["answer"]["text"]
            .as_str()
            .or(attempt["code"]["text"].as_str())
            .unwrap(),
        &[],
    );
    assert_eq!(
        own["score"], attempt["reflection"]["score"],
        "{own}\n{attempt}"
    );
}

#[test]
fn a_lane_change_needs_the_higher_score() {
    let change = json("Generate_IDM_Planner(right_lane, None, 8, 1, 3)", &[]);
    assert_eq!(
        (
            change["threshold"].as_f64(),
            change["lane_change_threshold"].as_bool()
        ),
        (Some(0.98), Some(true))
    );
}

#[test]
fn a_code_that_cannot_be_read_says_where_and_what_the_scene_has() {
    let of = |code: &str| refused(&["plan", "--scenario", SCENE, "--code", code]);
    let unknown = of("Generate_IDM_Planner(up_lane, None, 8, 1, 3)");
    assert!(
        unknown.contains("--code, column 22: c names 'up_lane', which is not in the scene"),
        "{unknown}"
    );
    assert!(
        unknown.contains("the scene has ") && unknown.contains("ego_lane"),
        "{unknown}"
    );
    assert!(
        unknown.contains("\n                       ^^^^^^^\n"),
        "{unknown}"
    );
    let number = of("Generate_IDM_Planner(ego_lane, None, fast, 1, 900)");
    assert!(
        number.contains("column 38: v0 is not a number") && number.contains("column 47: dec = 900"),
        "{number}"
    );
    assert!(of("drive on").contains("no call of Generate_IDM_Planner"));
    let both = refused(&[
        "plan",
        "--model",
        "nano",
        "--code",
        "Generate_IDM_Planner(ego_lane, None, 8, 1, 3)",
    ]);
    assert!(both.contains("cannot be used with"), "{both}");
    let off = refused(&["plan", "--set", "reflection.enabled=false", "--code", "x"]);
    assert!(off.contains("reflection.enabled=true"), "{off}");
}

#[test]
fn the_picture_shows_the_roll_out_as_executed_or_refused() {
    let work = TempDir::new().unwrap();
    let picture = |code: &str| {
        let file = work.path().join("rollout.png");
        assert_eq!(judged(code, &["--image", file.to_str().unwrap()]).0, 0);
        image::open(&file).unwrap().into_rgb8()
    };
    let executed = picture("Generate_IDM_Planner(ego_lane, None, 8, 1.5, 3)");
    let slow = picture("Generate_IDM_Planner(ego_lane, None, 1, 1.5, 3)");
    assert_eq!(executed.width(), slow.width());
    assert_ne!(executed, slow);
}
