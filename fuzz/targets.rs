//! What the fuzz targets do with bytes: the readers and parsers of outside data, through the functions that the program uses.
//! A target must end and must not panic; its result does not matter. `tests/fuzz_corpus.rs` gives each the files of its corpus.

use planagent::internals::environment::text::TextForm;
use planagent::internals::mllm::{
    Constraint, Deadline, HubAccess, Loading, LocalModel, ModelPlace, ModelRegistry, ModelSpec, PromptPrefix, Request,
    Sampling,
};
use planagent::internals::reasoning::{
    AssistVariant, Feedback, MotionInstruction, Names, PromptSet, Round, feedback_text, parse, parse_assistance,
    round_prompt, system_prompt,
};
use planagent::internals::report::RunFolder;
use planagent::internals::report::page::{self, PageSettings};
use planagent::internals::runner::Config;
use planagent::internals::scenario::nuplan::{FilterFile, MapStore};
use planagent::internals::scenario::{DataRoots, Readers};
use std::fs;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::thread;
use tempfile::TempDir;

/// A target with its name.
pub(crate) type Target = (&'static str, fn(&[u8]));

/// All targets.
pub(crate) const TARGETS: [Target; 15] = [
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
    ("run_folder", run_folder),
    ("endpoint_reply", endpoint_reply),
];

/// Runs the target of a name.
pub(crate) fn run(name: &str, bytes: &[u8]) {
    if let Some((_, target)) = TARGETS.iter().find(|(known, _)| *known == name) {
        target(bytes);
    }
}

/// A folder with files.
fn folder(files: &[(&str, &[u8])]) -> TempDir {
    let folder = TempDir::new().expect("a folder for files");
    for (name, bytes) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("a file lies in a folder")).expect("a folder can be made");
        fs::write(path, bytes).expect("a file can be written");
    }
    folder
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn planner_code(bytes: &[u8]) {
    let parsed = parse(&text(bytes), &Names::default());
    assert!(parsed.errors.iter().all(|error| error.span.end <= text(bytes).len()), "an error lies behind the text");
}

fn answers(bytes: &[u8]) {
    let answer = text(bytes);
    let _ = MotionInstruction::find(&answer);
    for variant in [AssistVariant::Unconstrained, AssistVariant::Parameters] {
        let _ = parse_assistance(&answer, variant);
    }
}

/// The first byte chooses which file of a prompt set has the rest.
fn prompts(bytes: &[u8]) {
    const FILES: [&str; 6] =
        ["set.toml", "system.jinja", "understanding.jinja", "instruction.jinja", "code.jinja", "feedback.jinja"];
    let Some((choice, rest)) = bytes.split_first() else { return };
    let settings = &b"scene_text = 'compact'\nunderstanding = 'choices'\ninstruction = 'choices'\n"[..];
    let of = |i: usize| match i {
        _ if i == usize::from(*choice) % FILES.len() => rest,
        0 => settings,
        _ => b"text",
    };
    let files: Vec<(&str, &[u8])> = FILES.iter().enumerate().map(|(i, name)| (*name, of(i))).collect();
    let folder = folder(&files);
    let Ok(set) = PromptSet::open(&folder.path().to_string_lossy()) else { return };
    let _ = system_prompt(&set, "legend");
    for &round in Round::ALL {
        let _ = round_prompt(&set, round, &Names::default(), Some("speed 9"), Some("again"));
    }
    let feedback = Feedback {
        code: None,
        score: Some(0.5),
        threshold: 0.75,
        parts: Vec::new(),
        is_slow: false,
        errors: Vec::new(),
    };
    let _ = feedback_text(&set, &feedback);
}

fn lane_graph_text(bytes: &[u8]) {
    let _ = TextForm::is_compact(&text(bytes));
}

/// A model folder without weights and with this chat template: the template is reached only where all else is as it should be.
fn chat_template(bytes: &[u8]) {
    let tiny = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().map(|above| above.join("tests/fixtures/tiny_llava"));
    let Some(tiny) = tiny.into_iter().find(|folder| folder.is_dir()) else { return };
    let model = TempDir::new().expect("a folder for files");
    for entry in fs::read_dir(tiny).expect("the fixture can be read").flatten() {
        fs::copy(entry.path(), model.path().join(entry.file_name())).expect("a fixture can be copied");
    }
    fs::write(model.path().join("chat_template.jinja"), bytes).expect("a file can be written");
    check(&ModelPlace::Folder(model.path().to_owned()));
}

/// Finds and opens all scenarios in a file or folder.
fn open_all(roots: &DataRoots, place: &Path) {
    let Ok(found) = Readers::new(roots).find(&place.to_string_lossy()) else { return };
    for scenario in found.iter().take(4) {
        let _ = scenario.open();
    }
}

fn tfrecord(bytes: &[u8]) {
    let folder = folder(&[("a.tfrecord", bytes)]);
    open_all(&DataRoots::default(), &folder.path().join("a.tfrecord"));
}

