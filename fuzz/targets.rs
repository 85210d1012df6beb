//! What the fuzz targets do with bytes: the readers and parsers of outside data, through the
//! functions that the program uses. A target must end and must not panic. It tells whether its
//! input was read to the end, which is asked only of the inputs that are named `whole`: they show
//! that a target reaches what lies behind the shell of its format. `tests/fuzz_corpus.rs` gives
//! each the files of its corpus.
//!
//! An input that begins with `=` is a text that [`formats`] writes as a file of the target's
//! format; any other input is the file.

mod formats;
mod lab;
mod planning;

use planagent_agent::environment::bev;
use planagent_agent::environment::text::{TextForm, write as write_text};
use planagent_agent::environment::{CenterlineName, DEFAULT_NODE_LENGTH, Description, LaneGraph};
use planagent_agent::reasoning::{
    AssistVariant, Feedback, MotionInstruction, Names, PromptSet, Round, feedback_text, parse,
    parse_assistance, round_prompt, system_prompt,
};
use planagent_learned::Checkpoint;
use planagent_mllm::{
    AdapterSpec, Constraint, Deadline, HubAccess, Loading, LocalModel, ModelPlace, ModelRegistry,
    ModelSpec, PromptPrefix, Request, Sampling,
};
use planagent_runs::report::page::{self, PageSettings};
use planagent_runs::report::render::{Film, Look, SimulationChoice};
use planagent_runs::report::{RunFolder, last_run_of};
use planagent_runs::runner::Config;
use planagent_scenario::generator::{Spec, generate, types};
use planagent_scenario::nuplan::export::{ExportSettings, write_scenario};
use planagent_scenario::nuplan::{FilterFile, MapStore};
use planagent_scenario::{DataRoots, Readers};
use planagent_world::{ObjectKind, Scene};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::thread;
use tempfile::TempDir;

/// A target with its name.
pub(crate) type Target = (&'static str, fn(&[u8]) -> bool);

/// All targets.
pub(crate) const TARGETS: [Target; 32] = [
    ("planner_code", planner_code),
    ("answers", answers),
    ("prompts", prompts),
    ("lane_graph_text", lane_graph_text),
    ("chat_template", chat_template),
    ("tfrecord", tfrecord),
    ("argoverse2", argoverse2),
    ("nuplan_log", nuplan_log),
    ("nuplan_map", nuplan_map),
    ("filter", filter),
    ("configuration", configuration),
    ("gguf", gguf),
    ("safetensors", safetensors),
    ("adapter", adapter),
    ("quantized_folder", quantized_folder),
    ("run_folder", run_folder),
    ("run_manifest", |bytes| run_record(0, bytes)),
    ("run_record", |bytes| run_record(1, bytes)),
    ("run_metrics", |bytes| run_record(2, bytes)),
    ("run_calls", |bytes| run_record(3, bytes)),
    ("run_replay", |bytes| run_record(4, bytes)),
    ("run_picture", |bytes| run_record(5, bytes)),
    ("run_summary", |bytes| run_record(6, bytes)),
    ("endpoint_reply", endpoint_reply),
    ("modification", modification),
    ("checkpoint", checkpoint),
    ("model_file", model_file),
    ("agent_answers", planning::agent_answers),
    ("agent_memory", planning::agent_memory),
    ("exec_answer", planning::exec_answer),
    ("study", lab::study),
    ("lab_folder", lab::lab_folder),
];

/// Runs the target of a name; true when it read the input to its end.
pub(crate) fn run(name: &str, bytes: &[u8]) -> bool {
    TARGETS
        .iter()
        .find(|(known, _)| *known == name)
        .is_some_and(|(_, target)| target(bytes))
}

/// A folder with files.
fn folder(files: &[(&str, &[u8])]) -> TempDir {
    let folder = TempDir::new().expect("a folder for files");
    for (name, bytes) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("a file lies in a folder"))
            .expect("a folder can be made");
        fs::write(path, bytes).expect("a file can be written");
    }
    folder
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The text of an input that is one, without its mark.
fn as_text(bytes: &[u8]) -> Option<String> {
    bytes.strip_prefix(b"=").map(text)
}

