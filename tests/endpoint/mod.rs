//! Models behind a server: requests, answers, failures, and simulations that continue after them.

mod card;
mod deadline;
mod key;
mod llama_cpp;
mod probe;
mod questions;
pub(crate) mod server;
mod simulation;
mod troubles;

use planagent_mllm::{
    Constraint, Deadline, Endpoint, EndpointSettings, Mllm, MllmError, Request, Sampling,
};
use server::Server;
use toml::toml;

/// Settings of a server with GBNF, few retries and short waits.
fn settings(url: &str) -> EndpointSettings {
    let mut table = toml! {
        model = "test-model"
        grammar = "gbnf"
        timeout_ms = 20000
        retries = 2
        first_wait_ms = 5
    };
    table.insert("endpoint".into(), url.into());
    table.try_into().unwrap()
}

fn open(server: &Server) -> Endpoint {
    Endpoint::open("test", &settings(&server.url())).unwrap()
}

fn request(constraint: Constraint) -> Request {
    Request {
        constraint,
        max_new_tokens: 50,
        sampling: Sampling::Greedy,
        deadline: Deadline::NONE,
        draft: None,
    }
}

/// Asks one question.
fn ask(endpoint: &Endpoint, request: &Request) -> Result<planagent_mllm::Answer, MllmError> {
    endpoint
        .converse(&planagent_mllm::PromptPrefix::default(), 0)
        .unwrap()
        .ask("Which lane?", request)
}
