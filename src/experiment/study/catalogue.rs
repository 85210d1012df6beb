//! The experiments that there are.

use super::paper::{self, Published};
use super::{Column, Figure, NO, Rows, Study, Variant, YES};
use crate::experiment::suite::{RECORDED, Suite};
use crate::planner::PlannerName;

const GENERATED_14: &str = Suite::GENERATED_14.name;
const HARD: &str = Suite::GENERATED_14_HARD.name;

/// Their names, in the order in which `all` makes them.
pub const NAMES: [&str; 11] = [
    "main",
    "scenario-types",
    "environment",
    "reasoning",
    "interval",
    "mllm",
    "controls",
    "inputs",
    "execution",
    "gate",
    "latency-aware",
];

/// All experiments.
pub fn all() -> Vec<Study> {
    vec![
        main(),
        scenario_types(),
        environment(),
        reasoning(),
        interval(),
        mllm(),
        controls(),
        inputs(),
        execution(),
        gate(),
        latency_aware(),
    ]
}

/// The experiment of a name.
pub fn named(name: &str) -> Option<Study> {
    all().into_iter().find(|study| study.name == name)
}

/// A planner as it is configured.
const fn planner(labels: &'static [&'static str], planner: PlannerName, published: Published) -> Variant {
    Variant { labels, planner, settings: "", published, x: None }
}

/// PlanAgent with settings of its own, at a place on the axis of a figure.
fn agent_at(labels: &'static [&'static str], settings: &'static str, published: Published, x: f64) -> Variant {
    Variant { x: Some(x), ..agent(labels, settings, published) }
}

/// PlanAgent with settings of its own.
const fn agent(labels: &'static [&'static str], settings: &'static str, published: Published) -> Variant {
    Variant { settings, ..planner(labels, PlannerName::PLAN_AGENT, published) }
}

const PLAN_AGENT: Variant = planner(&["plan-agent"], PlannerName::PLAN_AGENT, paper::PLAN_AGENT);
/// PlanAgent as the paper has it: one λ for all planners, the last planner drives after `max_exec` refusals, and a planner drives as it was written.
const AS_IN_THE_PAPER: &str =
    "reflection = { lane_change_threshold = 0.0, after_max_exec = 'last', monitoring = false }";
const RANDOM_CODE: Variant = planner(&["random-code"], PlannerName::new("random-code"), Published::NOTHING);
const FIXED_CODE: Variant = planner(&["fixed-code"], PlannerName::new("fixed-code"), Published::NOTHING);
const GRID_CODE: Variant = planner(&["grid-code"], PlannerName::new("grid-code"), Published::NOTHING);
const PDM_CLOSED: Variant = planner(&["pdm-closed"], PlannerName::PDM_CLOSED, paper::PDM_CLOSED);

fn main() -> Study {
    Study {
        name: "main",
        title: "PlanAgent beside rule-based planners and the recorded driver",
        paper: Some("comparison with competitive methods"),
        labels: &["planner"],
        variants: vec![
            planner(&["log-replay"], PlannerName::new("log-replay"), paper::LOG_REPLAY),
            planner(&["idm"], PlannerName::new("idm"), paper::IDM),
            PDM_CLOSED,
            planner(&["llm-assist-unc"], PlannerName::new("llm-assist-unc"), paper::LLM_ASSIST_UNC),
            planner(&["llm-assist-par"], PlannerName::new("llm-assist-par"), paper::LLM_ASSIST_PAR),
            RANDOM_CODE,
            FIXED_CODE,
            GRID_CODE,
            agent(&["plan-agent (paper)"], AS_IN_THE_PAPER, paper::PLAN_AGENT),
            PLAN_AGENT,
        ],
        reference: 2,
        suites: &[GENERATED_14, HARD, RECORDED],
        rows: Rows::Variants,
        columns: &[],
        figure: Figure::Differences,
        remarks: &[
            "log-replay is the recorded driver; among reactive traffic it does not react itself.",
            "LLM-ASSIST is rebuilt, with prompts of our own (docs/llm_assist.md); nano was not trained for its questions.",
            "random-code, fixed-code and grid-code are the agent with codes that no model wrote, under the same Reflection.",
            "plan-agent (paper): after three refusals the last planner drives, and a planner drives as it was written; \
             plan-agent: as configured.",
        ],
    }
}

fn scenario_types() -> Study {
    Study {
        name: "scenario-types",
        title: "PlanAgent and PDM-Closed by scenario type",
        paper: Some("figure of NR-CLS over 14 scenario types"),
        labels: &["planner"],
        variants: vec![PDM_CLOSED, PLAN_AGENT],
        reference: 0,
        suites: &[HARD],
        rows: Rows::ScenarioTypes,
        columns: &[],
        figure: Figure::Bars,
        remarks: &[
            "The paper draws this figure without numbers. Its text names changing_lane, turns, high_lateral_acceleration \
                    and traversing_pickup_dropoff among the types in which PlanAgent is better.",
        ],
    }
}

