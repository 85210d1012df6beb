//! The experiments that there are.

use super::paper::{self, Published};
use super::{Column, Figure, NO, Rows, Study, SuiteName, Variant, YES};
use crate::experiment::run::PlannerKind;

/// Their names, in the order in which `all` makes them.
pub const NAMES: [&str; 6] = ["main", "scenario-types", "environment", "reasoning", "interval", "mllm"];

/// All experiments.
pub fn all() -> Vec<Study> {
    vec![main(), scenario_types(), environment(), reasoning(), interval(), mllm()]
}

/// The experiment of a name.
pub fn named(name: &str) -> Option<Study> {
    all().into_iter().find(|study| study.name == name)
}

/// A planner as it is configured.
const fn planner(labels: &'static [&'static str], planner: PlannerKind, published: Published) -> Variant {
    Variant { labels, planner, settings: "", published, x: None }
}

/// PlanAgent with settings of its own.
const fn agent(labels: &'static [&'static str], settings: &'static str, published: Published) -> Variant {
    Variant { settings, ..planner(labels, PlannerKind::PlanAgent, published) }
}

const PLAN_AGENT: Variant = planner(&["plan-agent"], PlannerKind::PlanAgent, paper::PLAN_AGENT);
const PDM_CLOSED: Variant = planner(&["pdm-closed"], PlannerKind::PdmClosed, paper::PDM_CLOSED);

fn main() -> Study {
    Study {
        name: "main",
        title: "PlanAgent beside rule-based planners and the recorded driver",
        paper: Some("comparison with competitive methods"),
        labels: &["planner"],
        variants: vec![
            planner(&["log-replay"], PlannerKind::LogReplay, paper::LOG_REPLAY),
            planner(&["idm"], PlannerKind::Idm, paper::IDM),
            PDM_CLOSED,
            PLAN_AGENT,
        ],
        reference: 2,
        suites: &[SuiteName::Common, SuiteName::Hard, SuiteName::Recorded],
        rows: Rows::Variants,
        columns: &[],
        figure: Figure::Differences,
        remarks: &["log-replay is the recorded driver; among reactive traffic it does not react itself."],
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
        suites: &[SuiteName::Hard],
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
        suites: &[SuiteName::Hard],
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
        suites: &[SuiteName::Hard],
        rows: Rows::Variants,
        columns: &[],
        figure: Figure::Differences,
        remarks: &[],
    }
}

fn interval() -> Study {
    let every =
        |labels, settings, published, seconds| Variant { x: Some(seconds), ..agent(labels, settings, published) };
    Study {
        name: "interval",
        title: "Time between two planning calls",
        paper: Some("ablation of the interval of MLLM calls"),
        labels: &["interval"],
        variants: vec![
            every(&["1 s"], "reasoning.interval = 10", paper::EVERY_SECOND, 1.0),
            every(&["2 s"], "reasoning.interval = 20", paper::PLAN_AGENT, 2.0),
            every(&["3 s"], "reasoning.interval = 30", paper::EVERY_THIRD_SECOND, 3.0),
        ],
        reference: 1,
        suites: &[SuiteName::Hard],
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
            planner(&["(pdm-closed)"], PlannerKind::PdmClosed, paper::PDM_CLOSED),
            agent(&["nano"], "mllm.model = 'nano'", Published::NOTHING),
            agent(&["llava-1.5-7b"], "mllm.model = 'llava-1.5-7b'", paper::LLAVA_7B),
            agent(&["llava-1.5-13b"], "mllm.model = 'llava-1.5-13b'", paper::LLAVA_13B),
            agent(&["cogvlm-chat-17b"], "mllm.model = 'cogvlm-chat-17b'", paper::COGVLM),
            agent(&["gpt-4v"], "mllm.model = 'openai'", paper::GPT_4V),
        ],
        reference: 0,
        suites: &[SuiteName::Hard],
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