/// The first byte chooses which files of a log have the rest.
fn argoverse2(bytes: &[u8]) {
    let Some((choice, rest)) = bytes.split_first() else { return };
    let files: &[&str] = if choice % 2 == 0 {
        &["city_SE3_egovehicle.feather", "annotations.feather", "map/log_map_archive_a.json"]
    } else {
        &["scenario_a.parquet", "log_map_archive_a.json"]
    };
    let files: Vec<(&str, &[u8])> = files.iter().map(|name| (*name, rest)).collect();
    let folder = folder(&files);
    open_all(&DataRoots::default(), folder.path());
}

fn nuplan_log(bytes: &[u8]) {
    let folder = folder(&[("log.db", bytes)]);
    let roots = DataRoots { data: Some(folder.path().to_owned()), maps: Some(folder.path().to_owned()) };
    open_all(&roots, &folder.path().join("log.db"));
}

fn nuplan_map(bytes: &[u8]) {
    let index = br#"{"us-ma-boston": {"version": "1"}}"#;
    let folder = folder(&[("nuplan-maps-v1.0.json", index), ("us-ma-boston/1/map.gpkg", bytes)]);
    let _ = MapStore::new(Some(folder.path().to_owned())).map("us-ma-boston");
}

fn filter(bytes: &[u8]) {
    let folder = folder(&[("filter.yaml", bytes)]);
    let _ = FilterFile::open(&folder.path().join("filter.yaml"));
}

fn configuration(bytes: &[u8]) {
    let folder = folder(&[("planagent.toml", bytes)]);
    let _ = Config::load(Some(&folder.path().join("planagent.toml")));
    let _ = ModelSpec::parse(Path::new("model.toml"), &text(bytes));
}

fn check(place: &ModelPlace) {
    let _ = LocalModel::check(place, &Loading::default());
}

fn gguf(bytes: &[u8]) {
    let folder = folder(&[("model.gguf", bytes)]);
    check(&ModelPlace::Gguf { model: folder.path().join("model.gguf"), mmproj: None });
}

fn safetensors(bytes: &[u8]) {
    let config = br#"{"model_type": "llava"}"#;
    let folder = folder(&[("config.json", config), ("model.safetensors", bytes)]);
    check(&ModelPlace::Folder(folder.path().to_owned()));
}

/// The first byte chooses which file of a run has the rest.
fn run_folder(bytes: &[u8]) {
    const FILES: [&str; 5] = [
        "manifest.toml",
        "simulations/000000-a/record.toml",
        "simulations/000000-a/metrics.toml",
        "simulations/000000-a/calls.jsonl",
        "simulations/000000-a/replay.json.gz",
    ];
    let Some((choice, rest)) = bytes.split_first() else { return };
    let chosen = usize::from(*choice) % FILES.len();
    let files: Vec<(&str, &[u8])> =
        FILES.iter().enumerate().map(|(i, name)| (*name, if i == chosen { rest } else { b"" })).collect();
    let folder = folder(&files);
    let run = folder.path().to_owned();
    let _ = RunFolder::manifest(&run);
    let _ = RunFolder::read_completed(&run);
    let _ = page::write(std::slice::from_ref(&run), &run.join("page.html"), &PageSettings::default(), &|_, _| ());
}

/// A server on this machine that answers a question with these bytes.
fn endpoint_reply(bytes: &[u8]) {
    let Ok(listener) = TcpListener::bind("127.0.0.1:0") else { return };
    let Ok(address) = listener.local_addr() else { return };
    let reply = bytes.to_vec();
    let server = thread::spawn(move || {
        let Ok((mut stream, _)) = listener.accept() else { return };
        let mut request = [0; 1 << 13];
        let _ = stream.read(&mut request);
        let head = format!(
            "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
            reply.len()
        );
        let _ = stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(&reply));
    });
    let description = format!(
        "name = 'm'\nprompt_set = 'compact'\n[source]\nendpoint = 'http://{address}'\nmodel = 'm'\ngrammar = 'none'\n\
         image_size = 336\nretries = 0\ntimeout_ms = 2000\nstream = {}\n",
        bytes.starts_with(b"data:")
    );
    let spec = ModelSpec::parse(Path::new("m.toml"), &description).expect("the description is valid");
    let registry = ModelRegistry::new(PathBuf::from("models"), HubAccess::default());
    if let Ok(model) = registry.open(&spec) {
        let request = Request {
            constraint: Constraint::Free,
            max_new_tokens: 8,
            sampling: Sampling::Greedy,
            deadline: Deadline::NONE,
            draft: None,
        };
        let prefix = PromptPrefix { system: String::new(), image: None };
        let _ = model.converse(&prefix, 0).and_then(|mut conversation| conversation.ask("?", &request));
    }
    // The listener waits for a connection that a failed start never made.
    let _ = std::net::TcpStream::connect(address);
    let _ = server.join();
}
