//! The version of the program's results.

/// Version of what simulations compute. It is part of a run's identity: runs of another version are
/// not resumed, and studies simulate again.
///
/// Raise it whenever a change alters a score, a metric or a planner code of any simulation.
/// `tests/runner/pinned.rs` compares some simulations with pinned scores and fails when this was
/// forgotten.
pub const RESULT_VERSION: u32 = 26;
