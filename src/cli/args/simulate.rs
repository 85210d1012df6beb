//! `simulate` and `plan`.

use super::data::{DataArguments, SplitArguments};
use super::model::ModelArguments;
use crate::help;
use crate::picture::{PictureFile, picture_file};
use crate::words::{count, path_word, planner_words, shard_word};
use anyhow::Context;
use clap::Args;
use planagent_agent::planner::DEFAULT_EXEC_TIMEOUT;
use planagent_runs::runner::{Request, Shard};
use planagent_runs::worker::suite::Suite;
use std::path::PathBuf;
use std::time::Duration;

/// Arguments of `simulate`.
#[derive(Debug, Args)]
pub(crate) struct SimulateArguments {
    /// Scenarios: files, folders, or generated/TYPE/SEED[.TRAFFIC].
    ///
    /// TFRecord files of Waymo Open Motion, nuPlan logs (LOG.db, or one scenario as LOG.db#TOKEN),
    /// Argoverse 2 logs, folders of these, or generated/TYPE/SEED[.TRAFFIC]. The default is one
    /// generated scenario.
    #[arg(long = "scenario", value_name = "SCENARIO", num_args = 1.., value_parser = path_word())]
    pub(crate) scenarios: Vec<String>,
    #[command(flatten)]
    pub(crate) split: SplitArguments,
    #[command(flatten)]
    pub(crate) sample: SampleArguments,
    #[arg(long, value_name = "NAMES", help = help::planners_short(), long_help = help::planners())]
    pub(crate) planner: Vec<String>,
    /// The checkpoint of a learned planner, or PLANNER=FILE for each of several.
    ///
    /// A Lightning .ckpt, a .pth or .safetensors file; its names and shapes must be those of the
    /// planner's authors. The setting learned.PLANNER says the same.
    #[arg(long, value_name = "FILE", value_parser = path_word(), hide_short_help = true)]
    pub(crate) checkpoint: Vec<String>,
    /// With a command as planner or agents: seconds that it may take for a step.
    #[arg(long, value_name = "SECONDS", default_value_t = DEFAULT_EXEC_TIMEOUT.as_secs_f64(), hide_short_help = true)]
    exec_timeout: f64,
    /// Challenges: nonreactive, reactive, both or open-loop [default: nonreactive].
    ///
    /// Separated by commas. nonreactive: agents replay the log. reactive: agents are controlled by
    /// IDM. both: these two. open-loop: plans are compared with the log. The default is
    /// nonreactive.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub(crate) challenge: Vec<String>,
    /// A command that controls the other agents: exec:COMMAND or NAME=exec:COMMAND.
    ///
    /// The closed loop with these agents is no challenge of nuPlan's: NAME stands in its place in
    /// tables and files. Without --challenge, it alone is simulated. --exec-timeout bounds each
    /// step.
    #[arg(long, value_name = "COMMAND", hide_short_help = true)]
    agents: Option<String>,
    /// Folder for the results, new or empty [default: the next free runs/NNNN].
    #[arg(long, value_name = "FOLDER", conflicts_with = "resume")]
    pub(crate) out: Option<PathBuf>,
    /// Resume the run in this folder with its own settings; completed simulations stay.
    #[arg(long, value_name = "FOLDER")]
    pub(crate) resume: Option<PathBuf>,
    /// With --resume: repeat failed simulations.
    #[arg(long, requires = "resume", hide_short_help = true)]
    pub(crate) retry_failed: bool,
    /// With --resume: go on although prompts, model files or recordings changed.
    ///
    /// The manifest then lists the changes. Without this option such a run is refused, because its
    /// table would mix two configurations.
    #[arg(long, requires = "resume", hide_short_help = true)]
    pub(crate) accept_changes: bool,
    /// Print the simulations on stdout as CSV.
    #[arg(long, conflicts_with = "json")]
    pub(crate) csv: bool,
    #[command(flatten)]
    pub(super) model: ModelArguments,
}

