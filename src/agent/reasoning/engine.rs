//! Asks a model the rounds of an attempt and reads its answers.

use super::call_parser::ParseError;
use super::code::{Names, PlannerCode};
use super::code_parser::{Parsed, parse};
use super::error::{PromptError, ReasoningError};
use super::fitting::Fitting;
use super::grammar::{self, Refused};
use super::history::{AnswerHistory, Speculation};
use super::instruction::MotionInstruction;
use super::prompt_set::PromptSet;
use super::proposals::Proposals;
use super::round::{Round, RoundName};
use super::tool::ToolUse;
use super::variables;
use crate::environment::text::Description;
use image::RgbImage;
use planagent_mllm::{
    Answer, Constraint, ConstraintUse, Conversation, Deadline, FinishReason, GenerationSettings,
    Mark, Mllm, MllmError, PromptPrefix, Request, RoundTime, Sampling, TokenCounts,
};
use std::sync::Arc;

/// The input of a planning call to the model.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScenarioPrompt {
    /// The BEV image; `None` leaves it out.
    pub image: Option<Arc<RgbImage>>,
    /// The lane-graph text; `None` leaves it out.
    pub text: Option<String>,
    /// What the text says, for other prompt sets that might fit.
    pub description: Option<Description>,
    /// The names that planner code may use.
    pub names: Names,
    /// The meaning of the image's colors, for the system prompt; empty for a model that reads text
    /// alone.
    pub legend: String,
}

/// Why a plan was refused.
#[derive(Debug, Clone, PartialEq)]
pub struct Feedback {
    /// The line, as it was read.
    pub code: Option<String>,
    /// The score of its plan; `None` without a plan.
    pub score: Option<f64>,
    /// The score that a plan needs.
    pub threshold: f64,
    /// The parts of the score by name.
    pub parts: Vec<(String, f64)>,
    /// Whether the plan lacks nothing but progress.
    pub is_slow: bool,
    /// The errors in the answer.
    pub errors: Vec<ParseError>,
}

/// Record of one round: prompt, answer, and what it cost.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
pub struct RoundRecord {
    pub round: RoundName,
    pub prompt: String,
    /// BLAKE3 of the whole chat before the answer.
    pub prompt_hash: String,
    pub answer: String,
    /// Why the answer ends.
    pub finish: FinishReason,
    /// How the round's grammar was used.
    pub constraint: ConstraintUse,
    /// The natural logarithm of the probability of what the model chose in the answer, among what
    /// the grammar allowed and at temperature 1; absent without a grammar, and from a server.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log_probability: Option<f64>,
    /// Tokens read and written.
    pub tokens: TokenCounts,
    /// The tool that the answer calls, with what it gave.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool: Option<ToolUse>,
    /// Wall time; written apart from the rest of a record.
    #[serde(skip)]
    pub time: RoundTime,
}

/// Why an attempt ended before its last answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Interruption {
    /// The planning call's deadline passed.
    Deadline,
    /// A transient failure of the model. The text says how.
    Model(String),
}

impl From<MllmError> for Interruption {
    fn from(error: MllmError) -> Self {
        match error {
            MllmError::Deadline => Self::Deadline,
            other => Self::Model(other.to_string()),
        }
    }
}

/// The outcome of one attempt's rounds.
#[derive(Debug, Clone, PartialEq)]
pub struct ReasoningTrace<A> {
    /// The rounds that were answered.
    pub rounds: Vec<RoundRecord>,
    /// Why the later rounds were not answered; `None` when all were.
    pub interruption: Option<Interruption>,
    /// The motion instruction, if round 2 was asked and its words were found.
    pub instruction: Option<MotionInstruction>,
    /// The last answer as it was read.
    pub parsed: Parsed<A>,
    /// Less likely answers, which are tried out too.
    pub proposals: Vec<A>,
}

impl<A> ReasoningTrace<A> {
    /// An answer that no model gave.
    pub fn without_rounds(answer: A) -> Self {
        Self::of_parsed(Parsed::from_answer(answer))
    }

    /// A line that no model gave, as it was read.
    pub fn of_parsed(parsed: Parsed<A>) -> Self {
        Self {
            rounds: Vec::new(),
            interruption: None,
            instruction: None,
            parsed,
            proposals: Vec::new(),
        }
    }
}

