//! `scenarios`.

use super::data::{DataArguments, SplitArguments};
use crate::help;
use crate::picture::{PictureFile, picture_file};
use crate::words::path_word;
use clap::{Args, Subcommand, ValueEnum};
use planagent_runs::worker::interactive::SCENARIOS;
use std::path::PathBuf;

/// Subcommands of `scenarios`.
#[derive(Debug, Subcommand)]
pub(crate) enum ScenariosCommand {
    /// List scenarios: the records of files and folders, or the types that can be generated.
    #[command(after_long_help = help::SCENARIOS_LIST)]
    List(ListArguments),
    /// Show one scenario: its map, route, objects and lights; with --image a picture.
    #[command(after_long_help = help::SCENARIOS_SHOW)]
    Show(ShowArguments),
    /// Compare two sets of scenes, such as generated and recorded ones, feature by feature.
    #[command(after_long_help = help::SCENARIOS_STATISTICS)]
    Statistics(StatisticsArguments),
    /// Generate scenarios with their expert drivers, and print a line for each.
    #[command(after_long_help = help::SCENARIOS_GENERATE)]
    Generate(GenerateArguments),
    /// Write scenarios in the format of another tool.
    #[command(after_long_help = help::SCENARIOS_EXPORT)]
    Export(ExportArguments),
    /// Draw the scenarios of an interactive suite, which simulates none.
    #[command(after_long_help = help::SCENARIOS_INTERACTIVE)]
    Interactive(InteractiveArguments),
    /// Draw text twins, by the search and without a model.
    #[command(after_long_help = help::SCENARIOS_TWINS)]
    Twins(TwinArguments),
    /// Select the scenes of generated-test14-hard from a run of PDM-Closed on
    /// generated-test14-candidates.
    #[command(after_long_help = help::SCENARIOS_HARD)]
    Hard {
        /// Folder of the run.
        run: PathBuf,
    },
}

/// Arguments of `scenarios interactive`.
#[derive(Debug, Args)]
pub(crate) struct InteractiveArguments {
    /// Seeds of generated scenarios: train, validation or test.
    #[arg(long, value_name = "SPLIT", default_value = "validation", value_parser = ["train", "validation", "test"])]
    pub(crate) seeds: String,
    /// Scenarios of each kind.
    #[arg(long, value_name = "N", default_value_t = SCENARIOS)]
    pub(crate) count: usize,
    /// A folder with recordings in place of generated scenarios.
    #[arg(long, value_name = "FOLDER", conflicts_with = "seeds")]
    pub(crate) recordings: Option<PathBuf>,
}

/// Arguments of `scenarios twins`.
#[derive(Debug, Args)]
pub(crate) struct TwinArguments {
    /// Seeds of generated scenarios: train, validation or test.
    #[arg(long, value_name = "SPLIT", default_value = "validation", value_parser = ["train", "validation", "test"])]
    pub(crate) seeds: String,
    /// Pairs of each kind [default: those of the list].
    #[arg(long, value_name = "N")]
    pub(crate) count: Option<usize>,
    /// Draw from so many candidates alone.
    #[arg(long, value_name = "N")]
    pub(crate) candidates: Option<u64>,
}

/// Arguments of `scenarios list`.
#[derive(Debug, Args)]
pub(crate) struct ListArguments {
    /// Scenarios, as `simulate` takes them [default: the types that can be generated].
    #[arg(value_name = "SCENARIO", value_parser = path_word())]
    pub(crate) sources: Vec<String>,
    #[command(flatten)]
    pub(crate) split: SplitArguments,
    /// Print data on stdout as CSV.
    #[arg(long, conflicts_with = "json")]
    pub(crate) csv: bool,
}

/// Arguments of `scenarios generate`.
#[derive(Debug, Args)]
pub(crate) struct GenerateArguments {
    /// Types, separated by commas [default: all].
    #[arg(long = "type", value_name = "TYPES", value_delimiter = ',')]
    pub(crate) types: Vec<String>,
    /// First seed.
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(crate) from: u64,
    /// Number of seeds of each type.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) count: u64,
    /// Traffic seed.
    ///
    /// Another one keeps roads, route and situation of a seed, and draws other traffic around them.
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(crate) traffic: u64,
}

/// Arguments of `scenarios show`.
#[derive(Debug, Args)]
pub(crate) struct ShowArguments {
    /// The scenario, as `simulate` takes it.
    #[arg(value_parser = path_word())]
    pub(crate) scenario: String,
    #[command(flatten)]
    pub(crate) data: DataArguments,
    /// Seconds after the start of the window.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub(crate) at: f64,
    /// Write a BEV picture to this file, a .png or .jpg.
    #[arg(long, value_name = "FILE", value_parser = picture_file())]
    pub(crate) image: Option<PictureFile>,
    /// Side of the picture, meters.
    #[arg(long, value_name = "METERS", default_value_t = 128.0)]
    pub(crate) view: f64,
}

/// Arguments of `scenarios statistics`.
#[derive(Debug, Args)]
pub(crate) struct StatisticsArguments {
    /// Scenarios, as `simulate` takes them, or a split; several are separated by commas.
    #[arg(value_name = "A", value_parser = path_word())]
    pub(crate) a: String,
    /// The scenarios that they are compared with.
    #[arg(value_name = "B", value_parser = path_word())]
    pub(crate) b: String,
    #[command(flatten)]
    pub(crate) data: DataArguments,
    /// Write a figure to this file, an SVG.
    #[arg(long, value_name = "FILE")]
    pub(crate) figure: Option<PathBuf>,
}

/// Arguments of `scenarios export`.
#[derive(Debug, Args)]
// clap does not wrap this line.
#[command(
    override_usage = "planagent scenarios export [OPTIONS] --format <FORMAT> --out <FOLDER>\n       <SCENARIO>..."
)]
pub(crate) struct ExportArguments {
    /// Scenarios, as `simulate` takes them.
    #[arg(required = true, value_name = "SCENARIO", value_parser = path_word())]
    pub(crate) scenarios: Vec<String>,
    #[command(flatten)]
    pub(crate) data: DataArguments,
    /// Format: nuplan writes a log for each scenario and a package for each map.
    #[arg(long, value_enum)]
    pub(crate) format: ExportFormat,
    /// Folder for the files, new or empty.
    #[arg(long, value_name = "FOLDER")]
    pub(crate) out: PathBuf,
    /// Name of the map [default: a digest of its content].
    #[arg(long, value_name = "NAME")]
    pub(crate) location: Option<String>,
    /// Write empty maps for those of nuPlan's locations that are missing.
    ///
    /// The devkit opens no folder without its four locations.
    #[arg(long, hide_short_help = true)]
    pub(crate) stand_in_maps: bool,
    /// Scenario type of all logs [default: that of each scenario].
    #[arg(long, value_name = "TYPE", hide_short_help = true)]
    pub(crate) scenario_type: Option<String>,
    /// UTM zone of the scenarios, as an EPSG code.
    #[arg(
        long,
        value_name = "CODE",
        default_value_t = 32_611,
        hide_short_help = true
    )]
    pub(crate) epsg: u32,
    /// Easting and northing of their origin, meters.
    #[arg(long, value_name = "METERS", num_args = 2, default_values_t = [664_000.0, 3_998_000.0], hide_short_help = true)]
    pub(crate) origin: Vec<f64>,
}

/// Format of `scenarios export`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ExportFormat {
    /// nuPlan's log databases and map packages.
    Nuplan,
}
