//! A server on this machine whose answers and failures a test chooses.

use serde_json::{Value, json};
use std::fmt::Write as _;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

#[derive(Debug, Clone)]
pub(crate) struct Received {
    /// Request line and headers.
    pub(crate) head: String,
    pub(crate) body: Value,
}

/// The server's reaction to a request.
pub(crate) enum Reaction {
    /// Sends these bytes and closes the connection.
    Send(Vec<u8>),
    /// Sends these bytes repeatedly.
    Repeat(Vec<u8>),
    /// Sends these bytes, then nothing, and keeps the connection open.
    Hang(Vec<u8>),
}

/// The server; the drop of this value ends it.
pub(crate) struct Server {
    address: String,
    received: Arc<Mutex<Vec<Received>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// `react` gets the index of each request. The short questions before a run are answered well,
    /// and not counted.
    pub(crate) fn start(
        react: impl Fn(usize, &Received) -> Reaction + Send + Sync + 'static,
    ) -> Self {
        Self::listening(react, true)
    }

    /// A server whose `react` gets the short questions before a run, too.
    pub(crate) fn probed(
        react: impl Fn(usize, &Received) -> Reaction + Send + Sync + 'static,
    ) -> Self {
        Self::listening(react, false)
    }

    fn listening(
        react: impl Fn(usize, &Received) -> Reaction + Send + Sync + 'static,
        answers_probes: bool,
    ) -> Self {
        let probes = answers_probes.then(|| Arc::new(AtomicUsize::new(0)));
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let received = Arc::new(Mutex::new(Vec::new()));
        let stop = Arc::new(AtomicBool::new(false));
        let react = Arc::new(react);
        let thread = {
            let (received, stop) = (Arc::clone(&received), Arc::clone(&stop));
            std::thread::spawn(move || {
                for stream in listener.incoming() {
                    if stop.load(Ordering::SeqCst) {
                        return;
                    }
                    let (received, stop, react) =
                        (Arc::clone(&received), Arc::clone(&stop), Arc::clone(&react));
                    let probes = probes.clone();
                    std::thread::spawn(move || {
                        serve(
                            stream.unwrap(),
                            &received,
                            &stop,
                            &*react,
                            probes.as_deref(),
                        );
                    });
                }
            })
        };
        Self {
            address,
            received,
            stop,
            thread: Some(thread),
        }
    }

    /// A server with the same reaction to every request.
    pub(crate) fn always(react: impl Fn() -> Reaction + Send + Sync + 'static) -> Self {
        Self::start(move |_, _| react())
    }

    /// The address for a model description.
    pub(crate) fn url(&self) -> String {
        format!("http://{}/v1", self.address)
    }

