//! A labeled state: three rounds with their answers, from the facts of the scene and the search.

use super::label_weights::DecisionWeights;
use super::lessons::Lesson;
use super::refusal::refusal;
use planagent_agent::environment::facts::{Ahead, Light, Question};
use planagent_agent::environment::text::{self, Description, TextForm};
use planagent_agent::environment::{CenterlineName, LaneGraph, SceneFacts};
use planagent_agent::reasoning::{
    Lateral, LateralReason, Longitudinal, LongitudinalReason, Names, PromptError, PromptSet, Round,
    round_prompt, system_prompt,
};
use planagent_agent::reflection::SubScores;
use planagent_controls::search::{Candidate, NEAR_LIMIT};
use serde::Serialize;
use std::collections::BTreeMap;

/// Minimum change of speed within 3 s for an instruction, m/s.
const SPEED_CHANGE: f64 = 0.7;

/// Gain at which a decision weighs as much as a fact.
const UNIT_GAIN: f64 = 0.1;
/// Minimum weight of a decision.
const MIN_WEIGHT: f64 = 0.05;

/// One turn of the conversation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Message {
    role: &'static str,
    content: String,
    /// Of an answer: spans of characters that the grammar does not fast-forward.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    learn: Vec<[usize; 2]>,
    /// Weights of these spans in the loss, unless all are 1.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    weights: Vec<f64>,
}

/// A line of a shard.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct LabeledState {
    /// Scenario and time.
    pub state: String,
    /// Index of the image in the shard's PNG.
    pub image: usize,
    /// System prompt, then prompts and answers.
    pub conversation: Vec<Message>,
    /// All answers by question: those of round 1, `lateral`, `longitudinal`, and the search's
    /// `code`.
    pub facts: BTreeMap<String, String>,
    /// nuPlan's score of the labeled planner over the search's horizon.
    pub score: f64,
    /// Codes for expert iteration, the label among them; none where there is only one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub tried: Vec<TriedCode>,
    /// Codes that Reflection refuses, in the order of the search.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub refused: Vec<RefusedCode>,
    /// Occupancy grids now, 1 s and 2 s later, as 64 hexadecimal digits each (see
    /// [`OccupancyGrid`](planagent_agent::environment::OccupancyGrid)).
    pub occupancy: [String; 3],
    /// Name of the text-twin pair that this state is one half of.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub twin: Option<String>,
}

/// A code that the search tried, with the answers that lead to it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct TriedCode {
    /// Chance of being the one to learn. The chances of a state sum up to 1.
    chance: f64,
    /// nuPlan's score over the search's horizon, with the terms that break ties.
    value: f64,
    /// Answers of the rounds Instruction and Code, in place of the label's.
    answers: [Message; 2],
}

/// A code that Reflection refuses, with what it is worth all the same.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct RefusedCode {
    code: String,
    /// nuPlan's score over the search's horizon, with the terms that break ties.
    value: f64,
    /// nuPlan's score over the search's horizon, 0 to 1.
    score: f64,
    /// Reflection's score, 0 to 1, and its parts.
    reflection: f64,
    parts: SubScores,
    /// Why it is refused.
    reason: String,
}

impl RefusedCode {
    /// Those among the codes that the search tried.
    pub(super) fn among(tried: &[Candidate]) -> Vec<Self> {
        let refused = tried.iter().filter(|candidate| !candidate.is_accepted());
        refused
            .map(|candidate| Self {
                code: candidate.code.to_string(),
                value: candidate.value,
                score: candidate.score,
                reflection: candidate.reflection.score,
                parts: candidate.reflection.parts,
                reason: refusal(&candidate.reflection),
            })
            .collect()
    }
}

/// An answer in pieces, some of which are learned.
#[derive(Default)]
struct Answer {
    text: String,
    learn: Vec<[usize; 2]>,
    weights: Vec<f64>,
}

impl Answer {
    /// Adds text that the grammar fast-forwards.
    fn fixed(mut self, text: &str) -> Self {
        self.text.push_str(text);
        self
    }

    /// Adds text that the model samples.
    fn chosen(mut self, text: &str) -> Self {
        let start = self.text.chars().count();
        self.text.push_str(text);
        self.learn.push([start, self.text.chars().count()]);
        self
    }