/// Settings of the rounds.
#[derive(Debug, Clone, PartialEq)]
pub struct ReasoningSettings {
    /// The rounds that are asked, in order; the last must be [`Round::Code`].
    pub rounds: Vec<Round>,
    /// The model's own settings: bounds on answers, and the sampling of the first attempt.
    pub generation: GenerationSettings,
    /// Sampling of later attempts.
    pub rethink_sampling: Sampling,
    /// Whether answers are decoded under grammars. Without, they may fail to parse.
    pub grammar: bool,
    /// Where drafts of answers come from.
    pub speculation: Speculation,
    /// How many codes an attempt proposes.
    pub proposals: Proposals,
}

impl ReasoningSettings {
    pub(super) fn max_new_tokens(&self, round: Round) -> usize {
        let limits = self.generation.max_new_tokens;
        match round {
            Round::Understanding => limits.understanding,
            Round::Instruction => limits.instruction,
            Round::Code => limits.code,
        }
    }
}

/// The conversation of one planning call.
pub struct Reasoning<'a> {
    model: &'a dyn Mllm,
    system: String,
    conversation: Box<dyn Conversation + 'a>,
    start: Mark,
    prompts: &'a PromptSet,
    settings: &'a ReasoningSettings,
    scenario: &'a ScenarioPrompt,
    deadline: Deadline,
    history: &'a mut AnswerHistory,
    attempts: usize,
    /// The codes of the earlier attempts, which were all refused.
    refused: Refused,
}

impl<'a> Reasoning<'a> {
    /// Opens the conversation of a planning call that must end by `deadline`. `history` has the
    /// answers of the simulation so far.
    pub fn open(
        model: &'a dyn Mllm,
        prompts: &'a PromptSet,
        settings: &'a ReasoningSettings,
        scenario: &'a ScenarioPrompt,
        seed: u64,
        deadline: Deadline,
        history: &'a mut AnswerHistory,
    ) -> Result<Self, ReasoningError> {
        let system = system_prompt(prompts, &scenario.legend)?;
        let prefix = PromptPrefix {
            system: system.clone(),
            image: scenario.image.clone(),
        };
        let fitting = Fitting {
            model,
            prompts,
            settings,
            scenario,
        };
        let conversation = model
            .converse(&prefix, seed)
            .map_err(|error| fitting.failed(error, [system.as_str()]))?;
        // System prompt and image are computed once a call; attempts go back to this mark.
        let start = conversation.mark();
        Ok(Self {
            model,
            system,
            conversation,
            start,
            prompts,
            settings,
            scenario,
            deadline,
            history,
            attempts: 0,
            refused: Refused::default(),
        })
    }

    /// One attempt: all rounds from the start, with feedback on the last attempt in the first
    /// prompt.
    ///
    /// # Errors
    /// On a permanent failure of the model, or when a prompt cannot be rendered. Wrong answers and
    /// interruptions are no errors.
    pub(crate) fn think(
        &mut self,
        feedback: Option<&Feedback>,
    ) -> Result<ReasoningTrace<PlannerCode>, ReasoningError> {
        self.conversation.rewind(self.start);
        self.attempts += 1;
        // Of several proposals the feedback is on the best, which need not be the likeliest.
        let slow = feedback
            .filter(|feedback| feedback.is_slow)
            .and_then(|feedback| feedback.code.as_deref());
        self.refused
            .slow
            .extend(slow.and_then(|code| parse(code, &self.scenario.names).answer));
        let mut feedback = feedback
            .map(|f| feedback_text(self.prompts, f))
            .transpose()?;
        let mut scene_text = self.scenario.text.as_deref();
        let mut rounds: Vec<RoundRecord> = Vec::with_capacity(self.settings.rounds.len());
        let (mut instruction, mut less_likely) = (None, Vec::new());
        for &round in &self.settings.rounds {
            let names = &self.scenario.names;
            let prompt = round_prompt(
                self.prompts,
                round,
                names,
                scene_text.take(),
                feedback.take().as_deref(),
            )?;
            let (answer, others) = match self.answer(round, &prompt) {
                Ok(answers) => answers,
                Err(error) if error.is_transient() => {
                    let interruption = Some(error.into());
                    let (parsed, proposals) = (Parsed::NOTHING, Vec::new());
                    return Ok(ReasoningTrace {
                        rounds,
                        interruption,
                        instruction,
                        parsed,
                        proposals,
                    });
                }
                Err(error) => {
                    let asked = rounds
                        .iter()
                        .flat_map(|record| [record.prompt.as_str(), record.answer.as_str()])
                        .chain([self.system.as_str(), prompt.as_str()]);
                    return Err(self.fitting().failed(error, asked));
                }
            };
            if round == Round::Instruction {
                instruction = MotionInstruction::find(&answer.text);
            }
            self.history.set(round, answer.ids.clone());
            rounds.push(round_record(round, prompt, answer));
            less_likely = others;
        }
        let code = rounds
            .last()
            .filter(|last| last.round == RoundName::Code)
            .map_or("", |last| last.answer.as_str());
        let names = &self.scenario.names;
        let parsed = parse(code, names);
        let proposals: Vec<PlannerCode> = less_likely
            .iter()
            .filter_map(|text| parse(text, names).answer)
            .filter(|code| parsed.answer != Some(*code))
            .collect();
        self.refused
            .codes
            .extend(parsed.answer.iter().chain(&proposals));
        Ok(ReasoningTrace {
            rounds,
            interruption: None,
            instruction,
            parsed,
            proposals,
        })
    }

