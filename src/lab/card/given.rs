//! A model of whose answers some are given: what comes after them is its own.

use planagent_mllm::{
    Answer, AnswerTime, Constraint, Conversation, Mark, Mllm, MllmError, ModelDescription,
    PromptPrefix, Request,
};
use std::sync::Arc;

/// A model whose first answers in each conversation are given, turn by turn; `None` leaves a turn
/// to the model, and so does the end of the list.
pub(super) struct GivenAnswers {
    pub(super) model: Arc<dyn Mllm>,
    pub(super) answers: Vec<Option<String>>,
}

struct GivenConversation<'a> {
    conversation: Box<dyn Conversation + 'a>,
    answers: &'a [Option<String>],
    /// The marks before each turn, that before the next one last.
    marks: Vec<Mark>,
}

impl Mllm for GivenAnswers {
    fn name(&self) -> &str {
        self.model.name()
    }

    fn describe(&self) -> ModelDescription {
        self.model.describe()
    }

    fn answer_time(&self, text: usize, new: usize) -> Option<AnswerTime> {
        self.model.answer_time(text, new)
    }

    fn converse<'a>(
        &'a self,
        prefix: &PromptPrefix,
        seed: u64,
    ) -> Result<Box<dyn Conversation + 'a>, MllmError> {
        let conversation = self.model.converse(prefix, seed)?;
        Ok(Box::new(GivenConversation {
            marks: vec![conversation.mark()],
            conversation,
            answers: &self.answers,
        }))
    }

    fn count_tokens(&self, text: &str) -> Option<usize> {
        self.model.count_tokens(text)
    }
}

impl GivenConversation<'_> {
    /// The request of the next turn; a given answer is all that its constraint allows.
    fn next_request(&self, request: &Request) -> (Request, bool) {
        let turn = self.marks.len().saturating_sub(1);
        let mut request = request.clone();
        let Some(Some(text)) = self.answers.get(turn) else {
            return (request, false);
        };
        request.constraint = Constraint::Choice(vec![text.clone()]);
        // No token has fewer bytes than one, so the whole answer fits.
        request.max_new_tokens = request.max_new_tokens.max(text.len() + 1);
        (request, true)
    }
}

impl Conversation for GivenConversation<'_> {
    fn ask(&mut self, prompt: &str, request: &Request) -> Result<Answer, MllmError> {
        let (request, _) = self.next_request(request);
        let answer = self.conversation.ask(prompt, &request)?;
        self.marks.push(self.conversation.mark());
        Ok(answer)
    }

    fn ask_likeliest(
        &mut self,
        prompt: &str,
        request: &Request,
        count: usize,
    ) -> Result<Vec<Answer>, MllmError> {
        let (request, is_given) = self.next_request(request);
        let answers = if is_given {
            vec![self.conversation.ask(prompt, &request)?]
        } else {
            self.conversation.ask_likeliest(prompt, &request, count)?
        };
        self.marks.push(self.conversation.mark());
        Ok(answers)
    }

    fn mark(&self) -> Mark {
        self.conversation.mark()
    }

    fn rewind(&mut self, mark: Mark) {
        self.conversation.rewind(mark);
        self.marks.retain(|own| *own <= mark);
        if self.marks.is_empty() {
            self.marks.push(mark);
        }
    }
}
