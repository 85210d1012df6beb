//! `planagent scenarios generate`.

use crate::args::GenerateArguments;
use crate::{Exit, Printer};
use anyhow::Context;
use planagent_scenario::generator::{GeneratorError, Spec, generate, types};
use serde_json::json;

/// Generates scenarios and prints a line about the expert driver of each.
pub(super) fn run(arguments: &GenerateArguments, printer: Printer) -> anyhow::Result<Exit> {
    let GenerateArguments {
        types: names,
        from,
        count,
        traffic,
    } = arguments;
    let known =
        |name: &String| types::named(name).ok_or_else(|| GeneratorError::UnknownType(name.clone()));
    let kinds = if names.is_empty() {
        types::in_suites().collect()
    } else {
        names.iter().map(known).collect::<Result<Vec<_>, _>>()?
    };
    let last = from
        .checked_add(count - 1)
        .with_context(|| format!("--from {from} --count {count}: no seed is so large"))?;
    let mut failed = false;
    for kind in kinds {
        for seed in *from..=last {
            let spec = Spec::new(kind, seed).with_traffic_seed(*traffic);
            // A seed without a scene hides none of the others.
            match generate(&spec) {
                Ok(scenario) => {
                    let distance: f64 = scenario
                        .expert()
                        .zip(scenario.expert().skip(1))
                        .map(|(a, b)| a.rear_axle.distance(&b.rear_axle))
                        .sum();
                    let objects = scenario
                        .frame(0)
                        .expect("a generated scenario has frames")
                        .objects
                        .len();
                    printer.named(
                        &scenario.id,
                        &format!("expert drives {distance:6.1} m, {objects:>3} objects"),
                    );
                    if printer.is_json() {
                        printer.json(
                            &json!({"id": scenario.id, "expert_m": distance, "objects": objects}),
                        )?;
                    }
                }
                Err(error) => {
                    failed = true;
                    printer.note(format!("failed: {spec}: {error}"));
                }
            }
        }
    }
    Ok(if failed {
        Exit::SomeFailed
    } else {
        Exit::Success
    })
}
