//! The flags, as typed.

use super::picture::PictureFile;
use crate::experiment::study;
use crate::mllm::WeightFormat;
use crate::planner::PlannerRegistry;
use crate::runner::{ExperimentsRequest, Request, TOKENS};
use crate::scenario::{DataRoots, Readers};
use clap::builder::{PathBufValueParser, PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

#[expect(clippy::struct_excessive_bools, reason = "these are flags")]
/// A driving agent that plans with a multimodal language model, offline, on the CPU.
#[derive(Debug, Parser)]
#[command(name = "planagent", version, max_term_width = 80)]
pub(super) struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub(super) command: Command,
    /// Configuration file [default: planagent.toml in the working directory, if it is there].
    #[arg(long, global = true, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,
    /// Model: a name from models/, a folder in Hugging Face's layout, a GGUF file, or a hub id.
    #[arg(long, global = true, value_name = "MODEL")]
    pub(super) model: Option<String>,
    /// Hold the model's weights in `f32`, `f16`, `q8_0`, `q6_k` or `q4_k` [default: as its files hold them, safetensors in f32].
    #[arg(long, global = true, value_name = "KIND")]
    pub(super) quantize: Option<WeightFormat>,
    /// Load the model even if it seems to need more memory than is free.
    #[arg(long, global = true)]
    pub(super) ignore_memory: bool,
    /// Never use the network: models of the hub must be in the cache.
    #[arg(long, global = true)]
    pub(super) offline: bool,
    /// Seed of everything that is drawn at random.
    #[arg(long, global = true)]
    pub(super) seed: Option<u64>,
    /// Number of threads; 0 takes all cores.
    #[arg(long, global = true, value_name = "N")]
    pub(super) threads: Option<usize>,
    /// Data on stdout as JSON.
    #[arg(long, global = true)]
    pub(super) json: bool,
    /// Nothing but errors on stderr.
    #[arg(long, short, global = true)]
    pub(super) quiet: bool,
    /// More on stderr: how the weights of a model are held.
    #[arg(long, short, global = true, conflicts_with = "quiet")]
    pub(super) verbose: bool,
}

/// Stands for every experiment.
pub(super) const ALL_EXPERIMENTS: &str = "all";

/// Name of the hidden subcommand that `bench` starts itself by.
pub(super) const BENCH_PROCESS: &str = "bench-process";

/// The subcommands.
#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Drive scenarios in closed loop and score them with nuPlan's metrics.
    Simulate(SimulateArguments),
    /// Make one planning call and show what was seen, thought, written and judged.
    Plan(PlanArguments),
    /// Write a page of runs: scores, histograms, and replays with their transcripts.
    Report(ReportArguments),
    /// Write a drive of a run as a film or a picture.
    Render(RenderArguments),
    /// List, show and generate scenarios.
    #[command(subcommand)]
    Scenarios(ScenariosCommand),
    /// List, check, fetch and quantise language models.
    #[command(subcommand)]
    Models(ModelsCommand),
    /// Write labelled states for training: BEV images and the three rounds with their answers.
    Dataset(DatasetArguments),
    /// Make the paper's tables and figures, and some beyond it.
    Experiment(ExperimentArguments),
    /// Measure what a planning call costs with local models, and beside llama.cpp.
    Bench(BenchArguments),
    /// The measuring process of `bench`: requests on stdin, replies on stdout.
    #[command(name = BENCH_PROCESS, hide = true)]
    BenchProcess,
}

/// Flags that say where nuPlan's data lies.
#[derive(Debug, Args)]
pub(super) struct DataArguments {
    /// Folder of nuPlan's logs, with folders below [default: `$NUPLAN_DATA_ROOT`].
    #[arg(long, value_name = "FOLDER")]
    data_root: Option<PathBuf>,
    /// Folder of nuPlan's maps [default: `$NUPLAN_MAPS_ROOT`].
    #[arg(long, value_name = "FOLDER")]
    maps_root: Option<PathBuf>,
}

impl DataArguments {
    /// The folders by these flags, else by the environment.
    pub(super) fn roots(&self) -> DataRoots {
        let known = DataRoots::from_environment();
        DataRoots { data: self.data_root.clone().or(known.data), maps: self.maps_root.clone().or(known.maps) }
    }

    /// The scenario readers, with nuPlan's data in these folders.
    pub(super) fn readers(&self) -> Readers {
        Readers::new(&self.roots())
    }
}

