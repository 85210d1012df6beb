//! nuPlan's data as input: filters, indices, and the errors of broken logs and maps.

mod broken_filters;
mod broken_logs;
mod broken_maps;
mod filters;
mod fixture;
mod hostile_logs;
mod indices;
mod velocities;
mod words;
