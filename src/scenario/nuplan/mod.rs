//! nuPlan's formats: the log database, the map package, and what both rest on.

pub mod export;
pub mod extraction;
pub mod geometry_blob;
pub mod projection;
pub mod token;
