//! Scenarios as they are listed and shown, instants, pictures and numbers.

use super::{SCENE, refused, run};
use crate::argoverse2::all_logs;
use crate::outside::Needy;
use crate::womd::written;
use serde_json::Value;
use std::path::Path;
use tempfile::TempDir;

/// The lines of JSON that a command prints.
fn told(arguments: &[&str]) -> Vec<Value> {
    let (code, stdout, stderr) = run(&[arguments, &["--json"]].concat());
    assert_eq!(code, 0, "{stderr}");
    stdout
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// What `list` and `show` say of a word agrees; `list` opens files of recordings, and then knows
/// more fields.
fn tell_the_same(word: &str, opened: &[&str]) {
    let listed = told(&["scenarios", "list", word]);
    assert_eq!(listed.len(), 1, "{listed:?}");
    let shown = &told(&["scenarios", "show", word])[0];
    for field in ["id", "source", "scenario_type", "log_name"]
        .iter()
        .chain(opened)
    {
        assert!(!shown[field].is_null(), "{field} in {shown}");
        assert_eq!(listed[0][field], shown[field], "{field} of {word}");
    }
    for field in ["iterations", "lanes"] {
        assert!(
            listed[0].get(field).is_some() && shown[field].as_u64().unwrap() > 0,
            "{field} of {word}"
        );
    }
    assert!(
        shown["map"]["connectors"].as_u64() <= shown["lanes"].as_u64(),
        "{shown}"
    );
}

#[test]
fn list_and_show_tell_the_same_under_the_same_names() {
    tell_the_same(SCENE, &[]);
}

#[test]
fn list_and_show_tell_the_same_of_a_recording() {
    let work = TempDir::new().unwrap();
    let recording = work.path().join("recording.tfrecord");
    written::write(&recording, SCENE);
    tell_the_same(recording.to_str().unwrap(), &["iterations", "lanes"]);
}

#[test]
fn list_and_show_tell_the_same_of_logs_of_argoverse2() -> Needy {
    for log in all_logs()? {
        tell_the_same(log.to_str().unwrap(), &["iterations", "lanes"]);
    }
    Ok(())
}

#[test]
fn a_generated_scenario_is_listed_by_its_name() {
    let (code, stdout, stderr) = run(&["scenarios", "list", SCENE]);
    assert_eq!((code, stdout.trim_end()), (0, SCENE), "{stderr}");
    let kind = refused(&["scenarios", "list", "generated/flying/1"]);
    assert!(kind.contains("'flying' is not a scenario type"), "{kind}");
    let form = refused(&["scenarios", "list", "generated/changing_lane"]);
    assert!(
        form.contains("expected generated/<scenario type>/<seed>"),
        "{form}"
    );
    let traffic = refused(&["scenarios", "list", "generated/changing_lane/3.x"]);
    assert!(
        traffic.contains("traffic seed 'x' of 'generated/changing_lane/3.x'"),
        "{traffic}"
    );
    let nowhere = refused(&["scenarios", "list", "nowhere"]);
    assert!(nowhere.contains("no file or folder nowhere"), "{nowhere}");
}

#[test]
fn other_traffic_has_a_name() {
    let other = "generated/changing_lane/3.1";
    let generated = told(&[
        "scenarios",
        "generate",
        "--type",
        "changing_lane",
        "--from",
        "3",
        "--traffic",
        "1",
    ]);
    assert_eq!(generated[0]["id"], other);
    let [own, other] = [SCENE, other].map(|name| told(&["scenarios", "show", name]).remove(0));
    assert_eq!(
        (&own["map"], &own["lanes"]),
        (&other["map"], &other["lanes"])
    );
    assert_ne!(own["id"], other["id"]);
}

#[test]
fn statistics_of_two_sets_fit_a_terminal_and_tell_them_apart() {
    let work = TempDir::new().unwrap();
    let figure = work.path().join("statistics.svg");
    let figure = figure.to_str().unwrap();
    let list = |from: usize| {
        let names = (from..from + 10).map(|seed| format!("generated/high_magnitude_speed/{seed}"));
        names.collect::<Vec<_>>().join(",")
    };
    // Slow and fast scenes of one generator; and a set against itself.
    let slow: Vec<String> = (0..10)
        .map(|seed| format!("generated/stationary_in_traffic/{seed}"))
        .collect();
    let (fast, slow) = (list(0), slow.join(","));
    let found = told(&["scenarios", "statistics", &fast, &slow, "--figure", figure]).remove(0);
    assert!(
        found["classifier"]["mean"].as_f64().unwrap() >= 0.9,
        "{}",
        found["classifier"]
    );
    let feature = |key: &str| {
        let features = found["features"].as_array().unwrap();
        features
            .iter()
            .find(|feature| feature["key"] == key)
            .unwrap()
            .clone()
    };
    let speed = feature("ego_speed");
    assert!(
        speed["a"]["mean"].as_f64() > speed["b"]["mean"].as_f64(),
        "{speed}"
    );
    assert!(speed["coefficient"].as_f64().unwrap() > 0.0, "{speed}");
    assert_eq!(feature("unknown_limits")["difference"], Value::Null);
    assert_eq!(found["scenes"][1].as_array().unwrap().len(), 10);
    let drawn = std::fs::read_to_string(figure).unwrap();
    assert!(
        drawn.starts_with("<svg") && drawn.contains("speed of the ego, m/s"),
        "{drawn}"
    );

    let same = told(&["scenarios", "statistics", &fast, &fast]).remove(0);
    assert!(
        same["classifier"]["mean"].as_f64().unwrap() <= 0.5,
        "{}",
        same["classifier"]
    );
    let (code, table, stderr) = run(&[
        "scenarios",
        "statistics",
        SCENE,
        "generated/changing_lane/4",
    ]);
    assert_eq!(code, 0, "{stderr}");
    assert!(
        table.lines().all(|line| line.chars().count() <= 80),
        "{table}"
    );
    assert!(table.contains("no classifier"), "{table}");

    let png = refused(&[
        "scenarios",
        "statistics",
        SCENE,
        SCENE,
        "--figure",
        "statistics.png",
    ]);
    assert!(png.contains("must end in .svg"), "{png}");
    let nowhere = refused(&["scenarios", "statistics", SCENE, "nowhere"]);
    assert!(nowhere.contains("no file or folder nowhere"), "{nowhere}");
}

#[test]
fn hard_scenes_are_chosen_out_of_a_whole_run_only() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let out = out.to_str().unwrap();
    let error = refused(&["scenarios", "hard", out]);
    assert!(error.contains(out), "{error}");
    let drive = [
        "simulate",
        "--split",
        "generated-test14-candidates",
        "--planner",
        "pdm-closed",
        "--limit",
        "1",
        "--out",
    ];
    let (code, _, stderr) = run(&[&drive[..], &[out]].concat());
    assert_eq!(code, 0, "{stderr}");
    let error = refused(&["scenarios", "hard", out]);
    assert!(
        error.contains("1399 of the 1400") && error.contains("--planner pdm-closed"),
        "{error}"
    );
}

