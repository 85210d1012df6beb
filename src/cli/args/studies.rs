//! `study`, `bench` and `dataset`.

use super::data::DataArguments;
use super::model::ModelArguments;
use crate::help;
use crate::words::{count, path_word};
use anyhow::bail;
use clap::builder::RangedU64ValueParser;
use clap::{Args, ValueEnum};
use planagent_lab::bench::protocol::Precision;
#[cfg(feature = "learned")]
use planagent_lab::dataset::imitation::ImitationPlanner;
use planagent_lab::dataset::taught_agents;
use planagent_lab::study_runs::StudiesRequest;
use planagent_planners::all_planners;
use planagent_runs::worker::suite::RECORDED;
use std::num::NonZeroU32;
use std::path::PathBuf;

/// Word for every study.
pub(crate) const ALL_STUDIES: &str = "all";

/// Name of the hidden subcommand in which `bench` measures.
pub(crate) const BENCH_PROCESS: &str = "bench-process";

/// Arguments of `dataset`.
#[derive(Debug, Args)]
pub(crate) struct DatasetArguments {
    /// What is trained: nano (labels), any language model (messages), or a learned planner
    /// (imitation).
    ///
    /// labels: images and planner codes, for nano's trainer. messages: chats of all rounds with
    /// PNG files, lessons, preferences, and all tried codes, as JSON lines for TRL, LLaMA-Factory and
    /// ms-swift. imitation: the features of a learned planner and what the logged driver did, a
    /// sample a second, as safetensors.
    #[arg(long = "for", value_name = "KIND", value_enum, default_value_t = DatasetKind::Labels)]
    pub(crate) kind: DatasetKind,
    /// With --for imitation: the learned planner [default: plantf].
    #[cfg(feature = "learned")]
    #[arg(long, value_name = "NAME", value_parser = imitation_planner(), hide_short_help = true)]
    pub(crate) planner: Option<String>,
    /// With --for imitation: logs, as `simulate` takes them [default: generated ones of training
    /// seeds].
    #[cfg(feature = "learned")]
    #[arg(long = "scenario", value_name = "SCENARIO", num_args = 1.., value_parser = path_word(), hide_short_help = true)]
    pub(crate) scenarios: Vec<String>,
    #[cfg(feature = "learned")]
    #[command(flatten)]
    pub(crate) data: DataArguments,
    /// Folder for the shards; an interrupted run continues where it stopped.
    #[arg(long, value_name = "FOLDER")]
    pub(crate) out: PathBuf,
    /// Labeled states for training.
    ///
    /// There may be more, because shards are written whole.
    #[arg(long, default_value_t = 20_000)]
    pub(crate) states: usize,
    /// Labeled states for validation, from seeds of their own.
    #[arg(long, default_value_t = 2_000)]
    pub(crate) validation: usize,
    /// Share of the scenarios that are modified, from 0 to 1: interPlan's kinds, as far as one
    /// fits.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = share, hide_short_help = true)]
    pub(crate) modified: f64,
    /// With --for messages: conversations of other agents on the same states, beside those of
    /// PlanAgent; separated by commas.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = taught_agent(), hide_short_help = true)]
    pub(crate) agents: Vec<String>,
    /// Pairs of text twins for training: two states with the same prompts, other pictures and other
    /// best codes.
    ///
    /// Their shards lie beside the others. The two states of a pair follow each other and have its
    /// name in `twin`.
    #[arg(
        long,
        value_name = "PAIRS",
        default_value_t = 0,
        conflicts_with = "driven",
        hide_short_help = true
    )]
    pub(crate) twins: usize,
    /// Pairs of text twins for validation.
    #[arg(
        long,
        value_name = "PAIRS",
        default_value_t = 0,
        conflicts_with = "driven",
        hide_short_help = true
    )]
    pub(crate) validation_twins: usize,
    /// Label the states that PlanAgent reaches with the model in control.
    ///
    /// For training only. These shards may lie in the same folder as others.
    #[arg(long)]
    pub(crate) driven: bool,
    #[command(flatten)]
    pub(super) model: ModelArguments,
}

/// A share from 0 to 1.
fn share(text: &str) -> Result<f64, String> {
    let share: f64 = text
        .parse()
        .map_err(|_| format!("'{text}' is not a number"))?;
    if (0.0..=1.0).contains(&share) {
        Ok(share)
    } else {
        Err(format!("{share} must be from 0 to 1"))
    }
}

