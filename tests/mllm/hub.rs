//! A model fetched from a hub: a server on this machine that speaks the part of the hub's protocol that is needed.

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};

use planagent::mllm::{HubAccess, Mllm, MllmError, ModelRegistry};

use super::{FIRST, free, opening, tiny};

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

/// Serves the tiny checkpoint as `org/tiny` and nothing else; gives its address.
fn serve() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            std::thread::spawn(move || answer(stream));
        }
    });
    address
}

fn answer(mut stream: TcpStream) {
    let mut lines = BufReader::new(stream.try_clone().unwrap()).lines().map_while(Result::ok);
    let first = lines.next().unwrap_or_default();
    lines.take_while(|line| !line.is_empty()).for_each(drop);
    let mut words = first.split(' ');
    let (method, target) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let path = target.split('?').next().unwrap_or_default();
    let (status, body) = match body(path) {
        Some(body) => ("200 OK", body),
        None => ("404 Not Found", Vec::new()),
    };
    let head = format!(
        "HTTP/1.1 {status}\r\ncontent-length: {}\r\ncontent-type: application/json\r\netag: \"{}\"\r\nx-repo-commit: {COMMIT}\r\nconnection: close\r\n\r\n",
        body.len(),
        blake3::hash(&body).to_hex()
    );
    stream.write_all(head.as_bytes()).unwrap();
    if method != "HEAD" {
        stream.write_all(&body).unwrap();
    }
}

fn body(path: &str) -> Option<Vec<u8>> {
    if let Some(file) = path.strip_prefix(&format!("/org/tiny/resolve/{COMMIT}/")) {
        return FILES.contains(&file).then(|| std::fs::read(tiny().join(file)).unwrap());
    }
    if path.starts_with("/api/models/org/tiny/tree/") {
        let entries: Vec<_> = FILES
            .iter()
            .map(|file| serde_json::json!({"type": "file", "path": file, "oid": "0", "size": std::fs::metadata(tiny().join(file)).unwrap().len()}))
            .collect();
        return Some(serde_json::Value::from(entries).to_string().into_bytes());
    }
    path.starts_with("/api/models/org/tiny")
        .then(|| serde_json::json!({"id": "org/tiny", "sha": COMMIT, "siblings": []}).to_string().into_bytes())
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
    let registry = |access| ModelRegistry::new("models", access);
    let spec = registry(access(true, nowhere)).find("org/tiny").unwrap();
    let before = registry(access(true, nowhere)).open(&spec).map(|_| ());
    assert!(matches!(before, Err(MllmError::NotInCache { .. })), "{before:?}");

    let address = serve();
    let model = registry(access(false, &address)).open(&spec).unwrap();
    assert_eq!(model.name(), "tiny");
    let answer = |model: &dyn Mllm| model.converse(&opening(), 0).unwrap().ask(FIRST, &free(8)).unwrap().text;
    assert_eq!(answer(&*model), answer(&super::open()));

    let again = registry(access(true, nowhere)).open(&spec).unwrap();
    assert_eq!(again.describe(), model.describe());

    let unknown = registry(access(false, &address)).find("org/other").unwrap();
    let refused = registry(access(false, &address)).open(&unknown).map(|_| ());
    assert!(matches!(refused, Err(MllmError::Hub { .. })), "{refused:?}");
}
