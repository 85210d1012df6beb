//! `planagent models check`.

use super::check_server;
use crate::{Exit, Printer};
use planagent_agent::reasoning::PromptSet;
use planagent_mllm::{
    MllmError, ModelCheck, ModelRegistry, ModelSource, ModelSpec, in_bytes, parameter_count,
};
use planagent_runs::runner::Config;
use serde::Serialize;

/// The check of a model.
#[derive(Debug, Serialize)]
struct Row<'a> {
    /// Its name.
    model: &'a str,
    /// The result; none if the model is not on this machine.
    #[serde(flatten)]
    check: Option<ModelCheck>,
    /// Why there is no result.
    #[serde(skip_serializing_if = "Option::is_none")]
    missing: Option<String>,
}

/// Checks models; without names, all described ones. Files that are not on this machine are no
/// fault of a model that nobody named.
pub(super) fn run(
    models: &[String],
    registry: &ModelRegistry,
    config: &Config,
    printer: Printer,
) -> anyhow::Result<Exit> {
    let names = if models.is_empty() {
        registry.names()?
    } else {
        models.to_vec()
    };
    let mut well = true;
    for model in &names {
        let spec = match registry.find(model) {
            // Who names no model asks about files.
            Ok(spec) if models.is_empty() && matches!(spec.source, ModelSource::Endpoint(_)) => {
                continue;
            }
            Ok(spec) if matches!(spec.source, ModelSource::Endpoint(_)) => {
                let row = check_server::check(model, &spec, registry, config, printer);
                well &= row.problems.is_empty();
                if printer.is_json() {
                    printer.json(&row)?;
                } else {
                    check_server::tell(&row, printer);
                }
                continue;
            }
            found => found,
        };
        let checked = spec.and_then(|spec| match registry.place_here(&spec)?.absent() {
            Some(missing) => Err(missing),
            None => checked(&spec, registry, config),
        });
        let absent = matches!(
            checked,
            Err(MllmError::NotInCache { .. } | MllmError::Absent { .. })
        );
        let row = match checked {
            Ok(check) => Row {
                model,
                check: Some(check),
                missing: None,
            },
            Err(error) => Row {
                model,
                check: None,
                missing: Some(reason(&error, model)),
            },
        };
        let is_absent = models.is_empty() && absent;
        well &= is_absent
            || row
                .check
                .as_ref()
                .is_some_and(|check| check.problems.is_empty());
        if printer.is_json() {
            printer.json(&row)?;
        } else {
            tell(&row, printer);
        }
    }
    Ok(if well {
        Exit::Success
    } else {
        Exit::SomeFailed
    })
}

/// The check of a model's files, and of what says how it is asked.
fn checked(
    spec: &ModelSpec,
    registry: &ModelRegistry,
    config: &Config,
) -> Result<ModelCheck, MllmError> {
    let mut check = registry.check(spec)?;
    let own = registry
        .asking_here(spec)
        .map_err(|error| error.to_string());
    let set = own.and_then(|asking| {
        let wanted = config.reasoning.prompt_set.as_ref();
        PromptSet::open(wanted.unwrap_or(&asking.prompt_set)).map_err(|error| error.to_string())
    });
    if let Err(problem) = set
        && !check.problems.contains(&problem)
    {
        check.problems.push(problem);
    }
    Ok(check)
}

/// Why a model cannot be checked or listed. Its files are only looked for on this machine, whatever
/// the settings of the network.
pub(super) fn reason(error: &MllmError, model: &str) -> String {
    match error {
        MllmError::NotInCache { .. } => {
            format!("not on this machine; `planagent models fetch {model}` downloads it")
        }
        other => other.to_string(),
    }
}

fn tell(row: &Row<'_>, printer: Printer) {
    // A line and no error: the other models are still checked.
    let Some(check) = &row.check else {
        let why = row
            .missing
            .as_deref()
            .expect("a row without a check says why");
        // An error of a description names its file.
        if why.starts_with(row.model) {
            printer.line(why);
        } else {
            printer.line(format!("{}: {why}", row.model));
        }
        return;
    };
    let family = check
        .architecture
        .map(planagent_mllm::Architecture::name)
        .or(check.kind.as_deref())
        .unwrap_or("unknown family");
    let state = match check.problems.len() {
        0 => "can be opened".to_owned(),
        1 => "1 problem".to_owned(),
        count => format!("{count} problems"),
    };
    printer.line(format!(
        "{}: {family}, {} parameters, {state}",
        row.model,
        parameter_count(check.parameters)
    ));
    if let Some(need) = check.memory {
        printer.line(format!(
            "  memory: about {} (weights {}, cache {}, work {}, picture {})",
            in_bytes(need.total()),
            in_bytes(need.weights),
            in_bytes(need.cache),
            in_bytes(need.work),
            in_bytes(need.picture)
        ));
    }
    for line in check.load.lines() {
        printer.line(format!("  {line}"));
    }
    for problem in &check.problems {
        printer.line(format!("  problem: {problem}"));
    }
}
