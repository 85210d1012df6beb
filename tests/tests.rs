//! The one integration-test binary; a module a subject.

mod metrics;
mod mllm;