/// The two parts of a text around a line of `---`; the second may be missing.
fn parts(text: &str) -> (&str, &str) {
    text.split_once("\n---\n").unwrap_or((text, ""))
}

/// A file of the project, from the folder of the targets or of the tests.
fn of_project(path: &str) -> Option<PathBuf> {
    let place = Path::new(env!("CARGO_MANIFEST_DIR"));
    place
        .ancestors()
        .map(|above| above.join(path))
        .find(|path| path.exists())
}

/// What a scene text may name.
fn names() -> Names {
    let lead_agents = ["vehicle1", "vehicle2", "obstacle1"]
        .map(str::parse)
        .into_iter()
        .flatten()
        .collect();
    Names {
        centerlines: CenterlineName::ALL.to_vec(),
        lead_agents,
        speed_limit: Some(13),
    }
}

fn planner_code(bytes: &[u8]) -> bool {
    let parsed = parse(&text(bytes), &names());
    assert!(
        parsed
            .errors
            .iter()
            .all(|error| error.span.end <= text(bytes).len()),
        "an error lies behind the text"
    );
    parsed.errors.is_empty()
}

fn answers(bytes: &[u8]) -> bool {
    let answer = text(bytes);
    let variants = [AssistVariant::Unconstrained, AssistVariant::Parameters];
    let assists = variants.map(|variant| parse_assistance(&answer, variant).errors.is_empty());
    MotionInstruction::find(&answer).is_some() || assists.contains(&true)
}

/// The first byte chooses which file of a prompt set has the rest.
fn prompts(bytes: &[u8]) -> bool {
    const FILES: [&str; 6] = [
        "set.toml",
        "system.jinja",
        "understanding.jinja",
        "instruction.jinja",
        "code.jinja",
        "feedback.jinja",
    ];
    let Some((choice, rest)) = bytes.split_first() else {
        return false;
    };
    let settings =
        &b"scene_text = 'compact'\nunderstanding = 'choices'\ninstruction = 'choices'\n"[..];
    let of = |i: usize| match i {
        _ if i == usize::from(*choice) % FILES.len() => rest,
        0 => settings,
        _ => b"text",
    };
    let files: Vec<(&str, &[u8])> = FILES
        .iter()
        .enumerate()
        .map(|(i, name)| (*name, of(i)))
        .collect();
    let folder = folder(&files);
    let Ok(set) = PromptSet::open(&folder.path().to_string_lossy()) else {
        return false;
    };
    let _ = system_prompt(&set, "legend");
    for &round in Round::ALL {
        let _ = round_prompt(&set, round, &names(), Some("speed 9"), Some("again"));
    }
    let feedback = Feedback {
        code: None,
        score: Some(0.5),
        threshold: 0.75,
        parts: Vec::new(),
        is_slow: false,
        errors: Vec::new(),
    };
    feedback_text(&set, &feedback).is_ok()
}

