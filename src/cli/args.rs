//! The arguments of the command line.

use super::help;
use super::picture::PictureFile;
use crate::mllm::WeightFormat;
use crate::planner::PlannerRegistry;
use crate::runner::{ExperimentsRequest, Request};
use crate::scenario::{DataRoots, Readers};
use clap::builder::{PathBufValueParser, TypedValueParser};
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

#[expect(clippy::struct_excessive_bools, reason = "these are flags")]
/// A driving agent that plans with a vision-language model, offline, on the CPU.
#[derive(Debug, Parser)]
#[command(name = "planagent", version = help::version(), max_term_width = 80)]
pub(super) struct Arguments {
    #[command(subcommand)]
    pub(super) command: Command,
    /// Configuration file [default: planagent.toml in the working directory, if it exists].
    #[arg(long, global = true, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,
    /// Model: a name from models/, a folder in Hugging Face's layout, a GGUF file, or a hub id.
    #[arg(long, global = true, value_name = "MODEL")]
    pub(super) model: Option<String>,
    /// Weight format in memory: `f32`, `f16`, `q8_0`, `q6_k` or `q4_k` [default: that of the files, f32 for safetensors].
    #[arg(long, global = true, value_name = "KIND")]
    pub(super) quantize: Option<WeightFormat>,
    /// Load the model even if it seems to need more memory than is free.
    #[arg(long, global = true)]
    pub(super) ignore_memory: bool,
    /// Do not use the network: models of the hub must be in the cache.
    #[arg(long, global = true)]
    pub(super) offline: bool,
    /// Seed of all random numbers.
    #[arg(long, global = true)]
    pub(super) seed: Option<u64>,
    /// Number of threads; 0 for one per core.
    #[arg(long, global = true, value_name = "N")]
    pub(super) threads: Option<usize>,
    /// Print data on stdout as JSON.
    #[arg(long, global = true)]
    pub(super) json: bool,
    /// Print only errors on stderr.
    #[arg(long, short, global = true)]
    pub(super) quiet: bool,
    /// Print details on stderr, for example the weight formats of a model.
    #[arg(long, short, global = true, conflicts_with = "quiet")]
    pub(super) verbose: bool,
}

/// Word for every experiment.
pub(super) const ALL_EXPERIMENTS: &str = "all";

/// Name of the hidden subcommand in which `bench` measures.
pub(super) const BENCH_PROCESS: &str = "bench-process";

/// The subcommands.
#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Simulate scenarios and score them with nuPlan's metrics.
    Simulate(SimulateArguments),
    /// Run one planning call and show its input, answers, code and scores.
    Plan(PlanArguments),
    /// Write an HTML page of runs: scores, histograms, and replays with their transcripts.
    Report(ReportArguments),
    /// Write a simulation of a run as a film or a picture.
    Render(RenderArguments),
    /// List, show and generate scenarios.
    #[command(subcommand)]
    Scenarios(ScenariosCommand),
    /// List, check, fetch and quantize models.
    #[command(subcommand)]
    Models(ModelsCommand),
    /// Write labeled states for training: BEV images and the three rounds with their answers.
    Dataset(DatasetArguments),
    /// Reproduce the paper's tables and figures, and run further studies.
    Experiment(ExperimentArguments),
    /// Measure the time of a planning call with local models, also against llama.cpp.
    Bench(BenchArguments),
    /// The measuring process of `bench`: requests on stdin, replies on stdout.
    #[command(name = BENCH_PROCESS, hide = true)]
    BenchProcess,
}

/// Folders of nuPlan's data.
#[derive(Debug, Args)]
pub(super) struct DataArguments {
    /// Folder of nuPlan's logs, searched with its subfolders [default: `$NUPLAN_DATA_ROOT`].
    #[arg(long, value_name = "FOLDER")]
    data_root: Option<PathBuf>,
    /// Folder of nuPlan's maps [default: `$NUPLAN_MAPS_ROOT`].
    #[arg(long, value_name = "FOLDER")]
    maps_root: Option<PathBuf>,
}

