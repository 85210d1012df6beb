//! `planagent scenarios export`.

use crate::args::{ExportArguments, ExportFormat};
use crate::{Exit, Printer};
use anyhow::bail;
use planagent_scenario::nuplan::export::{ExportChanges, ExportSettings, write_scenarios};
use planagent_scenario::{Scenario, ScenarioRef};
use planagent_world::geometry::Point;
use rayon::prelude::*;

/// Writes scenarios in another format. A failure leaves no files behind.
pub(super) fn run(arguments: &ExportArguments, printer: Printer) -> anyhow::Result<Exit> {
    let readers = arguments.data.readers();
    let words = arguments.data.modified(&arguments.scenarios)?;
    let found = words.iter().map(|word| readers.find(word));
    let sources: Vec<ScenarioRef> = found.collect::<Result<Vec<_>, _>>()?.concat();
    for note in readers.take_notes() {
        printer.note(note);
    }
    let scenarios: Vec<Scenario> = sources
        .par_iter()
        .map(|source| {
            source.open().map_err(|error| {
                let (name, text) = (source.to_string(), error.to_string());
                // The error of a file begins with its path.
                let error = anyhow::Error::new(error);
                if text.contains(&name) {
                    error
                } else {
                    error.context(format!("cannot open {name}"))
                }
            })
        })
        .collect::<Result<_, _>>()?;
    match arguments.format {
        ExportFormat::Nuplan => nuplan(arguments, &scenarios, printer),
    }
}

fn nuplan(
    arguments: &ExportArguments,
    scenarios: &[Scenario],
    printer: Printer,
) -> anyhow::Result<Exit> {
    let &[x, y] = arguments.origin.as_slice() else {
        bail!("--origin takes an easting and a northing")
    };
    let settings = ExportSettings {
        location: arguments.location.clone(),
        epsg: arguments.epsg,
        origin: Point::new(x, y),
        scenario_type: arguments.scenario_type.clone(),
        stand_in_maps: arguments.stand_in_maps,
    };
    let exported = write_scenarios(scenarios, &arguments.out, &settings)?;
    for log in &exported.logs {
        printer.named(
            &log.log,
            &format!("token {}  map {}", log.token, log.location),
        );
        if log.changes != ExportChanges::default() {
            printer.note(format!("{}: {}", log.scenario, summary(&log.changes)));
        }
        if printer.is_json() {
            printer.json(log)?;
        }
    }
    // In the form in which a shell takes them, because the devkit reads these two variables.
    printer.note(format!("NUPLAN_DATA_ROOT={}", exported.data.display()));
    printer.note(format!("NUPLAN_MAPS_ROOT={}", exported.maps.display()));
    Ok(Exit::Success)
}

/// The changes in words.
fn summary(changes: &ExportChanges) -> String {
    let counted = [
        (
            changes.inserted_connectors,
            "connectors inserted between lanes",
        ),
        (changes.inserted_lanes, "lanes inserted between connectors"),
        (
            changes.open_ends_closed,
            "lanes inserted at open ends of connectors",
        ),
        (
            changes.connectors_repeated,
            "connectors repeated for more lanes",
        ),
        (changes.inserted_stop_lines, "stop lines inserted"),
        (
            changes.dropped_future_states,
            "recorded states after the end dropped",
        ),
        (
            changes.appended_roadblocks,
            "roadblocks appended to the route",
        ),
        (changes.neighbors_changed, "neighbor relations changed"),
    ];
    // Most maps keep nuPlan's rules, so nearly all counts are zero.
    let some = counted
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{count} {what}"));
    some.collect::<Vec<_>>().join(", ")
}