/// What is drawn and said of a scene. A line is a call of the builder: `limit`, `width`, `lanes
/// COUNT X Y X Y ...`, `connector X Y ...`, `route LANE ...`, `ego X Y HEADING SPEED`, and objects
/// by their kind.
fn lane_graph_text(bytes: &[u8]) -> bool {
    /// Coordinates of the scene, meters: a longer road takes longer than it tells.
    const FARTHEST: f64 = 2_000.0;
    let Some(written) = as_text(bytes) else {
        return TextForm::is_compact(&text(bytes));
    };
    let mut scene = Scene::builder();
    for line in written.lines().take(64) {
        let (word, rest) = line.split_once(' ').unwrap_or((line, ""));
        let numbers: Vec<f64> = rest
            .split(' ')
            .filter_map(|number| number.parse().ok())
            .collect();
        let near = numbers.iter().all(|number| number.abs() <= FARTHEST);
        let points = |numbers: &[f64]| {
            numbers
                .chunks_exact(2)
                .map(|at| [at[0], at[1]])
                .collect::<Vec<_>>()
        };
        let kind = match word {
            "vehicle" => ObjectKind::Vehicle,
            "pedestrian" => ObjectKind::Pedestrian,
            "bicycle" => ObjectKind::Bicycle,
            "cone" => ObjectKind::TrafficCone,
            _ => ObjectKind::GenericObject,
        };
        scene = match (word, &numbers[..]) {
            ("limit", []) => scene.speed_limit(None),
            ("limit", [limit, ..]) => scene.speed_limit(*limit),
            ("width", [width, ..]) if near => scene.lane_width(*width),
            ("lanes", [count, line @ ..]) if near => {
                scene.lanes(count.clamp(0.0, 8.0) as usize, points(line))
            }
            ("connector", line) if near => scene.connector(points(line)),
            ("route", lanes) => scene.route(lanes.iter().map(|lane| *lane as usize)),
            ("ego", [x, y, heading, speed]) => scene.ego([*x, *y], *heading, *speed),
            (_, [x, y, heading, speed]) => scene.object(kind, [*x, *y], *heading, *speed),
            _ => scene,
        };
    }
    let Ok(scene) = scene.build() else {
        return false;
    };
    let _ = bev::render(&scene.view(), &bev::BevView::default());
    let Ok(graph) = LaneGraph::build(&scene.view(), DEFAULT_NODE_LENGTH) else {
        return false;
    };
    for form in [
        TextForm::Paper,
        TextForm::Brief,
        TextForm::Compact,
        TextForm::Compact2,
    ] {
        let said = write_text(&Description::from_graph(&graph), form);
        assert!(
            !said.contains("NaN") && !said.contains("inf"),
            "a number of the text is not finite: {said}"
        );
    }
    true
}

/// A small model of each family whose folders have configurations of their own.
const TINY: [&str; 9] = [
    "tiny_llava",
    "tiny_qwen2_vl",
    "tiny_llava_onevision",
    "tiny_qwen3_5",
    "tiny_lfm2_vl",
    "tiny_gemma3",
    "tiny_gemma3n_vision",
    "tiny_gemma4",
    "tiny_smolvlm",
];

/// The copy of a small model, made once; a target writes one of its files again for each input.
fn tiny_model(name: &'static str) -> Option<PathBuf> {
    thread_local! {
        static MODELS: RefCell<BTreeMap<&'static str, TempDir>> = const { RefCell::new(BTreeMap::new()) };
    }
    let tiny = of_project(&format!("tests/fixtures/{name}"))?;
    MODELS.with_borrow_mut(|models| {
        let copied = models.entry(name).or_insert_with(|| {
            let model = TempDir::new().expect("a folder for files");
            let entries = fs::read_dir(tiny).expect("the fixture can be read");
            let files = entries.flatten().filter(|entry| entry.path().is_file());
            for entry in files {
                fs::copy(entry.path(), model.path().join(entry.file_name()))
                    .expect("a fixture can be copied");
            }
            model
        });
        Some(copied.path().to_owned())
    })
}

/// A model folder with this chat template: the template is reached only where all else is as it
/// should be.
fn chat_template(bytes: &[u8]) -> bool {
    let Some(model) = tiny_model(TINY[0]) else {
        return false;
    };
    let file = model.join("chat_template.jinja");
    let kept = fs::read(&file).expect("the model has a template");
    fs::write(&file, bytes).expect("a file can be written");
    let fits = check(&ModelPlace::Folder(model));
    fs::write(&file, kept).expect("a file can be written");
    fits
}