    /// Adds a decision with this gain.
    fn decided(mut self, text: &str, gain: f64) -> Self {
        self.weights.push((gain / UNIT_GAIN).max(MIN_WEIGHT));
        self.chosen(text)
    }

    fn message(self) -> Message {
        Message {
            role: "assistant",
            content: self.text,
            learn: self.learn,
            weights: self.weights,
        }
    }
}

/// The instruction of the search, with reasons.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Instruction {
    pub(super) lateral: Lateral,
    pub(super) why_lateral: LateralReason,
    pub(super) longitudinal: Longitudinal,
    pub(super) why_longitudinal: LongitudinalReason,
}

/// The label of a state, without its occupancy grids. The first prompt contains `feedback` on a
/// rejected planner, if any.
pub(super) fn label(
    state: String,
    graph: &LaneGraph,
    facts: &SceneFacts,
    best: &Candidate,
    weights: DecisionWeights,
    prompts: &PromptSet,
    feedback: Option<&str>,
) -> Result<LabeledState, PromptError> {
    let scene_text = text::write(&Description::from_graph(graph), prompts.forms().scene_text);
    let instruction = instruction(graph, facts, best, limit(graph, prompts));
    let asked = prompts.forms().understanding.questions();
    let questions = if asked.is_empty() {
        Question::first_version()
    } else {
        asked
    };
    let names = Names::from_graph(graph);
    // The prompts are those of the agent, word for word: a model learns on what it will be asked.
    let mut conversation = vec![Message {
        role: "system",
        content: system_prompt(prompts, "")?,
        learn: vec![],
        weights: vec![],
    }];
    for &round in Round::ALL {
        let first = round == Round::Understanding;
        let prompt = round_prompt(
            prompts,
            round,
            &names,
            first.then_some(scene_text.as_str()),
            feedback.filter(|_| first),
        )?;
        let content = if first {
            format!("<image>\n{prompt}")
        } else {
            prompt
        };
        conversation.push(Message {
            role: "user",
            content,
            learn: vec![],
            weights: vec![],
        });
        conversation.push(match round {
            Round::Understanding => understanding_answer(facts, questions),
            Round::Instruction => instruction_answer(instruction, weights),
            Round::Code => code_answer(best, weights),
        });
    }
    let mut answers: BTreeMap<String, String> = questions
        .iter()
        .map(|&q| (q.to_string(), facts.answer(q).to_owned()))
        .collect();
    answers.insert("lateral".to_owned(), instruction.lateral.to_string());
    answers.insert(
        "longitudinal".to_owned(),
        instruction.longitudinal.to_string(),
    );
    answers.insert("code".to_owned(), best.code.to_string());
    let occupancy = Default::default();
    let tried = Vec::new();
    Ok(LabeledState {
        state,
        image: 0,
        conversation,
        facts: answers,
        score: best.score,
        tried,
        refused: Vec::new(),
        occupancy,
        twin: None,
    })
}

