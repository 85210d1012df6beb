//! The server of live pages: what it answers, what it refuses, and that nobody can hold it up.

use super::{scenes, simulate};
use crate::cli::refused;
use flate2::read::GzDecoder;
use planagent_runs::report::page::LivePage;
use planagent_runs::report::serve::{Server, Stopper};
use serde_json::Value;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Maximum time of an answer on a busy machine.
const PATIENCE: Duration = Duration::from_mins(1);
/// Connections that the server keeps at a time.
const MAX_CONNECTIONS: usize = 64;

/// A server in a thread.
pub(super) struct Served {
    pub(super) address: SocketAddr,
    stopper: Stopper,
    thread: Option<JoinHandle<()>>,
}

impl Served {
    pub(super) fn start(runs: &[&Path]) -> Self {
        let runs: Vec<PathBuf> = runs.iter().map(|run| (*run).to_owned()).collect();
        let server = Server::bind(LivePage::open(&runs, &|_, _| ()).unwrap(), 0).unwrap();
        let (address, stopper) = (server.address(), server.stopper());
        Self {
            address,
            stopper,
            thread: Some(thread::spawn(|| server.run())),
        }
    }

    pub(super) fn stop(&mut self) {
        self.stopper.stop();
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream
    }

    /// Sends bytes and gives status, head and body of the answer.
    fn ask(&self, request: &[u8]) -> (u16, String, Vec<u8>) {
        let mut stream = self.connect();
        stream.write_all(request).unwrap();
        answer(stream)
    }

    fn get(&self, path: &str) -> (u16, String, Vec<u8>) {
        self.ask(format!("GET {path} HTTP/1.1\r\nHost: {}\r\n\r\n", self.address).as_bytes())
    }

    /// The JSON of an answer, which may be packed.
    fn json(&self, path: &str) -> Value {
        let (status, head, body) = self.get(path);
        assert_eq!(status, 200, "{path}: {head}");
        if head.contains("Content-Encoding: gzip") {
            serde_json::from_reader(GzDecoder::new(body.as_slice())).unwrap()
        } else {
            serde_json::from_slice(&body).unwrap()
        }
    }

    /// Waits until the server shows this number of simulations; gives the index.
    fn wait_for(&self, simulations: u64) -> Value {
        let begun = Instant::now();
        while self.json("/data/version")["simulations"] != simulations {
            assert!(
                begun.elapsed() < PATIENCE,
                "never {simulations} simulations: {}",
                self.json("/data/version")
            );
            thread::sleep(Duration::from_millis(50));
        }
        self.json("/data/index")
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop();
    }
}

fn answer(mut stream: TcpStream) -> (u16, String, Vec<u8>) {
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    let split = bytes
        .windows(4)
        .position(|four| four == b"\r\n\r\n")
        .unwrap_or(bytes.len());
    let head = String::from_utf8(bytes[..split].to_vec()).unwrap();
    let status = head
        .split(' ')
        .nth(1)
        .and_then(|number| number.parse().ok())
        .unwrap_or(0);
    (
        status,
        head,
        bytes.get(split + 4..).unwrap_or_default().to_vec(),
    )
}