/// What a dataset is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum DatasetKind {
    Labels,
    Messages,
    Imitation,
}

#[cfg(feature = "learned")]
fn imitation_planner() -> clap::builder::PossibleValuesParser {
    ImitationPlanner::ALL.map(ImitationPlanner::name).into()
}

fn taught_agent() -> clap::builder::PossibleValuesParser {
    taught_agents().collect::<Vec<_>>().into()
}

/// Arguments of `study`.
#[derive(Debug, Args)]
pub(crate) struct StudyArguments {
    #[arg(value_name = "NAME", help = help::studies_short(), long_help = help::studies())]
    pub(crate) name: String,
    /// Only 2 scenes of each type and 14 recordings: a first look, in minutes.
    #[arg(long)]
    pub(crate) quick: bool,
    /// Only N scenes of a suite, evenly from the types.
    ///
    /// The first of each type, then the second of each, and so on.
    #[arg(long, value_name = "N", value_parser = count, conflicts_with = "quick")]
    pub(crate) limit: Option<usize>,
    /// Suites, separated by commas [default: those of the study].
    ///
    /// Splits as `simulate` takes them, or recorded, the recordings of --scenario.
    #[arg(long = "suite", value_name = "NAMES", value_delimiter = ',')]
    pub(crate) suites: Vec<String>,
    /// Scenarios of the suite recorded, as `simulate` takes them [default: the recordings in
    /// `$PLANAGENT_DATA`].
    #[arg(long = "scenario", value_name = "SCENARIO", num_args = 1.., value_parser = path_word())]
    pub(crate) scenarios: Vec<String>,
    #[command(flatten)]
    pub(crate) data: DataArguments,
    /// Folder for results and runs; completed simulations in it are not repeated.
    #[arg(long, value_name = "FOLDER", default_value = "runs/studies")]
    pub(crate) out: PathBuf,
    /// Folder of a bench with the times of models whose weights are not on this machine.
    #[arg(long, value_name = "FOLDER", hide_short_help = true)]
    pub(crate) bench: Option<PathBuf>,
    /// Repeat failed simulations.
    #[arg(long, hide_short_help = true)]
    pub(crate) retry_failed: bool,
    /// Print the scores on stdout as CSV.
    #[arg(long, conflicts_with = "json")]
    pub(crate) csv: bool,
    #[command(flatten)]
    pub(super) model: ModelArguments,
}

impl StudyArguments {
    pub(crate) fn request(&self) -> anyhow::Result<StudiesRequest> {
        let modified = |suite: &String| match suite.as_str() {
            // The words of its recordings carry the modification.
            RECORDED => Ok(suite.clone()),
            _ => self
                .data
                .modified(std::slice::from_ref(suite))
                .map(|words| words.concat()),
        };
        let scenarios = self.data.modified(&self.scenarios)?;
        if self.data.modifies() && self.suites.is_empty() && scenarios.is_empty() {
            bail!("--modify: name the suites by --suite, or recordings by --scenario");
        }
        Ok(StudiesRequest {
            suites: self
                .suites
                .iter()
                .map(modified)
                .collect::<anyhow::Result<_>>()?,
            scenarios,
            registry: all_planners(),
            roots: self.data.roots(),
            out: self.out.clone(),
            bench: self.bench.clone(),
            quick: self.quick,
            limit: self.limit,
            retry_failed: self.retry_failed,
        })
    }
}

