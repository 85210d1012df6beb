//! Reflection's verdict on one plan in words: every part of its score, what each costs, and whether
//! the plan is executed.

use super::number::fixed;
use planagent_agent::reflection::{ProgressReference, ReflectionReport, Verdict};
use planagent_score::pdm::{WEIGHT_COMFORT, WEIGHT_PROGRESS, WEIGHT_TTC};
use serde::Serialize;

/// How far PDM's scorer looks ahead for the time to collision, seconds.
const TTC_S: f64 = 0.9;
/// Costs below this are not named.
const MIN_COST: f64 = 0.005;

/// Reflection's verdict on a plan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judgement {
    /// s, in [0, 1].
    pub score: f64,
    /// λ.
    pub threshold: f64,
    /// Whether λ is that of plans that begin a lane change or stay in a blocked lane.
    pub lane_change_threshold: bool,
    /// Whether it would be executed.
    pub executed: bool,
    /// Why.
    pub reason: String,
    /// The parts of the score.
    pub metrics: Vec<JudgedMetric>,
}

/// A part of the score.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JudgedMetric {
    /// Its name.
    pub name: &'static str,
    /// Its value, in [0, 1].
    pub value: f64,
    /// Its weight in the mean; none for a part that multiplies the score.
    pub weight: Option<f64>,
    /// What it says of this plan.
    pub finding: String,
}

impl Judgement {
    /// The verdict of a report; `lane_change` says whether its λ is that of plans that begin a lane
    /// change or stay in a blocked lane.
    pub fn from_report(report: &ReflectionReport, lane_change: bool) -> Self {
        let metrics = metrics(report);
        let executed = report.verdict == Verdict::Execute;
        let reason = reason(report, &metrics, lane_change);
        Self {
            score: report.score,
            threshold: report.threshold,
            lane_change_threshold: lane_change,
            executed,
            reason,
            metrics,
        }
    }
}

fn metrics(report: &ReflectionReport) -> Vec<JudgedMetric> {
    let parts = &report.parts;
    let when = |time: Option<f64>| {
        time.map(|time| format!(" after {} s", fixed(time, 1)))
            .unwrap_or_default()
    };
    // A sentence for each factor of the score, in the order of its formula.
    let collision = match parts.no_collision {
        value if value >= 1.0 => "the ego causes no collision".to_owned(),
        value if value > 0.0 => format!("the ego hits an object{}", when(report.first_at_fault_s)),
        _ => format!(
            "the ego causes a collision{}",
            when(report.first_at_fault_s)
        ),
    };
    let area = if parts.drivable_area >= 1.0 {
        "all corners of the ego stay on the drivable area"
    } else {
        "a corner of the ego leaves the drivable area"
    };
    let direction = if parts.driving_direction >= 1.0 {
        "the ego keeps out of oncoming lanes"
    } else {
        "the ego drives in oncoming lanes"
    };
    let progress = match report.progress_reference {
        ProgressReference::PdmProposals => {
            format!(
                "{} m, {} % of the best proposal",
                fixed(report.progress_m, 1),
                fixed(100.0 * parts.progress, 0)
            )
        }
        ProgressReference::Reach => format!(
            "{} m; {} % of what could be reached in this way or past what blocks the lane",
            fixed(report.progress_m, 1),
            fixed(100.0 * parts.progress, 0)
        ),
        ProgressReference::OwnProgress => {
            format!(
                "{} m; there are no proposals to compare with",
                fixed(report.progress_m, 1)
            )
        }
    };
    let ttc = if parts.time_to_collision >= 1.0 {
        format!("no collision is within {TTC_S} s at constant speed")
    } else {
        format!(
            "a collision is within {TTC_S} s at constant speed{}",
            when(report.first_ttc_s)
        )
    };
    let comfort = if parts.comfort >= 1.0 {
        "all limits of acceleration, jerk and yaw hold"
    } else {
        "a limit of acceleration, jerk or yaw is exceeded"
    };
    let part = |name, value, weight, finding| JudgedMetric {
        name,
        value,
        weight,
        finding,
    };
    vec![
        part("no at-fault collision", parts.no_collision, None, collision),
        part("drivable area", parts.drivable_area, None, area.to_owned()),
        part(
            "driving direction",
            parts.driving_direction,
            None,
            direction.to_owned(),
        ),
        part("progress", parts.progress, Some(WEIGHT_PROGRESS), progress),
        part(
            "time to collision",
            parts.time_to_collision,
            Some(WEIGHT_TTC),
            ttc,
        ),
        part(
            "comfort",
            parts.comfort,
            Some(WEIGHT_COMFORT),
            comfort.to_owned(),
        ),
    ]
}

/// Two numbers with two decimals, or as many more as tell them apart.
fn told_apart(a: f64, b: f64) -> (String, String) {
    let written = |decimals| (fixed(a, decimals), fixed(b, decimals));
    (2..=9)
        .map(written)
        .find(|(a, b)| a != b)
        .unwrap_or_else(|| written(2))
}

