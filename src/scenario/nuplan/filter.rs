//! nuPlan's `ScenarioFilter`: which scenarios of the logs to take.

use super::Token;
use std::path::PathBuf;

/// A limit of the number of scenarios.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Limit {
    /// Maximal number.
    Count(usize),
    /// Share of all, between 0 and 1.
    Fraction(f64),
}

/// A set of `lidar_pc` tokens, and the share of a scenario's rows that must be in it.
#[derive(Debug, Clone, PartialEq)]
pub struct TokenSet {
    /// A JSON file with a list of tokens.
    pub path: PathBuf,
    /// More than this share must be in the set; with 1, the rows must equal the set.
    pub fraction: f64,
}

/// Which scenarios [`ScenarioFilter::timestamp_threshold_s`] compares.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ThresholdScope {
    /// Those of all logs, by the clock, as the devkit does: scenarios of logs recorded at the same
    /// time exclude each other.
    #[default]
    AllLogs,
    /// Those of one log.
    EachLog,
}

/// nuPlan's `ScenarioFilter`, field by field; a `None` lets all scenarios pass.
///
/// `expand_scenarios` is missing: it makes scenarios of one frame, which cannot be simulated.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ScenarioFilter {
    /// Scenario types. A row with several of these tags takes the alphabetically last one.
    pub scenario_types: Option<Vec<String>>,
    /// Tokens of the tagged `lidar_pc` rows.
    pub scenario_tokens: Option<Vec<Token>>,
    pub log_names: Option<Vec<String>>,
    /// Names of maps, as `us-ma-boston`.
    pub map_names: Option<Vec<String>>,
    /// Maximal number of each type, evenly spaced in order of log and time.
    pub num_scenarios_per_type: Option<usize>,
    /// Maximal number of all; scenarios of type `unknown` are dropped first.
    pub limit_total_scenarios: Option<Limit>,
    /// Minimal time between the starts of two scenarios of a type, s.
    pub timestamp_threshold_s: Option<f64>,
    /// The scenarios that [`Self::timestamp_threshold_s`] compares; not a field of nuPlan.
    pub threshold_scope: ThresholdScope,
    /// Minimal distance that the center of the ego moves over the scenario, m.
    pub ego_displacement_minimum_m: Option<f64>,
    /// Whether scenarios without a mission goal are excluded.
    pub remove_invalid_goals: bool,
    /// Whether order and samples are random. The devkit draws from Python's global generator, whose
    /// state is unknown; here the numbers come from [`Self::seed`].
    pub shuffle: bool,
    /// Seed of [`Self::shuffle`]; not a field of nuPlan.
    pub seed: u64,
    /// Speed that the ego must rise above at some time, m/s.
    pub ego_start_speed_threshold: Option<f64>,
    /// Speed that the ego must fall to at some time, m/s.
    pub ego_stop_speed_threshold: Option<f64>,
    /// Changes of speed up to this are noise, m/s; 0.1 by default.
    pub speed_noise_tolerance: Option<f64>,
    pub token_set: Option<TokenSet>,
    /// Maximal distance of the ego at iteration 0 to a lane of the route, m.
    pub ego_route_radius: Option<f64>,
}

/// Name of [`ScenarioFilter::timestamp_threshold_s`] in an [`super::Exclusion`].
pub(crate) const THRESHOLD_KEY: &str = "timestamp_threshold_s";

/// Default of [`ScenarioFilter::speed_noise_tolerance`], m/s (devkit `_check_for_speed_edge`).
pub(super) const SPEED_NOISE: f64 = 0.1;

impl ScenarioFilter {
    /// Whether a filter needs the frames of a scenario, not only its name, time and type.
    pub(super) fn needs_rows(&self) -> bool {
        self.ego_displacement_minimum_m.is_some()
            || self.ego_start_speed_threshold.is_some()
            || self.ego_stop_speed_threshold.is_some()
            || self.token_set.is_some()
            || self.ego_route_radius.is_some()
    }
}