/// Which of the scenarios are simulated.
#[derive(Debug, Args)]
pub(crate) struct SampleArguments {
    /// Only scenarios of these types.
    ///
    /// Separated by commas. Without --scenario and --split, of the split generated.
    #[arg(long = "type", value_name = "TYPES", value_delimiter = ',')]
    types: Vec<String>,
    /// Take the scenarios in a random order, which --seed draws.
    #[arg(long, hide_short_help = true)]
    shuffle: bool,
    /// Only N scenarios, evenly from the types.
    ///
    /// The first of each type, then the second of each, and so on. With --shuffle, random ones.
    #[arg(long, value_name = "N", value_parser = count)]
    limit: Option<usize>,
    /// Simulate one of N parts of the run, for example 2/8; `planagent merge` joins them.
    ///
    /// A scenario is always in the same part of N, whatever else is simulated. `auto` takes the
    /// part from `SLURM_ARRAY_TASK_ID` and `SLURM_ARRAY_TASK_COUNT`, else from `NODE_RANK` and
    /// `NUM_NODES`.
    #[arg(long, value_name = "I/N", value_parser = shard_word, hide_short_help = true)]
    shard: Option<Shard>,
}

impl SampleArguments {
    /// Whether it selects from what words and splits name.
    fn draws(&self) -> bool {
        !self.types.is_empty() || self.shuffle || self.limit.is_some()
    }
}

impl SimulateArguments {
    pub(crate) fn request(&self) -> anyhow::Result<Request> {
        let exec_timeout = Duration::try_from_secs_f64(self.exec_timeout)
            .ok()
            .filter(|time| !time.is_zero());
        let exec_timeout = exec_timeout.with_context(|| {
            format!(
                "--exec-timeout is {}; it must be a number greater than 0",
                self.exec_timeout
            )
        })?;
        let data = &self.split.data;
        let mut splits = data.modified(&self.split.splits)?;
        if data.modifies() && splits.is_empty() && self.scenarios.is_empty() && self.sample.draws()
        {
            // A draw without --scenario and --split is one from this suite.
            splits = data.modified(&[Suite::DEMONSTRATION.name.to_owned()])?;
        }
        let names_some = !splits.is_empty() || self.sample.draws() || self.resume.is_some();
        let scenarios = if names_some {
            data.modified(&self.scenarios)?
        } else {
            data.modified_or_default(&self.scenarios)?
        };
        Ok(Request {
            scenarios,
            splits,
            types: self.sample.types.clone(),
            shuffle: self.sample.shuffle,
            limit: self.sample.limit,
            shard: self.sample.shard,
            planners: planner_words(&self.planner),
            exec_timeout,
            challenges: self.challenge.clone(),
            agents: self.agents.clone(),
            roots: self.split.data.roots(),
            retry_failed: self.retry_failed,
            accept_changes: self.accept_changes,
            ..Request::default()
        })
    }
}

/// Arguments of `plan`.
#[derive(Debug, Args)]
pub(crate) struct PlanArguments {
    /// The scenario, as `simulate` takes it [default: one generated scenario].
    #[arg(long, value_name = "SCENARIO", value_parser = path_word())]
    pub(crate) scenario: Option<String>,
    #[command(flatten)]
    pub(crate) data: DataArguments,
    /// Seconds after the start of the window.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub(crate) at: f64,
    /// Judge this planner code, quoted as one word, instead of asking a model.
    ///
    /// Reflection scores it as it scores the agent's own, with the settings of the section
    /// reflection. Prints every part of the score, and whether the code would be executed. No model
    /// is loaded.
    #[arg(long, value_name = "CODE", conflicts_with_all = ["model", "prompt_set", "adapter", "quantize", "offline", "context", "ignore_memory", "trust_model"])]
    pub(crate) code: Option<String>,
    /// Write a picture of the call to this file, a .png or .jpg: the scene with its plans, and the
    /// model's own picture beside it. The model's picture as the model sees it goes to
    /// NAME.model.EXTENSION.
    #[arg(long, value_name = "FILE", value_parser = picture_file())]
    pub(crate) image: Option<PictureFile>,
    #[command(flatten)]
    pub(super) model: ModelArguments,
}