impl DataArguments {
    /// The folders of these flags, else of the environment.
    pub(super) fn roots(&self) -> DataRoots {
        let known = DataRoots::from_environment();
        DataRoots { data: self.data_root.clone().or(known.data), maps: self.maps_root.clone().or(known.maps) }
    }

    /// The scenario readers, with nuPlan's data in these folders.
    pub(super) fn readers(&self) -> Readers {
        Readers::new(&self.roots())
    }
}

/// Named lists of scenarios.
#[derive(Debug, Args)]
pub(super) struct SplitArguments {
    #[arg(long = "split", value_name = "NAME", help = help::splits())]
    pub(super) splits: Vec<String>,
    #[command(flatten)]
    pub(super) data: DataArguments,
}

/// Arguments of `simulate`.
#[derive(Debug, Args)]
pub(super) struct SimulateArguments {
    /// Scenarios: TFRecord files, nuPlan logs (LOG.db, or one scenario as LOG.db#TOKEN), Argoverse 2 logs, folders of these, or
    /// generated/TYPE/SEED[.TRAFFIC] [default: one generated scenario].
    #[arg(long = "scenario", value_name = "SCENARIO", num_args = 1..)]
    pub(super) scenarios: Vec<String>,
    #[command(flatten)]
    pub(super) split: SplitArguments,
    /// Only the first N scenarios.
    #[arg(long, value_name = "N")]
    pub(super) limit: Option<usize>,
    #[arg(long, value_name = "NAMES", value_delimiter = ',', help = help::planners())]
    pub(super) planner: Vec<String>,
    /// Challenges, separated by commas: nonreactive (agents replay the log), reactive (IDM agents), both of these, open-loop
    /// (plans compared with the log) [default: nonreactive].
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub(super) challenge: Vec<String>,
    /// Folder for the results, new or empty [default: the next free runs/NNNN].
    #[arg(long, value_name = "FOLDER", conflicts_with = "resume")]
    pub(super) out: Option<PathBuf>,
    /// Resume the run in this folder with its own settings; completed simulations stay.
    #[arg(long, value_name = "FOLDER")]
    pub(super) resume: Option<PathBuf>,
    /// With --resume: repeat failed simulations.
    #[arg(long, requires = "resume")]
    pub(super) retry_failed: bool,
}

impl SimulateArguments {
    pub(super) fn request(&self) -> Request {
        Request {
            scenarios: self.scenarios.clone(),
            splits: self.split.splits.clone(),
            limit: self.limit,
            planners: self.planner.clone(),
            challenges: self.challenge.clone(),
            roots: self.split.data.roots(),
            retry_failed: self.retry_failed,
            ..Request::default()
        }
    }
}

/// Arguments of `plan`.
#[derive(Debug, Args)]
pub(super) struct PlanArguments {
    /// The scenario: a TFRecord file, LOG.db#TOKEN, an Argoverse 2 log or generated/TYPE/SEED[.TRAFFIC] [default: one
    /// generated scenario].
    #[arg(long, value_name = "SCENARIO")]
    pub(super) scenario: Option<String>,
    #[command(flatten)]
    pub(super) data: DataArguments,
    /// Seconds after the start of the window.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_negative_numbers = true)]
    pub(super) at: f64,
    /// Write the BEV image to this file, a .png or .jpg.
    #[arg(long, value_name = "FILE", value_parser = picture_file())]
    pub(super) image: Option<PictureFile>,
}

/// Arguments of `report`.
#[derive(Debug, Args)]
pub(super) struct ReportArguments {
    /// Folders of runs; the page compares several.
    #[arg(required = true, value_name = "RUN")]
    pub(super) runs: Vec<PathBuf>,
    /// The page [default: report.html in the folder of the first run].
    #[arg(long, value_name = "FILE")]
    pub(super) out: Option<PathBuf>,
    /// Maximum size of the page, megabytes; replays that do not fit are left out, by whole scenarios.
    #[arg(long, value_name = "MB", default_value_t = 15.0, allow_negative_numbers = true)]
    pub(super) max_mb: f64,
    /// Only replays of scenarios with this text in their name; tables and histograms show all simulations.
    #[arg(long, value_name = "TEXT")]
    pub(super) scenario: Option<String>,
}