#[test]
fn an_instant_outside_the_window_is_refused_with_the_window() {
    for at in ["-1", "-0.2", "15.1", "1e300", "NaN"] {
        for command in [
            &["plan", "--scenario", SCENE][..],
            &["scenarios", "show", SCENE],
        ] {
            let error = refused(&[command, &["--at", at]].concat());
            assert!(
                error.contains("outside the window") && error.contains("from 0 to 15.0 s"),
                "{error}"
            );
        }
    }
    let view = refused(&["scenarios", "show", SCENE, "--view", "-5"]);
    assert!(view.contains("between 8 and 1000 meters"), "{view}");
}

#[test]
fn a_picture_has_the_format_of_its_ending() {
    let work = TempDir::new().unwrap();
    let format = |path: &Path| {
        image::ImageReader::open(path)
            .unwrap()
            .with_guessed_format()
            .unwrap()
            .format()
    };
    for (name, written) in [
        ("a.png", image::ImageFormat::Png),
        ("b.jpg", image::ImageFormat::Jpeg),
        ("c.JPEG", image::ImageFormat::Jpeg),
    ] {
        let path = work.path().join(name);
        let (code, _, stderr) = run(&[
            "scenarios",
            "show",
            SCENE,
            "--image",
            path.to_str().unwrap(),
        ]);
        assert_eq!(code, 0, "{stderr}");
        assert_eq!(
            (format(&path), image::open(&path).unwrap().width()),
            (Some(written), 1024),
            "{name}"
        );
    }
    for name in ["d.gif", "e.webp", "f"] {
        let path = work.path().join(name);
        for command in [
            &["plan", "--scenario", SCENE][..],
            &["scenarios", "show", SCENE],
        ] {
            let error = refused(&[command, &["--image", path.to_str().unwrap()]].concat());
            assert!(
                error.contains(".png, .jpg or .jpeg") && error.contains(name),
                "{error}"
            );
        }
        assert!(!path.exists());
    }
}

#[test]
fn no_zero_has_a_minus() {
    for command in [
        &["plan", "--scenario", SCENE][..],
        &["scenarios", "show", SCENE, "--at", "-0.0"],
    ] {
        for form in [&[][..], &["--json"]] {
            let (code, stdout, stderr) = run(&[command, form].concat());
            assert_eq!(code, 0, "{stderr}");
            let bounds = |c: char| !(c.is_ascii_digit() || matches!(c, '-' | '.' | 'e'));
            let minus = stdout.split(bounds).find(|word| {
                word.strip_prefix('-').is_some_and(|rest| {
                    rest.contains('0') && rest.chars().all(|c| matches!(c, '0' | '.'))
                })
            });
            assert_eq!(minus, None, "{stdout}");
        }
    }
}

#[test]
fn a_log_below_a_folder_does_not_hide_its_folders_of_recordings() {
    let work = TempDir::new().unwrap();
    let womd = work.path().join("womd");
    std::fs::create_dir_all(work.path().join("vectors/deep")).unwrap();
    std::fs::create_dir(&womd).unwrap();
    std::fs::write(work.path().join("vectors/deep/x.db"), "no log").unwrap();
    std::fs::write(
        womd.join("validation.tfrecord-00000-of-00001"),
        "no recording",
    )
    .unwrap();
    let said = refused(&["scenarios", "list", work.path().to_str().unwrap()]);
    assert!(
        said.contains("validation.tfrecord-00000-of-00001") && said.contains("x.db"),
        "{said}"
    );
}
