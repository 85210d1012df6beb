//! Why Reflection refuses a code, in one line.

use planagent_agent::reflection::{ReflectionReport, Verdict};

/// Why Reflection refuses a plan: its score, and the parts that are not whole; empty if it accepts
/// it.
pub(super) fn refusal(report: &ReflectionReport) -> String {
    if report.verdict == Verdict::Execute {
        return String::new();
    }
    let parts: Vec<String> = report
        .parts
        .named()
        .into_iter()
        .filter(|(_, value)| *value < 1.0)
        .map(|(name, value)| format!("{name} {value:.2}"))
        .collect();
    format!(
        "Reflection scores the plan {:.2}, and {} is needed: {}",
        report.score,
        report.threshold,
        parts.join(", ")
    )
}
