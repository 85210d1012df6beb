//! What a study of recordings adds to its results: each recording, and the planning calls.

use super::results::VariantSimulations;
use planagent_agent::simulation::Challenge;
use planagent_runs::report::SimulationRow;
use planagent_scenario::without_start;
use planagent_score::metrics::distinct;
use serde::Serialize;

/// Metric of collisions at the ego's fault.
const COLLISIONS: &str = "no_ego_at_fault_collisions";
/// Smaller losses have no class, points.
const LOSS: f64 = 1.0;

/// The planning calls of a variant, and its collisions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CallShares {
    /// Simulations with a collision at the ego's fault, by challenge.
    pub at_fault: Vec<(Challenge, usize)>,
    /// Planning calls; the other numbers are of these.
    pub planning_calls: usize,
    /// Calls in which every plan leaves the route.
    pub off_route: usize,
    /// Calls in which every plan leaves the drivable area.
    pub off_area: usize,
    /// Calls whose first attempt was refused.
    pub first_refused: usize,
    /// Calls whose attempts were all refused.
    pub all_refused: usize,
}

impl CallShares {
    pub(super) fn from_rows(rows: &[SimulationRow]) -> Self {
        let sum = |of: fn(&SimulationRow) -> usize| rows.iter().map(of).sum();
        let collides =
            |row: &&SimulationRow| row.metric(COLLISIONS).is_some_and(|score| score < 1.0);
        let at_fault = |challenge| {
            rows.iter()
                .filter(|row| row.challenge == challenge)
                .filter(collides)
                .count()
        };
        Self {
            at_fault: Challenge::CLOSED_LOOP
                .map(|challenge| (challenge, at_fault(challenge)))
                .to_vec(),
            planning_calls: sum(|row| row.planning_calls),
            off_route: sum(|row| row.off_route_calls),
            off_area: sum(|row| row.off_area_calls),
            first_refused: sum(|row| row.first_refused_calls),
            all_refused: sum(|row| row.refused_calls),
        }
    }
}

/// A recording from all of its start times.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordingResults {
    /// Name of the recording.
    pub recording: String,
    /// Number of start times.
    pub starts: usize,
    /// The challenges.
    pub challenges: Vec<RecordingScores>,
}

/// The scores on a recording in a challenge.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordingScores {
    pub challenge: Challenge,
    /// Mean score of each variant over the start times, in the study's order.
    pub scores: Vec<Option<f64>>,
    /// Where the first variant loses most against the reference: nuPlan's metric. None for a loss
    /// below one point.
    pub loss: Option<String>,
}

/// Each recording, by name.
pub(super) fn recordings(
    variants: &[VariantSimulations],
    reference: usize,
) -> Vec<RecordingResults> {
    let rows: Vec<&[SimulationRow]> = variants.iter().map(VariantSimulations::rows).collect();
    let mut names: Vec<String> = distinct(rows.iter().flat_map(|rows| rows.iter()).map(name));
    names.sort();
    let recordings = names.into_iter().map(|recording| {
        let starts = distinct(
            rows.iter()
                .flat_map(|rows| rows_of(rows, &recording, None))
                .map(|row| &row.source),
        )
        .len();
        let challenges = Challenge::CLOSED_LOOP.map(|challenge| {
            let own: Vec<Vec<&SimulationRow>> = rows
                .iter()
                .map(|rows| rows_of(rows, &recording, Some(challenge)).collect())
                .collect();
            let scores: Vec<Option<f64>> = own.iter().map(|rows| mean(rows)).collect();
            let at = |place: usize| scores.get(place).copied().flatten();
            // Only a clear loss is traced to a simulation; small differences are the noise of a
            // recording.
            let loses = at(0)
                .zip(at(reference))
                .is_some_and(|(first, other)| first < other - LOSS);
            let loss = own
                .first()
                .zip(own.get(reference))
                .filter(|_| loses)
                .and_then(|(a, b)| largest_loss(a, b));
            RecordingScores {
                challenge,
                scores,
                loss,
            }
        });
        RecordingResults {
            recording,
            starts,
            challenges: challenges.to_vec(),
        }
    });
    recordings.collect()
}

fn name(row: &SimulationRow) -> String {
    without_start(&row.scenario).to_owned()
}

fn rows_of<'a>(
    rows: &'a [SimulationRow],
    recording: &'a str,
    challenge: Option<Challenge>,
) -> impl Iterator<Item = &'a SimulationRow> {
    let own = rows
        .iter()
        .filter(move |row| without_start(&row.scenario) == recording);
    own.filter(move |row| challenge.is_none_or(|challenge| row.challenge == challenge))
}

fn mean(rows: &[&SimulationRow]) -> Option<f64> {
    let scores: Vec<f64> = rows
        .iter()
        .filter_map(|row| Some(row.score? * 100.0))
        .collect();
    (!scores.is_empty()).then(|| scores.iter().sum::<f64>() / scores.len() as f64)
}

/// The metric whose mean over the start times falls most.
fn largest_loss(first: &[&SimulationRow], other: &[&SimulationRow]) -> Option<String> {
    let metrics = distinct(
        other
            .iter()
            .flat_map(|row| &row.metrics)
            .map(|metric| metric.name.clone()),
    );
    let mean = |rows: &[&SimulationRow], metric: &str| {
        let scores: Vec<f64> = rows.iter().filter_map(|row| row.metric(metric)).collect();
        (!scores.is_empty()).then(|| scores.iter().sum::<f64>() / scores.len() as f64)
    };
    let losses = metrics
        .into_iter()
        .filter_map(|metric| Some((mean(other, &metric)? - mean(first, &metric)?, metric)));
    losses
        .rev()
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(loss, _)| *loss > 0.0)
        .map(|(_, metric)| metric)
}
