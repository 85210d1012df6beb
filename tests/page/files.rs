//! The files of `report` and `render`, without a browser.

use super::{scenes, simulate};
use crate::cli::{refused, run};
use crate::outside::{Needy, program};
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

fn simulation_folders(run: &Path) -> Vec<std::path::PathBuf> {
    let mut folders: Vec<_> = fs::read_dir(run.join("simulations"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    folders.sort();
    folders
}

#[test]
fn pages_hold_runs_and_name_what_is_missing() {
    let work = TempDir::new().unwrap();
    let [one, other] = ["one", "other"].map(|name| work.path().join(name));
    simulate(&one, &scenes(3), "log-replay,simple");
    simulate(&other, &scenes(2), "idm");
    // A simulation of an older version has no replay.
    fs::remove_file(simulation_folders(&other)[0].join("replay.json.gz")).unwrap();
    let page = work.path().join("page.html");
    let flags = ["--out", page.to_str().unwrap(), "--json"];
    let write = |more: &[&str]| -> Value {
        let runs = ["report", one.to_str().unwrap(), other.to_str().unwrap()];
        let (code, stdout, stderr) = run(&[&runs[..], &flags[..], more].concat());
        assert_eq!(code, 0, "{stderr}");
        serde_json::from_str(&stdout).unwrap()
    };
    let all = write(&[]);
    assert_eq!(
        (&all["simulations"], &all["replays"], &all["without_replay"]),
        (&8.into(), &7.into(), &1.into())
    );
    assert_eq!(all["bytes"], fs::metadata(&page).unwrap().len());
    assert!(
        fs::read_to_string(&page)
            .unwrap()
            .contains("<title>PlanAgent: one, other</title>")
    );
    let some = write(&["--scenario", "changing_lane"]);
    assert_eq!(some["replays"], 2, "{some}");
    let small = write(&["--max-mb", "0.16"]);
    assert!(
        small["replays"].as_u64() < all["replays"].as_u64(),
        "{small}"
    );
    assert!(small["bytes"].as_u64().unwrap() <= 160_000, "{small}");

    let nothing = refused(&["report", one.to_str().unwrap(), "--scenario", "submarine"]);
    assert!(nothing.contains("submarine"), "{nothing}");
    let no_run = refused(&["report", work.path().to_str().unwrap()]);
    assert!(no_run.contains("holds no run"), "{no_run}");
    let limit = refused(&["report", one.to_str().unwrap(), "--max-mb", "-1"]);
    assert!(limit.contains("--max-mb"), "{limit}");
    let replay = simulation_folders(&one)[0].join("replay.json.gz");
    fs::write(&replay, "no gzip").unwrap();
    // A file that cannot be read costs the replay of its simulation, and is named.
    let (code, _, stderr) = run(&["report", one.to_str().unwrap()]);
    assert!(
        code == 0 && stderr.contains("replay.json.gz"),
        "{code}: {stderr}"
    );
}

/// A larger picture has the page's colors and a legend.
fn looks_like_the_page(run_folder: &str, png: &str) {
    let style = include_str!("../../src/runs/report/page/assets/theme.css");
    let color = |name: &str| {
        let (_, after) = style.split_once(&format!("--{name}: #")).unwrap();
        [0, 2, 4].map(|i| u8::from_str_radix(&after[i..i + 2], 16).unwrap())
    };
    let pixels = 400;
    let (code, _, stderr) = run(&[
        "render", run_folder, "0", "--png", png, "--at", "2.0", "--pixels", "400",
    ]);
    assert_eq!(code, 0, "{stderr}");
    let picture = image::open(png).unwrap().to_rgb8();
    let count = |name: &str, rows: std::ops::Range<u32>| {
        picture
            .enumerate_pixels()
            .filter(|(_, y, pixel)| rows.contains(y) && pixel.0 == color(name))
            .count()
    };
    let (scene, text) = (0..pixels, pixels..picture.height());
    for name in ["ground", "road", "route", "ego"] {
        assert!(count(name, scene.clone()) > 100, "{name} in the scene");
    }
    // The swatches of the legend.
    for name in ["route", "road", "ego", "vehicle"] {
        assert!(count(name, text.clone()) > 20, "{name} in the legend");
    }
    // Antialiased letters have many shades.
    let shades: std::collections::BTreeSet<[u8; 3]> = picture
        .enumerate_pixels()
        .filter(|(_, y, _)| text.contains(y))
        .map(|(_, _, pixel)| pixel.0)
        .collect();
    assert!(shades.len() > 40, "{} shades", shades.len());
}

#[test]
fn a_simulation_is_rendered() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    simulate(&out, &scenes(1), "log-replay,simple");
    let run_folder = out.to_str().unwrap();
    let [gif, png, mp4] =
        ["a.gif", "a.png", "a.mp4"].map(|name| work.path().join(name).to_str().unwrap().to_owned());
    let small = ["--pixels", "160", "--view", "48"];
    let render = |more: &[&str]| {
        let (code, _, stderr) = run(&[&["render", run_folder], more, &small[..]].concat());
        assert_eq!(code, 0, "{stderr}");
    };
    render(&[
        "changing_lane/1",
        "--planner",
        "log-replay",
        "--gif",
        &gif,
        "--fps",
        "2",
    ]);
    let film =
        image::codecs::gif::GifDecoder::new(std::io::BufReader::new(fs::File::open(&gif).unwrap()))
            .unwrap();
    let frames = image::AnimationDecoder::into_frames(film)
        .collect_frames()
        .unwrap();
    assert_eq!(frames.len(), 31);
    assert_ne!(frames[0].buffer(), frames[30].buffer());
    render(&["0", "--png", &png, "--at", "3.0"]);
    let frame = image::open(&png).unwrap().to_rgb8();
    assert!(frame.width() == 160 && frame.height() > 160);
    // A decoded frame is the whole scene, not only its changes.
    let seen = frames[6].buffer();
    let close = |(a, b): (&image::Rgba<u8>, &image::Rgb<u8>)| {
        a.0[3] == 255 && (0..3).all(|i| a.0[i].abs_diff(b.0[i]) < 48)
    };
    let same = seen
        .pixels()
        .zip(frame.pixels())
        .filter(|&pair| close(pair))
        .count();
    assert!(
        same * 100 > 97 * seen.pixels().len(),
        "{same} of {} pixels",
        seen.pixels().len()
    );
    render(&["0", "--png", &png]);
    assert!(image::open(&png).unwrap().width() > 4 * 160);
    looks_like_the_page(run_folder, &png);

    let fails = |more: &[&str]| refused(&[&["render", run_folder], more].concat());
    let several = fails(&["changing_lane/1", "--png", &png]);
    assert!(
        several.contains("2 simulations") && several.contains("by log-replay, nonreactive"),
        "{several}"
    );
    assert!(fails(&["7", "--png", &png]).contains("no simulation '7'"));
    assert!(fails(&["0", "--png", &png, "--at", "99"]).contains("outside the simulation"));
    assert!(fails(&["0"]).contains("--gif"));
    // Without ffmpeg the error has a hint.
    let output = crate::cli::planagent()
        .args(film_of(run_folder, &mp4))
        .env("PATH", work.path())
        .output()
        .unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.code() == Some(2) && stderr.contains("ffmpeg") && stderr.contains("--gif"),
        "{stderr}"
    );
}

/// The arguments that render a film.
fn film_of<'a>(run_folder: &'a str, mp4: &'a str) -> [&'a str; 7] {
    ["render", run_folder, "0", "--mp4", mp4, "--pixels", "160"]
}

#[test]
fn ffmpeg_writes_a_film() -> Needy {
    program(&["ffmpeg"])?;
    let work = TempDir::new().unwrap();
    let [out, mp4] = ["run", "a.mp4"].map(|name| work.path().join(name));
    simulate(&out, &scenes(1), "log-replay");
    assert_eq!(
        run(&film_of(out.to_str().unwrap(), mp4.to_str().unwrap())).0,
        0
    );
    assert_eq!(&fs::read(&mp4).unwrap()[4..8], b"ftyp");
    Ok(())
}