/// Flags that name lists of scenarios.
#[derive(Debug, Args)]
pub(super) struct SplitArguments {
    /// List of scenarios: val14, test14-hard, reduced-val14; generated (16 types x 10 seeds), generated-14 (14 x 150),
    /// generated-14-hard (14 x 20), generated-14-candidates (14 x 100); or a nuPlan scenario filter FILE.yaml.
    #[arg(long = "split", value_name = "NAME")]
    pub(super) splits: Vec<String>,
    #[command(flatten)]
    pub(super) data: DataArguments,
}

/// Flags of `simulate`.
#[derive(Debug, Args)]
pub(super) struct SimulateArguments {
    /// Scenarios: TFRecord files, nuPlan logs (LOG.db, or one scenario as LOG.db#TOKEN), Argoverse 2 logs, folders of these, or
    /// generated/TYPE/SEED[.TRAFFIC] [default: one generated scene].
    #[arg(long = "scenario", value_name = "SCENARIO", num_args = 1..)]
    pub(super) scenarios: Vec<String>,
    #[command(flatten)]
    pub(super) split: SplitArguments,
    /// Only the first N scenarios.
    #[arg(long, value_name = "N")]
    pub(super) limit: Option<usize>,
    /// Planners, separated by commas: plan-agent, log-replay, idm, simple, pdm-closed, llm-assist-unc, llm-assist-par, and the
    /// controls random-code, fixed-code, grid-code (the agent with codes that no model wrote) [default: plan-agent].
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub(super) planner: Vec<String>,
    /// Challenges, separated by commas: nonreactive (replayed traffic), reactive (IDM traffic), both of these, open-loop
    /// (plans compared with the log) [default: nonreactive].
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub(super) challenge: Vec<String>,
    /// Folder for the results; must be new or empty [default: the next free runs/NNNN].
    #[arg(long, value_name = "FOLDER", conflicts_with = "resume")]
    pub(super) out: Option<PathBuf>,
    /// Go on with the run in this folder, with what it was started with; drives that have ended are kept.
    #[arg(long, value_name = "FOLDER")]
    pub(super) resume: Option<PathBuf>,
    /// With --resume: make drives that failed once more.
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

/// Flags of `plan`.
#[derive(Debug, Args)]
pub(super) struct PlanArguments {
    /// The scenario: a TFRecord file, LOG.db#TOKEN, an Argoverse 2 log or generated/TYPE/SEED[.TRAFFIC] [default: one
    /// generated scene].
    #[arg(long, value_name = "SCENARIO")]
    pub(super) scenario: Option<String>,
    #[command(flatten)]
    pub(super) data: DataArguments,
    /// Seconds after the start of the window.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_negative_numbers = true)]
    pub(super) at: f64,
    /// Write the BEV map to this file, a PNG or JPEG by its ending.
    #[arg(long, value_name = "FILE", value_parser = picture_file())]
    pub(super) image: Option<PictureFile>,
}

/// Flags of `report`.
#[derive(Debug, Args)]
pub(super) struct ReportArguments {
    /// Folders of runs; several are compared.
    #[arg(required = true, value_name = "RUN")]
    pub(super) runs: Vec<PathBuf>,
    /// The page [default: report.html in the folder of the first run].
    #[arg(long, value_name = "FILE")]
    pub(super) out: Option<PathBuf>,
    /// Largest page, megabytes: replays that do not fit in are left out, whole scenarios at a time.
    #[arg(long, value_name = "MB", default_value_t = 15.0, allow_negative_numbers = true)]
    pub(super) max_mb: f64,
    /// Only replays of scenarios with this in their name; tables and histograms are of all drives.
    #[arg(long, value_name = "TEXT")]
    pub(super) scenario: Option<String>,
}

/// Flags of `render`.
#[derive(Debug, Args)]
pub(super) struct RenderArguments {
    /// Folder of the run.
    #[arg(value_name = "RUN")]
    pub(super) run: PathBuf,
    /// The drive: its number in the run, or the name of its scenario.
    #[arg(value_name = "DRIVE")]
    pub(super) drive: String,
    /// By which planner, where several drove the scenario.
    #[arg(long, value_name = "NAME")]
    pub(super) planner: Option<String>,
    /// In which challenge, where it was driven in several.
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
    /// Side of the scene, metres.
    #[arg(long, value_name = "METRES", default_value_t = 64.0, allow_negative_numbers = true)]
    pub(super) view: f64,
    /// Frames a second of a film; the drive has 10.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=10))]
    pub(super) fps: u32,
}

/// What `render` writes: one of these.
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

/// Takes a path whose ending names a format that pictures are written in.
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
    /// Generate scenarios and drive them with their expert: a line each.
    Generate(GenerateArguments),
    /// Write scenarios as another tool's files.
    Export(ExportArguments),
    /// Choose the scenes of generated-14-hard out of a run of PDM-Closed on generated-14-candidates.
    Hard {
        /// Folder of the run.
        run: PathBuf,
    },
}

