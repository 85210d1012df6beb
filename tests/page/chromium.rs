//! A headless Chromium, controlled by its debugging protocol over a pair of pipes.

use crate::outside::{self, Missing};
use serde_json::{Value, json};
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Maximum time of an answer on a busy machine.
const PATIENCE: Duration = Duration::from_mins(2);
/// Program names of Chromium.
const NAMES: [&str; 4] = [
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
];

/// A running browser with one page.
pub(super) struct Chromium {
    process: Child,
    to: File,
    from: Receiver<Value>,
    session: Option<String>,
    sent: u64,
    /// Events of the page.
    events: Vec<Value>,
    _profile: TempDir,
}

impl Chromium {
    /// The browser: `$PLANAGENT_CHROMIUM`, or one on the path.
    pub(super) fn program() -> Result<PathBuf, Missing> {
        let named = std::env::var_os("PLANAGENT_CHROMIUM").map(PathBuf::from);
        named.map_or_else(|| outside::program(&NAMES), Ok)
    }

    /// Starts the browser with an empty page of 1280 by 800 pixels.
    pub(super) fn start(program: &Path) -> Self {
        let profile = TempDir::new().unwrap();
        let [to, from] = ["to", "from"].map(|name| profile.path().join(name));
        assert!(
            Command::new("mkfifo")
                .args([&to, &from])
                .status()
                .unwrap()
                .success()
        );
        // The browser reads commands from descriptor 3 and answers on 4; the shell opens both.
        let script = "exec \"$0\" \"$@\" 3<\"$TO\" 4>\"$FROM\"";
        let process = Command::new("sh")
            .args(["-c", script])
            .arg(program)
            .args([
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--no-first-run",
            ])
            .args([
                "--remote-debugging-pipe",
                "--window-size=1280,800",
                "about:blank",
            ])
            .arg(format!(
                "--user-data-dir={}",
                profile.path().join("profile").display()
            ))
            .env("TO", &to)
            .env("FROM", &from)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let to = File::options().write(true).open(&to).unwrap();
        let from = BufReader::new(File::open(&from).unwrap());
        let (sender, receiver) = channel();
        std::thread::spawn(move || {
            for message in from.split(0).map_while(Result::ok) {
                if sender
                    .send(serde_json::from_slice(&message).unwrap())
                    .is_err()
                {
                    return;
                }
            }
        });
        let mut browser = Self {
            process,
            to,
            from: receiver,
            session: None,
            sent: 0,
            events: Vec::new(),
            _profile: profile,
        };
        let target =
            browser.call("Target.createTarget", &json!({"url": "about:blank"}))["targetId"].clone();
        let attached = browser.call(
            "Target.attachToTarget",
            &json!({"targetId": target, "flatten": true}),
        );
        browser.session = attached["sessionId"].as_str().map(str::to_owned);
        for domain in ["Runtime", "Log", "Page", "Network"] {
            browser.call(&format!("{domain}.enable"), &json!({}));
        }
        browser.show_at(1280, 800, "light");
        browser
    }

    /// Sets the size of the page in pixels, and the color scheme: `light` or `dark`.
    pub(super) fn show_at(&mut self, width: u32, height: u32, scheme: &str) {
        let screen =
            json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false});
        self.call("Emulation.setDeviceMetricsOverride", &screen);
        let features = json!([{"name": "prefers-color-scheme", "value": scheme}]);
        self.call("Emulation.setEmulatedMedia", &json!({"features": features}));
    }

    /// Sends a command and waits for its result.
    pub(super) fn call(&mut self, method: &str, parameters: &Value) -> Value {
        self.sent += 1;
        let id = self.sent;
        let mut message = json!({"id": id, "method": method, "params": parameters});
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        self.to
            .write_all(format!("{message}\0").as_bytes())
            .unwrap();
        let begun = Instant::now();
        loop {
            let left = PATIENCE.saturating_sub(begun.elapsed());
            let answer = self
                .from
                .recv_timeout(left)
                .unwrap_or_else(|_| panic!("no answer to {method}"));
            if answer["id"] == id {
                assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
                return answer["result"].clone();
            }
            self.events.push(answer);
        }
    }

    /// Opens a file at a fragment and waits until the page is ready.
    pub(super) fn open(&mut self, page: &Path, fragment: &str) {
        self.visit(&format!("file://{}#{fragment}", page.display()));
    }

    /// Opens an address and waits until the page is ready.
    pub(super) fn visit(&mut self, url: &str) {
        self.call("Page.navigate", &json!({"url": url}));
        self.wait_for("document.body?.dataset.ready === 'true'");
    }

    /// The value of an expression in the page.
    pub(super) fn value(&mut self, expression: &str) -> Value {
        let asked = json!({"expression": expression, "awaitPromise": true, "returnByValue": true});
        let answer = self.call("Runtime.evaluate", &asked);
        assert!(
            answer["exceptionDetails"].is_null(),
            "{expression}: {}",
            answer["exceptionDetails"]
        );
        answer["result"]["value"].clone()
    }

    /// Waits until an expression holds.
    pub(super) fn wait_for(&mut self, expression: &str) {
        let begun = Instant::now();
        while self.value(expression) != json!(true) {
            let said = self.value("document.getElementById('trouble')?.textContent");
            assert!(
                begun.elapsed() < PATIENCE,
                "never: {expression}; the page says {said}; {:?}",
                self.errors()
            );
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// Presses a key, named as in the DOM.
    pub(super) fn press(&mut self, key: &str) {
        for kind in ["keyDown", "keyUp"] {
            let mut event = json!({"type": kind, "key": key});
            if kind == "keyDown" && key.chars().count() == 1 {
                event["text"] = json!(key);
            }
            self.call("Input.dispatchKeyEvent", &event);
        }
    }

    /// Errors and warnings of the console, and uncaught exceptions.
    pub(super) fn errors(&self) -> Vec<String> {
        let is_error = |event: &&Value| match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => true,
            Some("Runtime.consoleAPICalled") => ["error", "warning", "assert"]
                .iter()
                .any(|t| event["params"]["type"] == *t),
            Some("Log.entryAdded") => ["error", "warning"]
                .iter()
                .any(|l| event["params"]["entry"]["level"] == *l),
            _ => false,
        };
        self.events
            .iter()
            .filter(is_error)
            .map(ToString::to_string)
            .collect()
    }

    /// The network requests of the page, without its own file and data.
    pub(super) fn requests(&self) -> Vec<String> {
        let urls = self
            .events
            .iter()
            .filter(|event| event["method"] == "Network.requestWillBeSent");
        let urls = urls.filter_map(|event| event["params"]["request"]["url"].as_str());
        urls.filter(|url| {
            !["file:", "data:", "blob:", "about:"]
                .iter()
                .any(|s| url.starts_with(s))
        })
        .map(str::to_owned)
        .collect()
    }

    /// Writes a screenshot into the folder `$PLANAGENT_SCREENSHOTS`, if it is set.
    pub(super) fn picture(&mut self, name: &str) {
        use base64::Engine;
        let Some(folder) = std::env::var_os("PLANAGENT_SCREENSHOTS") else {
            return;
        };
        let picture = self.call("Page.captureScreenshot", &json!({"format": "png"}));
        let bytes = base64::engine::general_purpose::STANDARD
            .decode(picture["data"].as_str().unwrap())
            .unwrap();
        std::fs::write(Path::new(&folder).join(format!("{name}.png")), bytes).unwrap();
    }
}

impl Drop for Chromium {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
