//! Sizes of the files of a run. Who made a run folder may have packed more into it than a memory
//! holds, so each limit is a small multiple of what real runs have.

/// Largest `manifest.toml`, bytes: 80,000 recordings with their digests.
pub(super) const MAX_MANIFEST_BYTES: u64 = 16 << 20;
/// Largest `summary.json`, bytes: a kilobyte for each of 60,000 simulations.
pub(super) const MAX_SUMMARY_BYTES: u64 = 64 << 20;
/// Largest `record.toml`, bytes. That of a simulation of 15 s with a model has 9,000.
pub(super) const MAX_RECORD_BYTES: u64 = 2 << 20;
/// Largest `metrics.toml`, bytes. That of a simulation of 15 s has 60,000.
pub(super) const MAX_METRICS_BYTES: u64 = 4 << 20;
/// Largest `calls.jsonl` of a simulation, bytes. A planning call has 20,000 to 200,000.
pub(super) const MAX_CALLS_BYTES: u64 = 64 << 20;
/// Largest record of a planning call, bytes.
pub(super) const MAX_CALL_BYTES: usize = 4 << 20;
/// Largest `replay.json.gz`, bytes. That of a recording of 15 s has 40,000.
pub(super) const MAX_REPLAY_BYTES: u64 = 4 << 20;
/// Largest replay once unpacked, bytes.
pub(super) const MAX_UNPACKED_BYTES: u64 = 16 << 20;
/// Largest BEV map, bytes.
pub(super) const MAX_IMAGE_BYTES: u64 = 4 << 20;
/// Largest side of a BEV map, pixels.
pub(super) const MAX_IMAGE_PIXELS: u32 = 4096;
/// Largest `transcript.md`, bytes.
pub(super) const MAX_TRANSCRIPT_BYTES: u64 = 64 << 20;

/// Longest name of a scenario, its source, log or type, bytes. A path of Linux has at most 4,096.
pub(super) const MAX_NAME_BYTES: usize = 8 << 10;
/// Maximum number of simulations of a run.
pub(super) const MAX_SIMULATIONS: usize = 1_000_000;
/// Maximum number of iterations of a simulation: a day.
pub(super) const MAX_ITERATIONS: usize = 864_000;
/// Maximum number of metrics of a simulation.
pub(super) const MAX_METRICS: usize = 1_000;
/// Maximum number of attempts of a planning call.
pub(super) const MAX_ATTEMPTS: usize = 1_000;
/// Maximum number of objects, lanes or areas of a replay.
pub(super) const MAX_OBJECTS: usize = 100_000;