/// The simulation folders of a run, in order.
pub(super) fn simulations(run: &Path) -> Vec<PathBuf> {
    let mut folders: Vec<_> = fs::read_dir(run.join("simulations"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    folders.sort();
    folders
}

/// A run that has only begun: the manifest of another one.
pub(super) fn begun(whole: &Path, run: &Path) {
    fs::create_dir_all(run).unwrap();
    fs::copy(whole.join("manifest.toml"), run.join("manifest.toml")).unwrap();
}

/// Copies a simulation as a running process completes it: written under another name, then renamed.
pub(super) fn complete(simulation: &Path, run: &Path) {
    fn copy(from: &Path, to: &Path) {
        fs::create_dir_all(to).unwrap();
        for entry in fs::read_dir(from).unwrap() {
            let path = entry.unwrap().path();
            let target = to.join(path.file_name().unwrap());
            if path.is_dir() {
                copy(&path, &target);
            } else {
                fs::copy(&path, &target).map(|_| ()).unwrap();
            }
        }
    }
    let name = simulation.file_name().unwrap().to_str().unwrap();
    let unfinished = run.join("simulations").join(format!(".unfinished-{name}"));
    copy(simulation, &unfinished);
    fs::rename(&unfinished, run.join("simulations").join(name)).unwrap();
}

#[test]
fn a_live_page_shows_simulations_as_they_finish() {
    let work = TempDir::new().unwrap();
    let [whole, run] = ["whole", "run"].map(|name| work.path().join(name));
    simulate(&whole, &scenes(2), "plan-agent,log-replay");
    begun(&whole, &run);
    let served = Served::start(&[&run]);
    let (status, head, page) = served.get("/");
    let page = String::from_utf8(page).unwrap();
    assert!(
        status == 200 && head.contains("text/html") && head.contains("frame-ancestors 'none'"),
        "{head}"
    );
    assert!(page.contains("<title>PlanAgent: run</title>") && page.contains("id=\"live\""));
    let start = served.json("/data/version");
    assert_eq!(
        (&start["simulations"], &start["planned"]),
        (&0.into(), &4.into()),
        "{start}"
    );
    assert_eq!(
        served.json("/data/index")["simulations"],
        Value::Array(Vec::new())
    );

    assert_eq!(start["running"], false, "{start}");
    let lock = File::create(run.join(".lock")).unwrap();
    lock.lock().unwrap();
    let folders = simulations(&whole);
    complete(&folders[0], &run);
    // Folders that are being written or copied are no simulations yet.
    fs::create_dir(run.join("simulations/.unfinished-000003-x")).unwrap();
    let half = run
        .join("simulations")
        .join(folders[2].file_name().unwrap());
    fs::create_dir(&half).unwrap();
    fs::write(half.join("record.toml"), "number = 2\nsource = ").unwrap();
    let index = served.wait_for(1);
    assert_ne!(index["version"], start["version"]);
    assert_eq!(served.json("/data/version")["running"], true);
    lock.unlock().unwrap();
    assert!(
        index["unreadable"][0]
            .as_str()
            .unwrap()
            .contains("record.toml"),
        "{}",
        index["unreadable"]
    );
    let simulation = &index["simulations"][0];
    assert_eq!(
        (
            &simulation["number"],
            &index["statistics"]["rows"].as_array().unwrap().len()
        ),
        (&0.into(), &1)
    );
    let replay = served.json(&format!("/data/simulation-{}", simulation["replay"]));
    assert!(replay["calls"].as_array().unwrap().len() > 5 && replay["replay"]["plans"].is_array());
    assert!(served.json(&format!("/data/map-{}", simulation["map"]))["lanes"].is_array());
    assert!(served.json(&format!("/data/images-{}", simulation["images"]))["0"].is_string());

    // What was read is not read again: a file that is broken now, with its old size and time, is
    // not noticed.
    let metrics = simulations(&run)
        .into_iter()
        .find(|folder| folder.ends_with(folders[0].file_name().unwrap()))
        .unwrap();
    let metrics = metrics.join("metrics.toml");
    let before = fs::metadata(&metrics).unwrap();
    fs::write(&metrics, vec![b'#'; before.len() as usize]).unwrap();
    File::options()
        .write(true)
        .open(&metrics)
        .unwrap()
        .set_modified(before.modified().unwrap())
        .unwrap();
    complete(&folders[1], &run);
    let index = served.wait_for(2);
    assert_eq!(
        index["unreadable"].as_array().unwrap().len(),
        1,
        "{}",
        index["unreadable"]
    );
    let first = &index["simulations"][0];
    assert_eq!(
        (&first["number"], &first["replay"]),
        (&0.into(), &simulation["replay"])
    );

    // A simulation that was discarded and runs again gets another number.
    fs::remove_dir_all(&half).unwrap();
    fs::remove_dir_all(metrics.parent().unwrap()).unwrap();
    served.wait_for(1);
    complete(&folders[0], &run);
    complete(&folders[2], &run);
    let index = served.wait_for(3);
    assert_eq!(index["unreadable"], Value::Array(Vec::new()));
    assert_ne!(index["simulations"][0]["replay"], simulation["replay"]);
    assert_eq!(
        served
            .get(&format!("/data/simulation-{}", simulation["replay"]))
            .0,
        404
    );

    // A run that is gone leaves its data, and the page says so.
    fs::rename(&run, work.path().join("elsewhere")).unwrap();
    let begun = Instant::now();
    while served.json("/data/version")["problem"].is_null() {
        assert!(begun.elapsed() < PATIENCE);
        thread::sleep(Duration::from_millis(50));
    }
    let version = served.json("/data/version");
    assert!(
        version["problem"]
            .as_str()
            .unwrap()
            .contains("there is no such folder")
            && version["simulations"] == 3,
        "{version}"
    );
}

/// The names of all files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.push(path);
        }
    }
    found.sort();
    found
}

