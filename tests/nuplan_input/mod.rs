//! nuPlan's data as input: what filters pick, what indices do, and what is said about broken logs and maps.

mod broken_filters;
mod broken_logs;
mod broken_maps;
mod filters;
mod fixture;
mod indices;
mod velocities;
mod words;
