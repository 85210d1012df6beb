//! Run folders of strangers: links at every place, and wild values in every record. Whatever is
//! done with them, nothing outside of the folder changes, and nothing from outside arrives in a
//! page, an answer of the server or a copy.

use super::config::Config;
use super::event::silent;
use super::merge::merge;
use super::request::Request;
use super::simulate::{resume, start};
use crate::report::page::{self, LivePage, PageSettings};
use crate::report::render::{Film, Look, SimulationChoice};
use crate::report::{RunFolder, last_run};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use image::{ImageFormat, RgbImage};
use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;

/// What private files have in them.
const MARK: &[u8] = b"PRIVATE-BYTES-OF-THE-USER-5f2c";
/// Planning calls of a run, from the inputs of the fuzz targets.
const CALLS: &[u8] = include_bytes!("../../../fuzz/corpus/run_folder/whole_calls.bin");
/// Wild values that are tried, where `PROPTEST_CASES` gives no number.
const CASES: u32 = 64;

/// A work folder with a run and private files beside it.
struct Place {
    work: TempDir,
    private: BTreeMap<PathBuf, Vec<u8>>,
}

/// A run with one simulation, with planning calls and a picture; made once.
fn whole_run() -> &'static Path {
    static RUN: OnceLock<TempDir> = OnceLock::new();
    RUN.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let request = Request {
            scenarios: vec!["generated/changing_lane/0".to_owned()],
            planners: vec!["log-replay".to_owned()],
            ..Request::default()
        };
        let run = folder.path().join("run");
        start(&request, &Config::default(), Some(&run), &silent()).unwrap();
        let simulation = simulation_of(&run);
        fs::write(simulation.join("calls.jsonl"), &CALLS[1..]).unwrap();
        fs::create_dir_all(simulation.join("bev")).unwrap();
        let iteration =
            serde_json::from_slice::<Value>(first_line(&CALLS[1..])).unwrap()["iteration"]
                .as_u64()
                .unwrap();
        fs::write(simulation.join(format!("bev/{iteration:03}.png")), png(b"")).unwrap();
        renew_digests(&simulation);
        folder
    })
    .path()
}

fn first_line(text: &[u8]) -> &[u8] {
    text.split(|byte| *byte == b'\n').next().unwrap()
}

/// A picture with something behind it.
fn png(behind: &[u8]) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    RgbImage::new(4, 4)
        .write_to(&mut bytes, ImageFormat::Png)
        .unwrap();
    [bytes.get_ref().as_slice(), behind].concat()
}

fn simulation_of(run: &Path) -> PathBuf {
    let entry = fs::read_dir(run.join("simulations")).unwrap().next();
    entry.unwrap().unwrap().path()
}

/// Sets the digests in a record to those of the files, so that these are read.
fn renew_digests(simulation: &Path) {
    let path = simulation.join("record.toml");
    let Ok(mut record) = fs::read_to_string(&path).unwrap().parse::<toml::Table>() else {
        return;
    };
    let digest = |name: &str| {
        let bytes = fs::read(simulation.join(name)).unwrap();
        toml::Value::String(blake3::hash(&bytes).to_hex().to_string())
    };
    let files = ["metrics.toml", "calls.jsonl"].map(|name| (name.to_owned(), digest(name)));
    record.insert("files".to_owned(), toml::Table::from_iter(files).into());
    fs::write(path, record.to_string()).unwrap();
}

fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy_folder(&path, &target);
        } else {
            fs::copy(&path, &target).unwrap();
        }
    }
}

/// All files below a folder with their bytes; of a link, where it leads.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let kind = fs::symlink_metadata(&path).unwrap().file_type();
        if kind.is_dir() {
            found.insert(path.clone(), Vec::new());
            found.extend(files(&path));
        } else if kind.is_file() {
            found.insert(path.clone(), fs::read(&path).unwrap());
        } else if kind.is_symlink() {
            let target = fs::read_link(&path).unwrap();
            found.insert(path, target.to_string_lossy().into_owned().into_bytes());
        }
    }
    found
}

impl Place {
    fn new() -> Self {
        let work = tempfile::tempdir().unwrap();
        copy_folder(&whole_run().join("run"), &work.path().join("run"));
        let private = work.path().join("private");
        copy_folder(
            &simulation_of(&work.path().join("run")),
            &private.join("simulation"),
        );
        fs::write(private.join("secret"), MARK).unwrap();
        fs::write(private.join("picture"), png(MARK)).unwrap();
        let simulation = private.join("simulation");
        for name in ["record.toml", "metrics.toml", "transcript.md"] {
            let before = fs::read(simulation.join(name)).unwrap_or_default();
            let comment = [&before[..], b"\n# ", MARK, b"\n"].concat();
            fs::write(simulation.join(name), comment).unwrap();
        }
        let record = fs::read_to_string(simulation.join("record.toml")).unwrap();
        let marked = record.replace(
            "log_name = \"generated\"",
            &format!("log_name = \"{}\"", String::from_utf8_lossy(MARK)),
        );
        fs::write(simulation.join("record.toml"), marked).unwrap();
        renew_digests(&simulation);
        Self {
            private: files(&private),
            work,
        }
    }