fn reason(report: &ReflectionReport, metrics: &[JudgedMetric], higher: bool) -> String {
    let (score, threshold) = told_apart(report.score, report.threshold);
    let needed = if report.threshold > 1.0 {
        "the threshold of a plan that leaves a lane in which the ego can pass what stands there"
    } else if higher {
        "the threshold of a plan that begins a lane change or stays in a blocked lane"
    } else {
        "the threshold"
    };
    if report.verdict == Verdict::Execute {
        return format!("{score} is not below {threshold}, {needed}");
    }
    let refused = format!("{score} is below {threshold}, {needed}");
    let costs = costs(metrics);
    if costs.is_empty() {
        refused
    } else {
        format!("{refused}: {}", costs.join("; "))
    }
}

/// What lowers the score, the largest cost first. Where a factor is 0, nothing else matters.
fn costs(metrics: &[JudgedMetric]) -> Vec<String> {
    let factors = || {
        metrics
            .iter()
            .filter(|metric| metric.weight.is_none() && metric.value < 1.0)
    };
    let zero: Vec<String> = factors()
        .filter(|metric| metric.value <= 0.0)
        .map(|metric| format!("{} (factor 0)", metric.finding))
        .collect();
    // The score is a product, so a factor of 0 makes all other costs meaningless.
    if !zero.is_empty() {
        return zero;
    }
    let factor: f64 = factors().map(|metric| metric.value).product();
    let all: f64 = metrics.iter().filter_map(|metric| metric.weight).sum();
    let mut weighted: Vec<(f64, String)> = metrics
        .iter()
        .filter_map(|metric| Some((factor * metric.weight? * (1.0 - metric.value) / all, metric)))
        .filter(|(cost, _)| *cost >= MIN_COST)
        .map(|(cost, metric)| {
            (
                cost,
                format!("{} ({}: -{})", metric.finding, metric.name, fixed(cost, 2)),
            )
        })
        .collect();
    weighted.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    let factors =
        factors().map(|metric| format!("{} (factor {})", metric.finding, fixed(metric.value, 1)));
    factors
        .chain(weighted.into_iter().map(|(_, words)| words))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::reflection::{BehaviorScores, SubScores};
    use planagent_score::pdm::DrivableLayers;

    fn report(parts: SubScores, score: f64) -> ReflectionReport {
        ReflectionReport {
            score,
            parts,
            behaviors: BehaviorScores::new(score, score, score),
            progress_reference: ProgressReference::PdmProposals,
            drivable_layers: DrivableLayers::Lanes,
            threshold: 0.75,
            verdict: if score >= 0.75 {
                Verdict::Execute
            } else {
                Verdict::Rethink
            },
            progress_m: 12.0,
            first_at_fault_s: Some(2.3),
            first_ttc_s: Some(1.2),
            states: Vec::new(),
        }
    }

    const GOOD: SubScores = SubScores {
        no_collision: 1.0,
        drivable_area: 1.0,
        driving_direction: 1.0,
        progress: 1.0,
        time_to_collision: 1.0,
        comfort: 1.0,
    };

    #[test]
    fn a_whole_score_may_be_too_little_to_leave_the_lane() {
        let refused = ReflectionReport {
            threshold: 1.02,
            verdict: Verdict::Rethink,
            ..report(GOOD, 1.0)
        };
        assert_eq!(
            Judgement::from_report(&refused, true).reason,
            "1.00 is below 1.02, the threshold of a plan that leaves a lane in which the ego can pass what stands there"
        );
    }

    #[test]
    fn a_reason_names_what_costs_most_first() {
        let slow = SubScores {
            progress: 0.4,
            time_to_collision: 0.0,
            ..GOOD
        };
        let judged = Judgement::from_report(&report(slow, 0.333), false);
        assert!(!judged.executed);
        assert_eq!(
            judged.reason,
            "0.33 is below 0.75, the threshold: a collision is within 0.9 s at constant speed after 1.2 s (time to \
             collision: -0.42); 12.0 m, 40 % of the best proposal (progress: -0.25)"
        );
        let hit = SubScores {
            no_collision: 0.0,
            progress: 0.0,
            ..GOOD
        };
        let judged = Judgement::from_report(&report(hit, 0.0), true);
        assert!(
            judged
                .reason
                .ends_with("blocked lane: the ego causes a collision after 2.3 s (factor 0)"),
            "{}",
            judged.reason
        );
        let good = Judgement::from_report(&report(GOOD, 1.0), false);
        assert_eq!(
            (good.executed, good.reason.as_str()),
            (true, "1.00 is not below 0.75, the threshold")
        );
        assert_eq!(good.metrics.len(), GOOD.named().len());
        let scarcely = Judgement::from_report(&report(slow, 0.7496), false);
        assert!(
            scarcely
                .reason
                .starts_with("0.7496 is below 0.7500, the threshold"),
            "{}",
            scarcely.reason
        );
    }
}