/// Flags of `scenarios generate`.
#[derive(Debug, Args)]
pub(super) struct GenerateArguments {
    /// Types [default: all].
    #[arg(long = "type", value_name = "TYPE")]
    pub(super) types: Vec<String>,
    /// First seed.
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(super) from: u64,
    /// How many seeds of each type.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(super) count: u64,
    /// Among which traffic: another traffic seed keeps roads, route and situation of a seed, and draws anew what is luck.
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(super) traffic: u64,
}

/// Flags of `scenarios show`.
#[derive(Debug, Args)]
pub(super) struct ShowArguments {
    /// A TFRecord file, LOG.db#TOKEN, an Argoverse 2 log or generated/TYPE/SEED[.TRAFFIC].
    pub(super) scenario: String,
    #[command(flatten)]
    pub(super) data: DataArguments,
    /// Seconds after the start of the window.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_negative_numbers = true)]
    pub(super) at: f64,
    /// Write a BEV picture to this file, a PNG or JPEG by its ending.
    #[arg(long, value_name = "FILE", value_parser = picture_file())]
    pub(super) image: Option<PictureFile>,
    /// Side of the picture, metres.
    #[arg(long, value_name = "METRES", default_value_t = 128.0, allow_negative_numbers = true)]
    pub(super) view: f64,
}

/// Flags of `scenarios export`.
#[derive(Debug, Args)]
// clap does not wrap this line.
#[command(
    override_usage = "planagent scenarios export [OPTIONS] --format <FORMAT> --out <FOLDER>\n       <SCENARIO>..."
)]
pub(super) struct ExportArguments {
    /// Scenarios, as `simulate` takes them; generated/TYPE/SEED[.TRAFFIC] among them.
    #[arg(required = true, value_name = "SCENARIO")]
    pub(super) scenarios: Vec<String>,
    #[command(flatten)]
    pub(super) data: DataArguments,
    /// Which files: nuplan writes a log for each scenario and a map for each map.
    #[arg(long, value_enum)]
    pub(super) format: ExportFormat,
    /// Folder for them; must be new or empty.
    #[arg(long, value_name = "FOLDER")]
    pub(super) out: PathBuf,
    /// Name of the map; without it maps are named by their content.
    #[arg(long, value_name = "NAME")]
    pub(super) location: Option<String>,
    /// UTM zone in which the scenarios are put, as an EPSG code.
    #[arg(long, value_name = "CODE", default_value_t = 32_611)]
    pub(super) epsg: u32,
    /// Easting and northing at which their origin is put, metres.
    #[arg(long, value_name = "METRES", num_args = 2, default_values_t = [664_000.0, 3_998_000.0], allow_negative_numbers = true)]
    pub(super) origin: Vec<f64>,
}

/// What `scenarios export` writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ExportFormat {
    /// nuPlan's log databases and map packages.
    Nuplan,
}

/// Subcommands of `models`.
#[derive(Debug, Subcommand)]
pub(super) enum ModelsCommand {
    /// List the described models: family, source, where their files are, size.
    List,
    /// Look at the files of models without reading the weights, and say all that is wrong.
    Check {
        /// Models as `--model` takes them [default: all that are described and on this machine].
        models: Vec<String>,
    },
    /// Download models of the hub.
    Fetch {
        /// Models as `--model` takes them.
        #[arg(required = true)]
        models: Vec<String>,
    },
    /// Write a model as GGUF, for a quicker start and for llama.cpp.
    Quantize(QuantizeArguments),
}

/// Flags of `models quantize`.
#[derive(Debug, Args)]
pub(super) struct QuantizeArguments {
    /// The model, as `--model` takes it.
    #[arg(value_name = "MODEL")]
    pub(super) source: String,
    /// How its weights are held: `f32`, `f16`, `q8_0`, `q6_k` or `q4_k`.
    #[arg(long, value_name = "KIND")]
    pub(super) to: WeightFormat,
    /// The file, called NAME.gguf; a LLaVA's vision tower goes beside it as mmproj-NAME.gguf.
    #[arg(long, value_name = "FILE")]
    pub(super) out: PathBuf,
    /// Replace files that are there.
    #[arg(long)]
    pub(super) force: bool,
}

