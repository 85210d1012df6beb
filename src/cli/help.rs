//! Help texts: what the registries hold, and examples.

use super::args::ALL_STUDIES;
use planagent_agent::planner::PlannerName;
use planagent_lab::study;
use planagent_lab::study_runs::{TOKENS, TWINS};
use planagent_planners::all_planners;
use planagent_runs::runner::build_commit;
use planagent_runs::worker::interactive::NAMES as INTERACTIVE;
use planagent_runs::worker::suite::Suite;
use planagent_scenario::{DataRoots, Readers};
use std::sync::LazyLock;

/// Version of the program, with the commit of the build.
pub(super) fn version() -> &'static str {
    static VERSION: LazyLock<String> = LazyLock::new(|| {
        let version = env!("CARGO_PKG_VERSION");
        build_commit().map_or_else(
            || version.to_owned(),
            |commit| format!("{version} ({commit})"),
        )
    });
    &VERSION
}

pub(super) fn planners_short() -> String {
    format!(
        "Planners, separated by commas, or exec:COMMAND [default: {}]",
        PlannerName::PLAN_AGENT
    )
}

pub(super) fn planners() -> String {
    let registry = all_planners();
    let names: Vec<&str> = registry
        .entries()
        .iter()
        .map(|entry| entry.name.as_str())
        .collect();
    format!(
        "Planners, separated by commas: {} [default: {}]. Or a command of your own, as exec:COMMAND or NAME=exec:COMMAND; it \
         takes the rest of the value",
        names.join(", "),
        PlannerName::PLAN_AGENT
    )
}

pub(super) const SPLITS_SHORT: &str = "A named list of scenarios, or a nuPlan filter FILE.yaml";

pub(super) fn splits() -> String {
    let suite = |suite: Suite| {
        let specs = suite.specs();
        let types = specs
            .chunk_by(|a, b| a.scenario_type == b.scenario_type)
            .count();
        format!(
            "{} ({types} types x {})",
            suite.name,
            specs.len() / types.max(1)
        )
    };
    let known = Readers::new(&DataRoots::default())
        .splits()
        .into_iter()
        .map(str::to_owned);
    let names: Vec<String> = known
        .chain(Suite::ALL.map(suite))
        .chain(INTERACTIVE.map(str::to_owned))
        .collect();
    format!(
        "List of scenarios: {}; or a nuPlan scenario filter FILE.yaml",
        names.join(", ")
    )
}

pub(super) fn studies_short() -> String {
    format!("A study, {TOKENS}, {TWINS}, {ALL_STUDIES}, or the path of a study FILE.toml")
}

pub(super) fn studies() -> String {
    let names: Vec<&str> = study::names().chain([TOKENS, TWINS]).collect();
    format!(
        "{}; {ALL_STUDIES} for all of these; or the path of a study FILE.toml",
        names.join(", ")
    )
}

pub(super) const PROGRAM: &str = "\
Examples:
  planagent simulate
  planagent report --open
  planagent simulate --split generated --limit 28 --planner plan-agent,idm
  planagent study main --quick

Exit codes: 0 success; 1 a simulation, call or check failed; 2 wrong input.";

pub(super) const SIMULATE: &str = "\
Examples:
  One generated scenario, with the model that ships:
    planagent simulate
  Two scenarios of each of 14 types, two planners, both closed-loop challenges:
    planagent simulate --split generated-test14 --limit 28 \\
      --planner plan-agent,pdm-closed --challenge both
  Random scenarios of two types:
    planagent simulate --type changing_lane,starting_left_turn --shuffle \\
      --limit 6
  Recordings, and another threshold of Reflection:
    planagent simulate --scenario folder/ --set reflection.threshold=0.5
  A planner of your own, in any language:
    planagent simulate --planner \"exec:python3 examples/exec_planner.py\"
  The second of eight parts of a run, for a cluster:
    planagent simulate --split generated-test14 --shard 2/8 --out runs/part-2
  The part of a SLURM array that its task has:
    planagent simulate --split generated-test14 --shard auto \\
      --out runs/part-$SLURM_ARRAY_TASK_ID";

pub(super) const PLAN: &str = "\
Examples:
  planagent plan --scenario generated/changing_lane/3 --at 3 --image bev.png
  planagent plan --model local-server --json
  Why would Reflection refuse this code?
    planagent plan --code 'Generate_IDM_Planner(ego_lane, None, 13, 2, 3)'";

pub(super) const ASK: &str = "\
Examples:
  planagent ask \"What blocks the ego's lane?\" --model llava-1.5-7b
  planagent ask \"Is the light red?\" --scenario generated/changing_lane/3 \\
    --at 3 --model local-server --image scene.png";

pub(super) const REPORT: &str = "\
Examples:
  planagent report --open
  planagent report runs/0001 runs/0002 --out comparison.html";

