//! The prompts of both variants.

use super::AssistVariant;
use super::answer::signature;
use crate::reasoning::error::PromptError;
use crate::reasoning::prompt_set::PromptSet;
use crate::reasoning::templates::Templates;
use crate::reasoning::variables;

/// The prompts of a variant; short ones for models that read the compact texts.
#[derive(Debug)]
pub(super) struct AssistPrompts<'a> {
    templates: &'a Templates,
    variant: AssistVariant,
    compact: bool,
}

impl<'a> AssistPrompts<'a> {
    /// The prompts for models that are asked with a prompt set.
    pub(super) fn new(variant: AssistVariant, prompts: &'a PromptSet) -> Result<Self, PromptError> {
        let templates = prompts.question_set(match variant {
            AssistVariant::Unconstrained => "llm_assist_unc",
            AssistVariant::Parameters => "llm_assist_par",
        })?;
        Ok(Self {
            templates,
            variant,
            compact: prompts.forms().scene_text.is_for_small_models(),
        })
    }

    pub(super) fn system(&self) -> Result<String, PromptError> {
        let signature = signature(self.variant).to_string();
        self.templates
            .render("system", variables::assist_system(&signature, self.compact))
    }

    /// The question about a scene, with the score of PDM-Closed's best proposal and feedback on the
    /// last answer.
    pub(super) fn question(
        &self,
        scene: &str,
        score: f64,
        feedback: Option<&str>,
    ) -> Result<String, PromptError> {
        self.templates.render(
            "question",
            variables::assist_question(scene, score, feedback, self.compact),
        )
    }
}
