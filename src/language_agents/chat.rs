//! The questions of one planning call to the model, with their records.

use planagent_agent::planner::Unreadable;
use planagent_agent::reasoning::{
    Interruption, ReasoningError, ReasoningSettings, RoundName, RoundRecord, ToolUse, round_record,
};
use planagent_mllm::{
    Constraint, Conversation, Deadline, FinishReason, Mllm, PromptPrefix, Request,
};

/// Asks a model, in one conversation or several, and keeps the records of all rounds.
pub(crate) struct Chat<'a> {
    model: &'a dyn Mllm,
    settings: &'a ReasoningSettings,
    seed: u64,
    deadline: Deadline,
    /// What Reflection says of the last answer.
    feedback: Option<String>,
    conversation: Option<Box<dyn Conversation + 'a>>,
    /// Conversations so far, each of which draws from a stream of its own.
    opened: u64,
    pub(crate) rounds: Vec<RoundRecord>,
    /// Why the model was not asked further.
    pub(crate) interruption: Option<Interruption>,
}

/// A question to the model.
pub(crate) struct Asked {
    pub(crate) round: RoundName,
    pub(crate) prompt: String,
    /// The grammar of the answer, where answers are decoded under grammars.
    pub(crate) constraint: Constraint,
    /// Maximum tokens of the answer.
    pub(crate) max_tokens: usize,
}

impl<'a> Chat<'a> {
    pub(crate) fn new(
        model: &'a dyn Mllm,
        settings: &'a ReasoningSettings,
        seed: u64,
        deadline: Deadline,
    ) -> Self {
        Self {
            model,
            settings,
            seed,
            deadline,
            feedback: None,
            conversation: None,
            opened: 0,
            rounds: Vec::new(),
            interruption: None,
        }
    }

    /// Begins another attempt, with what Reflection says of the last one. Its records stand alone.
    pub(crate) fn begin_attempt(&mut self, feedback: Option<String>) {
        self.feedback = feedback;
        self.rounds.clear();
    }

    /// What Reflection says of the last answer of this planning call, for the prompt that asks for
    /// another.
    pub(crate) fn feedback(&self) -> Option<&str> {
        self.feedback.as_deref()
    }

    /// Begins a conversation with a system prompt; there is no image.
    ///
    /// # Errors
    /// When the chat template cannot render it.
    pub(crate) fn open(&mut self, system: String) -> Result<(), ReasoningError> {
        let seed = self.seed.wrapping_add(self.opened.rotate_left(32));
        self.opened += 1;
        let prefix = PromptPrefix {
            system,
            image: None,
        };
        self.conversation = Some(self.model.converse(&prefix, seed)?);
        Ok(())
    }

    /// Asks in the last conversation. `None` where the call was interrupted, now or before.
    ///
    /// # Errors
    /// When the model cannot be asked at all.
    pub(crate) fn ask(
        &mut self,
        Asked {
            round,
            prompt,
            constraint,
            max_tokens,
        }: Asked,
    ) -> Result<Option<String>, ReasoningError> {
        let Some(conversation) = self
            .conversation
            .as_mut()
            .filter(|_| self.interruption.is_none())
        else {
            return Ok(None);
        };
        let request = Request {
            constraint: if self.settings.grammar {
                constraint
            } else {
                Constraint::Free
            },
            max_new_tokens: max_tokens,
            sampling: if self.feedback.is_some() {
                self.settings.rethink_sampling
            } else {
                self.settings.generation.sampling
            },
            deadline: self.deadline,
            draft: None,
        };
        match conversation.ask(&prompt, &request) {
            Ok(answer) => {
                let text = answer.text.clone();
                self.rounds.push(round_record(round, prompt, answer));
                Ok(Some(text))
            }
            // An interruption is recorded and no failure: the planner then keeps its active plan.
            Err(error) if error.is_transient() => {
                self.interruption = Some(error.into());
                Ok(None)
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Adds the tool that the last answer calls to its record.
    pub(crate) fn note_tool(&mut self, tool: ToolUse) {
        if let Some(last) = self.rounds.last_mut() {
            last.tool = Some(tool);
        }
    }

    /// What is wrong with the last answer, in which nothing was found.
    pub(crate) fn without_line(&self) -> Unreadable {
        match self.rounds.last() {
            None => Unreadable::NoAttempt,
            Some(last) if last.answer.trim().is_empty() => Unreadable::Empty,
            Some(last) if self.is_cut_off(last) => Unreadable::CutOff,
            Some(_) => Unreadable::NoLine,
        }
    }

    /// What is wrong with the last answer, in which something wrong was found.
    pub(crate) fn with_wrong_line(&self) -> Unreadable {
        match self.rounds.last() {
            Some(last) if last.answer.trim().is_empty() => Unreadable::Empty,
            Some(last) if self.is_cut_off(last) => Unreadable::CutOff,
            _ => Unreadable::WrongLine,
        }
    }

    #[allow(clippy::unused_self, reason = "a question about a round of this chat")]
    fn is_cut_off(&self, round: &RoundRecord) -> bool {
        matches!(
            round.finish,
            FinishReason::Length | FinishReason::ContextFull
        )
    }
}
