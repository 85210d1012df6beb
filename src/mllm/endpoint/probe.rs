//! At most two short questions that show whether a server can be asked what a run asks: it is there,
//! has the model, takes a picture and a constraint, and the model looks at the picture.

use super::chat::{self, Chat, TurnImage};
use super::client::Question;
use super::{Endpoint, ProbeQuestion};
use crate::{Constraint, ConstraintUse, Deadline, GrammarField, MllmError, Request};
use image::{Rgb, RgbImage};
use std::cell::Cell;
use std::sync::atomic::Ordering;

/// The system prompt: runs have one, and some models refuse it.
const SYSTEM: &str = "You answer with one word.";
/// The colors of the pictures, one each.
const COLORS: [(&str, Rgb<u8>); 2] = [("red", Rgb([220, 30, 30])), ("blue", Rgb([30, 30, 220]))];
/// The prompt with a picture.
const OF_PICTURE: &str =
    "The picture has one color. Which one is it? Answer with one word: red or blue.";
/// The prompt without a picture.
const OF_NOTHING: &str = "Which color has the clear sky? Answer with one word: red or blue.";
/// Most requests of a probe. One that is refused for its form counts, so that one question is left.
const MAX_REQUESTS: usize = 2;
/// A server that refuses two forms.
const UNTRIED: &str = "it refused the test question in two forms and asks for another one, which the first planning call tries";
/// Longest part of an answer in a remark, characters.
const MAX_SHOWN: usize = 60;

/// An answer to one of the questions.
#[derive(Debug, Clone, PartialEq)]
struct ProbeAnswer {
    text: String,
    constraint: ConstraintUse,
}

impl Endpoint {
    /// Asks the questions, unless they were answered before.
    pub(super) fn probe_once(
        &self,
        question: &ProbeQuestion,
        on_wait: &dyn Fn(&str),
    ) -> Result<Vec<String>, MllmError> {
        if self.probed.load(Ordering::Relaxed) {
            return Ok(Vec::new());
        }
        let colors: &[_] = if question.picture { &COLORS } else { &[] };
        let side = self.settings.image_size;
        let pictures = colors
            .iter()
            .map(|(_, color)| Some(RgbImage::from_pixel(side, side, *color)));
        // A refused form is a request, too: the question of the second color is left out then.
        let sent = Cell::new(0);
        let may_send = || {
            sent.set(sent.get() + 1);
            sent.get() <= MAX_REQUESTS
        };
        let mut answers = Vec::new();
        for picture in pictures.chain(colors.is_empty().then_some(None)) {
            if sent.get() == MAX_REQUESTS {
                break;
            }
            may_send();
            match self.probe_answer(question, picture.as_ref(), on_wait, &may_send) {
                Err(_) if sent.get() > MAX_REQUESTS => {
                    self.probed.store(true, Ordering::Relaxed);
                    return Ok(vec![UNTRIED.to_owned()]);
                }
                answer => answers.push(answer?),
            }
        }
        self.probed.store(true, Ordering::Relaxed);
        Ok(remarks(&answers, self.settings.grammar, question.picture))
    }

    fn probe_answer(
        &self,
        question: &ProbeQuestion,
        picture: Option<&RgbImage>,
        on_wait: &dyn Fn(&str),
        may_change: &dyn Fn() -> bool,
    ) -> Result<ProbeAnswer, MllmError> {
        let constraint = if question.constrained {
            Constraint::Choice(COLORS.map(|(name, _)| name.to_owned()).to_vec())
        } else {
            Constraint::Free
        };
        // As a run asks: what a server refuses here, it would refuse there.
        let request = Request {
            constraint,
            max_new_tokens: question.max_new_tokens,
            sampling: question.sampling,
            deadline: Deadline::NONE,
            draft: None,
        };
        request.sampling.check()?;
        let shown = picture.map(|image| TurnImage::new(image, 0));
        let images: Vec<TurnImage> = shown.transpose()?.into_iter().collect();
        let chat = Chat {
            system: SYSTEM,
            images: &images,
            turns: &[],
            prompt: if images.is_empty() {
                OF_NOTHING
            } else {
                OF_PICTURE
            },
        };
        let body = chat::body(&self.settings, &chat, &request, 0)?;
        let asked = Question {
            settings: &self.settings,
            body: &body,
            seed: 0,
            deadline: request.deadline,
            on_wait,
            may_change,
        };
        let reply = self.client.ask(asked, None)?;
        let text = chat::text(&self.settings, &request.constraint, reply.content);
        Ok(ProbeAnswer {
            constraint: chat::constraint_use(&self.settings, &request.constraint, &text),
            text,
        })
    }
}