/// A tiny model in which one file has these bytes; the first byte chooses model and file.
fn model_file(bytes: &[u8]) -> bool {
    const FILES: [&str; 6] = [
        "config.json",
        "generation_config.json",
        "preprocessor_config.json",
        "tokenizer_config.json",
        "planagent.json",
        "model.safetensors.index.json",
    ];
    let Some((choice, rest)) = bytes.split_first() else {
        return false;
    };
    let choice = usize::from(*choice);
    let Some(model) = tiny_model(TINY[choice / FILES.len() % TINY.len()]) else {
        return false;
    };
    let file = model.join(FILES[choice % FILES.len()]);
    let kept = fs::read(&file).ok();
    fs::write(&file, rest).expect("a file can be written");
    let place = ModelPlace::Folder(model.clone());
    let fits = check(&place);
    let word = model.to_string_lossy();
    let registry = ModelRegistry::new(PathBuf::from("models"), HubAccess::default());
    let asking = registry.find(&word).and_then(|spec| registry.asking(&spec));
    match kept {
        Some(bytes) => fs::write(&file, bytes).expect("a file can be written"),
        None => fs::remove_file(&file).expect("a file can be removed"),
    }
    fits && asking.is_ok()
}

/// Finds and opens the first scenarios in a file or folder; true when one opens.
fn open_all(roots: &DataRoots, place: &Path) -> bool {
    let Ok(found) = Readers::new(roots).find(&place.to_string_lossy()) else {
        return false;
    };
    found
        .iter()
        .take(4)
        .filter(|scenario| scenario.open().is_ok())
        .count()
        > 0
}

fn tfrecord(bytes: &[u8]) -> bool {
    let written = as_text(bytes).map(|text| formats::tfrecord(&text));
    let folder = folder(&[("a.tfrecord", written.as_deref().unwrap_or(bytes))]);
    open_all(&DataRoots::default(), &folder.path().join("a.tfrecord"))
}

/// The first byte of a file chooses which files of a log have the rest. The second byte of a text
/// chooses which file of a whole log it replaces: the map, the poses, the annotations, or the table
/// of a scenario.
fn argoverse2(bytes: &[u8]) -> bool {
    const MAP: &str = include_str!("corpus/argoverse2/whole_map.txt");
    const POSES: &str = include_str!("corpus/argoverse2/whole_poses.txt");
    const ANNOTATIONS: &str = include_str!("corpus/argoverse2/whole_annotations.txt");
    const SCENARIO: &str = include_str!("corpus/argoverse2/whole_scenario.txt");
    let folder = if let Some(text) = as_text(bytes) {
        let of = |base: &'static str| {
            if text.get(..1) == base.get(1..2) {
                text[1..].to_owned()
            } else {
                base[2..].to_owned()
            }
        };
        if text.starts_with('s') {
            folder(&[
                ("scenario_a.parquet", &formats::parquet(&of(SCENARIO))),
                ("log_map_archive_a.json", of(MAP).as_bytes()),
            ])
        } else {
            folder(&[
                ("city_SE3_egovehicle.feather", &formats::feather(&of(POSES))),
                ("annotations.feather", &formats::feather(&of(ANNOTATIONS))),
                (
                    "map/log_map_archive_a____PIT_city_1.json",
                    of(MAP).as_bytes(),
                ),
            ])
        }
    } else {
        let Some((choice, rest)) = bytes.split_first() else {
            return false;
        };
        let files: &[&str] = if choice % 2 == 0 {
            &[
                "city_SE3_egovehicle.feather",
                "annotations.feather",
                "map/log_map_archive_a.json",
            ]
        } else {
            &["scenario_a.parquet", "log_map_archive_a.json"]
        };
        folder(&files.iter().map(|name| (*name, rest)).collect::<Vec<_>>())
    };
    open_all(&DataRoots::default(), folder.path())
}

