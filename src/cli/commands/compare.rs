//! `planagent compare`.

use crate::args::CompareArguments;
use crate::completed::completed;
use crate::{Exit, Printer};
use anyhow::bail;
use planagent_runs::report::{PlannerPair, RunComparison, RunFolder, comparison_table};

/// Compares two runs; the table goes to stdout.
pub(crate) fn run(flags: &CompareArguments, printer: Printer) -> anyhow::Result<Exit> {
    let [first, second] = [&flags.first, &flags.second];
    let manifests = [RunFolder::manifest(first)?, RunFolder::manifest(second)?];
    let rows = [completed(first, printer)?, completed(second, printer)?];
    // clap takes any number of values between commas, so the count is checked here.
    let named = match flags.planner.as_slice() {
        [] => None,
        [first, second] => Some(PlannerPair {
            first: first.clone(),
            second: second.clone(),
        }),
        other => bail!(
            "--planner {}: expected two planners, FIRST,SECOND",
            other.join(",")
        ),
    };
    let comparison =
        RunComparison::new((&manifests[0], &rows[0]), (&manifests[1], &rows[1]), named)?;
    if flags.csv {
        printer.csv(&comparison.scenes)?;
    } else if printer.is_json() {
        printer.json(&comparison)?;
    } else {
        let names = [first.display().to_string(), second.display().to_string()];
        printer.table(comparison_table(
            &comparison,
            [&names[0], &names[1]],
            flags.by_type,
            printer.line_width(),
        ));
    }
    Ok(Exit::Success)
}
