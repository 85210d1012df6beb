//! Downloads from a local server that implements a part of the hub's protocol.

use super::{FIRST, free, prefix, tiny};
use planagent_mllm::{
    FetchProgress, GgufPart, HubAccess, Mllm, MllmError, ModelRegistry, Trust, WeightFormat,
};
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

const COMMIT: &str = "0123456789abcdef0123456789abcdef01234567";
const FILES: [&str; 7] = [
    "config.json",
    "generation_config.json",
    "tokenizer.json",
    "tokenizer_config.json",
    "preprocessor_config.json",
    "chat_template.jinja",
    "model.safetensors",
];

/// A repository that is served.
struct Repository {
    folder: PathBuf,
    files: Vec<String>,
    /// Number of downloads of the weights that the server will interrupt.
    broken: AtomicUsize,
    /// The files that were sent, in this order.
    sent: Mutex<Vec<String>>,
}

impl Repository {
    /// All of these files.
    fn new(folder: &Path, files: &[&str]) -> Arc<Self> {
        let files = files.iter().map(ToString::to_string).collect();
        Arc::new(Self {
            folder: folder.to_path_buf(),
            files,
            broken: AtomicUsize::new(0),
            sent: Mutex::default(),
        })
    }

    /// Serves it as `org/tiny` and nothing else; gives the address.
    fn serve(self: &Arc<Self>) -> String {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        let repository = Arc::clone(self);
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let repository = Arc::clone(&repository);
                std::thread::spawn(move || answer(stream, &repository));
            }
        });
        address
    }

    fn body(&self, path: &str) -> Option<Vec<u8>> {
        if let Some(file) = path.strip_prefix(&format!("/org/tiny/resolve/{COMMIT}/")) {
            let known = self.files.iter().any(|known| known == file);
            return known.then(|| std::fs::read(self.folder.join(file)).unwrap());
        }
        if path.starts_with("/api/models/org/tiny/tree/") {
            let size = |file: &String| std::fs::metadata(self.folder.join(file)).unwrap().len();
            let entry = |file| serde_json::json!({"type": "file", "path": file, "oid": "0", "size": size(file)});
            let entries: Vec<serde_json::Value> = self.files.iter().map(entry).collect();
            return Some(serde_json::Value::from(entries).to_string().into_bytes());
        }
        path.starts_with("/api/models/org/tiny").then(|| {
            serde_json::json!({"id": "org/tiny", "sha": COMMIT, "siblings": []})
                .to_string()
                .into_bytes()
        })
    }
}

fn answer(mut stream: TcpStream, repository: &Repository) {
    let mut lines = BufReader::new(stream.try_clone().unwrap())
        .lines()
        .map_while(Result::ok);
    let first = lines.next().unwrap_or_default();
    lines.take_while(|line| !line.is_empty()).for_each(drop);
    let mut words = first.split(' ');
    let (method, target) = (
        words.next().unwrap_or_default(),
        words.next().unwrap_or_default(),
    );
    let path = target.split('?').next().unwrap_or_default();
    let (status, body) = match repository.body(path) {
        Some(body) => ("200 OK", body),
        None => ("404 Not Found", Vec::new()),
    };
    let head = format!(
        "HTTP/1.1 {status}\r\ncontent-length: {}\r\ncontent-type: application/json\r\netag: \"{}\"\r\nx-repo-commit: {COMMIT}\r\nconnection: close\r\n\r\n",
        body.len(),
        blake3::hash(&body).to_hex()
    );
    stream.write_all(head.as_bytes()).unwrap();
    if method == "HEAD" {
        return;
    }
    let is_weights = Path::new(path)
        .extension()
        .is_some_and(|extension| extension == "safetensors");
    let broken = is_weights
        && repository
            .broken
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| {
                left.checked_sub(1)
            })
            .is_ok();
    if broken {
        stream.write_all(&body[..body.len() / 2]).unwrap();
        return;
    }
    if let Some(file) = path.strip_prefix(&format!("/org/tiny/resolve/{COMMIT}/")) {
        repository.sent.lock().unwrap().push(file.to_string());
    }
    // The client may have closed the connection.
    let _ = stream.write_all(&body);
}