/// What is odd in the answers: one for each color that was shown, or a single one without a picture.
fn remarks(answers: &[ProbeAnswer], grammar: GrammarField, pictures: bool) -> Vec<String> {
    let mut remarks = Vec::new();
    if answers.iter().any(|answer| answer.text.trim().is_empty()) {
        remarks.push(
            "it answered a test question with nothing: plans cannot be read from empty answers"
                .to_owned(),
        );
        return remarks;
    }
    if answers
        .iter()
        .any(|answer| answer.constraint == ConstraintUse::Violated)
    {
        let field = serde_json::to_value(grammar).expect("the name of a field is a value of JSON");
        remarks.push(format!(
            "its answer to a test question does not follow the grammar ({}): the server may ignore this field, and another value \
             of grammar in the description may fit",
            field.as_str().expect("the name of a field is a text")
        ));
    }
    // Remarks and no errors: the questions are simple, but a small model may still fail them.
    let shows = |answer: &ProbeAnswer, own: usize| {
        COLORS
            .iter()
            .enumerate()
            .all(|(index, (name, _))| has_word(&answer.text, name) == (index == own))
    };
    let badly = match answers {
        [first, second] if first.text.trim() == second.text.trim() => {
            remarks.push(format!(
                "it answers {} to a red picture and to a blue one, so it may not look at pictures: start the server with a \
                 model that sees (llama.cpp: with its mmproj file), or set environment.bev=false",
                shown(&first.text)
            ));
            None
        }
        [first, second] if !(shows(first, 0) && shows(second, 1)) => Some(format!(
            "{} to a red picture and {} to a blue one",
            shown(&first.text),
            shown(&second.text)
        )),
        [only] if pictures && !shows(only, 0) => {
            Some(format!("{} to a red picture", shown(&only.text)))
        }
        _ => None,
    };
    if let Some(answered) = badly {
        remarks.push(format!(
            "it answers {answered}: it may see pictures badly, or not follow prompts"
        ));
    }
    remarks
}

/// Whether a text has a word, in letters of any case.
fn has_word(text: &str, word: &str) -> bool {
    text.split(|character: char| !character.is_alphanumeric())
        .any(|part| part.eq_ignore_ascii_case(word))
}

/// The beginning of an answer, in quotes.
fn shown(text: &str) -> String {
    let text = text.trim();
    let mut beginning: String = text.chars().take(MAX_SHOWN).collect();
    if text.chars().nth(MAX_SHOWN).is_some() {
        beginning.push('…');
    }
    format!("{beginning:?}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answers(texts: &[&str]) -> Vec<ProbeAnswer> {
        let answer = |text: &&str| ProbeAnswer {
            text: (*text).to_owned(),
            constraint: if ["red", "blue"].contains(text) {
                ConstraintUse::Satisfied
            } else {
                ConstraintUse::NotSent
            },
        };
        texts.iter().map(answer).collect()
    }

    #[test]
    fn a_model_that_sees_gets_no_remark_and_each_fault_gets_its_own() {
        let told = |texts: &[&str]| remarks(&answers(texts), GrammarField::Gbnf, true).join("\n");
        for seeing in [
            &["red", "blue"][..],
            &["Red.", " The picture is BLUE\n"],
            &["red"],
            &[],
        ] {
            assert_eq!(told(seeing), "", "{seeing:?}");
        }
        let sky = |text| remarks(&answers(&[text]), GrammarField::Gbnf, false);
        assert_eq!(sky("blue"), [] as [&str; 0]);
        assert!(told(&["blue"]).contains("\"blue\" to a red picture: it may see"));
        assert!(told(&["red", "red"]).contains("may not look at pictures"));
        assert!(told(&["I cannot see", "I cannot see "]).contains("may not look at pictures"));
        assert!(told(&["blue", "red"]).contains("may see pictures badly"));
        assert!(told(&["red or blue", "blue"]).contains("may see pictures badly"));
        assert!(told(&["", "blue"]).contains("with nothing"));
        assert!(told(&[" "]).contains("with nothing"));
        let mut free = answers(&["It is red", "It is blue"]);
        free[1].constraint = ConstraintUse::Violated;
        let told = remarks(&free, GrammarField::JsonSchema, true).join("\n");
        assert!(
            told.contains("does not follow the grammar (json_schema)"),
            "{told}"
        );
    }
}
