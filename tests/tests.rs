//! The one integration-test binary; a module a subject.

mod environment;
mod metrics;
mod mllm;
mod womd;