/// A small nuPlan data set, written once: its log, and its map under the location `a`.
fn data_set() -> &'static (Vec<u8>, Vec<u8>) {
    /// What a target need not read: most of the agents and of the time.
    const SMALLER: &str =
        "DELETE FROM lidar_box WHERE track_token NOT IN (SELECT token FROM track LIMIT 6);
        DELETE FROM track WHERE token NOT IN (SELECT track_token FROM lidar_box); VACUUM";
    static WRITTEN: OnceLock<(Vec<u8>, Vec<u8>)> = OnceLock::new();
    WRITTEN.get_or_init(|| {
        let folder = TempDir::new().expect("a folder for files");
        let out = folder.path().join("out");
        let scenario =
            generate(&Spec::new(types::changing_lane::TYPE, 0)).expect("the scenario is generated");
        let settings = ExportSettings {
            location: Some("a".to_owned()),
            ..ExportSettings::default()
        };
        write_scenario(&scenario, &out, &settings).expect("the scenario is exported");
        let log = fs::read_dir(out.join("data"))
            .expect("a folder of logs")
            .flatten()
            .next()
            .expect("a log")
            .path();
        let database = rusqlite::Connection::open(&log).expect("the log opens");
        database
            .execute_batch(SMALLER)
            .expect("the log gets smaller");
        drop(database);
        let map = out.join("maps/a/1.0/map.gpkg");
        (
            fs::read(log).expect("the log is there"),
            fs::read(map).expect("the map is there"),
        )
    })
}

/// A data set with these two files. A text is SQL that changes one of them.
fn open_data_set(log: &[u8], map: &[u8], changed: Option<(&str, &str)>) -> bool {
    let index = br#"{"a": {"version": "1.0"}}"#;
    let folder = folder(&[
        ("maps/nuplan-maps-v1.0.json", index),
        ("maps/a/1.0/map.gpkg", map),
        ("data/log.db", log),
    ]);
    if let Some((file, sql)) = changed {
        formats::change_database(&folder.path().join(file), sql);
    }
    let roots = DataRoots {
        data: Some(folder.path().join("data")),
        maps: Some(folder.path().join("maps")),
    };
    open_all(&roots, &folder.path().join("data/log.db"))
}

fn nuplan_log(bytes: &[u8]) -> bool {
    let (log, map) = data_set();
    match as_text(bytes) {
        Some(sql) => open_data_set(log, map, Some(("data/log.db", &sql))),
        None => open_data_set(bytes, map, None),
    }
}

fn nuplan_map(bytes: &[u8]) -> bool {
    let (log, map) = data_set();
    if let Some(sql) = as_text(bytes) {
        return open_data_set(log, map, Some(("maps/a/1.0/map.gpkg", &sql)));
    }
    let index = br#"{"us-ma-boston": {"version": "1"}}"#;
    let folder = folder(&[
        ("nuplan-maps-v1.0.json", index),
        ("us-ma-boston/1/map.gpkg", bytes),
    ]);
    MapStore::new(Some(folder.path().to_owned()))
        .map("us-ma-boston")
        .is_ok()
}

fn filter(bytes: &[u8]) -> bool {
    let folder = folder(&[("filter.yaml", bytes)]);
    FilterFile::open(&folder.path().join("filter.yaml")).is_ok()
}

fn configuration(bytes: &[u8]) -> bool {
    let folder = folder(&[("planagent.toml", bytes)]);
    let settings = Config::load(Some(&folder.path().join("planagent.toml")));
    let description = ModelSpec::parse(Path::new("model.toml"), &text(bytes));
    settings.is_ok() || description.is_ok()
}

fn check(place: &ModelPlace) -> bool {
    LocalModel::check(place, &Loading::default())
        .problems
        .is_empty()
}

/// A text has two files: the model, and the picture tower behind a line of `---`.
fn gguf(bytes: &[u8]) -> bool {
    let written = as_text(bytes);
    let (model, mmproj) = match written.as_deref().map(parts) {
        Some((model, "")) => (formats::gguf(model), None),
        Some((model, mmproj)) => (formats::gguf(model), Some(formats::gguf(mmproj))),
        None => (bytes.to_vec(), None),
    };
    // An empty file beside the model would be a tower that cannot be read.
    let tower = mmproj.as_deref().map(|tower| ("mmproj.gguf", tower));
    let files: Vec<(&str, &[u8])> = [("model.gguf", model.as_slice())]
        .into_iter()
        .chain(tower)
        .collect();
    let folder = folder(&files);
    let mmproj = mmproj.map(|_| folder.path().join("mmproj.gguf"));
    check(&ModelPlace::Gguf {
        model: folder.path().join("model.gguf"),
        mmproj,
    })
}

