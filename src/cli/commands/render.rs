//! `planagent render`.

use crate::args::RenderArguments;
use crate::completed::completed;
use crate::film::FilmFile;
use crate::picture::write_picture;
use crate::{Exit, Printer};
use anyhow::{Context, bail};
use planagent_agent::simulation::Challenge;
use planagent_runs::report::render::{
    Film, Look, SimulationChoice, named, words, write_gif, write_mp4,
};
use planagent_runs::report::{SimulationRow, last_run, simulation_folders};
use planagent_world::STEP_S;
use serde_json::json;
use std::collections::BTreeSet;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

/// Simulations that an error lists.
const MAX_LISTED: usize = 10;
/// Frames per second of a film that names no rate.
const DEFAULT_RATE: NonZeroU32 = NonZeroU32::new(5).unwrap();

/// Writes simulations as films or pictures: one to a file, or all that are chosen to a folder.
pub(crate) fn run(flags: &RenderArguments, printer: Printer) -> anyhow::Result<Exit> {
    let output = flags
        .output
        .film()
        .context("name the output by --gif, --mp4 or --png")?;
    let is_file = output.is_file()?;
    let (run, simulation) = run_and_simulation(flags, printer)?;
    let rows = chosen(flags, &run, simulation, printer);
    // A word that is no folder was taken for a simulation of the last run; the error names both
    // readings.
    let rows = match (&flags.run, &flags.simulation) {
        (Some(word), None) if simulation.is_some() => {
            rows.with_context(|| format!("there is no folder {word}"))?
        }
        _ => rows?,
    };
    if is_file {
        let [row] = rows.as_slice() else {
            return Err(several(&rows));
        };
        write(flags, &run, row, &output, printer)?;
        return Ok(Exit::Success);
    }
    let folders = simulation_folders(&run)?;
    let mut exit = Exit::Success;
    for row in &rows {
        let name = folders
            .get(&row.number)
            .map_or_else(|| row.number.to_string(), |folder| folder.name().to_owned());
        let file = output.inside(&name);
        if row.error.is_some() {
            printer.failure(format!(
                "simulation {} failed and has no film: {}",
                row.number,
                words(row)
            ));
            exit = Exit::SomeFailed;
            continue;
        }
        let parent = file.path().parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(parent)
            .with_context(|| format!("cannot create the folder {}", parent.display()))?;
        write(flags, &run, row, &file, printer)?;
    }
    Ok(exit)
}

/// The run and the simulation of the two arguments; one alone is a run if it is the folder of one.
fn run_and_simulation(
    flags: &RenderArguments,
    printer: Printer,
) -> anyhow::Result<(PathBuf, Option<&str>)> {
    let (run, simulation) = match (&flags.run, &flags.simulation) {
        (Some(run), Some(simulation)) => return Ok((run.into(), Some(simulation))),
        (Some(word), None) if Path::new(word).is_dir() => return Ok((word.into(), None)),
        (Some(simulation), None) => {
            let run = last_run().with_context(|| format!("there is no folder {simulation}"))?;
            (run, Some(simulation.as_str()))
        }
        (None, _) => (last_run()?, None),
    };
    printer.note(format!("run {}", run.display()));
    Ok((run, simulation))
}

/// The completed simulations that the arguments choose.
fn chosen(
    flags: &RenderArguments,
    run: &Path,
    simulation: Option<&str>,
    printer: Printer,
) -> anyhow::Result<Vec<SimulationRow>> {
    let mut rows = completed(run, printer)?;
    // Before any filter, so that the error can say what the run has.
    let known: BTreeSet<String> = rows
        .iter()
        .map(|row| format!("{} in {}", row.planner, row.challenge))
        .collect();
    let known = known.into_iter().collect::<Vec<_>>().join(", ");
    let challenge = flags
        .challenge
        .as_deref()
        .map(|word| challenge(word, &rows))
        .transpose()?;
    if let Some(simulation) = simulation {
        rows = named(&rows, simulation, run)?;
    }
    rows.retain(|row| {
        flags
            .planner
            .as_ref()
            .is_none_or(|planner| row.planner == *planner)
    });
    rows.retain(|row| challenge.is_none_or(|challenge| row.challenge == challenge));
    if rows.is_empty() {
        let planner = flags
            .planner
            .as_deref()
            .map_or_else(String::new, |planner| format!(" of planner {planner}"));
        let challenge = challenge.map_or_else(String::new, |challenge| {
            format!(" in challenge {challenge}")
        });
        let what = simulation.map_or_else(
            || "simulation".to_owned(),
            |word| format!("simulation '{word}'"),
        );
        bail!(
            "the run {} has no completed {what}{planner}{challenge}; it has {known}",
            run.display()
        );
    }
    Ok(rows)
}

/// The challenge of a word: one of nuPlan's, or the name of a policy of the run's own agents.
fn challenge(word: &str, rows: &[SimulationRow]) -> anyhow::Result<Challenge> {
    let own = rows
        .iter()
        .map(|row| row.challenge)
        .find(|challenge| challenge.short_name() == word);
    let named = own.map_or_else(|| word.parse(), Ok);
    named.context(
        "--challenge takes nonreactive, reactive, open-loop, or the name of a policy of --agents",
    )
}

fn several(rows: &[SimulationRow]) -> anyhow::Error {
    let listed = rows
        .iter()
        .take(MAX_LISTED)
        .map(|row| format!("\n  {:>3}  {}", row.number, words(row)));
    let more = rows.len().saturating_sub(MAX_LISTED);
    let more = if more > 0 {
        format!("\n  and {more} more")
    } else {
        String::new()
    };
    anyhow::anyhow!(
        "a file holds one simulation, and {} simulations are named; name one by its number, or a folder for all:{}{more}",
        rows.len(),
        listed.collect::<String>()
    )
}

/// Writes one simulation to a file.
fn write(
    flags: &RenderArguments,
    run: &Path,
    row: &SimulationRow,
    output: &FilmFile,
    printer: Printer,
) -> anyhow::Result<()> {
    let rate = flags.fps.and_then(NonZeroU32::new).unwrap_or(DEFAULT_RATE);
    let shown = output.path();
    // The file that a link leads to is replaced, and not the link; the user still reads the own
    // words.
    let output = output.behind_links()?;
    let choice = SimulationChoice {
        simulation: row.number.to_string(),
        planner: None,
        challenge: None,
    };
    let film = Film::open(
        run,
        &choice,
        Look {
            pixels: flags.pixels,
            meters: flags.view,
        },
    )?;
    let frames = (film.iterations() as f64 * STEP_S * f64::from(rate.get())).ceil() as u64;
    let bar = printer.progress(frames, "frames");
    let on_frame = || bar.inc(1);
    match &output {
        FilmFile::Gif(path) => write_gif(&film, rate, path, &on_frame)?,
        FilmFile::Mp4(path) => write_mp4(&film, rate, path, &on_frame)?,
        FilmFile::Png(path) => {
            let picture = match flags.at {
                Some(at_s) => film.frame(film.iteration_at(at_s)?),
                None => film.sheet(),
            };
            write_picture(&picture, image::ImageFormat::Png, path)?;
        }
    }
    bar.finish_and_clear();
    if printer.is_json() {
        printer.json(&json!({"simulation": row.number, "file": shown}))?;
    } else {
        printer.line(shown.display().to_string());
    }
    Ok(())
}