/// The codes of a state for expert iteration; none where there is only one.
pub(super) fn tried_codes(
    graph: &LaneGraph,
    facts: &SceneFacts,
    lessons: &[Lesson<'_>],
    prompts: &PromptSet,
) -> Vec<TriedCode> {
    if lessons.len() < 2 {
        return Vec::new();
    }
    let limit = limit(graph, prompts);
    let tried = lessons.iter().map(
        |&Lesson {
             candidate,
             chance,
             weights,
         }| {
            let instruction = instruction(graph, facts, candidate, limit);
            let answers = [
                instruction_answer(instruction, weights),
                code_answer(candidate, weights),
            ];
            TriedCode {
                chance,
                value: candidate.value,
                answers,
            }
        },
    );
    tried.collect()
}

fn understanding_answer(facts: &SceneFacts, questions: &[Question]) -> Message {
    let mut answer = Answer::default();
    for (i, &question) in questions.iter().enumerate() {
        let space = if i == 0 { "" } else { " " };
        answer = answer
            .fixed(&format!("{space}{question}="))
            .chosen(facts.answer(question));
    }
    answer.message()
}

fn instruction_answer(instruction: Instruction, weights: DecisionWeights) -> Message {
    Answer::default()
        .fixed("why=")
        .decided(instruction.why_lateral.as_str(), weights.lane)
        .fixed(" lat=")
        .decided(instruction.lateral.as_str(), weights.lane)
        .fixed(" why=")
        .decided(instruction.why_longitudinal.as_str(), weights.speed)
        .fixed(" lon=")
        .decided(instruction.longitudinal.as_str(), weights.speed)
        .message()
}

fn code_answer(best: &Candidate, weights: DecisionWeights) -> Message {
    let code = &best.code;
    Answer::default()
        .fixed(&format!("{}(c=", planagent_agent::reasoning::FUNCTION))
        .decided(code.centerline.as_str(), weights.lane)
        .fixed(", la=")
        // The lead agent on a centerline is a fact of the scene.
        .decided(
            &code
                .lead_agent
                .map_or_else(|| "None".to_owned(), |name| name.to_string()),
            UNIT_GAIN,
        )
        .fixed(", v0=")
        .decided(&code.target_speed.to_string(), weights.speed)
        .fixed(", acc=")
        .decided(&code.accel_max.to_string(), weights.accelerations)
        .fixed(", dec=")
        .decided(&code.decel_max.to_string(), weights.accelerations)
        .fixed(")")
        .message()
}

/// The limit that the text of a prompt set gives, m/s: the map's, or its estimate.
pub(super) fn limit(graph: &LaneGraph, prompts: &PromptSet) -> f64 {
    let unknown = if prompts.forms().scene_text == TextForm::Compact {
        f64::INFINITY
    } else {
        graph.limit_estimate
    };
    graph.ego_lane().speed_limit.unwrap_or(unknown)
}

/// The instruction that a code follows from, with the reasons that the scene shows.
pub(super) fn instruction(
    graph: &LaneGraph,
    facts: &SceneFacts,
    best: &Candidate,
    limit: f64,
) -> Instruction {
    let lateral = match best.code.centerline {
        CenterlineName::EgoLane => Lateral::Keep,
        CenterlineName::RightLane => Lateral::ChangeRight,
        CenterlineName::OncomingLane
            if graph
                .oncoming
                .as_ref()
                .is_some_and(|lane| lane.border < 0.0) =>
        {
            Lateral::ChangeRight
        }
        CenterlineName::LeftLane | CenterlineName::OncomingLane => Lateral::ChangeLeft,
    };
    // The first reason that holds: what compels a change stands before what makes it better.
    let why_lateral = match lateral {
        Lateral::Keep => LateralReason::LaneServes,
        _ if facts.blocked != Ahead::None => LateralReason::Blocked,
        _ if graph
            .goal
            .is_some_and(|goal| goal.is_towards(best.code.centerline.lane_changes())) =>
        {
            LateralReason::GoalLane
        }
        _ if graph.lead_agent(CenterlineName::EgoLane).is_some() => LateralReason::SlowLead,
        _ => LateralReason::FasterLane,
    };
    let change = best.speed_later - graph.ego_speed;
    let longitudinal = if change > SPEED_CHANGE {
        Longitudinal::Accelerate
    } else if change < -SPEED_CHANGE {
        Longitudinal::Decelerate
    } else {
        Longitudinal::Maintain
    };
    Instruction {
        lateral,
        why_lateral,
        longitudinal,
        why_longitudinal: why_longitudinal(facts, best, lateral, limit),
    }
}

/// The visible reason that limits the speed most.
fn why_longitudinal(
    facts: &SceneFacts,
    best: &Candidate,
    lateral: Lateral,
    limit: f64,
) -> LongitudinalReason {
    if best.speed_later > NEAR_LIMIT * limit {
        return LongitudinalReason::SpeedLimit;
    }
    if matches!(facts.pedestrian, Ahead::Near | Ahead::Mid) {
        return LongitudinalReason::Person;
    }
    if matches!(facts.light, Light::Red | Light::Yellow) {
        return LongitudinalReason::Light;
    }
    if lateral == Lateral::Keep {
        if facts.lead_distance != Ahead::None {
            return LongitudinalReason::Lead;
        }
        if facts.blocked != Ahead::None {
            return LongitudinalReason::Obstacle;
        }
    }
    LongitudinalReason::FreeRoad
}
