//! A free question about a scene, outside of planning.

use super::error::PromptError;
use super::prompt_set::PromptSet;
use super::variables;

/// The set of its templates.
pub(super) const ASK: &str = "ask";

/// A question about a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FreeQuestion<'a> {
    /// The question in the user's words.
    pub question: &'a str,
    /// The lane-graph text; `None` leaves it out.
    pub scene_text: Option<&'a str>,
    /// The meaning of the image's colors; empty where the model sees no image.
    pub legend: &'a str,
}

/// The system prompt and the prompt of a question, for a model that is asked with a prompt set.
pub fn question_prompt(
    prompts: &PromptSet,
    question: &FreeQuestion<'_>,
) -> Result<(String, String), PromptError> {
    let templates = prompts.question_set(ASK)?;
    let context = variables::ask(question, prompts.forms().scene_text.is_for_small_models());
    Ok((
        templates.render("system", context.clone())?,
        templates.render("question", context)?,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_question_stands_after_the_scene_text() {
        let question = FreeQuestion {
            question: "What blocks us? ",
            scene_text: None,
            legend: "Colours: none.",
        };
        let asked = |set: &str, question| {
            question_prompt(&PromptSet::open(set).unwrap(), &question).unwrap()
        };
        let (system, prompt) = asked("paper", question);
        assert!(system.contains("Colours: none."), "{system}");
        assert_eq!(prompt, "What blocks us?");
        let (system, prompt) = asked(
            "compact",
            FreeQuestion {
                scene_text: Some("ego 3"),
                ..question
            },
        );
        assert_eq!(
            (system.as_str(), prompt.as_str()),
            ("drive", "ego 3\nWhat blocks us?")
        );
    }
}