/// Flags of `dataset`.
#[derive(Debug, Args)]
pub(super) struct DatasetArguments {
    /// Folder for the shards; an interrupted run goes on where it stopped.
    #[arg(long, value_name = "FOLDER")]
    pub(super) out: PathBuf,
    /// Labelled states to make for training; whole shards are made, so there may be more.
    #[arg(long, default_value_t = 20_000)]
    pub(super) states: usize,
    /// Labelled states to make for validation, from seeds of their own; likewise.
    #[arg(long, default_value_t = 2_000)]
    pub(super) validation: usize,
    /// Let PlanAgent with the configured model drive from state to state, so that the states are those that it reaches, and label
    /// those; for training only. Such shards may lie in the same folder as others.
    #[arg(long)]
    pub(super) driven: bool,
}

/// Flags of `experiment`.
#[derive(Debug, Args)]
pub(super) struct ExperimentArguments {
    /// Which one; all makes every one, and they share their drives.
    #[arg(value_name = "NAME", value_parser = experiment_name())]
    pub(super) name: String,
    /// Only 2 scenes of each type, and 14 recordings: a look, in minutes.
    #[arg(long)]
    pub(super) quick: bool,
    /// Suites to drive on, separated by commas: splits as simulate takes them, or recorded [default: the experiment's own].
    #[arg(long = "suite", value_name = "NAMES", value_delimiter = ',')]
    pub(super) suites: Vec<String>,
    /// What the suite recorded holds: recordings as simulate takes them [default: those in `$PLANAGENT_DATA`].
    #[arg(long = "scenario", value_name = "SCENARIO", num_args = 1..)]
    pub(super) scenarios: Vec<String>,
    #[command(flatten)]
    pub(super) data: DataArguments,
    /// Folder for results and drives; drives that lie there are not made again.
    #[arg(long, value_name = "FOLDER", default_value = "runs/experiments")]
    pub(super) out: PathBuf,
    /// Folder of a bench that has the times of models that cannot drive here.
    #[arg(long, value_name = "FOLDER")]
    pub(super) bench: Option<PathBuf>,
    /// Make drives that failed once more.
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

/// Takes the name of an experiment, or `all`.
fn experiment_name() -> PossibleValuesParser {
    PossibleValuesParser::new(study::NAMES.into_iter().chain([TOKENS, ALL_EXPERIMENTS]))
}

/// Flags of `bench`.
#[derive(Debug, Args)]
pub(super) struct BenchArguments {
    /// Models, as --model takes them [default: the configured one, unless --random-weights is given].
    #[arg(value_name = "MODEL")]
    pub(super) models: Vec<String>,
    /// Shapes of known models to be filled with random weights, separated by commas; nothing is downloaded. A wrong name lists
    /// them.
    #[arg(long, value_name = "SHAPES", value_delimiter = ',')]
    pub(super) random_weights: Vec<String>,
    /// Planning calls of each model that do not count.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(super) warm_up: usize,
    /// Planning calls of each model that count.
    #[arg(long, value_name = "N", default_value_t = 5)]
    pub(super) iterations: usize,
    /// Compare with another engine on the same GGUF files, the two taking turns.
    #[arg(long, value_name = "ENGINE", value_enum)]
    pub(super) vs: Option<OtherEngine>,
    /// Python interpreter that has the package llama-cpp-python [default: `$PLANAGENT_LLAMA_PYTHON`, else python3].
    #[arg(long, value_name = "FILE", requires = "vs")]
    pub(super) llama_python: Option<PathBuf>,
    /// Folder in which the GGUF files of random weights are kept for --vs [default: weights in the folder of the results].
    #[arg(long, value_name = "FOLDER", requires = "vs")]
    pub(super) weights: Option<PathBuf>,
    /// Folder for the results; must be new or empty [default: runs/bench-DATE].
    #[arg(long, value_name = "FOLDER", conflicts_with = "resume")]
    pub(super) out: Option<PathBuf>,
    /// Go on with the bench in this folder; models that are done are kept.
    #[arg(long, value_name = "FOLDER")]
    pub(super) resume: Option<PathBuf>,
}

/// What `bench` can compare with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum OtherEngine {
    /// llama.cpp, driven through llama-cpp-python's low-level interface.
    #[value(name = "llama.cpp")]
    LlamaCpp,
}