/// Arguments of `render`.
#[derive(Debug, Args)]
pub(super) struct RenderArguments {
    /// Folder of the run.
    #[arg(value_name = "RUN")]
    pub(super) run: PathBuf,
    /// The simulation: its number in the run, or the name of its scenario.
    #[arg(value_name = "SIMULATION")]
    pub(super) simulation: String,
    /// Its planner, where the scenario has several.
    #[arg(long, value_name = "NAME")]
    pub(super) planner: Option<String>,
    /// Its challenge, where the scenario has several.
    #[arg(long, value_name = "NAME")]
    pub(super) challenge: Option<String>,
    #[command(flatten)]
    pub(super) output: RenderOutput,
    /// With --png: the frame at this time, seconds [default: a sheet of eight frames].
    #[arg(long, value_name = "SECONDS", requires = "png", allow_negative_numbers = true)]
    pub(super) at: Option<f64>,
    /// Side of the scene, pixels.
    #[arg(long, value_name = "N", default_value_t = 640)]
    pub(super) pixels: u32,
    /// Side of the scene, meters.
    #[arg(long, value_name = "METRES", default_value_t = 64.0, allow_negative_numbers = true)]
    pub(super) view: f64,
    /// Frames per second of a film; a simulation has 10.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=10))]
    pub(super) fps: u32,
}

/// Output of `render`: one of these.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub(super) struct RenderOutput {
    /// Write a GIF.
    #[arg(long, value_name = "FILE")]
    pub(super) gif: Option<PathBuf>,
    /// Write an MP4; ffmpeg must be on the path.
    #[arg(long, value_name = "FILE")]
    pub(super) mp4: Option<PathBuf>,
    /// Write a PNG.
    #[arg(long, value_name = "FILE")]
    pub(super) png: Option<PathBuf>,
}

/// Takes a path with the extension of a picture format.
fn picture_file() -> impl TypedValueParser<Value = PictureFile> {
    PathBufValueParser::new().try_map(PictureFile::try_from)
}

/// Subcommands of `scenarios`.
#[derive(Debug, Subcommand)]
pub(super) enum ScenariosCommand {
    /// List scenarios: the records of files and folders, or the types that can be generated.
    List {
        /// TFRecord files, nuPlan logs, Argoverse 2 logs, folders of these, or generated/TYPE/SEED[.TRAFFIC].
        sources: Vec<String>,
        #[command(flatten)]
        split: SplitArguments,
    },
    /// Show one scenario: its map, route, objects and lights; with --image a picture.
    Show(ShowArguments),
    /// Generate scenarios with their expert drivers, and print a line for each.
    Generate(GenerateArguments),
    /// Write scenarios in the format of another tool.
    Export(ExportArguments),
    /// Select the scenes of generated-14-hard from a run of PDM-Closed on generated-14-candidates.
    Hard {
        /// Folder of the run.
        run: PathBuf,
    },
}

/// Arguments of `scenarios generate`.
#[derive(Debug, Args)]
pub(super) struct GenerateArguments {
    /// Types [default: all].
    #[arg(long = "type", value_name = "TYPE")]
    pub(super) types: Vec<String>,
    /// First seed.
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(super) from: u64,
    /// Number of seeds of each type.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(super) count: u64,
    /// Traffic seed: another one keeps roads, route and situation of a seed, and redraws the traffic around them.
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(super) traffic: u64,
}

