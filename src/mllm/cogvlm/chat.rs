//! Prompts of `CogVLM`, whose repositories have no chat template.

use super::config::AnswerStyle;
use crate::MllmError;
use crate::family::{Chat, ChatFormat, ChatImage, one_picture};
use crate::text::ChatTokenizer;

/// Vicuna's system prompt, for a chat without an image and without a system prompt.
const VICUNA_SYSTEM: &str = "A chat between a curious user and an artificial intelligence assistant. The assistant gives \
                             helpful, detailed, and polite answers to the user's questions.";

/// Questions and answers after the image; without an image, Vicuna's chats
/// (`build_conversation_input_ids` and `cli_demo_hf.py` of the model's authors).
///
/// The model has no system prompt. With an image it becomes the beginning of the first question;
/// without one it replaces Vicuna's.
#[derive(Debug)]
pub(super) struct QuestionFormat {
    /// The token that a chat begins with.
    pub bos: u32,
    /// The placeholder of the image's tokens.
    pub image_token: u32,
    pub style: AnswerStyle,
}

impl ChatFormat for QuestionFormat {
    fn ids(&self, tokenizer: &ChatTokenizer, chat: &Chat<'_>) -> Result<Vec<u32>, MllmError> {
        let (tokens, text) = match chat.images {
            [] => (0, vicuna(chat)),
            [ChatImage { turn: 0, layout }] => (layout.tokens, self.questions(chat)),
            _ => return Err(one_picture()),
        };
        let mut ids = vec![self.bos];
        ids.extend(std::iter::repeat_n(self.image_token, tokens));
        ids.extend(tokenizer.encode_text(&text)?);
        Ok(ids)
    }
}

impl QuestionFormat {
    fn questions(&self, chat: &Chat<'_>) -> String {
        let asked = match self.style {
            AnswerStyle::Chat => "Answer:",
            AnswerStyle::Short => "Short answer:",
        };
        let mut text = String::from("Question: ");
        if !chat.system.is_empty() {
            text += chat.system;
            text.push('\n');
        }
        for turn in chat.turns {
            text.extend([&turn.prompt, " ", asked, " ", &turn.answer, "\nQuestion: "]);
        }
        text + &format!("{} {asked}", chat.prompt)
    }
}

fn vicuna(chat: &Chat<'_>) -> String {
    let mut text = String::from(if chat.system.is_empty() {
        VICUNA_SYSTEM
    } else {
        chat.system
    });
    text.push(' ');
    for turn in chat.turns {
        text.extend(["USER: ", &turn.prompt, " ASSISTANT: ", &turn.answer, "\n"]);
    }
    text + &format!("USER: {} ASSISTANT:", chat.prompt)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Turn;

    #[test]
    fn questions_and_answers_follow_one_another() {
        let turns = [Turn {
            prompt: "one?".into(),
            answer: "two".into(),
        }];
        let chat = |system, turns| Chat {
            system,
            images: &[],
            turns,
            prompt: "three?",
        };
        let format = |style| QuestionFormat {
            bos: 1,
            image_token: 9,
            style,
        };
        assert_eq!(
            format(AnswerStyle::Chat).questions(&chat("", &[])),
            "Question: three? Answer:"
        );
        assert_eq!(
            format(AnswerStyle::Short).questions(&chat("Drive.", &turns)),
            "Question: Drive.\none? Short answer: two\nQuestion: three? Short answer:"
        );
        assert_eq!(
            vicuna(&chat("Drive.", &turns)),
            "Drive. USER: one? ASSISTANT: two\nUSER: three? ASSISTANT:"
        );
        assert!(vicuna(&chat("", &[])).starts_with("A chat between a curious user"));
    }
}
