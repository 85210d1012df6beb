//! `planagent bench`.

mod files;

use crate::args::{BENCH_PROCESS, BenchArguments, OtherEngine};
use crate::progress::listener;
use crate::{Exit, Printer, again, interrupt};
use anyhow::{Context, bail};
use files::OtherFiles;
use planagent_lab::bench::protocol::{ModelChoice, Precision};
use planagent_lab::bench::{
    BenchSettings, CallBudget, Candidate, EngineName, Other, Progress, PythonEngine, PythonWorker,
    run as measure, serve, serve_candle,
};
use planagent_lab::report::{
    BenchFigures, BenchFolder, BenchMetadata, bench_markdown, bench_table,
};
use planagent_mllm::{ModelRegistry, ModelShape, ModelSource, PromptSet, Trust};
use planagent_runs::report::{ReportError, check_writable, stamp};
use planagent_runs::runner::{Config, build_commit, cpu, memory, model_registry};
use serde_json::{Map, Value, json};
use std::io;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::SystemTime;

/// Measures models. Prints the table and writes all results to a folder. A model that fails is a
/// row, not an error.
pub(crate) fn run(
    flags: &BenchArguments,
    config: &Config,
    printer: Printer,
) -> anyhow::Result<Exit> {
    if flags.iterations == 0 {
        bail!("--iterations is 0; it must be at least 1");
    }
    let started = stamp(SystemTime::now()).to_string();
    let out = flags
        .out
        .clone()
        .unwrap_or_else(|| Path::new("runs").join(format!("bench-{started}")));
    // All that can be refused is refused before the first measurement, which may take an hour.
    check_writable(flags.resume.as_deref().unwrap_or(&out))?;
    flags.weights.as_deref().map_or(Ok(()), check_writable)?;
    let registry = model_registry(config, &listener(printer));
    let candidates = candidates(flags, config, &registry)?;
    let metadata = metadata(flags, config, &candidates, &started)?;
    let mut folder = match &flags.resume {
        Some(path) => BenchFolder::resume(path, &metadata)?,
        None => BenchFolder::create(&out, &metadata)?,
    };
    advise(&folder, printer)?;
    let mut left: Vec<Candidate> = candidates
        .into_iter()
        .filter(|candidate| !folder.done().contains(candidate.name.as_str()))
        .collect();
    if flags.vs == Some(OtherEngine::Candle) && config.mllm.quantize.is_some() {
        bail!("--vs candle reads the files as they are; leave out --quantize");
    }
    let versus = other_engine(flags);
    if let Some(Other::Python(worker)) = &versus {
        let weights = flags
            .weights
            .clone()
            .unwrap_or_else(|| folder.path().join("weights"));
        let files = OtherFiles {
            folder: &weights,
            config,
            registry: &registry,
            printer,
        };
        for candidate in &mut left {
            *candidate = match flags.vs {
                Some(OtherEngine::OpenVino) => {
                    files.export(candidate, worker, precisions(flags)?)?
                }
                _ => files.gguf(candidate)?,
            };
        }
    }
    let settings = BenchSettings {
        warm_up: flags.warm_up,
        iterations: flags.iterations,
        threads: rayon::current_num_threads(),
        seed: config.seed,
        weight_format: config.mllm.quantize,
        speculation: flags.speculation,
        versus,
    };
    crate::this_program()
        .context("cannot find the path of this program to start the measuring process")?;
    let own = || measuring_process(config, settings.threads);
    let committed: Result<(), ReportError> = measure(
        &left,
        &settings,
        &own,
        &mut |rows| {
            folder.commit(rows)?;
            if let Err(error) = advise(&folder, printer) {
                printer.error(&error);
            }
            Ok(())
        },
        &|progress| {
            printer.note(progress_line(progress));
        },
    );
    committed?;

    let figures = BenchFigures::from_rows(folder.rows());
    let machine = format!(
        "{}, {} threads, commit {}",
        metadata.cpu,
        settings.threads,
        metadata.commit.as_deref().unwrap_or("unknown")
    );
    folder.finish(
        &figures,
        &bench_markdown(&figures, &metadata.command.join(" "), &machine),
    )?;
    show(&figures, &folder, printer)
}

/// Prints the table and where the results are. Success if every model was measured.
fn show(figures: &BenchFigures, folder: &BenchFolder, printer: Printer) -> anyhow::Result<Exit> {
    if printer.is_json() {
        printer.json(figures)?;
    } else {
        printer.table(bench_table(figures, printer.line_width()));
    }
    if folder.has_measurements() {
        printer.note(format!("results in {}", folder.path().display()));
    } else {
        printer.note("no model could be measured, so nothing was written");
    }
    Ok(if figures.failed.is_empty() {
        Exit::Success
    } else {
        Exit::SomeFailed
    })
}