    fn run(&self) -> PathBuf {
        self.work.path().join("run")
    }

    /// Does everything with the run, and checks what the user would notice.
    fn check(&self, what: &str, draws: bool) {
        let run = self.run();
        let mut seen: Vec<Vec<u8>> = Vec::new();
        let runs = [run.clone()];
        let _ = RunFolder::check_new(Some(&run));
        let _ = last_run();
        let settings = PageSettings::default();
        let out = self.work.path().join("out.html");
        for out in [None, Some(out.as_path())] {
            if let Ok(contents) = page::write(&runs, out, &settings, &|_, _| ()) {
                seen.push(fs::read(contents.page).unwrap());
            }
        }
        if let Ok(live) = LivePage::open(&runs, &|_, _| ()) {
            let state = live.state();
            seen.push(state.index().to_vec());
            for part in ["simulation-0", "map-0", "images-0"] {
                seen.extend(state.part(part).ok().flatten());
            }
        }
        if draws {
            let choice = SimulationChoice {
                simulation: "0".to_owned(),
                ..SimulationChoice::default()
            };
            let look = Look {
                pixels: 64,
                meters: 50.0,
            };
            let _ = Film::open(&run, &choice, look);
        }
        let copy = self.work.path().join("copy");
        let _ = merge(&runs, Some(&copy));
        if copy.is_dir() {
            seen.extend(files(&copy).into_values());
        }
        if let Ok(config) = Config::of_run(&run) {
            let _ = resume(&run, &Request::default(), &config, &silent());
        }
        for bytes in &seen {
            assert!(!reveals(bytes, 0), "{what}: a private byte is shown");
        }
        assert_eq!(
            files(&self.work.path().join("private")),
            self.private,
            "{what}: a private file changed"
        );
        let mut names: Vec<String> = fs::read_dir(self.work.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.retain(|name| !["copy", "out.html", "private", "run"].contains(&name.as_str()));
        assert_eq!(names, Vec::<String>::new(), "{what}: files outside");
    }
}

/// Whether bytes have the mark in them, also packed or in base64.
fn reveals(bytes: &[u8], depth: usize) -> bool {
    if bytes.windows(MARK.len()).any(|part| part == MARK) {
        return true;
    }
    if depth > 4 {
        return false;
    }
    if bytes.starts_with(&[0x1f, 0x8b]) {
        let mut text = Vec::new();
        let _ = GzDecoder::new(bytes).read_to_end(&mut text);
        return reveals(&text, depth + 1);
    }
    let is_digit = |byte: &u8| byte.is_ascii_alphanumeric() || b"+/=".contains(byte);
    bytes
        .split(|byte| !is_digit(byte))
        .filter(|word| word.len() >= MARK.len())
        .filter_map(|word| STANDARD.decode(word).ok())
        .any(|decoded| reveals(&decoded, depth + 1))
}

#[test]
fn the_mark_is_found_where_it_is_hidden() {
    let picture = STANDARD.encode(png(MARK));
    let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
    write!(packed, "{{\"0\":\"{picture}\"}}").unwrap();
    let page = format!("<p>{}<", STANDARD.encode(packed.finish().unwrap()));
    assert!(reveals(page.as_bytes(), 0) && !reveals(&png(b""), 0));
}

/// The places of a run where a link is tried: what is there, and what is written.
fn places(run: &Path) -> Vec<PathBuf> {
    let simulation = simulation_of(run);
    let mut places: Vec<PathBuf> = files(run).into_keys().collect();
    let name = simulation.file_name().unwrap().to_string_lossy();
    let challenge = run.join("closed_loop_nonreactive_agents");
    places.extend(
        [
            ".lock",
            "report.html",
            "calls.jsonl",
            ".unfinished-report.html",
        ]
        .map(|n| run.join(n)),
    );
    places.extend(
        [
            ".unfinished-run.nuboard",
            ".unfinished-runner_report.parquet",
        ]
        .map(|n| challenge.join(n)),
    );
    places.push(run.join("simulations").join(format!(".unfinished-{name}")));
    places.push(run.join("simulations/000001-other"));
    places.push(simulation.join("bev/001.png"));
    places
}

#[cfg(unix)]
#[test]
fn links_at_every_place_lead_nowhere() {
    use std::os::unix::fs::symlink;
    let first = Place::new();
    first.check("the run as it was made", true);
    let root = first.run();
    for place in places(&root) {
        let inside = place.strip_prefix(&root).unwrap();
        let targets: &[&str] = match place.extension() {
            _ if place.is_dir() => &["simulation", "new"],
            Some(ending) if ending == "png" => &["secret", "picture", "new"],
            Some(_) => &["secret", "new"],
            None => &["secret", "simulation", "new"],
        };
        for target in targets {
            let other = Place::new();
            let link = other.run().join(inside);
            let kind = fs::symlink_metadata(&link).map(|metadata| metadata.file_type());
            match kind {
                Ok(kind) if kind.is_dir() => fs::remove_dir_all(&link).unwrap(),
                Ok(_) => fs::remove_file(&link).unwrap(),
                Err(_) => {}
            }
            fs::create_dir_all(link.parent().unwrap()).unwrap();
            symlink(other.work.path().join("private").join(target), &link).unwrap();
            // What a run that was not finished writes.
            let _ = fs::remove_file(other.run().join("summary.json"));
            other.check(&format!("{} leads to {target}", inside.display()), true);
        }
    }
}

#[cfg(unix)]
#[test]
fn pipes_are_not_waited_for() {
    for place in places(&whole_run().join("run")) {
        let inside = place.strip_prefix(whole_run().join("run")).unwrap();
        let other = Place::new();
        let pipe = other.run().join(inside);
        if pipe.is_dir() {
            continue;
        }
        let _ = fs::remove_file(&pipe);
        fs::create_dir_all(pipe.parent().unwrap()).unwrap();
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.is_ok_and(|status| status.success()));
        other.check(&format!("{} is a pipe", inside.display()), true);
    }
}