/// Arguments of `bench`.
#[derive(Debug, Args)]
pub(crate) struct BenchArguments {
    /// Models, as `--model` takes them [default: that of --model].
    ///
    /// With --random-weights, none by default.
    #[arg(value_name = "MODEL")]
    pub(crate) models: Vec<String>,
    /// Shapes of known models to fill with random weights, separated by commas.
    ///
    /// Nothing is downloaded. A wrong name lists the shapes.
    #[arg(
        long,
        value_name = "SHAPES",
        value_delimiter = ',',
        hide_short_help = true
    )]
    pub(crate) random_weights: Vec<String>,
    /// Planning calls of each model before the measurement.
    #[arg(long, value_name = "N", default_value_t = 1, hide_short_help = true, value_parser = calls())]
    pub(crate) warm_up: usize,
    /// Measured planning calls of each model.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = calls())]
    pub(crate) iterations: usize,
    /// Prompt sets whose planning calls are measured, separated by commas [default: that of the
    /// model].
    ///
    /// A call with brief has one attempt, with paper and compact two.
    #[arg(
        long,
        value_name = "SETS",
        value_delimiter = ',',
        conflicts_with = "prompt_set",
        hide_short_help = true
    )]
    pub(crate) calls: Vec<String>,
    /// Sides of the drawn image, pixels, separated by commas [default: that of the model].
    ///
    /// Only towers that take any size, those of Qwen-VL, have a choice. A larger image has more
    /// tokens.
    #[arg(
        long,
        value_name = "PIXELS",
        value_delimiter = ',',
        hide_short_help = true
    )]
    pub(crate) image_size: Vec<NonZeroU32>,
    /// Also measure calls with drafts of four tokens, of which a quarter, half and three quarters
    /// are accepted.
    #[arg(long, hide_short_help = true)]
    pub(crate) speculation: bool,
    /// Compare with another engine on the same files, in alternation.
    #[arg(long, value_name = "ENGINE", value_enum)]
    pub(crate) vs: Option<OtherEngine>,
    /// Python interpreter with the package llama-cpp-python [default: `$PLANAGENT_LLAMA_PYTHON`,
    /// else python3].
    #[arg(long, value_name = "FILE", requires = "vs", hide_short_help = true)]
    pub(crate) llama_python: Option<PathBuf>,
    /// Python interpreter with the packages openvino, optimum-intel and nncf [default:
    /// `$PLANAGENT_OPENVINO_PYTHON`, else python3].
    #[arg(long, value_name = "FILE", requires = "vs", hide_short_help = true)]
    pub(crate) openvino_python: Option<PathBuf>,
    /// Precision of OpenVINO's decoders: `f32`, `bf16`, `int8` or `int4`.
    ///
    /// With `f32`, its arithmetic is exact, so that logits and pictures can be compared.
    #[arg(
        long,
        value_name = "PRECISION",
        requires = "vs",
        default_value_t = Precision::Int8,
        hide_short_help = true
    )]
    pub(crate) openvino_weights: Precision,
    /// Precision of OpenVINO's vision towers: `f32`, `bf16` or `int8` [default: bf16, and f32 beside
    /// decoders in f32].
    #[arg(
        long,
        value_name = "PRECISION",
        requires = "vs",
        hide_short_help = true
    )]
    pub(crate) openvino_tower: Option<Precision>,
    /// Folder for the files of weights that --vs writes [default: weights in the folder of the
    /// results].
    #[arg(long, value_name = "FOLDER", requires = "vs", hide_short_help = true)]
    pub(crate) weights: Option<PathBuf>,
    /// Folder for the results, new or empty [default: runs/bench-DATE].
    #[arg(long, value_name = "FOLDER", conflicts_with = "resume")]
    pub(crate) out: Option<PathBuf>,
    /// Resume the bench in this folder; measured models stay.
    #[arg(long, value_name = "FOLDER")]
    pub(crate) resume: Option<PathBuf>,
    #[command(flatten)]
    pub(super) model: ModelArguments,
}

/// Engines that `bench` compares with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum OtherEngine {
    /// llama.cpp through the low-level interface of llama-cpp-python.
    #[value(name = "llama.cpp")]
    LlamaCpp,
    /// OpenVINO's runtime with models that optimum-intel exports: llava, smolvlm, qwen3-vl, and
    /// language models.
    #[value(name = "openvino")]
    OpenVino,
    /// candle-transformers' own llama, qwen2, qwen3 and gemma3, for language models in folders and
    /// GGUF files.
    #[value(name = "candle")]
    Candle,
}

/// Arguments of the process in which `bench` measures.
#[derive(Debug, Args)]
pub(crate) struct BenchProcessArguments {
    /// Compute with candle's decoders.
    #[arg(long)]
    pub(crate) candle: bool,
    #[command(flatten)]
    pub(super) model: ModelArguments,
}

/// Maximum number of planning calls of a benchmark: days of the smallest model.
const MAX_CALLS: u64 = 1_000_000;

/// Reads a number of planning calls.
fn calls() -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(..=MAX_CALLS)
}
