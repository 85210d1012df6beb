//! The one integration-test binary; a module a subject.

mod architecture;
mod cli;
mod environment;
mod metrics;
mod mllm;
mod womd;