    /// What tells which prompt sets fit the context.
    fn fitting(&self) -> Fitting<'a> {
        Fitting {
            model: self.model,
            prompts: self.prompts,
            settings: self.settings,
            scenario: self.scenario,
        }
    }

    /// The answer to a round, and the texts of less likely ones where several codes are proposed.
    /// Its counts and times contain theirs.
    fn answer(&mut self, round: Round, prompt: &str) -> Result<(Answer, Vec<String>), MllmError> {
        let request = self.request(round);
        let proposals = self.settings.proposals.get();
        if round != Round::Code || proposals == 1 {
            return Ok((self.conversation.ask(prompt, &request)?, Vec::new()));
        }
        let mut answers = self
            .conversation
            .ask_likeliest(prompt, &request, proposals)?;
        let others = answers.split_off(1.min(answers.len()));
        let nothing = || MllmError::Request {
            problem: "the model gave no proposal".to_owned(),
        };
        let likeliest = answers.pop().ok_or_else(nothing)?;
        Ok((
            likeliest,
            others.into_iter().map(|answer| answer.text).collect(),
        ))
    }

    fn request(&self, round: Round) -> Request {
        let forms = self.prompts.forms();
        let constraint = match round {
            _ if !self.settings.grammar => Constraint::Free,
            Round::Understanding => grammar::understanding(forms.understanding),
            Round::Instruction => grammar::instruction(forms.instruction),
            Round::Code => grammar::code(&self.scenario.names, &self.refused),
        };
        let sampling = if self.attempts > 1 {
            self.settings.rethink_sampling
        } else {
            self.settings.generation.sampling
        };
        let max_new_tokens = forms.max_tokens(round, self.settings.max_new_tokens(round));
        let draft = match self.settings.speculation {
            Speculation::None => None,
            Speculation::History => Some(self.history.last(round).to_vec()),
        };
        Request {
            constraint,
            max_new_tokens,
            sampling,
            deadline: self.deadline,
            draft,
        }
    }
}

/// The system prompt of a set: the same for all calls of a run.
pub fn system_prompt(prompts: &PromptSet, legend: &str) -> Result<String, PromptError> {
    prompts.system(variables::system(legend))
}

/// The prompt of a round; the first round that is asked carries the scene text and the feedback.
pub fn round_prompt(
    prompts: &PromptSet,
    round: Round,
    names: &Names,
    scene_text: Option<&str>,
    feedback: Option<&str>,
) -> Result<String, PromptError> {
    prompts.round(round, variables::round(names, scene_text, feedback))
}

/// The feedback on a refused plan that the model reads.
pub fn feedback_text(prompts: &PromptSet, feedback: &Feedback) -> Result<String, PromptError> {
    prompts.feedback(variables::feedback(feedback))
}

/// The record of an answered round.
pub fn round_record(round: impl Into<RoundName>, prompt: String, answer: Answer) -> RoundRecord {
    RoundRecord {
        round: round.into(),
        prompt,
        prompt_hash: answer.prompt_hash,
        answer: answer.text,
        finish: answer.finish,
        constraint: answer.constraint,
        log_probability: answer.log_probability,
        tokens: answer.tokens,
        tool: None,
        time: answer.time,
    }
}
