//! nuPlan's metrics and PDM's scorer: published vectors, golden vectors and hand-worked cases on small maps.

mod aggregate;
mod collisions;
mod comfort;
mod compliance;
mod devkit;
mod forecast;
mod lanes;
mod pdm;
mod progress;
mod road;
mod score;
