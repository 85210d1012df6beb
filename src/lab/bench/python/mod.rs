//! Engines that run in a Python interpreter of their own. A measuring process is the text of
//! `worker.py` with that of the engine behind it.

use super::engine::{Engine, EngineError, EngineName};
use std::path::PathBuf;
use std::process::Command;

/// An engine of a Python package.
#[derive(Debug, PartialEq, Eq)]
pub struct PythonEngine {
    pub name: EngineName,
    /// Its code behind the protocol.
    code: &'static str,
    /// The Python package that is installed for it.
    pub(crate) package: &'static str,
    /// The environment variable that names an interpreter with the package.
    pub variable: &'static str,
}

/// The protocol of a measuring process in Python.
const PROTOCOL: &str = include_str!("worker.py");
/// Starts it, once the class of the engine is there.
const START: &str = "main(Engine)\n";

/// All engines in Python. A further one is a file beside these and a row here.
static ENGINES: [PythonEngine; 2] = [
    PythonEngine {
        name: EngineName::LlamaCpp,
        code: include_str!("llama_cpp.py"),
        package: "llama-cpp-python",
        variable: "PLANAGENT_LLAMA_PYTHON",
    },
    PythonEngine {
        name: EngineName::OpenVino,
        code: concat!(
            include_str!("openvino_export.py"),
            "\n\n",
            include_str!("openvino_qwen.py"),
            "\n\n",
            include_str!("openvino.py")
        ),
        package: "openvino",
        variable: "PLANAGENT_OPENVINO_PYTHON",
    },
];

impl PythonEngine {
    /// The row of an engine; none for an engine that is no Python package.
    pub fn find(name: EngineName) -> Option<&'static Self> {
        ENGINES.iter().find(|engine| engine.name == name)
    }

    fn text(&self) -> String {
        [PROTOCOL, self.code, START].join("\n\n")
    }
}

/// An engine and the interpreter that has its package.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PythonWorker {
    pub engine: &'static PythonEngine,
    /// A Python interpreter.
    pub python: PathBuf,
}

impl PythonWorker {
    /// Starts the measuring process.
    ///
    /// # Errors
    /// When the interpreter cannot be started.
    pub fn start(&self) -> Result<Engine, EngineError> {
        let mut command = Command::new(&self.python);
        Engine::start(self.engine.name, command.args(["-c", &self.engine.text()]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::budget::Layout;
    use crate::bench::protocol::{Precision, PrepareRequest, Reply, Request};
    use planagent_mllm::Step;

    /// The word of a value with or without fields.
    fn word(value: &impl serde::Serialize) -> String {
        match serde_json::to_value(value).unwrap() {
            serde_json::Value::Object(fields) => fields.keys().next().unwrap().clone(),
            word => word.as_str().unwrap().to_owned(),
        }
    }

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
        for word in steps.iter().map(word) {
            assert!(PROTOCOL.contains(&format!("name == \"{word}\"")), "{word}");
        }
        let prepare = PrepareRequest {
            folder: PathBuf::new(),
            files: std::collections::BTreeMap::new(),
            gguf: None,
            export: PathBuf::new(),
            weights: Precision::Int8,
            tower: Precision::Bf16,
            seed: 0,
        };
        for request in [
            Request::Prepare(prepare),
            Request::Run(Vec::new()),
            Request::Answer {
                prompt: Vec::new(),
                count: 0,
            },
            Request::Features { side: 0, most: 0 },
        ] {
            let word = word(&request);
            assert!(
                PROTOCOL.contains(&format!("\"{word}\" in request")),
                "{word}"
            );
        }
        let prepared = word(&Reply::Prepared);
        assert!(PROTOCOL.contains(&format!("reply = \"{prepared}\"")));
        let layout = serde_json::to_string(&Layout::PrefixFirst).unwrap();
        for engine in &ENGINES {
            assert!(
                engine.text().contains(&format!("\"layout\": {layout}")),
                "{}: {layout}",
                engine.name
            );
        }
    }

    #[test]
    fn every_field_of_a_preparation_is_read() {
        let text = PythonEngine::find(EngineName::OpenVino).unwrap().text();
        let request = serde_json::json!(PrepareRequest {
            folder: PathBuf::new(),
            files: std::collections::BTreeMap::new(),
            gguf: None,
            export: PathBuf::new(),
            weights: Precision::Int4,
            tower: Precision::F32,
            seed: 0,
        });
        for field in request.as_object().unwrap().keys() {
            assert!(text.contains(&format!("request[\"{field}\"]")), "{field}");
        }
        for precision in Precision::ALL {
            let word = serde_json::to_string(&precision).unwrap();
            assert_eq!(word, format!("\"{precision}\""));
            assert!(text.contains(&word), "{word}");
        }
    }
}