#[test]
fn a_server_refuses_other_hosts_methods_and_paths() {
    let work = TempDir::new().unwrap();
    let run = work.path().join("run");
    simulate(&run, &scenes(1), "log-replay");
    let before = files(&run);
    let served = Served::start(&[&run]);
    assert_eq!(served.address.ip(), IpAddr::V4(Ipv4Addr::LOCALHOST));
    let status = |request: &str| served.ask(request.as_bytes()).0;
    for host in [
        "evil.example",
        "evil.example:4747",
        "127.0.0.1.evil.example",
        "192.168.0.2",
        "0.0.0.0",
    ] {
        assert_eq!(
            status(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n")),
            421,
            "{host}"
        );
    }
    for host in ["localhost", "localhost:9000", "127.0.0.1"] {
        assert_eq!(
            status(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n")),
            200,
            "{host}"
        );
    }
    for method in ["POST", "PUT", "DELETE", "OPTIONS", "PATCH"] {
        let body = "x".repeat(20_000);
        let length = body.len();
        let request = format!(
            "{method} / HTTP/1.1\r\nHost: localhost\r\nContent-Length: {length}\r\n\r\n{body}"
        );
        let (status, head, _) = served.ask(request.as_bytes());
        assert!(
            status == 405 && head.contains("Allow: GET, HEAD"),
            "{method}: {head}"
        );
    }
    for path in [
        "/manifest.toml",
        "/../manifest.toml",
        "/data/../manifest.toml",
        "/data/..%2fmanifest.toml",
        "/data/simulation-0/../../manifest.toml",
        "/data/simulation-../0",
        "/data/simulation-1",
        "/data/simulation--1",
        "/data/map-99999999999999999999999",
        "/data/",
        "//etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
    ] {
        let (status, head, body) = served.get(path);
        assert_eq!(status, 404, "{path}: {head}");
        assert_eq!(body, b"there is no such page\n");
    }
    for request in [
        "GET\r\n\r\n",
        "\0\0\0\0\r\n\r\n",
        "GET / HTTP/1.1\r\n\r\n",
        "GET / HTTP/9\r\nHost: localhost\r\n\r\n",
    ] {
        assert_eq!(status(request), 400, "{request:?}");
    }
    assert_eq!(
        status("GET manifest.toml HTTP/1.1\r\nHost: localhost\r\n\r\n"),
        400
    );
    assert_eq!(
        status(&format!(
            "GET / HTTP/1.1\r\nHost: localhost\r\nX: {}",
            "x".repeat(30_000)
        )),
        431
    );
    let (status, head, body) = served.ask(b"HEAD / HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert!(
        status == 200 && body.is_empty() && !head.contains("Content-Length: 0"),
        "{head}"
    );
    assert!(
        head.contains("nosniff") && head.contains("Cross-Origin-Resource-Policy: same-origin"),
        "{head}"
    );
    assert_eq!(files(&run), before, "the server wrote files");
}

#[test]
fn slow_and_many_clients_hold_nobody_up() {
    let work = TempDir::new().unwrap();
    let run = work.path().join("run");
    simulate(&run, &scenes(1), "log-replay");
    let served = Served::start(&[&run]);
    // Clients that never end their request, and one that takes no answer.
    let mut slow: Vec<TcpStream> = (0..20).map(|_| served.connect()).collect();
    for stream in &mut slow {
        stream.write_all(b"GET / HTTP/1.1\r\nHost: local").unwrap();
    }
    let mut deaf = served.connect();
    deaf.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        .unwrap();
    let begun = Instant::now();
    thread::scope(|scope| {
        let asked: Vec<_> = (0..30)
            .map(|_| scope.spawn(|| served.get("/data/index").0))
            .collect();
        assert!(
            asked
                .into_iter()
                .all(|thread| thread.join().unwrap() == 200)
        );
    });
    let elapsed = begun.elapsed();
    assert!(
        elapsed < Duration::from_secs(4),
        "{elapsed:?}: the slow clients hold the others up"
    );
    let (status, _, words) = answer(slow.pop().unwrap());
    assert_eq!(
        (status, words.as_slice()),
        (408, &b"the request did not arrive in time\n"[..])
    );
    assert!(begun.elapsed() < PATIENCE);
    assert_eq!(answer(deaf).0, 200);
    drop(slow);
    // The server notices that they are gone.
    thread::sleep(Duration::from_secs(2));

    // More connections than the server keeps: it says so, and recovers.
    let waiting =
        |count: usize| -> Vec<TcpStream> { (0..count).map(|_| served.connect()).collect() };
    let many = waiting(MAX_CONNECTIONS);
    let (status, head, _) = answer(served.connect());
    assert_eq!(status, 503, "{head}");
    drop(many);
    let begun = Instant::now();
    while served.get("/").0 != 200 {
        assert!(begun.elapsed() < PATIENCE, "the server does not recover");
        thread::sleep(Duration::from_millis(50));
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_the_program() {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};
    let work = TempDir::new().unwrap();
    let run = work.path().join("run");
    simulate(&run, &scenes(1), "log-replay");
    let program = assert_cmd::cargo::cargo_bin("planagent");
    for signal in ["-INT", "-TERM"] {
        let arguments = ["serve", run.to_str().unwrap(), "--port", "0"];
        let mut child = Command::new(&program)
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut line)
            .unwrap();
        let address = line
            .trim()
            .strip_prefix("http://")
            .and_then(|rest| rest.strip_suffix('/'))
            .unwrap()
            .to_owned();
        let mut stream = TcpStream::connect(&address).unwrap();
        stream
            .write_all(b"GET /data/version HTTP/1.1\r\nHost: localhost\r\n\r\n")
            .unwrap();
        assert_eq!(answer(stream).0, 200);
        let port = address.rsplit(':').next().unwrap();
        let taken = refused(&["serve", run.to_str().unwrap(), "--port", port]);
        assert!(
            taken.contains(&address) && taken.contains("--port"),
            "{taken}"
        );
        // The shell's own `kill`: a small system has no program of that name.
        assert!(
            Command::new("sh")
                .args(["-c", &format!("kill {signal} {}", child.id())])
                .status()
                .unwrap()
                .success()
        );
        assert_eq!(child.wait().unwrap().code(), Some(0), "{signal}");
    }
    let no_run = refused(&["serve", work.path().to_str().unwrap(), "--port", "0"]);
    assert!(no_run.contains("holds no run"), "{no_run}");
    let address = refused(&["serve", run.to_str().unwrap(), "--port", "0.0.0.0:80"]);
    assert!(address.contains("--port"), "{address}");
}