/// The command that starts the measuring process with what a configuration says of models.
fn measuring_process(config: &Config, threads: usize) -> Command {
    let mut command = crate::this_program().unwrap_or_else(|_| Command::new("planagent"));
    command.args([BENCH_PROCESS, "--threads", &threads.to_string()]);
    if let Some(context) = config.mllm.context {
        command.args(["--context", &context.to_string()]);
    }
    if let Some(adapter) = &config.mllm.adapter {
        command.arg("--adapter").arg(&adapter.path);
    }
    command.args(config.mllm.ignore_memory.then_some("--ignore-memory"));
    command.args(config.mllm.offline.then_some("--offline"));
    command.args((config.mllm.trust == Trust::Caller).then_some("--trust-model"));
    command
}

/// Says at Ctrl-C how the bench goes on: its folder exists from the first measured model on.
fn advise(folder: &BenchFolder, printer: Printer) -> anyhow::Result<()> {
    let advice = if folder.has_measurements() {
        format!("`{}` goes on", again::resume_this(folder.path()))
    } else {
        "no model is measured yet; the same command starts again".to_owned()
    };
    interrupt::advise(advice, printer)
}

/// The measuring process; runs until stdin ends.
pub(crate) fn process(candle: bool, config: &Config, printer: Printer) -> anyhow::Result<Exit> {
    let registry = model_registry(config, &listener(printer));
    let (requests, replies) = (io::stdin().lock(), io::stdout().lock());
    if candle {
        serve_candle(&registry, requests, replies)?;
    } else {
        serve(&registry, requests, replies)?;
    }
    Ok(Exit::Success)
}

/// The models to measure.
fn candidates(
    flags: &BenchArguments,
    config: &Config,
    registry: &ModelRegistry,
) -> anyhow::Result<Vec<Candidate>> {
    let configured = [config.mllm.model.clone()];
    let none = flags.models.is_empty() && flags.random_weights.is_empty();
    let named = if none { &configured[..] } else { &flags.models };
    let mut all = Vec::new();
    let specs = named.iter().map(|name| registry.find(name));
    let specs = specs.collect::<Result<Vec<_>, _>>()?;
    // It would fail after the others were measured.
    for spec in &specs {
        if let ModelSource::Endpoint(server) = &spec.source {
            bail!(
                "bench measures models in this process, and {} runs {}; `planagent models check {}` tries a server",
                server.endpoint,
                spec.name,
                spec.name
            );
        }
    }
    let shown = shown_names(named, &specs.iter().map(|spec| spec.name.as_str()));
    for ((name, spec), shown) in named.iter().zip(specs).zip(&shown) {
        let sets = prompt_sets(flags, config, || Ok(registry.asking(&spec)?.prompt_set))?;
        all.extend(of_sets(shown, &ModelChoice::Named(name.clone()), &sets));
    }
    for name in &flags.random_weights {
        let shape = ModelShape::find(name)?;
        let own = || {
            Ok(registry
                .find(name)
                .ok()
                .and_then(|spec| spec.prompt_set)
                .map_or_else(
                    || PromptSet::Paper.name().to_owned(),
                    |prompts| prompts.opened_by(),
                ))
        };
        let sets = prompt_sets(flags, config, own)?;
        all.extend(of_sets(
            name,
            &ModelChoice::Random(shape.name.to_owned()),
            &sets,
        ));
    }
    let all = of_sizes(all, &flags.image_size);
    for (index, candidate) in all.iter().enumerate() {
        if all
            .iter()
            .take(index)
            .any(|other| other.name == candidate.name)
        {
            bail!(
                "two models are called {}; measure them in two runs",
                candidate.name
            );
        }
    }
    Ok(all)
}

/// The names of models in the table: their own, or the words that name them where two have one
/// name, as files called alike in two folders.
fn shown_names<'a>(
    words: &[String],
    names: &(impl Iterator<Item = &'a str> + Clone),
) -> Vec<String> {
    let is_shared = |name: &str| names.clone().filter(|other| *other == name).count() > 1;
    words
        .iter()
        .zip(names.clone())
        .map(|(word, name)| {
            if is_shared(name) {
                word.clone()
            } else {
                name.to_owned()
            }
        })
        .collect()
}

/// The prompt sets whose tokens are measured: those of the flag, else that of the settings, else
/// the model's own.
fn prompt_sets(
    flags: &BenchArguments,
    config: &Config,
    own: impl FnOnce() -> anyhow::Result<String>,
) -> anyhow::Result<Vec<PromptSet>> {
    let names = if flags.calls.is_empty() {
        vec![config.reasoning.prompt_set.clone().map_or_else(own, Ok)?]
    } else {
        flags.calls.clone()
    };
    let set = |name: &String| {
        PromptSet::named(name).with_context(|| {
            format!(
                "bench knows the lengths of the prompt sets brief, compact, compact-2 and paper, and not of '{name}'"
            )
        })
    };
    names.iter().map(set).collect()
}

