//! Which scenarios of the logs are wanted: nuPlan's `ScenarioFilter`.

use super::Token;
use std::path::PathBuf;

/// A limit on the number of scenarios.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Limit {
    /// At most so many.
    Count(usize),
    /// This share of all, between 0 and 1.
    Fraction(f64),
}

/// A set of `lidar_pc` tokens and the share of a scenario's rows that must be in it.
#[derive(Debug, Clone, PartialEq)]
pub struct TokenSet {
    /// A JSON file: a list of tokens.
    pub path: PathBuf,
    /// More than this share must be in the set; with 1, the scenario's rows must be the set.
    pub fraction: f64,
}

/// Which scenarios [`ScenarioFilter::timestamp_threshold_s`] compares.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ThresholdScope {
    /// Those of all logs, by the clock, as the devkit does: of logs that were recorded at one time, one stands in the others' way.
    #[default]
    AllLogs,
    /// Those of one log.
    EachLog,
}

/// nuPlan's `ScenarioFilter`, field by field; a `None` lets everything pass.
///
/// `expand_scenarios` is missing: it makes scenarios of one frame, which nothing can be driven in.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ScenarioFilter {
    /// Scenario types; a row with several tags takes the alphabetically last of those that are listed here.
    pub scenario_types: Option<Vec<String>>,
    /// Scenario tokens: those of the tagged `lidar_pc` rows.
    pub scenario_tokens: Option<Vec<Token>>,
    /// Names of logs.
    pub log_names: Option<Vec<String>>,
    /// Names of maps, as `us-ma-boston`.
    pub map_names: Option<Vec<String>>,
    /// At most so many of each type, evenly spaced in order of log and time.
    pub num_scenarios_per_type: Option<usize>,
    /// At most so many in all; those of type `unknown` go first.
    pub limit_total_scenarios: Option<Limit>,
    /// Scenarios of a type begin at least this many seconds after one another.
    pub timestamp_threshold_s: Option<f64>,
    /// Among which scenarios [`Self::timestamp_threshold_s`] holds; not a field of nuPlan's.
    pub threshold_scope: ThresholdScope,
    /// The centre of the ego moves at least so far over the scenario, metres.
    pub ego_displacement_minimum_m: Option<f64>,
    /// Whether scenarios without a mission goal are left out.
    pub remove_invalid_goals: bool,
    /// Whether the order is random and samples are drawn at random. The devkit draws from Python's global generator, whose state
    /// nobody knows; here [`Self::seed`] decides.
    pub shuffle: bool,
    /// Seed of [`Self::shuffle`]; not a field of nuPlan's.
    pub seed: u64,
    /// The speed of the ego rises above this at some time, m/s.
    pub ego_start_speed_threshold: Option<f64>,
    /// The speed of the ego falls to this at some time, m/s.
    pub ego_stop_speed_threshold: Option<f64>,
    /// Changes of speed up to this are noise, m/s; 0.1 when not given.
    pub speed_noise_tolerance: Option<f64>,
    /// Tokens that the rows of a scenario should be among.
    pub token_set: Option<TokenSet>,
    /// A lane of the route lies within this distance of the ego at iteration 0, metres.
    pub ego_route_radius: Option<f64>,
}

/// Name of [`ScenarioFilter::timestamp_threshold_s`] in what a search tells.
pub const THRESHOLD_KEY: &str = "timestamp_threshold_s";

/// Noise of the speed when the filter does not say, m/s (devkit `_check_for_speed_edge`).
pub(super) const SPEED_NOISE: f64 = 0.1;

impl ScenarioFilter {
    /// Whether a filter looks at the frames of a scenario, not only at its name, time and type.
    pub(super) fn looks_inside(&self) -> bool {
        self.ego_displacement_minimum_m.is_some()
            || self.ego_start_speed_threshold.is_some()
            || self.ego_stop_speed_threshold.is_some()
            || self.token_set.is_some()
            || self.ego_route_radius.is_some()
    }
}