fn environment() -> Study {
    Study {
        name: "environment",
        title: "What the model is shown: BEV map and lane graph",
        paper: Some("ablation of the Environment Transformation"),
        labels: &["BEV", "lane graph"],
        variants: vec![
            agent(&[NO, NO], "environment = { bev = false, lane_graph = false }", paper::NEITHER_INPUT),
            agent(&[NO, YES], "environment.bev = false", paper::LANE_GRAPH_ALONE),
            agent(&[YES, NO], "environment.lane_graph = false", paper::BEV_ALONE),
            agent(&[YES, YES], "", paper::PLAN_AGENT),
        ],
        reference: 3,
        suites: &[HARD],
        rows: Rows::Variants,
        columns: &[],
        figure: Figure::Differences,
        remarks: &[],
    }
}

fn reasoning() -> Study {
    Study {
        name: "reasoning",
        title: "What the model is asked, and whether its planners are judged",
        paper: Some("ablation of the Reasoning Engine and Reflection"),
        labels: &["understanding", "instruction", "reflection"],
        variants: vec![
            agent(&[NO, YES, YES], "reasoning.rounds = ['instruction', 'code']", paper::WITHOUT_UNDERSTANDING),
            agent(&[YES, NO, YES], "reasoning.rounds = ['understanding', 'code']", paper::WITHOUT_INSTRUCTION),
            agent(&[YES, YES, NO], "reflection.enabled = false", paper::WITHOUT_REFLECTION),
            agent(&[YES, YES, YES], "", paper::PLAN_AGENT),
        ],
        reference: 3,
        suites: &[HARD],
        rows: Rows::Variants,
        columns: &[],
        figure: Figure::Differences,
        remarks: &[],
    }
}

fn interval() -> Study {
    Study {
        name: "interval",
        title: "Time between two planning calls",
        paper: Some("ablation of the interval of MLLM calls"),
        labels: &["interval"],
        variants: vec![
            agent_at(&["1 s"], "reasoning.interval = 10", paper::EVERY_SECOND, 1.0),
            agent_at(&["2 s"], "reasoning.interval = 20", paper::PLAN_AGENT, 2.0),
            agent_at(&["3 s"], "reasoning.interval = 30", paper::EVERY_THIRD_SECOND, 3.0),
        ],
        reference: 1,
        suites: &[HARD],
        rows: Rows::Variants,
        columns: &[Column::Calls],
        figure: Figure::Lines("seconds between planning calls"),
        remarks: &[],
    }
}

fn mllm() -> Study {
    Study {
        name: "mllm",
        title: "PlanAgent with different language models",
        paper: Some("performance of different MLLMs"),
        labels: &["model"],
        variants: vec![
            planner(&["(pdm-closed)"], PlannerName::PDM_CLOSED, paper::PDM_CLOSED),
            agent(&["nano"], "mllm.model = 'nano'", Published::NOTHING),
            agent(&["llava-1.5-7b"], "mllm.model = 'llava-1.5-7b'", paper::LLAVA_7B),
            agent(&["llava-1.5-13b"], "mllm.model = 'llava-1.5-13b'", paper::LLAVA_13B),
            agent(&["cogvlm-chat-17b"], "mllm.model = 'cogvlm-chat-17b'", paper::COGVLM),
            agent(&["gpt-4v"], "mllm.model = 'openai'", paper::GPT_4V),
        ],
        reference: 0,
        suites: &[HARD],
        rows: Rows::Variants,
        columns: &[Column::Parameters, Column::CallTime],
        figure: Figure::Differences,
        remarks: &[
            "A model drives where its trained weights are on this machine. Without them its time is that of a bench (--bench), \
             which fills its shape with random weights.",
            "The paper's time is of one inference, on hardware that it does not name; ours is the median of a planning call.",
        ],
    }
}

fn controls() -> Study {
    Study {
        name: "controls",
        title: "What the model is worth: other codes under the same Reflection",
        paper: None,
        labels: &["codes"],
        variants: vec![RANDOM_CODE, FIXED_CODE, GRID_CODE, Variant { labels: &["the model's"], ..PLAN_AGENT }],
        reference: 3,
        suites: &[GENERATED_14, HARD],
        rows: Rows::Variants,
        columns: &[Column::CallTime],
        figure: Figure::Differences,
        remarks: &[
            "random-code draws each attempt evenly from the codes that the grammar allows, fixed-code keeps the lane at the limit, \
             grid-code tries every code of a grid and takes the one that Reflection scores best.",
        ],
    }
}

