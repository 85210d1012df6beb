//! A server on this machine that answers each request with the next text, and the last text again.

use super::Endpoint;
use crate::{
    Answer, Constraint, Deadline, EndpointSettings, Mllm, MllmError, PromptPrefix, Request,
    Sampling,
};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};

pub(super) struct FakeServer {
    address: String,
    heads: Arc<Mutex<Vec<String>>>,
}

impl FakeServer {
    /// A server with these responses. Its thread ends with the test process.
    pub(super) fn start(responses: Vec<String>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let heads = Arc::new(Mutex::new(Vec::new()));
        let seen = Arc::clone(&heads);
        std::thread::spawn(move || {
            for (number, stream) in listener.incoming().enumerate() {
                let response = responses.get(number).or(responses.last()).unwrap();
                serve(stream.unwrap(), response, &seen);
            }
        });
        Self { address, heads }
    }

    pub(super) fn url(&self) -> String {
        format!("http://{}/v1", self.address)
    }

    /// All requests so far, whole.
    pub(super) fn bodies(&self) -> String {
        self.heads.lock().unwrap().concat()
    }

    /// The request lines so far.
    pub(super) fn requests(&self) -> Vec<String> {
        let heads = self.heads.lock().unwrap();
        heads
            .iter()
            .map(|head| {
                head.lines()
                    .next()
                    .unwrap_or_default()
                    .replace(" HTTP/1.1", "")
            })
            .collect()
    }
}

fn serve(mut stream: TcpStream, response: &str, heads: &Mutex<Vec<String>>) {
    let mut bytes = Vec::new();
    let mut buffer = [0; 4096];
    let is_whole = |bytes: &[u8]| {
        let text = String::from_utf8_lossy(bytes);
        text.split_once("\r\n\r\n").is_some_and(|(head, body)| {
            let length = head.to_ascii_lowercase().lines().find_map(|line| {
                line.strip_prefix("content-length:")
                    .map(|length| length.trim().parse::<usize>().unwrap())
            });
            body.len() >= length.unwrap_or(0)
        })
    };
    while !is_whole(&bytes) {
        match stream.read(&mut buffer) {
            Ok(0) | Err(_) => return,
            Ok(count) => bytes.extend_from_slice(buffer.get(..count).unwrap()),
        }
    }
    heads
        .lock()
        .unwrap()
        .push(String::from_utf8_lossy(&bytes).into_owned());
    // The client may have left.
    let _ = stream.write_all(response.as_bytes());
}

/// A response with a body.
pub(super) fn response(status: &str, body: &str) -> String {
    format!(
        "HTTP/1.1 {status}\r\nConnection: close\r\nContent-Length: {}\r\n\r\n{body}",
        body.len()
    )
}

/// A complete answer.
pub(super) fn answer(text: &str) -> String {
    let body =
        serde_json::json!({"choices": [{"message": {"content": text}, "finish_reason": "stop"}]});
    response("200 OK", &body.to_string())
}

/// Settings with short waits.
pub(super) fn settings(url: &str) -> EndpointSettings {
    let fields = serde_json::json!({
        "endpoint": url, "model": "eye", "grammar": "none", "timeout_ms": 5000, "retries": 1, "first_wait_ms": 1,
    });
    serde_json::from_value(fields).unwrap()
}

/// Asks one question.
pub(super) fn ask(endpoint: &Endpoint) -> Result<Answer, MllmError> {
    let request = Request {
        constraint: Constraint::Free,
        max_new_tokens: 50,
        sampling: Sampling::Greedy,
        deadline: Deadline::NONE,
        draft: None,
    };
    endpoint
        .converse(&PromptPrefix::default(), 0)?
        .ask("Which lane?", &request)
}

/// Asks a server with these responses one question: the answer or the error, whether the error
/// passes, and the requests.
pub(super) fn asked(responses: Vec<String>) -> (Result<String, String>, bool, Vec<String>) {
    let server = FakeServer::start(responses);
    let result = ask(&Endpoint::open("test", &settings(&server.url())).unwrap());
    let passes = result.as_ref().is_err_and(MllmError::is_transient);
    (
        result
            .map(|answer| answer.text)
            .map_err(|error| error.to_string()),
        passes,
        server.requests(),
    )
}
