//! The arguments of the command line.

mod ask;
mod card;
mod data;
mod memory;
mod model;
mod models;
mod results;
mod scenarios;
mod simulate;
mod studies;

pub(super) use ask::AskArguments;
pub(super) use card::CardArguments;
pub(super) use data::DataArguments;
pub(super) use memory::{FillArguments, MemoryCommand};
pub(super) use model::{ModelArguments, ModelFlags};
pub(super) use models::{ModelsCommand, QuantizeArguments};
pub(super) use results::{
    CompareArguments, MergeArguments, RenderArguments, ReportArguments, ServeArguments,
};
pub(super) use scenarios::{
    ExportArguments, ExportFormat, GenerateArguments, InteractiveArguments, ListArguments,
    ScenariosCommand, ShowArguments, StatisticsArguments, TwinArguments,
};
pub(super) use simulate::{PlanArguments, SimulateArguments};
pub(super) use studies::{
    ALL_STUDIES, BENCH_PROCESS, BenchArguments, BenchProcessArguments, DatasetArguments,
    DatasetKind, OtherEngine, StudyArguments,
};

use super::help;
use clap::{Args, Parser, Subcommand};
use clap_complete::Shell;
use std::path::PathBuf;

/// Name of the hidden subcommand in which the files of a model are tried.
pub(super) const TRIAL_PROCESS: &str = "trial-process";

/// Heading of the options that every command has.
const GLOBAL: &str = "Global options";

/// A driving agent that plans with a vision-language model, offline, on the CPU.
#[derive(Debug, Parser)]
#[command(name = "planagent", version = help::version(), max_term_width = 80, after_long_help = help::PROGRAM)]
pub(super) struct Arguments {
    #[command(subcommand)]
    pub(super) command: Command,
    #[command(flatten)]
    pub(super) global: GlobalArguments,
}

/// The options that every command has.
#[derive(Debug, Args)]
pub(super) struct GlobalArguments {
    /// Configuration file [default: planagent.toml here].
    ///
    /// By default planagent.toml in the working directory, if it exists.
    #[arg(long, global = true, value_name = "FILE", help_heading = GLOBAL, hide_short_help = true)]
    pub(super) config: Option<PathBuf>,
    /// Replace a setting, for example reflection.threshold=0.5.
    ///
    /// KEY is a key of planagent.toml with its section; VALUE is written as there, and quotes may
    /// be left out. May be given several times. `planagent config` lists all settings.
    #[arg(long, global = true, value_name = "KEY=VALUE", help_heading = GLOBAL)]
    pub(super) set: Vec<String>,
    /// Seed of all random numbers.
    // A configuration is TOML, whose integers have a sign.
    #[arg(
        long,
        global = true,
        help_heading = GLOBAL,
        hide_short_help = true,
        value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64)
    )]
    pub(super) seed: Option<u64>,
    /// Number of threads; 0 for one per core.
    #[arg(long, global = true, value_name = "N", help_heading = GLOBAL, hide_short_help = true)]
    pub(super) threads: Option<usize>,
    /// Print data on stdout as JSON.
    #[arg(long, global = true, help_heading = GLOBAL)]
    pub(super) json: bool,
    /// Print only errors on stderr.
    #[arg(long, short, global = true, help_heading = GLOBAL)]
    pub(super) quiet: bool,
    /// Print details on stderr, for example the weight formats of a model.
    #[arg(long, short, global = true, conflicts_with = "quiet", help_heading = GLOBAL, hide_short_help = true)]
    pub(super) verbose: bool,
}