#[test]
fn a_hub_model_is_downloaded_once_and_then_found_offline() {
    let cache = tempfile::tempdir().unwrap();
    let access = |offline, endpoint: &str| HubAccess {
        offline,
        cache: Some(cache.path().to_path_buf()),
        endpoint: Some(endpoint.to_string()),
    };
    let nowhere = "http://127.0.0.1:9";
    let registry = |access| ModelRegistry::new("models", access).with_trust(Trust::Caller);
    let spec = registry(access(true, nowhere)).find("org/tiny").unwrap();
    let before = registry(access(true, nowhere)).open(&spec).map(|_| ());
    assert!(
        matches!(before, Err(MllmError::NotInCache { .. })),
        "{before:?}"
    );

    let address = Repository::new(&tiny(), &FILES).serve();
    let model = registry(access(false, &address)).open(&spec).unwrap();
    assert_eq!(model.name(), "tiny");
    let answer = |model: &dyn Mllm| {
        model
            .converse(&prefix(), 0)
            .unwrap()
            .ask(FIRST, &free(8))
            .unwrap()
            .text
    };
    assert_eq!(answer(&*model), answer(&super::open()));

    let again = registry(access(true, nowhere)).open(&spec).unwrap();
    assert_eq!(again.describe(), model.describe());

    let unknown = registry(access(false, &address)).find("org/other").unwrap();
    let refused = registry(access(false, &address)).open(&unknown).map(|_| ());
    assert!(matches!(refused, Err(MllmError::Hub { .. })), "{refused:?}");
}

/// A registry with a server and a cache, and its reports of progress.
fn listening(cache: &Path, endpoint: &str) -> (ModelRegistry, Arc<Mutex<Vec<FetchProgress>>>) {
    let access = HubAccess {
        offline: false,
        cache: Some(cache.to_path_buf()),
        endpoint: Some(endpoint.to_string()),
    };
    let told = Arc::new(Mutex::new(Vec::new()));
    let listener = Arc::clone(&told);
    let registry = ModelRegistry::new("models", access)
        .with_trust(Trust::Caller)
        .with_listener(Arc::new(move |progress| {
            listener.lock().unwrap().push(progress);
        }));
    (registry, told)
}

#[test]
fn a_download_tells_how_far_it_is() {
    let cache = tempfile::tempdir().unwrap();
    let (registry, told) = listening(cache.path(), &Repository::new(&tiny(), &FILES).serve());
    registry.fetch(&registry.find("org/tiny").unwrap()).unwrap();
    let told = told.lock().unwrap();
    let all: u64 = FILES
        .iter()
        .map(|file| std::fs::metadata(tiny().join(file)).unwrap().len())
        .sum();
    let last = told.last().unwrap();
    assert_eq!((last.bytes, last.total), (all, all));
    assert!(told.iter().any(|progress| progress.bytes < all));
    assert!(told.is_sorted_by_key(|progress| progress.bytes), "{told:?}");
}

#[test]
fn a_download_that_was_broken_off_is_taken_up_file_by_file() {
    let cache = tempfile::tempdir().unwrap();
    let repository = Repository::new(&tiny(), &FILES);
    // More often than the client's own retries.
    repository.broken.store(100, Ordering::SeqCst);
    let (registry, _) = listening(cache.path(), &repository.serve());
    let spec = registry.find("org/tiny").unwrap();
    let failed = registry.fetch(&spec);
    assert!(matches!(failed, Err(MllmError::Hub { .. })), "{failed:?}");
    assert!(registry.place_here(&spec).is_err(), "half a model is none");
    let snapshot = cache
        .path()
        .join("models--org--tiny/snapshots")
        .join(COMMIT);
    let kept: Vec<&str> = FILES
        .into_iter()
        .filter(|file| snapshot.join(file).is_file())
        .collect();
    repository.broken.store(0, Ordering::SeqCst);
    registry.open(&spec).unwrap();
    let sent = repository.sent.lock().unwrap().clone();
    assert!(sent.contains(&"model.safetensors".to_string()));
    for file in kept {
        assert_eq!(
            sent.iter().filter(|name| *name == file).count(),
            1,
            "{file} came twice: {sent:?}"
        );
    }
}