/// Arguments of `scenarios show`.
#[derive(Debug, Args)]
pub(super) struct ShowArguments {
    /// A TFRecord file, LOG.db#TOKEN, an Argoverse 2 log or generated/TYPE/SEED[.TRAFFIC].
    pub(super) scenario: String,
    #[command(flatten)]
    pub(super) data: DataArguments,
    /// Seconds after the start of the window.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_negative_numbers = true)]
    pub(super) at: f64,
    /// Write a BEV picture to this file, a .png or .jpg.
    #[arg(long, value_name = "FILE", value_parser = picture_file())]
    pub(super) image: Option<PictureFile>,
    /// Side of the picture, meters.
    #[arg(long, value_name = "METRES", default_value_t = 128.0, allow_negative_numbers = true)]
    pub(super) view: f64,
}

/// Arguments of `scenarios export`.
#[derive(Debug, Args)]
// clap does not wrap this line.
#[command(
    override_usage = "planagent scenarios export [OPTIONS] --format <FORMAT> --out <FOLDER>\n       <SCENARIO>..."
)]
pub(super) struct ExportArguments {
    /// Scenarios, as `simulate` takes them.
    #[arg(required = true, value_name = "SCENARIO")]
    pub(super) scenarios: Vec<String>,
    #[command(flatten)]
    pub(super) data: DataArguments,
    /// Format: nuplan writes a log for each scenario and a package for each map.
    #[arg(long, value_enum)]
    pub(super) format: ExportFormat,
    /// Folder for the files, new or empty.
    #[arg(long, value_name = "FOLDER")]
    pub(super) out: PathBuf,
    /// Name of the map [default: a digest of its content].
    #[arg(long, value_name = "NAME")]
    pub(super) location: Option<String>,
    /// Also write empty maps for those of nuPlan's four locations that are missing: the devkit opens no folder without them.
    #[arg(long)]
    pub(super) stand_in_maps: bool,
    /// Scenario type of all logs [default: that of each scenario].
    #[arg(long, value_name = "TYPE")]
    pub(super) scenario_type: Option<String>,
    /// UTM zone of the scenarios, as an EPSG code.
    #[arg(long, value_name = "CODE", default_value_t = 32_611)]
    pub(super) epsg: u32,
    /// Easting and northing of their origin, meters.
    #[arg(long, value_name = "METRES", num_args = 2, default_values_t = [664_000.0, 3_998_000.0], allow_negative_numbers = true)]
    pub(super) origin: Vec<f64>,
}

/// Format of `scenarios export`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ExportFormat {
    /// nuPlan's log databases and map packages.
    Nuplan,
}

/// Subcommands of `models`.
#[derive(Debug, Subcommand)]
pub(super) enum ModelsCommand {
    /// List the described models: family, source, place of their files, size.
    List,
    /// Check the files of models without reading the weights, and report every fault.
    Check {
        /// Models as `--model` takes them [default: all described models on this machine].
        models: Vec<String>,
    },
    /// Download models of the hub.
    Fetch {
        /// Models as `--model` takes them.
        #[arg(required = true)]
        models: Vec<String>,
    },
    /// Write a model as GGUF, for a faster start and for llama.cpp.
    Quantize(QuantizeArguments),
}

/// Arguments of `models quantize`.
#[derive(Debug, Args)]
pub(super) struct QuantizeArguments {
    /// The model, as `--model` takes it.
    #[arg(value_name = "MODEL")]
    pub(super) source: String,
    /// Weight format: `f32`, `f16`, `q8_0`, `q6_k` or `q4_k`.
    #[arg(long, value_name = "KIND")]
    pub(super) to: WeightFormat,
    /// The file, NAME.gguf; the vision tower of a LLaVA is written beside it as mmproj-NAME.gguf.
    #[arg(long, value_name = "FILE")]
    pub(super) out: PathBuf,
    /// Overwrite existing files.
    #[arg(long)]
    pub(super) force: bool,
}

/// Arguments of `dataset`.
#[derive(Debug, Args)]
pub(super) struct DatasetArguments {
    /// Folder for the shards; an interrupted run continues where it stopped.
    #[arg(long, value_name = "FOLDER")]
    pub(super) out: PathBuf,
    /// Labeled states for training; there may be more, because shards are written whole.
    #[arg(long, default_value_t = 20_000)]
    pub(super) states: usize,
    /// Labeled states for validation, from seeds of their own.
    #[arg(long, default_value_t = 2_000)]
    pub(super) validation: usize,
    /// Label the states that PlanAgent reaches with the configured model in control; for training only. These shards may lie in
    /// the same folder as others.
    #[arg(long)]
    pub(super) driven: bool,
}

