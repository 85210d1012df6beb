//! Why a simulation cannot be rendered.

use crate::report::ReportError;
use planagent_agent::environment::BevError;
use std::io;
use std::path::{Path, PathBuf};

/// Why a simulation cannot be rendered.
#[allow(missing_docs, reason = "the message of a variant says what it is")]
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    #[error(transparent)]
    Report(#[from] ReportError),
    #[error("the run {} has no simulation '{wanted}'; name one by its number, or by a part of its scenario", run.display())]
    NoSimulation {
        run: PathBuf,
        wanted: String,
        /// The scenarios of the run.
        known: Vec<String>,
    },
    #[error(
        "'{wanted}' is in the names of {} scenarios; name one of them:\n  {}", scenarios.len(), listed(scenarios)
    )]
    SeveralScenarios {
        wanted: String,
        scenarios: Vec<String>,
    },
    #[error("{wanted} names {} simulations; name one by its number, or add --planner and --challenge:\n  {}", simulations.len(), simulations.join("\n  "))]
    SeveralSimulations {
        wanted: String,
        simulations: Vec<String>,
    },
    #[error("{0} has no replay: it failed, or the file is lost; resume its run to make it again")]
    NoReplay(String),
    #[error(transparent)]
    View(#[from] BevError),
    #[error("{at_s} s is outside the simulation, which lasts {end_s:.1} s")]
    Outside { at_s: f64, end_s: f64 },
    #[error(
        "cannot start ffmpeg, which writes MP4 files ({0}); install it, or write a GIF with --gif"
    )]
    NoFfmpeg(io::Error),
    #[error("{}: cannot write: {fault}", place.display())]
    Output { place: PathBuf, fault: OutputFault },
}

/// Candidates that an error lists.
const MAX_CANDIDATES: usize = 5;

/// The first names, a line each.
fn listed(names: &[String]) -> String {
    let mut lines: Vec<&str> = names
        .iter()
        .take(MAX_CANDIDATES)
        .map(String::as_str)
        .collect();
    lines.extend((names.len() > MAX_CANDIDATES).then_some("…"));
    lines.join("\n  ")
}

/// Why a picture or a film cannot be written.
#[allow(missing_docs, reason = "the message of a variant says what it is")]
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputFault {
    #[error("{0}")]
    Image(#[from] image::ImageError),
    #[error("{0}")]
    Gif(#[from] gif::EncodingError),
    #[error("a GIF is at most 65535 pixels wide and high; choose fewer --pixels")]
    TooLarge,
    #[error("ffmpeg failed: {0}")]
    Ffmpeg(String),
}

impl RenderError {
    /// For `map_err`: `place` cannot be written.
    pub fn output<F: Into<OutputFault>>(place: &Path) -> impl Fn(F) -> Self {
        let place = place.to_owned();
        move |fault| Self::Output {
            place: place.clone(),
            fault: fault.into(),
        }
    }
}