/// A text has a configuration, and behind a line of `---` the header of the weights, which are
/// zero.
fn safetensors(bytes: &[u8]) -> bool {
    /// Bytes of a file of weights; it is sparse.
    const MAX_WEIGHTS: u64 = 1 << 34;
    let Some(written) = as_text(bytes) else {
        let config = br#"{"model_type": "llava"}"#;
        let folder = folder(&[("config.json", config), ("model.safetensors", bytes)]);
        return check(&ModelPlace::Folder(folder.path().to_owned()));
    };
    with_weights(&written, MAX_WEIGHTS, &[], |model| {
        check(&ModelPlace::Folder(model.to_owned()))
    })
}

/// The tiny model with packed layers. A text is as that of [`safetensors`]; behind a further line
/// of `---` are pieces of the weights: an offset, and bytes as hexadecimal digits or, behind `"`,
/// as text. All other bytes are `0x3c`, so that no scale is zero.
fn quantized_folder(bytes: &[u8]) -> bool {
    /// Bytes of a file of weights.
    const MAX_WEIGHTS: u64 = 1 << 20;
    let Some(written) = as_text(bytes) else {
        return false;
    };
    let (head, pieces) = match written.rsplit_once("\n---\n") {
        Some((head, pieces)) if head.contains("\n---\n") => (head, pieces),
        _ => (written.as_str(), ""),
    };
    let piece = |line: &str| {
        let (offset, piece) = line.split_once(' ')?;
        let bytes = match piece.strip_prefix('"') {
            Some(text) => text.as_bytes().to_vec(),
            None => (0..piece.len() / 2)
                .filter_map(|at| u8::from_str_radix(piece.get(2 * at..2 * at + 2)?, 16).ok())
                .collect(),
        };
        Some((offset.parse().ok()?, bytes))
    };
    let pieces: Vec<(u64, Vec<u8>)> = pieces.lines().filter_map(piece).collect();
    with_weights(head, MAX_WEIGHTS, &pieces, |model| {
        let place = ModelPlace::Folder(model.to_owned());
        check(&place) && LocalModel::load("packed", &place, &Loading::default()).is_ok()
    })
}

/// Runs `use_model` with the tiny model, whose configuration and header of weights are those of a
/// text. `pieces` of the weights are set; where there are some, the others are `0x3c`, else zero.
fn with_weights(
    written: &str,
    most: u64,
    pieces: &[(u64, Vec<u8>)],
    use_model: impl Fn(&Path) -> bool,
) -> bool {
    let (config, header) = parts(written);
    let Some(model) = tiny_model(TINY[0]) else {
        return false;
    };
    let kept = ["config.json", "model.safetensors"]
        .map(|name| (model.join(name), fs::read(model.join(name))));
    fs::write(model.join("config.json"), config).expect("a file can be written");
    write_weights(&model.join("model.safetensors"), header, most, pieces);
    let fits = use_model(&model);
    for (path, bytes) in kept {
        fs::write(path, bytes.expect("the model has the file")).expect("a file can be written");
    }
    fits
}

/// Writes a safetensors file of at most `most` bytes of weights with this header.
fn write_weights(path: &Path, header: &str, most: u64, pieces: &[(u64, Vec<u8>)]) {
    let head = [&(header.len() as u64).to_le_bytes()[..], header.as_bytes()].concat();
    let ends = header.split("\"data_offsets\"").skip(1).filter_map(|rest| {
        rest.split(']')
            .next()?
            .rsplit(|c: char| !c.is_ascii_digit())
            .find(|word| !word.is_empty())?
            .parse::<u64>()
            .ok()
    });
    let weights = ends.max().unwrap_or(0).min(most);
    let mut file = fs::File::create(path).expect("a file can be written");
    let written = if pieces.is_empty() {
        let length = head.len() as u64 + weights;
        file.write_all(&head).and_then(|()| file.set_len(length))
    } else {
        let mut data = vec![0x3c; weights as usize];
        for (offset, piece) in pieces {
            let places = data.iter_mut().skip(*offset as usize);
            places.zip(piece).for_each(|(place, byte)| *place = *byte);
        }
        file.write_all(&[head, data].concat())
    };
    written.expect("a file can be written");
}

