//! `planagent render`.

use crate::cli::args::RenderArguments;
use crate::cli::{Exit, Printer};
use crate::report::render::{Film, Look, RenderError, SimulationChoice, write_gif, write_mp4};
use crate::world::STEP_S;
use anyhow::Context;
use std::num::NonZeroU32;
use std::path::Path;

/// Writes a simulation as a film or a picture.
pub(in crate::cli) fn run(flags: &RenderArguments, printer: Printer) -> anyhow::Result<Exit> {
    let challenge = flags.challenge.as_deref().map(str::parse).transpose();
    let challenge = challenge.context("--challenge takes nonreactive, reactive or open-loop")?;
    let choice = SimulationChoice { simulation: flags.simulation.clone(), planner: flags.planner.clone(), challenge };
    let rate = NonZeroU32::new(flags.fps).context("--fps is 0; a film needs frames")?;
    let film = Film::open(&flags.run, &choice, Look { pixels: flags.pixels, meters: flags.view })?;
    let frames = (film.iterations() as f64 * STEP_S * f64::from(flags.fps)).ceil() as u64;
    let bar = printer.progress(frames, "frames");
    let on_frame = || bar.inc(1);
    let output = &flags.output;
    let path: &Path = match (&output.gif, &output.mp4, &output.png) {
        (Some(path), ..) => {
            write_gif(&film, rate, path, &on_frame)?;
            path
        }
        (_, Some(path), _) => {
            write_mp4(&film, rate, path, &on_frame)?;
            path
        }
        (.., Some(path)) => {
            let picture = match flags.at {
                Some(at_s) => film.frame(film.iteration_at(at_s)?),
                None => film.sheet(),
            };
            let written = picture.save_with_format(path, image::ImageFormat::Png);
            written.map_err(RenderError::output(path))?;
            path
        }
        (None, None, None) => anyhow::bail!("name the file by --gif, --mp4 or --png"),
    };
    bar.finish_and_clear();
    printer.line(path.display().to_string());
    Ok(Exit::Success)
}
