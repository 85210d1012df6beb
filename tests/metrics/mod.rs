//! nuPlan's metrics: published vectors, golden vectors and hand-worked cases on small maps.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

mod aggregate;
mod collisions;
mod comfort;
mod compliance;
mod devkit;
mod documented;
mod lanes;
mod progress;
mod score;
mod stop_lines;
mod vectors;
