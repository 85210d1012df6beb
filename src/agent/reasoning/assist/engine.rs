//! Asks the question of a planning call, with feedback on the last answer, and reads the answers.

use super::AssistVariant;
use super::answer::{Assistance, grammar, parse_assistance};
use super::prompts::AssistPrompts;
use crate::reasoning::code_parser::Parsed;
use crate::reasoning::engine::{
    Feedback, ReasoningSettings, ReasoningTrace, feedback_text, round_record,
};
use crate::reasoning::error::ReasoningError;
use crate::reasoning::prompt_set::PromptSet;
use crate::reasoning::round::Round;
use planagent_mllm::{Constraint, Conversation, Deadline, Mark, Mllm, PromptPrefix, Request};

/// Minimum of the bound on an answer, tokens: small vocabularies spell names out.
const MIN_TOKENS: usize = 128;

/// The input of a planning call to the model.
#[derive(Debug, Clone, PartialEq)]
pub struct AssistQuestion {
    pub scene_text: String,
    /// The score of PDM-Closed's best proposal.
    pub score: f64,
    /// Speed limit of the ego's lane, whole m/s; `None` where it is unknown.
    pub speed_limit: Option<u32>,
}

/// The conversation of one call.
pub struct AssistReasoning<'a> {
    variant: AssistVariant,
    conversation: Box<dyn Conversation + 'a>,
    start: Mark,
    templates: AssistPrompts<'a>,
    /// The agent's own prompts, for the feedback.
    prompts: &'a PromptSet,
    settings: &'a ReasoningSettings,
    question: &'a AssistQuestion,
    deadline: Deadline,
    attempts: usize,
}

impl<'a> AssistReasoning<'a> {
    /// Opens the conversation of a call that must end by `deadline`. There is no image:
    /// LLM-ASSIST's models read text alone.
    pub fn open(
        variant: AssistVariant,
        model: &'a dyn Mllm,
        prompts: &'a PromptSet,
        settings: &'a ReasoningSettings,
        question: &'a AssistQuestion,
        seed: u64,
        deadline: Deadline,
    ) -> Result<Self, ReasoningError> {
        let templates = AssistPrompts::new(variant, prompts)?;
        let conversation = model.converse(
            &PromptPrefix {
                system: templates.system()?,
                image: None,
            },
            seed,
        )?;
        let start = conversation.mark();
        Ok(Self {
            variant,
            conversation,
            start,
            templates,
            prompts,
            settings,
            question,
            deadline,
            attempts: 0,
        })
    }

    /// Asks once from the start, with feedback on the last answer.
    pub(crate) fn think(
        &mut self,
        feedback: Option<&Feedback>,
    ) -> Result<ReasoningTrace<Assistance>, ReasoningError> {
        // Each attempt begins at the same place, so that the prompt does not grow with the
        // attempts.
        self.conversation.rewind(self.start);
        self.attempts += 1;
        let feedback = feedback
            .map(|f| feedback_text(self.prompts, f))
            .transpose()?;
        let AssistQuestion {
            scene_text, score, ..
        } = self.question;
        let prompt = self
            .templates
            .question(scene_text, *score, feedback.as_deref())?;
        let answer = match self.conversation.ask(&prompt, &self.request()) {
            Ok(answer) => answer,
            Err(error) if error.is_transient() => {
                let interruption = Some(error.into());
                return Ok(ReasoningTrace {
                    rounds: Vec::new(),
                    interruption,
                    instruction: None,
                    parsed: Parsed::NOTHING,
                    proposals: Vec::new(),
                });
            }
            Err(error) => return Err(error.into()),
        };
        let parsed = parse_assistance(&answer.text, self.variant);
        let rounds = vec![round_record(Round::Code, prompt, answer)];
        Ok(ReasoningTrace {
            rounds,
            interruption: None,
            instruction: None,
            parsed,
            proposals: Vec::new(),
        })
    }

    fn request(&self) -> Request {
        let ReasoningSettings {
            generation,
            rethink_sampling,
            grammar: constrained,
            ..
        } = self.settings;
        let constraint = if *constrained {
            grammar(self.variant, self.question.speed_limit)
        } else {
            Constraint::Free
        };
        let sampling = if self.attempts > 1 {
            *rethink_sampling
        } else {
            generation.sampling
        };
        let max_new_tokens = generation.max_new_tokens.code.max(MIN_TOKENS);
        Request {
            constraint,
            max_new_tokens,
            sampling,
            deadline: self.deadline,
            draft: None,
        }
    }
}
