//! What is made of runs: `report`, `serve`, `render`, `compare`, `merge`.

use crate::film::FilmFile;
use clap::Args;
use std::path::PathBuf;

/// Arguments of `report`.
#[derive(Debug, Args)]
pub(crate) struct ReportArguments {
    /// Folders of runs; the page compares several [default: the last run in runs/].
    #[arg(value_name = "RUN")]
    pub(crate) runs: Vec<PathBuf>,
    /// The page [default: report.html in the folder of the first run].
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// Open the page in the browser.
    #[arg(long)]
    pub(crate) open: bool,
    /// Maximum size of the page, megabytes.
    ///
    /// Replays that do not fit are left out, by whole scenarios.
    #[arg(long, value_name = "MB", default_value_t = 15.0)]
    pub(crate) max_mb: f64,
    /// Only replays of scenarios with this text in their name.
    ///
    /// Tables and histograms show all simulations.
    #[arg(long, value_name = "TEXT")]
    pub(crate) scenario: Option<String>,
}

/// Arguments of `serve`.
#[derive(Debug, Args)]
pub(crate) struct ServeArguments {
    /// Folders of runs; the page compares several [default: the last run in runs/].
    #[arg(value_name = "RUN")]
    pub(crate) runs: Vec<PathBuf>,
    /// Port on 127.0.0.1; 0 for any free one.
    #[arg(long, value_name = "N", default_value_t = 4747)]
    pub(crate) port: u16,
    /// Open the page in the browser.
    #[arg(long)]
    pub(crate) open: bool,
}

/// Arguments of `render`.
#[derive(Debug, Args)]
#[command(
    override_usage = "planagent render [OPTIONS] <--gif <PATH>|--mp4 <PATH>|--png <PATH>>\n       [RUN] [SIMULATION]"
)]
pub(crate) struct RenderArguments {
    /// Folder of the run [default: the last run in runs/].
    #[arg(value_name = "RUN")]
    pub(crate) run: Option<String>,
    /// The simulation: its number, or a part of its scenario's name that no other has [default:
    /// all].
    ///
    /// The number stands at the start of its folder's name in simulations/, as in 000012-…, in the
    /// page's address, as in #scenarios/0/12, and in record.toml.
    #[arg(value_name = "SIMULATION")]
    pub(crate) simulation: Option<String>,
    /// Only simulations of this planner.
    #[arg(long, value_name = "NAME")]
    pub(crate) planner: Option<String>,
    /// Only simulations in this challenge.
    #[arg(long, value_name = "NAME")]
    pub(crate) challenge: Option<String>,
    #[command(flatten)]
    pub(crate) output: RenderOutput,
    /// With --png: the frame at this time, seconds [default: a sheet of eight frames].
    #[arg(long, value_name = "SECONDS", conflicts_with_all = ["gif", "mp4"])]
    pub(crate) at: Option<f64>,
    /// Side of the scene, pixels.
    #[arg(long, value_name = "N", default_value_t = 640, hide_short_help = true)]
    pub(crate) pixels: u32,
    /// Side of the scene, meters.
    #[arg(
        long,
        value_name = "METERS",
        default_value_t = 64.0,
        hide_short_help = true
    )]
    pub(crate) view: f64,
    /// Frames per second of a film; a simulation has 10 [default: 5].
    #[arg(long, value_name = "N", conflicts_with = "png", value_parser = clap::value_parser!(u32).range(1..=10))]
    pub(crate) fps: Option<u32>,
}

/// Output of `render`: one of these.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub(crate) struct RenderOutput {
    /// Write GIFs: a file .gif for one simulation, or a folder.
    #[arg(long, value_name = "PATH")]
    pub(crate) gif: Option<PathBuf>,
    /// Write MP4s: a file .mp4 for one simulation, or a folder. Needs ffmpeg.
    #[arg(long, value_name = "PATH")]
    pub(crate) mp4: Option<PathBuf>,
    /// Write PNGs: a file .png for one simulation, or a folder.
    #[arg(long, value_name = "PATH")]
    pub(crate) png: Option<PathBuf>,
}

impl RenderOutput {
    /// The format and its path.
    pub(crate) fn film(&self) -> Option<FilmFile> {
        let Self { gif, mp4, png } = self;
        let gif = gif.clone().map(FilmFile::Gif);
        gif.or_else(|| mp4.clone().map(FilmFile::Mp4))
            .or_else(|| png.clone().map(FilmFile::Png))
    }
}

/// Arguments of `compare`.
#[derive(Debug, Args)]
pub(crate) struct CompareArguments {
    /// Folder of the first run, A.
    #[arg(value_name = "RUN")]
    pub(crate) first: PathBuf,
    /// Folder of the second run, B; the same one to compare two of its planners.
    #[arg(value_name = "RUN")]
    pub(crate) second: PathBuf,
    /// A planner of the first run and one of the second, separated by a comma.
    #[arg(long, value_name = "A,B", value_delimiter = ',')]
    pub(crate) planner: Vec<String>,
    /// Show the scores by scenario type too.
    #[arg(long)]
    pub(crate) by_type: bool,
    /// Print the common scenes on stdout as CSV.
    #[arg(long, conflicts_with = "json")]
    pub(crate) csv: bool,
}

/// Arguments of `merge`.
#[derive(Debug, Args)]
pub(crate) struct MergeArguments {
    /// Folders of the shards.
    #[arg(required = true, value_name = "RUN")]
    pub(crate) runs: Vec<PathBuf>,
    /// Folder for the merged run, new or empty [default: the next free runs/NNNN].
    #[arg(long, value_name = "FOLDER")]
    pub(crate) out: Option<PathBuf>,
}