    /// The requests so far.
    pub(crate) fn received(&self) -> Vec<Received> {
        self.received.lock().unwrap().clone()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        // Wakes the listener, which may have ended already.
        let _ = TcpStream::connect(&self.address);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

fn serve(
    mut stream: TcpStream,
    received: &Mutex<Vec<Received>>,
    stop: &AtomicBool,
    react: &(dyn Fn(usize, &Received) -> Reaction + Send + Sync),
    probes: Option<&AtomicUsize>,
) {
    let Some(request) = read(&mut stream) else {
        return;
    };
    if let Some(probes) = probes.filter(|_| is_probe(&request)) {
        let number = probes.fetch_add(1, Ordering::SeqCst);
        let color = ["red", "blue"][number % 2];
        if let Reaction::Send(bytes) = completion(color) {
            let _ = stream.write_all(&bytes);
        }
        return;
    }
    let number = {
        let mut received = received.lock().unwrap();
        received.push(request.clone());
        received.len() - 1
    };
    match react(number, &request) {
        Reaction::Send(bytes) => {
            let _ = stream.write_all(&bytes);
        }
        Reaction::Repeat(bytes) => {
            while !stop.load(Ordering::SeqCst) && stream.write_all(&bytes).is_ok() {}
        }
        Reaction::Hang(bytes) => {
            let _ = stream.write_all(&bytes);
            while !stop.load(Ordering::SeqCst) {
                std::thread::sleep(Duration::from_millis(10));
            }
        }
    }
}

/// Whether a request is one of the short questions that come before a run.
pub(crate) fn is_probe(request: &Received) -> bool {
    request.body["messages"][0]["content"] == "You answer with one word."
}

/// Reads head and body; `None` if the client disconnected.
fn read(stream: &mut TcpStream) -> Option<Received> {
    let mut bytes = Vec::new();
    let mut buffer = [0; 4096];
    let end = loop {
        if let Some(end) = bytes.windows(4).position(|window| window == b"\r\n\r\n") {
            break end + 4;
        }
        match stream.read(&mut buffer) {
            Ok(0) | Err(_) => return None,
            Ok(count) => bytes.extend_from_slice(&buffer[..count]),
        }
    };
    let head = String::from_utf8_lossy(&bytes[..end]).into_owned();
    let length = head.lines().find_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.eq_ignore_ascii_case("content-length")
            .then(|| value.trim().parse::<usize>().unwrap())
    });
    let mut body = bytes.split_off(end);
    while body.len() < length.unwrap_or(0) {
        match stream.read(&mut buffer) {
            Ok(0) | Err(_) => return None,
            Ok(count) => body.extend_from_slice(&buffer[..count]),
        }
    }
    // A list of models is asked for without a body.
    let body = if body.is_empty() {
        Value::Null
    } else {
        serde_json::from_slice(&body).unwrap()
    };
    Some(Received { head, body })
}

/// A response with additional header lines, each ended by `\r\n`.
pub(crate) fn response(status: &str, headers: &str, body: &str) -> Vec<u8> {
    let length = body.len();
    format!(
        "HTTP/1.1 {status}\r\nConnection: close\r\nContent-Length: {length}\r\n{headers}\r\n{body}"
    )
    .into_bytes()
}

/// A chat completion in one piece.
pub(crate) fn completion(text: &str) -> Reaction {
    let body = json!({
        "object": "chat.completion",
        "choices": [{"index": 0, "message": {"role": "assistant", "content": text}, "finish_reason": "stop"}],
        "usage": {"prompt_tokens": 100, "completion_tokens": 7, "prompt_tokens_details": {"cached_tokens": 40}},
    });
    Reaction::Send(response(
        "200 OK",
        "Content-Type: application/json\r\n",
        &body.to_string(),
    ))
}

/// A streamed chat completion of these parts. If not `ended`, it breaks off after them.
pub(crate) fn stream(parts: &[&str], ended: bool) -> Reaction {
    let mut body = String::from(
        "HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Type: text/event-stream\r\n\r\n",
    );
    let mut event = |value: Value| write!(body, "data: {value}\n\n").unwrap();
    for part in parts {
        event(
            json!({"choices": [{"index": 0, "delta": {"content": part}, "finish_reason": null}]}),
        );
    }
    if ended {
        event(json!({"choices": [{"index": 0, "delta": {}, "finish_reason": "stop"}]}));
        event(json!({"choices": [], "usage": {"prompt_tokens": 100, "completion_tokens": 7}}));
        body.push_str("data: [DONE]\n\n");
    }
    Reaction::Send(body.into_bytes())
}

/// A list of models, owned by a server of this name.
pub(crate) fn models(names: &[&str], owner: &str) -> Reaction {
    let models: Vec<Value> = names
        .iter()
        .map(|name| json!({"id": name, "owned_by": owner}))
        .collect();
    Reaction::Send(response(
        "200 OK",
        "",
        &json!({"object": "list", "data": models}).to_string(),
    ))
}

/// An error response in `OpenAI`'s form.
pub(crate) fn error(status: &str, headers: &str, message: &str) -> Reaction {
    let body = json!({"error": {"message": message, "type": "some_error", "code": null}});
    Reaction::Send(response(status, headers, &body.to_string()))
}