/// Arguments of `experiment`.
#[derive(Debug, Args)]
pub(super) struct ExperimentArguments {
    #[arg(value_name = "NAME", help = help::experiments())]
    pub(super) name: String,
    /// Only 2 scenes of each type and 14 recordings: a first look, in minutes.
    #[arg(long)]
    pub(super) quick: bool,
    /// Suites, separated by commas: splits as `simulate` takes them, or recorded [default: those of the experiment].
    #[arg(long = "suite", value_name = "NAMES", value_delimiter = ',')]
    pub(super) suites: Vec<String>,
    /// Scenarios of the suite recorded, as `simulate` takes them [default: the recordings in `$PLANAGENT_DATA`].
    #[arg(long = "scenario", value_name = "SCENARIO", num_args = 1..)]
    pub(super) scenarios: Vec<String>,
    #[command(flatten)]
    pub(super) data: DataArguments,
    /// Folder for results and runs; completed simulations in it are not repeated.
    #[arg(long, value_name = "FOLDER", default_value = "runs/experiments")]
    pub(super) out: PathBuf,
    /// Folder of a bench with the times of models whose weights are not on this machine.
    #[arg(long, value_name = "FOLDER")]
    pub(super) bench: Option<PathBuf>,
    /// Repeat failed simulations.
    #[arg(long)]
    pub(super) retry_failed: bool,
}

impl ExperimentArguments {
    pub(super) fn request(&self) -> ExperimentsRequest {
        ExperimentsRequest {
            suites: self.suites.clone(),
            scenarios: self.scenarios.clone(),
            registry: PlannerRegistry::default(),
            roots: self.data.roots(),
            out: self.out.clone(),
            bench: self.bench.clone(),
            quick: self.quick,
            retry_failed: self.retry_failed,
        }
    }
}

/// Arguments of `bench`.
#[derive(Debug, Args)]
pub(super) struct BenchArguments {
    /// Models, as --model takes them [default: the configured one, unless --random-weights is given].
    #[arg(value_name = "MODEL")]
    pub(super) models: Vec<String>,
    /// Shapes of known models to fill with random weights, separated by commas; nothing is downloaded. A wrong name lists
    /// them.
    #[arg(long, value_name = "SHAPES", value_delimiter = ',')]
    pub(super) random_weights: Vec<String>,
    /// Planning calls of each model before the measurement.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(super) warm_up: usize,
    /// Measured planning calls of each model.
    #[arg(long, value_name = "N", default_value_t = 5)]
    pub(super) iterations: usize,
    /// Compare with another engine on the same GGUF files, in alternation.
    #[arg(long, value_name = "ENGINE", value_enum)]
    pub(super) vs: Option<OtherEngine>,
    /// Python interpreter with the package llama-cpp-python [default: `$PLANAGENT_LLAMA_PYTHON`, else python3].
    #[arg(long, value_name = "FILE", requires = "vs")]
    pub(super) llama_python: Option<PathBuf>,
    /// Folder for the GGUF files of random weights for --vs [default: weights in the folder of the results].
    #[arg(long, value_name = "FOLDER", requires = "vs")]
    pub(super) weights: Option<PathBuf>,
    /// Folder for the results, new or empty [default: runs/bench-DATE].
    #[arg(long, value_name = "FOLDER", conflicts_with = "resume")]
    pub(super) out: Option<PathBuf>,
    /// Resume the bench in this folder; measured models stay.
    #[arg(long, value_name = "FOLDER")]
    pub(super) resume: Option<PathBuf>,
}

/// Engines that `bench` compares with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum OtherEngine {
    /// llama.cpp through the low-level interface of llama-cpp-python.
    #[value(name = "llama.cpp")]
    LlamaCpp,
}
