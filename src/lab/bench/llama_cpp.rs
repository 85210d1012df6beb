//! llama.cpp through the Python package `llama-cpp-python`.

use std::path::PathBuf;
use std::process::Command;

/// The measuring process: reads requests, calls the low-level interface of `llama_cpp`, writes
/// replies.
const WORKER: &str = include_str!("llama_cpp_worker.py");

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LlamaCpp {
    /// A Python interpreter with `llama_cpp`.
    pub python: PathBuf,
}

impl LlamaCpp {
    /// The command of the measuring process.
    pub fn command(&self) -> Command {
        let mut command = Command::new(&self.python);
        command.args(["-c", WORKER]);
        command
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::budget::Layout;
    use crate::bench::protocol::Request;
    use planagent_mllm::Step;

    #[test]
    fn the_worker_knows_the_words_of_the_protocol() {
        let steps = [
            Step::Keep(0),
            Step::Encode,
            Step::Image,
            Step::Text(1),
            Step::FastForwarded(1),
            Step::Sampled(1),
            Step::Compute,
        ];
        let word = |step: &Step| match serde_json::to_value(step).unwrap() {
            serde_json::Value::Object(fields) => fields.keys().next().unwrap().clone(),
            word => word.as_str().unwrap().to_owned(),
        };
        for word in steps.iter().map(word) {
            assert!(WORKER.contains(&format!("name == \"{word}\"")), "{word}");
        }
        for request in [
            Request::Run(Vec::new()),
            Request::Answer {
                prompt: Vec::new(),
                count: 0,
            },
            Request::Features { side: 0, most: 0 },
        ] {
            let request = serde_json::to_value(request).unwrap();
            let word = request.as_object().unwrap().keys().next().unwrap();
            assert!(WORKER.contains(&format!("\"{word}\" in request")), "{word}");
        }
        let layout = serde_json::to_string(&Layout::PrefixFirst).unwrap();
        assert!(
            WORKER.contains(&format!("\"layout\": {layout}")),
            "{layout}"
        );
    }
}