/// Arguments of `config`.
#[derive(Debug, Args)]
pub(super) struct ConfigArguments {
    /// Print what each setting means above it.
    #[arg(long)]
    pub(super) explain: bool,
    /// Write planagent.toml here: every setting with its default and its meaning.
    ///
    /// A file that exists is kept, and the exit code is 2.
    #[arg(long, conflicts_with_all = ["explain", "json"])]
    pub(super) init: bool,
    #[command(flatten)]
    model: ModelArguments,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Simulate scenarios and score them with nuPlan's metrics.
    ///
    /// Every scenario is simulated with every planner in every challenge. The table goes to stdout,
    /// all else to a folder: scores, transcripts, replays, nuPlan's Parquet files. An interrupted
    /// run continues with --resume.
    #[command(after_long_help = help::SIMULATE)]
    Simulate(SimulateArguments),
    /// Run one planning call; show its input, answers, code and scores.
    #[command(after_long_help = help::PLAN)]
    Plan(PlanArguments),
    /// Put a question about the picture of a scene to the model.
    ///
    /// The answer goes to stdout as it is generated. The models of models/ other than nano answer
    /// in sentences.
    #[command(after_long_help = help::ASK)]
    Ask(AskArguments),
    /// Write an HTML page of runs: scores, histograms, replays.
    ///
    /// A replay has the transcript of its planning calls beside it.
    #[command(after_long_help = help::REPORT)]
    Report(ReportArguments),
    /// Serve the page of runs while they go on.
    ///
    /// The page shows each simulation when it is complete. The server listens on 127.0.0.1 only and
    /// changes no file; Ctrl-C ends it. Without RUN, the last run in runs/ is taken.
    #[command(after_long_help = help::SERVE)]
    Serve(ServeArguments),
    /// Write simulations of a run as films or pictures.
    ///
    /// Without SIMULATION, all simulations of the run are written to a folder. Without RUN, the
    /// last run in runs/ is taken.
    #[command(after_long_help = help::RENDER)]
    Render(RenderArguments),
    /// Compare two runs on the scenes that both have.
    ///
    /// The difference is taken scene by scene; its interval is a bootstrap over scenes. Planners
    /// that both runs have are compared, or the only ones.
    #[command(after_long_help = help::COMPARE)]
    Compare(CompareArguments),
    /// Merge the shards of a run.
    ///
    /// The result is the run that one process would have made, apart from measured times. Settings,
    /// versions and scenarios of the shards must be equal.
    #[command(after_long_help = help::MERGE)]
    Merge(MergeArguments),
    /// List, show and generate scenarios.
    #[command(subcommand, after_long_help = help::SCENARIOS)]
    Scenarios(ScenariosCommand),
    /// List, show, check, fetch and quantize models.
    #[command(subcommand, after_long_help = help::MODELS)]
    Models(ModelsCommand),
    /// Write labeled states for training.
    ///
    /// A state is a BEV image and the three rounds with their answers.
    #[command(after_long_help = help::DATASET)]
    Dataset(DatasetArguments),
    /// Fill the memory of a language agent.
    #[command(subcommand, after_long_help = help::MEMORY)]
    Memory(MemoryCommand),
    /// Reproduce the paper's tables and figures, and run further studies.
    #[command(after_long_help = help::STUDY)]
    Study(StudyArguments),
    /// Say on one page what a model is worth as a source of codes.
    ///
    /// Scores beside those of random, fixed and grid codes, the cost of a call, whether probable
    /// codes are good ones, whether picture and reasoning matter: as Markdown, JSON and HTML.
    #[command(after_long_help = help::CARD)]
    Card(CardArguments),
    /// Measure planning calls of local models, also against others.
    #[command(after_long_help = help::BENCH)]
    Bench(BenchArguments),
    /// Print every setting with its value and its origin.
    ///
    /// The output is a configuration file for --config.
    #[command(after_long_help = help::CONFIG)]
    Config(ConfigArguments),
    /// Print a script that completes commands in a shell.
    ///
    /// It asks the program at each press of Tab, and completes commands, options and paths, and the
    /// names of planners, splits, scenario types, studies, models, prompt sets, challenges and
    /// settings. Models are those of the working directory.
    #[command(after_long_help = help::COMPLETIONS)]
    Completions {
        /// The shell.
        #[arg(value_enum)]
        shell: Shell,
    },
    /// The measuring process of `bench`: requests on stdin, replies on stdout.
    #[command(name = BENCH_PROCESS, hide = true)]
    BenchProcess(BenchProcessArguments),
    /// The process that tries the files of a model: a request on stdin, what it tries and the
    /// outcome on stdout.
    #[command(name = TRIAL_PROCESS, hide = true)]
    TrialProcess,
}

impl Command {
    /// The options of the command about its model.
    pub(super) fn model_flags(&self) -> ModelFlags {
        match self {
            Self::Simulate(flags) => flags.model.flags(),
            Self::Plan(flags) => flags.model.flags(),
            Self::Ask(flags) => flags.model.flags(),
            Self::Dataset(flags) => flags.model.flags(),
            Self::Memory(MemoryCommand::Fill(flags)) => flags.model.flags(),
            Self::Study(flags) => flags.model.flags(),
            Self::Card(flags) => flags.model.flags(),
            Self::Bench(flags) => flags.model.flags(),
            Self::Models(command) => command.flags(),
            Self::Config(flags) => flags.model.flags(),
            Self::BenchProcess(flags) => flags.model.flags(),
            Self::Report(_)
            | Self::Serve(_)
            | Self::Render(_)
            | Self::Compare(_)
            | Self::Merge(_)
            | Self::Scenarios(_)
            | Self::TrialProcess
            | Self::Completions { .. } => ModelFlags::default(),
        }
    }
}