/// An adapter of a small model: a GGUF file, or a text. A text has the entries of a GGUF file, or
/// the settings of PEFT, and behind a line of `---` the header of the weights, which are zero.
fn adapter(bytes: &[u8]) -> bool {
    /// Bytes of a file of weights; it is sparse.
    const MAX_WEIGHTS: u64 = 1 << 34;
    let Some(model) = tiny_model(TINY[0]) else {
        return false;
    };
    let folder = match as_text(bytes) {
        None => folder(&[("adapter.gguf", bytes)]),
        Some(text) if !text.trim_start().starts_with('{') => {
            folder(&[("adapter.gguf", &formats::gguf(&text))])
        }
        Some(text) => {
            let (settings, header) = parts(&text);
            let folder = folder(&[("adapter_config.json", settings.as_bytes())]);
            let weights = folder.path().join("adapter_model.safetensors");
            write_weights(&weights, header, MAX_WEIGHTS, &[]);
            folder
        }
    };
    let file = folder.path().join("adapter.gguf");
    let place = if file.is_file() {
        file
    } else {
        folder.path().to_owned()
    };
    let loading = Loading {
        adapter: Some(AdapterSpec::new(place)),
        ..Loading::default()
    };
    LocalModel::check(&ModelPlace::Folder(model), &loading)
        .problems
        .is_empty()
}

/// A complete run in which one file, by its place in [`run_folder`], has these bytes.
fn run_record(file: u8, bytes: &[u8]) -> bool {
    run_folder(&[&[file], bytes].concat())
}

/// The first byte chooses which file of a complete run has the rest. The words `METRICS` and
/// `CALLS` of a record become the digests of the two files: with another digest, a file is not
/// read.
fn run_folder(bytes: &[u8]) -> bool {
    const FILES: [(&str, &[u8]); 7] = [
        (
            "manifest.toml",
            include_bytes!("corpus/run_folder/whole_manifest.bin"),
        ),
        (
            "simulations/000000-a/record.toml",
            include_bytes!("corpus/run_folder/whole_record.bin"),
        ),
        (
            "simulations/000000-a/metrics.toml",
            include_bytes!("corpus/run_folder/whole_metrics.bin"),
        ),
        (
            "simulations/000000-a/calls.jsonl",
            include_bytes!("corpus/run_folder/whole_calls.bin"),
        ),
        (
            "simulations/000000-a/replay.json.gz",
            include_bytes!("corpus/run_folder/whole_replay.bin"),
        ),
        (
            "simulations/000000-a/bev/000.png",
            include_bytes!("corpus/run_folder/whole_picture.bin"),
        ),
        (
            "summary.json",
            include_bytes!("corpus/run_folder/whole_summary.bin"),
        ),
    ];
    const REPLAY: usize = 4;
    let Some((choice, rest)) = bytes.split_first() else {
        return false;
    };
    let chosen = usize::from(*choice) % FILES.len();
    let of = |(i, (name, whole)): (usize, &(&'static str, &'static [u8]))| {
        let content = if i == chosen { rest } else { &whole[1..] };
        // The text of a replay is packed here, so that a changed byte reaches what the replay says.
        let packed = i == REPLAY && !content.starts_with(&[0x1f, 0x8b]);
        (
            *name,
            if packed {
                formats::gzip(content)
            } else {
                content.to_vec()
            },
        )
    };
    let mut files: Vec<(&str, Vec<u8>)> = FILES.iter().enumerate().map(of).collect();
    let digest = |i: usize| blake3::hash(&files[i].1).to_hex();
    if let Ok(record) = std::str::from_utf8(&files[1].1) {
        files[1].1 = record
            .replace("METRICS", &digest(2))
            .replace("CALLS", &digest(3))
            .into_bytes();
    }
    let in_run = |name: &str| format!("0001/{name}");
    let placed: Vec<(String, &[u8])> = files
        .iter()
        .map(|(name, content)| (in_run(name), &content[..]))
        .collect();
    let folder = folder(
        &placed
            .iter()
            .map(|(name, content)| (name.as_str(), *content))
            .collect::<Vec<_>>(),
    );
    let run = folder.path().join("0001");
    let last = last_run_of(folder.path());
    let completed = RunFolder::read_completed(&run).is_ok_and(|rows| !rows.rows.is_empty());
    let page = page::write(
        std::slice::from_ref(&run),
        None,
        &PageSettings::default(),
        &|_, _| (),
    );
    let first = SimulationChoice {
        simulation: "0".to_owned(),
        ..SimulationChoice::default()
    };
    let look = Look {
        pixels: 160,
        meters: 64.0,
    };
    if let Ok(film) = Film::open(&run, &first, look) {
        let _ = (film.frame(0), film.frame(usize::MAX));
    }
    RunFolder::manifest(&run).is_ok() && completed && page.is_ok() && last.is_ok()
}

