//! `planagent scenarios export`.

use crate::cli::args::{ExportArguments, ExportFormat};
use crate::cli::{Exit, Printer};
use crate::geometry::Point;
use crate::scenario::nuplan::export::{Departures, ExportSettings, write_scenarios};
use crate::scenario::{Scenario, ScenarioRef};
use anyhow::{Context, bail};
use rayon::prelude::*;

/// Writes scenarios in another format. A failure leaves no files behind.
pub(super) fn run(arguments: &ExportArguments, printer: Printer) -> anyhow::Result<Exit> {
    let readers = arguments.data.readers();
    let found = arguments.scenarios.iter().map(|word| readers.find(word));
    let sources: Vec<ScenarioRef> = found.collect::<Result<Vec<_>, _>>()?.concat();
    for note in readers.take_notes() {
        printer.note(note);
    }
    let scenarios: Vec<Scenario> = sources
        .par_iter()
        .map(|source| source.open().with_context(|| format!("cannot open {source}")))
        .collect::<Result<_, _>>()?;
    match arguments.format {
        ExportFormat::Nuplan => nuplan(arguments, &scenarios, printer),
    }
}

fn nuplan(arguments: &ExportArguments, scenarios: &[Scenario], printer: Printer) -> anyhow::Result<Exit> {
    let &[x, y] = arguments.origin.as_slice() else { bail!("--origin takes an easting and a northing") };
    let settings =
        ExportSettings { location: arguments.location.clone(), epsg: arguments.epsg, origin: Point::new(x, y) };
    let exported = write_scenarios(scenarios, &arguments.out, &settings)?;
    for log in &exported.logs {
        printer.named(&log.log, &format!("token {}  map {}", log.token, log.location));
        if log.departures != Departures::default() {
            printer.note(format!("{}: {}", log.scenario, said_otherwise(&log.departures)));
        }
        if printer.is_json() {
            printer.json(log)?;
        }
    }
    printer.note(format!("NUPLAN_DATA_ROOT={}", exported.data.display()));
    printer.note(format!("NUPLAN_MAPS_ROOT={}", exported.maps.display()));
    Ok(Exit::Success)
}

/// The differences of a written map from the scenario's, in words.
fn said_otherwise(departures: &Departures) -> String {
    let counted = [
        (departures.connectors_put_in, "connectors put between lanes"),
        (departures.lanes_put_in, "lanes put between connectors"),
        (departures.open_ends_closed, "lanes put at open ends of connectors"),
        (departures.connectors_repeated, "connectors repeated for more lanes"),
        (departures.stop_lines_put_in, "stop lines put in"),
        (departures.future_left_out, "recorded states after the end left out"),
        (departures.neighbors_changed, "neighbourhoods not said as they are"),
    ];
    let some = counted.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}"));
    some.collect::<Vec<_>>().join(", ")
}