pub(super) const SERVE: &str = "\
Examples:
  planagent serve --open
  planagent serve runs/0001 runs/0002 --port 0";

pub(super) const RENDER: &str = "\
Examples:
  All simulations of the last run, to a folder:
    planagent render --gif films/
  One simulation of the last run, by its number:
    planagent render 3 --gif film.gif
  A sheet of eight frames:
    planagent render runs/0001 generated/changing_lane/3 --png sheet.png";

pub(super) const COMPARE: &str = "\
Examples:
  planagent compare runs/0001 runs/0002
  planagent compare runs/0001 runs/0001 --planner pdm-closed,plan-agent
  planagent compare runs/0001 runs/0002 --csv > scenes.csv";

pub(super) const MERGE: &str = "\
Example:
  planagent simulate --split generated --shard 1/2 --out runs/part-1
  planagent simulate --split generated --shard 2/2 --out runs/part-2
  planagent merge runs/part-1 runs/part-2 --out runs/whole";

pub(super) const DATASET: &str = "\
Example:
  planagent dataset --out data --states 300 --validation 50";

pub(super) const MEMORY: &str = "\
Examples:
  planagent memory fill agent-driver --out agent_driver.json --scenarios 40
  planagent simulate --planner agent-driver --set language_agents.agent_driver.memory=agent_driver.json";

pub(super) const STUDY: &str = "\
Examples:
  planagent study main --quick
  planagent study environment --suite generated-test14
  planagent study main --suite recorded --scenario folder/of/recordings
  planagent study my_study.toml";

pub(super) const CARD: &str = "\
Examples:
  planagent card
  planagent card --model path/to/model.gguf --prompt-set brief --limit 14
  planagent card --latency-of runs/cards/nano --out again";

pub(super) const BENCH: &str = "\
Examples:
  planagent bench
  planagent bench nano path/to/model.gguf --iterations 10
  planagent bench --random-weights llava-1.5-7b --quantize q4_k";

pub(super) const CONFIG: &str = "\
Examples:
  planagent config
  planagent config --explain
  planagent config --init
  planagent config --set environment.bev=false > without_bev.toml";

pub(super) const COMPLETIONS: &str = "\
Examples:
  echo 'source <(planagent completions bash)' >> ~/.bashrc
  echo 'source <(planagent completions zsh)' >> ~/.zshrc
  echo 'planagent completions fish | source' >> ~/.config/fish/config.fish";

pub(super) const MODELS: &str = "\
Examples:
  planagent models list
  planagent models check nano";

pub(super) const MODELS_LIST: &str = "\
Examples:
  planagent models list
  planagent models list --csv > models.csv";

pub(super) const SCENARIOS: &str = "\
Examples:
  planagent scenarios list
  planagent scenarios show generated/changing_lane/3";

pub(super) const SCENARIOS_INTERACTIVE: &str = "\
Examples:
  planagent scenarios interactive --count 2
  planagent scenarios interactive --recordings folder/of/data";

pub(super) const SCENARIOS_TWINS: &str = "\
Example:
  planagent scenarios twins --count 2";

pub(super) const SCENARIOS_STATISTICS: &str = "\
Examples:
  planagent scenarios statistics generated folder/of/recordings
  planagent scenarios statistics generated a/folder,b/folder \\
    --figure statistics.svg";

pub(super) const SCENARIOS_HARD: &str = "\
Example:
  planagent simulate --split generated-test14-candidates \\
    --planner pdm-closed --out runs/candidates
  planagent scenarios hard runs/candidates";

pub(super) const MODELS_CHECK: &str = "\
Examples:
  planagent models check
  planagent models check folder/of/model --quantize q4_k";

pub(super) const MODELS_SHOW: &str = "\
Examples:
  planagent models show smolvlm2-500m
  planagent models show folder/of/model --json";

pub(super) const MODELS_FETCH: &str = "\
Example:
  planagent models fetch llava-hf/llava-1.5-7b-hf";

pub(super) const MODELS_FAMILIES: &str = "\
Examples:
  planagent models families
  planagent models families --markdown";

pub(super) const MODELS_QUANTIZE: &str = "\
Example:
  planagent models quantize llava-1.5-7b --to q4_k --out llava-1.5-7b.gguf";

pub(super) const SCENARIOS_LIST: &str = "\
Examples:
  planagent scenarios list
  planagent scenarios list folder/of/recordings
  planagent scenarios list --split generated-test14-hard --csv";

pub(super) const SCENARIOS_SHOW: &str = "\
Example:
  planagent scenarios show generated/changing_lane/3 --image scene.png";

pub(super) const SCENARIOS_GENERATE: &str = "\
Example:
  planagent scenarios generate --type changing_lane --from 100 --count 20";

pub(super) const SCENARIOS_EXPORT: &str = "\
Example:
  planagent scenarios export generated/changing_lane/3 --format nuplan \\
    --out data";
