//! The columns of a study beside its scores.

use super::study::rows_of;
use crate::report::{AskedFigures, MetricLoss, SuiteResults};
use crate::study::{Column, Study};
use planagent_agent::simulation::Challenge;
use planagent_runs::report::fixed;
use planagent_runs::report::table::{Table, or_dash, short, three_digits, weights};

/// What the columns of [`Column::Lost`] are.
pub(super) const LOST_NOTE: &str = "Columns of metrics (coll, prog, TTC, comf, ...) = points that the score would gain if that metric alone were \
     perfect. Metrics without a column cost each row less than 0.05 points.";

/// Metrics that cost every variant less have no column, points.
const MIN_LOSS: f64 = 0.05;

/// The columns of the study beside scores; none if it has none.
pub(super) fn costs(study: &Study, suite: &SuiteResults) -> Option<Table> {
    let mut headers = study.labels.clone();
    let lost = losing(suite);
    // Heads and cells are two matches on one list; the compiler asks for both when a column is
    // added.
    for column in &study.columns {
        let heads: &[&str] = match column {
            Column::Calls => &["calls/sim"],
            Column::Parameters => &["params", "paper"],
            Column::CallTime => &["ms/call p50", "paper ms"],
            Column::Collisions => &["collisions"],
            Column::Questions => &["questions/call"],
            Column::Tokens => &["tokens/call"],
            Column::NoPlan => &["unreadable %", "refused %"],
            Column::Lost => {
                headers.extend(
                    lost.iter()
                        .map(|loss| format!("{} {}", loss.label, short(loss.challenge))),
                );
                &[]
            }
        };
        headers.extend(heads.iter().map(ToString::to_string));
    }
    let rows = rows_of(study, suite).map(|(variant, results)| {
        let mut cells = variant.labels.clone();
        let model = results.model.as_ref();
        let paper = model.and_then(|model| model.paper.as_ref());
        let asked = results.asked.as_ref().filter(|_| results.run.is_some());
        let one_digit = |value| fixed(value, 1);
        for column in &study.columns {
            match column {
                Column::Calls => cells.push(or_dash(results.calls_per_simulation, |calls| {
                    fixed(calls, 1)
                })),
                Column::Collisions => {
                    cells.push(or_dash(asked, |asked| asked.collisions.to_string()));
                }
                Column::Questions => {
                    cells.push(or_dash(asked.and_then(|asked| asked.questions), one_digit));
                }
                Column::Tokens => {
                    let tokens = asked.and_then(|asked| asked.tokens);
                    cells.push(or_dash(tokens, |tokens| fixed(tokens, 0)));
                }
                Column::NoPlan => {
                    let percent = |count: fn(&AskedFigures) -> usize| {
                        let share = asked.and_then(|asked| asked.percent(count(asked)));
                        or_dash(share, one_digit)
                    };
                    cells.extend([percent(|a| a.unreadable), percent(|a| a.refused)]);
                }
                Column::Lost => cells.extend(lost.iter().map(|column| {
                    let own = results.lost.iter().find(|own| own.is_of(column));
                    or_dash(own.map(|own| own.points), one_digit)
                })),
                Column::Parameters => cells.extend([
                    or_dash(model.and_then(|model| model.parameters), weights),
                    or_dash(
                        paper.and_then(|paper| paper.parameters.clone()),
                        |parameters| parameters,
                    ),
                ]),
                Column::CallTime => cells.extend([
                    or_dash(model.and_then(|model| model.call_ms), three_digits),
                    or_dash(paper, |paper| paper.time_ms.to_string()),
                ]),
            }
        }
        cells
    });
    (!study.columns.is_empty()).then(|| Table::new(headers, study.labels.len(), rows))
}

/// The metrics that cost some variant, by challenge: one loss of each.
fn losing(suite: &SuiteResults) -> Vec<&MetricLoss> {
    let all = || suite.variants.iter().flat_map(|variant| &variant.lost);
    let mut columns: Vec<&MetricLoss> = Vec::new();
    for loss in all() {
        let costs = all().any(|own| own.is_of(loss) && own.points >= MIN_LOSS);
        if costs && !columns.iter().any(|column| column.is_of(loss)) {
            columns.push(loss);
        }
    }
    columns.sort_by_key(|loss| loss.challenge != Challenge::NonReactive);
    columns
}
