//! The simulations of a card: the model among other sources of codes, then with plans that come late.

use super::calls::{self, CallCounts};
use super::measured::{CallCost, Measured};
use super::outcome::Part;
use super::scores::{SourceScore, late_study, scores, study};
use crate::report::{SuiteSimulations, VariantSimulations};
use crate::study_runs::{Studies, StudiesRequest};
use planagent_planners::all_planners;
use planagent_runs::report::SimulationRow;
use planagent_runs::runner::{Config, Listener, RunnerError};
use std::path::Path;

/// Folder of the runs in that of a card, as studies have it.
pub(super) const RUNS: &str = "runs";

/// What is simulated.
pub(super) struct Loop<'a> {
    /// Folder of the card.
    pub(super) out: &'a Path,
    /// Scenes of a suite.
    pub(super) limit: usize,
    pub(super) retry_failed: bool,
    /// Whether the model sees a picture.
    pub(super) sees: bool,
    /// Whether codes may name the oncoming lane.
    pub(super) oncoming: bool,
}

/// What came of it.
pub(super) struct Simulated {
    pub(super) scores: Vec<SourceScore>,
    pub(super) calls: Vec<CallCounts>,
    pub(super) measured: Part<Measured>,
    /// Simulations that failed.
    pub(super) failed: Vec<SimulationRow>,
    /// Planning calls without an answer.
    pub(super) unanswered: usize,
}

impl Loop<'_> {
    /// Simulates what is left. The latency is that of `earlier`, else the one that is measured.
    pub(super) fn simulate(
        &self,
        earlier: Option<CallCost>,
        config: &Config,
        listener: &Listener,
    ) -> Result<Simulated, RunnerError> {
        let request = StudiesRequest {
            registry: all_planners(),
            out: self.out.to_owned(),
            limit: Some(self.limit),
            retry_failed: self.retry_failed,
            ..StudiesRequest::default()
        };
        let mut studies = Studies::new(&request, config, listener)?;
        let sources = study(self.sees, self.oncoming);
        let suites = studies.simulate_variants(sources.clone())?;
        let cost = earlier.or_else(|| CallCost::from_rows(model_rows(&suites)));
        let mut of_late = Vec::new();
        // The latency is known only after the loop without one.
        let measured = match cost {
            Some(cost) => {
                let late = late_study(cost.latency_ms);
                of_late = studies.simulate_variants(late.clone())?;
                let late = scores(&late, &of_late, &suites);
                Part::Known(Measured { cost, late })
            }
            None => Part::missing("no planning call was made"),
        };
        let rows = || {
            let suites = suites.iter().chain(&of_late);
            let variants = suites.flat_map(|suite| &suite.variants);
            variants.flat_map(VariantSimulations::rows)
        };
        Ok(Simulated {
            scores: scores(&sources, &suites, &suites),
            calls: calls::count(&suites, &self.out.join(RUNS))?,
            measured,
            failed: rows().filter(|row| row.error.is_some()).cloned().collect(),
            unanswered: rows().map(|row| row.failed_calls).sum(),
        })
    }
}

/// The simulations of the model as it is.
fn model_rows(suites: &[SuiteSimulations]) -> impl Iterator<Item = &SimulationRow> {
    let model = suites.iter().filter_map(|suite| suite.variants.first());
    model.flat_map(VariantSimulations::rows)
}
