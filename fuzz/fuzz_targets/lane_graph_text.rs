//! Gives bytes to the target `lane_graph_text` of `targets.rs`.
#![no_main]

#[path = "../targets.rs"]
mod targets;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    targets::run("lane_graph_text", bytes);
});
