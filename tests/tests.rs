//! The one integration-test binary; a module a subject.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]
#![allow(clippy::print_stdout, reason = "some tests print what they measure")]

// Its `#[test]` stands before the compiler's, which would remove the functions.
#[macro_use]
extern crate planagent_test_attribute;

mod agent;
mod architecture;
mod argoverse2;
mod bench;
mod cases;
mod cli;
mod default_scenario;
mod docs;
mod endpoint;
mod environment;
mod fuzz_corpus;
mod generator;
mod harness;
#[cfg(feature = "learned")]
mod learned;
mod llm_assist;
mod metrics;
mod mllm;
mod monitored_agent;
mod nuplan;
mod nuplan_input;
mod outside;
mod own_clock;
mod own_planner;
mod own_reader;
mod page;
mod pdm;
mod proposals;
mod public_api;
mod public_items;
mod recordings;
mod road;
mod runner;
mod simulation;
mod study;
mod supply_chain;
mod timed_agent;
mod tokens;
mod womd;
mod words;

fn main() -> std::process::ExitCode {
    harness::run()
}
