//! Why a drive cannot be rendered.

use crate::environment::BevError;
use crate::report::ReportError;
use crate::world::MapError;
use std::io;
use std::path::PathBuf;

/// Why a drive cannot be rendered.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The run cannot be read, or the result not be written.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// No drive of the run is meant.
    #[error("the run has no simulation {0}; name one by its number or its scenario")]
    NoSimulation(String),
    /// More than one drive is meant.
    #[error("{wanted} names {} simulations; name one by its number, or add --planner and --challenge:\n  {}", simulations.len(), simulations.join("\n  "))]
    SeveralSimulations {
        /// What was asked for.
        wanted: String,
        /// What it names.
        simulations: Vec<String>,
    },
    /// The drive has no replay.
    #[error("{0} has no replay: it failed, or an earlier version made it")]
    NoReplay(String),
    /// The map of the replay cannot be drawn.
    #[error("the map of the replay cannot be drawn")]
    Map(#[from] MapError),
    /// The view cannot be drawn.
    #[error(transparent)]
    View(#[from] BevError),
    /// The instant lies outside the drive.
    #[error("{at_s} s is outside the simulation, which lasts {end_s:.1} s")]
    Outside {
        /// What was asked for.
        at_s: f64,
        /// The drive's last sample.
        end_s: f64,
    },
    /// A picture cannot be encoded or written.
    #[error("cannot write {}: {source}", path.display())]
    Image {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: image::ImageError,
    },
    /// A film cannot be encoded.
    #[error("cannot write {}: {source}", path.display())]
    Gif {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: gif::EncodingError,
    },
    /// A GIF is at most 65,535 pixels wide and high.
    #[error("{} would be larger than a GIF can be; ask for fewer --pixels", path.display())]
    TooLarge {
        /// Which file.
        path: PathBuf,
    },
    /// There is no ffmpeg.
    #[error("an MP4 is written by ffmpeg, which cannot be started ({0}); install it, or write a GIF by --gif")]
    NoFfmpeg(io::Error),
    /// ffmpeg failed.
    #[error("ffmpeg cannot write {}: {message}", path.display())]
    Ffmpeg {
        /// Which file.
        path: PathBuf,
        /// Its last words.
        message: String,
    },
}