fn inputs() -> Study {
    Study {
        name: "inputs",
        title: "Does it see? What each input is worth to the model",
        paper: None,
        labels: &["BEV", "text"],
        variants: vec![
            agent(&["another scene's", "own"], "environment.shuffled_bev = true", Published::NOTHING),
            agent(&["none", "own"], "environment.bev = false", Published::NOTHING),
            agent(&["own", "none"], "environment.lane_graph = false", Published::NOTHING),
            agent(&["none", "none"], "environment = { bev = false, lane_graph = false }", Published::NOTHING),
            agent(&["own", "own"], "", Published::NOTHING),
        ],
        reference: 4,
        suites: &[HARD],
        rows: Rows::Variants,
        columns: &[],
        figure: Figure::Differences,
        remarks: &["Another scene's BEV map is that of a generated scene, a new one at each planning call."],
    }
}

fn execution() -> Study {
    let refused = |labels, settings| agent(labels, settings, Published::NOTHING);
    Study {
        name: "execution",
        title: "Who drives after refusals, and how between planning calls",
        paper: None,
        labels: &["after refusals", "between calls"],
        variants: vec![
            agent(&["last", "as written"], AS_IN_THE_PAPER, paper::PLAN_AGENT),
            refused(&["best", "as written"], "reflection = { after_max_exec = 'best', monitoring = false }"),
            refused(&["last", "watched"], "reflection = { after_max_exec = 'last', monitoring = true }"),
            refused(&["best", "watched"], "reflection = { after_max_exec = 'best', monitoring = true }"),
        ],
        reference: 0,
        suites: &[HARD],
        rows: Rows::Variants,
        columns: &[],
        figure: Figure::Differences,
        remarks: &["The first row is the paper's."],
    }
}

fn gate() -> Study {
    let below = |labels, settings, x| agent_at(labels, settings, Published::NOTHING, x);
    Study {
        name: "gate",
        title: "The model asked where PDM-Closed expects to do badly",
        paper: None,
        labels: &["asked below"],
        variants: vec![
            below(&["0.50"], "agent.gate = 0.5", 0.5),
            below(&["0.75"], "agent.gate = 0.75", 0.75),
            below(&["0.90"], "agent.gate = 0.9", 0.9),
            below(&["0.95"], "agent.gate = 0.95", 0.95),
            below(&["always"], "", 1.0),
        ],
        reference: 4,
        suites: &[GENERATED_14, HARD],
        rows: Rows::Variants,
        columns: &[Column::Calls],
        figure: Figure::Lines("predicted score of PDM-Closed below which the model is asked; 1: always"),
        remarks: &["Elsewhere PDM-Closed drives: the paper's future work."],
    }
}

fn latency_aware() -> Study {
    let lasting = |labels, settings, seconds| agent_at(labels, settings, Published::NOTHING, seconds);
    Study {
        name: "latency-aware",
        title: "What the time of a planning call costs",
        paper: None,
        labels: &["a call lasts"],
        variants: vec![
            lasting(&["0 s"], "", 0.0),
            lasting(&["0.2 s"], "agent.latency = 200", 0.2),
            lasting(&["0.5 s"], "agent.latency = 500", 0.5),
            lasting(&["1 s"], "agent.latency = 1000", 1.0),
            lasting(&["2 s"], "agent.latency = 2000", 2.0),
            lasting(&["2.936 s"], "agent.latency = 2936", 2.936),
            lasting(&["5.568 s"], "agent.latency = 5568", 5.568),
        ],
        reference: 0,
        suites: &[HARD],
        rows: Rows::Variants,
        columns: &[Column::Calls],
        figure: Figure::Lines("seconds that a planning call lasts in the simulated world"),
        remarks: &[
            "A call's planner comes into force when its time has passed; the last one drives meanwhile. 2.936 s and 5.568 s are \
                    the paper's times of LLaVA-7B and GPT-4V.",
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_experiment_is_whole() {
        assert_eq!(all().iter().map(|study| study.name).collect::<Vec<_>>(), NAMES);
        for study in all() {
            let name = study.name;
            assert!(study.reference < study.variants.len(), "{name}");
            let labels: BTreeSet<_> = study.variants.iter().map(|variant| variant.labels).collect();
            assert_eq!(labels.len(), study.variants.len(), "{name}: two variants of one name");
            for variant in &study.variants {
                assert_eq!(variant.labels.len(), study.labels.len(), "{name}: {:?}", variant.labels);
                assert_eq!(
                    variant.x.is_some(),
                    matches!(study.figure, Figure::Lines(_)),
                    "{name}: {:?}",
                    variant.labels
                );
            }
            assert!(!study.suites.is_empty(), "{name}");
        }
    }
}