/// A modification of a scenario, read and applied.
fn modification(bytes: &[u8]) -> bool {
    let folder = folder(&[("change.toml", bytes)]);
    let word = format!(
        "generated/changing_lane/0~{}",
        folder.path().join("change.toml").display()
    );
    open_all(&DataRoots::default(), Path::new(&word))
}

/// A checkpoint of a learned planner.
fn checkpoint(bytes: &[u8]) -> bool {
    let folder = folder(&[("model.ckpt", bytes)]);
    Checkpoint::open(&folder.path().join("model.ckpt")).is_ok()
}

/// A server on this machine that answers a question with these bytes: with the whole answer where
/// they begin with `HTTP/`, else with its body.
fn endpoint_reply(bytes: &[u8]) -> bool {
    let Ok(listener) = TcpListener::bind("127.0.0.1:0") else {
        return false;
    };
    let Ok(address) = listener.local_addr() else {
        return false;
    };
    let reply = bytes.to_vec();
    let server = thread::spawn(move || {
        let Ok((mut stream, _)) = listener.accept() else {
            return;
        };
        let mut request = [0; 1 << 13];
        let _ = stream.read(&mut request);
        let head = format!(
            "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
            reply.len()
        );
        let head = if reply.starts_with(b"HTTP/") {
            ""
        } else {
            &head
        };
        let _ = stream
            .write_all(head.as_bytes())
            .and_then(|()| stream.write_all(&reply));
    });
    let description = format!(
        "name = 'm'\nprompt_set = 'compact'\n[source]\nendpoint = 'http://{address}'\nmodel = 'm'\ngrammar = 'none'\n\
         image_size = 336\nretries = 0\ntimeout_ms = 2000\nstream = {}\n",
        bytes.starts_with(b"data:")
    );
    let spec =
        ModelSpec::parse(Path::new("m.toml"), &description).expect("the description is valid");
    let registry = ModelRegistry::new(PathBuf::from("models"), HubAccess::default());
    let mut answered = false;
    if let Ok(model) = registry.open(&spec) {
        let request = Request {
            constraint: Constraint::Free,
            max_new_tokens: 8,
            sampling: Sampling::Greedy,
            deadline: Deadline::NONE,
            draft: None,
        };
        let prefix = PromptPrefix {
            system: String::new(),
            image: None,
        };
        answered = model
            .converse(&prefix, 0)
            .and_then(|mut conversation| conversation.ask("?", &request))
            .is_ok();
    }
    // The listener waits for a connection that a failed start never made.
    let _ = std::net::TcpStream::connect(address);
    let _ = server.join();
    answered
}
