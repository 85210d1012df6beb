//! `planagent scenarios statistics`: compares two sets of scenes.

use crate::args::{DataArguments, StatisticsArguments};
use crate::{Exit, Printer};
use anyhow::{Context, bail};
use planagent_files::{path_of, write_whole};
use planagent_lab::realism::{MeasuredScene, SceneComparison};
use planagent_lab::report::{realism_figure, realism_table};
use planagent_runs::worker::split::{SplitError, split};
use planagent_scenario::{ReaderError, Readers, ScenarioRef};
use rayon::prelude::*;
use serde_json::json;
use std::path::Path;

/// Opens all scenes, measures them, and prints the comparison.
pub(super) fn run(arguments: &StatisticsArguments, printer: Printer) -> anyhow::Result<Exit> {
    let StatisticsArguments { a, b, data, figure } = arguments;
    // Before the scenes are measured, which takes minutes.
    if let Some(file) = figure {
        check_figure(file)?;
    }
    let readers = data.readers();
    let (of_a, of_b) = (scenarios(a, data, &readers)?, scenarios(b, data, &readers)?);
    let progress = printer.progress((of_a.len() + of_b.len()) as u64, "scenes");
    let measured = |list: &[ScenarioRef]| -> Result<Vec<MeasuredScene>, ReaderError> {
        list.par_iter()
            .map(|scenario| {
                let measured = scenario
                    .open()
                    .map(|opened| MeasuredScene::from_scenario(&opened));
                progress.inc(1);
                measured
            })
            .collect()
    };
    let (a_scenes, b_scenes) = (measured(&of_a)?, measured(&of_b)?);
    progress.finish_and_clear();
    for note in readers.take_notes() {
        printer.note(note);
    }
    let comparison = SceneComparison::from_sets(a_scenes, b_scenes);
    let names = [a, b].map(|words| shown(words));
    let names = names.each_ref().map(String::as_str);
    if let Some(file) = figure {
        write_whole(file, realism_figure(&comparison, names).as_bytes())
            .with_context(|| format!("cannot write {}", file.display()))?;
        printer.note(format!("figure in {}", file.display()));
    }
    printer.table(realism_table(&comparison, names, printer.line_width()));
    if printer.is_json() {
        let SceneComparison {
            features,
            classifier,
            scenes,
        } = &comparison;
        printer.json(&json!({"a": a, "b": b, "features": features, "classifier": classifier, "scenes": scenes}))?;
    }
    Ok(Exit::Success)
}

/// The words of a set; of a long list the first one.
fn shown(words: &str) -> String {
    match words.split_once(',') {
        Some((first, rest)) if rest.contains(',') => {
            format!("{first} and {} more", rest.split(',').count())
        }
        _ => words.to_owned(),
    }
}

fn check_figure(file: &Path) -> anyhow::Result<()> {
    if file
        .extension()
        .is_none_or(|extension| !extension.eq_ignore_ascii_case("svg"))
    {
        bail!("--figure {} must end in .svg", file.display());
    }
    Ok(())
}

/// The scenarios of words separated by commas, each a split or what a reader takes. A path may hold
/// a comma.
fn scenarios(
    words: &str,
    data: &DataArguments,
    readers: &Readers,
) -> anyhow::Result<Vec<ScenarioRef>> {
    let list: Vec<&str> = if path_of(words).exists() {
        vec![words]
    } else {
        words.split(',').map(str::trim).collect()
    };
    let list: Vec<String> = list.into_iter().map(str::to_owned).collect();
    let mut found = Vec::new();
    for word in &data.modified(&list)? {
        match split(word, readers, &|_, _| {}) {
            Ok(split) if split.missing.is_empty() => found.extend(split.scenarios),
            Ok(split) => bail!("{}", split.missing),
            Err(SplitError::Unknown { .. }) => found.extend(readers.find(word)?),
            Err(error) => return Err(error.into()),
        }
    }
    if found.is_empty() {
        bail!("'{words}' names no scenario");
    }
    Ok(found)
}