#[test]
fn gguf_files_of_a_repository_are_fetched_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let local = ModelRegistry::new("models", HubAccess::default()).with_trust(Trust::Caller);
    let spec = local.find(tiny().to_str().unwrap()).unwrap();
    for (file, weight_format) in [
        ("tiny-q8_0.gguf", WeightFormat::Q8_0),
        ("tiny-f32.gguf", WeightFormat::F32),
    ] {
        let mut create = |part: GgufPart| -> std::io::Result<Box<dyn Write>> {
            let path = if part == GgufPart::Model {
                folder.path().join(file)
            } else {
                folder.path().join("mmproj.gguf")
            };
            Ok(Box::new(std::fs::File::create(path)?))
        };
        local
            .export(&spec, weight_format, &mut create, &mut |_, _| {})
            .unwrap();
    }
    let repository = Repository::new(
        folder.path(),
        &["tiny-q8_0.gguf", "tiny-f32.gguf", "mmproj.gguf"],
    );
    let cache = tempfile::tempdir().unwrap();
    let (registry, _) = listening(cache.path(), &repository.serve());
    let model = registry
        .open(&registry.find("org/tiny/tiny-f32.gguf").unwrap())
        .unwrap();
    let answer = |model: &dyn Mllm| {
        model
            .converse(&prefix(), 0)
            .unwrap()
            .ask(FIRST, &free(8))
            .unwrap()
            .text
    };
    assert_eq!(answer(&*model), answer(&super::open()));
    let mut sent = repository.sent.lock().unwrap().clone();
    sent.sort();
    assert_eq!(sent, ["mmproj.gguf", "tiny-f32.gguf"], "and nothing else");
    let missing = registry
        .open(&registry.find("org/tiny/tiny-q4_k.gguf").unwrap())
        .map(|_| ());
    assert!(
        matches!(&missing, Err(MllmError::Hub { problem, .. }) if problem.contains("tiny-q4_k.gguf")),
        "{missing:?}"
    );
}

#[test]
fn a_repository_of_gguf_files_alone_says_how_they_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let files = ["m-Q4_K_M.gguf", "m-Q8_0.gguf", "mmproj-m-Q8_0.gguf"];
    for file in files {
        std::fs::write(folder.path().join(file), "GGUF").unwrap();
    }
    let address = Repository::new(folder.path(), &files).serve();
    let cache = tempfile::tempdir().unwrap();
    let (registry, _) = listening(cache.path(), &address);
    let problem = |word: &str| {
        let spec = registry.find(word).unwrap();
        registry.open(&spec).map(|_| ()).unwrap_err().to_string()
    };
    for word in ["org/tiny", "org/tiny:Q2_K", "hf.co/org/tiny"] {
        let problem = problem(word);
        assert!(
            problem.contains("org/tiny/m-Q4_K_M.gguf, org/tiny/m-Q8_0.gguf")
                && !problem.contains("tiny/mmproj"),
            "{word}: {problem}"
        );
    }
    // The file is found by its format, and is none.
    let broken = problem("org/tiny:q8_0");
    assert!(broken.contains("m-Q8_0.gguf"), "{broken}");
    let unknown = problem("org/other");
    assert!(
        unknown.contains("no such repository") && unknown.matches("http").count() == 1,
        "{unknown}"
    );
}