/// A model once for each prompt set; its name says which, where there are several.
fn of_sets(name: &str, model: &ModelChoice, sets: &[PromptSet]) -> Vec<Candidate> {
    let candidate = |prompts: &PromptSet| Candidate {
        name: if sets.len() > 1 {
            format!("{name} {}", prompts.name())
        } else {
            name.to_owned()
        },
        // It becomes the name of a file.
        weights: name.replace(['/', '\\'], "-"),
        model: model.clone(),
        prompts: *prompts,
        image_size: None,
    };
    sets.iter().map(candidate).collect()
}

/// Each model once for each size of its image; its name says which, where there are several.
fn of_sizes(all: Vec<Candidate>, sizes: &[NonZeroU32]) -> Vec<Candidate> {
    if sizes.is_empty() {
        return all;
    }
    let sized = |candidate: &Candidate, size: NonZeroU32| Candidate {
        name: if sizes.len() > 1 {
            format!("{} {size} px", candidate.name)
        } else {
            candidate.name.clone()
        },
        image_size: Some(size.get()),
        ..candidate.clone()
    };
    all.iter()
        .flat_map(|candidate| sizes.iter().map(|size| sized(candidate, *size)))
        .collect()
}

/// The engine to compare with, if the flags name one.
fn other_engine(flags: &BenchArguments) -> Option<Other> {
    let (name, python) = match flags.vs? {
        OtherEngine::Candle => return Some(Other::Candle),
        OtherEngine::LlamaCpp => (EngineName::LlamaCpp, &flags.llama_python),
        OtherEngine::OpenVino => (EngineName::OpenVino, &flags.openvino_python),
    };
    let engine = PythonEngine::find(name)?;
    let python = python
        .clone()
        .or_else(|| std::env::var_os(engine.variable).map(PathBuf::from))
        .unwrap_or_else(|| "python3".into());
    Some(Other::Python(PythonWorker { engine, python }))
}

/// The precisions of OpenVINO's decoder and vision tower.
fn precisions(flags: &BenchArguments) -> anyhow::Result<[Precision; 2]> {
    let tower = flags
        .openvino_tower
        .unwrap_or(match flags.openvino_weights {
            Precision::F32 => Precision::F32,
            _ => Precision::Bf16,
        });
    if tower == Precision::Int4 {
        bail!("--openvino-tower int4: optimum-intel gives vision towers f32, bf16 or int8");
    }
    Ok([flags.openvino_weights, tower])
}

fn metadata(
    flags: &BenchArguments,
    config: &Config,
    candidates: &[Candidate],
    started: &str,
) -> anyhow::Result<BenchMetadata> {
    let models: Map<String, Value> = candidates
        .iter()
        .map(|candidate| {
            let budget = CallBudget::for_prompts(candidate.prompts);
            Ok((
                candidate.name.clone(),
                json!({"model": &candidate.model, "budget": budget, "image_size": candidate.image_size}),
            ))
        })
        .collect::<anyhow::Result<_>>()?;
    let vs_openvino = match flags.vs {
        Some(OtherEngine::OpenVino) => json!(precisions(flags)?),
        _ => json!(false),
    };
    // All that changes a time is written down, so that a bench can be repeated.
    let settings = json!({
        "models": models,
        "warm_up": flags.warm_up,
        "iterations": flags.iterations,
        "threads": rayon::current_num_threads(),
        "seed": config.seed,
        "adapter": config.mllm.adapter,
        "quantize": config.mllm.quantize,
        "vs_llama_cpp": flags.vs == Some(OtherEngine::LlamaCpp),
        "vs_openvino": vs_openvino,
        "vs_candle": flags.vs == Some(OtherEngine::Candle),
        "speculation": flags.speculation,
    });
    let Value::Object(settings) = settings else {
        bail!("the settings are not a JSON object")
    };
    Ok(BenchMetadata {
        planagent: env!("CARGO_PKG_VERSION").to_owned(),
        commit: build_commit().map(str::to_owned),
        started: started.to_owned(),
        command: std::env::args().collect(),
        cpu: cpu(),
        memory: memory(),
        settings,
    })
}

/// A line of progress.
fn progress_line(progress: Progress<'_>) -> String {
    match progress {
        Progress::Loading(engine, candidate) => {
            format!("{}: {engine} loads the model", candidate.name)
        }
        Progress::LeftOut(candidate, why) => format!("{}: skipped: {why}", candidate.name),
        Progress::Disturbed(candidate, share) => format!(
            "{}: the processor reached {:.0} % of its best; measured again",
            candidate.name,
            100.0 * share
        ),
        Progress::Done(row, of) => {
            let warm_up = if row.warm_up { ", warm-up" } else { "" };
            let done = row.iteration + 1;
            format!(
                "{}: {} {} {done}/{of}{warm_up}: {:.0} ms",
                row.model,
                row.engine,
                row.workload,
                row.total_ms()
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_models_never_share_a_name() {
        let words = ["a/m.gguf", "b/m.gguf", "nano"].map(str::to_owned);
        let names = ["m.gguf", "m.gguf", "nano"];
        assert_eq!(
            shown_names(&words, &names.into_iter()),
            ["a/m.gguf", "b/m.gguf", "nano"]
        );
    }
}