/// The records of a run.
const RECORDS: [&str; 5] = [
    "manifest.toml",
    "record.toml",
    "metrics.toml",
    "calls.jsonl",
    "replay.json.gz",
];

/// Values that nobody writes.
fn wild() -> impl Strategy<Value = Value> {
    prop_oneof![
        Just(Value::from("../../private/secret")),
        Just(Value::from("a/../../../../private/new")),
        Just(Value::from("/")),
        Just(Value::from("..")),
        Just(Value::from("")),
        Just(Value::from("\u{1b}[2J\u{202e}")),
        Just(Value::from(1e308)),
        Just(Value::from(-1)),
        Just(Value::from(i64::MAX)),
        Just(Value::from(u64::MAX)),
        Just(Value::from(true)),
        Just(Value::Array(Vec::new())),
        Just(serde_json::json!({})),
        Just(serde_json::json!({"..": "../.."})),
        "\\PC{0,12}".prop_map(Value::from),
    ]
}

/// Replaces the value at a place among all values, in the order of the text.
fn replace(value: &mut Value, place: &mut usize, by: &Value) -> bool {
    if *place == 0 {
        *value = by.clone();
        return true;
    }
    *place -= 1;
    match value {
        Value::Array(entries) => entries.iter_mut().any(|entry| replace(entry, place, by)),
        Value::Object(fields) => fields.values_mut().any(|field| replace(field, place, by)),
        _ => false,
    }
}

fn count(value: &Value) -> usize {
    1 + match value {
        Value::Array(entries) => entries.iter().map(count).sum(),
        Value::Object(fields) => fields.values().map(count).sum(),
        _ => 0,
    }
}

/// Changes one value of a record.
fn change(place: &Place, record: &str, at: usize, by: &Value) {
    let simulation = simulation_of(&place.run());
    let path = match record {
        "manifest.toml" => place.run().join(record),
        _ => simulation.join(record),
    };
    let bytes = fs::read(&path).unwrap();
    let changed = |mut value: Value| {
        let mut at = at % count(&value);
        replace(&mut value, &mut at, by);
        value
    };
    let kind = Path::new(record).extension();
    let written = if kind == Some("toml".as_ref()) {
        let table: toml::Table = String::from_utf8(bytes).unwrap().parse().unwrap();
        let value = changed(serde_json::to_value(table).unwrap());
        // A table has no null, and a number of a table is at most that of 64 bits with a sign.
        toml::to_string(&value).unwrap_or_default().into_bytes()
    } else if kind == Some("gz".as_ref()) {
        let mut text = String::new();
        GzDecoder::new(&bytes[..])
            .read_to_string(&mut text)
            .unwrap();
        let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
        let value = changed(serde_json::from_str(&text).unwrap());
        write!(packed, "{value}").unwrap();
        packed.finish().unwrap()
    } else {
        format!(
            "{}\n",
            changed(serde_json::from_slice(first_line(&bytes)).unwrap())
        )
        .into_bytes()
    };
    fs::write(&path, written).unwrap();
    if record != "record.toml" {
        renew_digests(&simulation);
    }
}

#[test]
fn wild_values_in_records_change_and_show_nothing_private() {
    let asked = std::env::var("PROPTEST_CASES").ok();
    let config = ProptestConfig {
        cases: asked.map_or(CASES, |count| count.parse().unwrap()),
        failure_persistence: None,
        ..ProptestConfig::default()
    };
    let rng = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    let mut runner = TestRunner::new_with_rng(config, rng);
    let strategy = (0..RECORDS.len(), any::<u16>(), wild());
    let tried = runner.run(&strategy, |(record, at, by)| {
        let (place, record) = (Place::new(), RECORDS[record]);
        change(&place, record, at.into(), &by);
        place.check(&format!("{record}: value {at} is {by}"), false);
        Ok(())
    });
    if let Err(failed) = tried {
        panic!("{failed}");
    }
}
