//! The prompts of both variants.

use super::AssistVariant;
use super::answer::signature;
use crate::environment::TextForm;
use crate::reasoning::error::PromptError;
use crate::reasoning::templates::Templates;
use minijinja::context;

/// Templates of the unconstrained variant: system prompt and question.
const UNCONSTRAINED: [(&str, &str); 2] = [
    ("system", include_str!("../../../prompts/llm_assist_unc/system.jinja")),
    ("question", include_str!("../../../prompts/llm_assist_unc/question.jinja")),
];
/// Templates of the other variant.
const PARAMETERS: [(&str, &str); 2] = [
    ("system", include_str!("../../../prompts/llm_assist_par/system.jinja")),
    ("question", include_str!("../../../prompts/llm_assist_par/question.jinja")),
];

/// The prompts of a variant; short ones for models that read the compact texts.
#[derive(Debug)]
pub(super) struct AssistPrompts {
    templates: Templates,
    variant: AssistVariant,
    compact: bool,
}

impl AssistPrompts {
    /// The prompts for models that read scene texts of this form.
    pub(super) fn new(variant: AssistVariant, form: TextForm) -> Result<Self, PromptError> {
        let (set, sources) = match variant {
            AssistVariant::Unconstrained => ("llm_assist_unc", UNCONSTRAINED),
            AssistVariant::Parameters => ("llm_assist_par", PARAMETERS),
        };
        let templates = Templates::compile(set, sources.map(|(name, source)| (name, source.to_owned())))?;
        Ok(Self { templates, variant, compact: form == TextForm::Compact })
    }

    pub(super) fn system(&self) -> Result<String, PromptError> {
        let signature = signature(self.variant).to_string();
        self.templates.render("system", context! { compact => self.compact, signature => signature })
    }

    /// The question about a scene, with the score of PDM-Closed's best proposal and feedback on the last answer.
    pub(super) fn question(&self, scene: &str, score: f64, feedback: Option<&str>) -> Result<String, PromptError> {
        let score = format!("{score:.2}");
        let context = context! { compact => self.compact, scene_text => scene, score => score, feedback => feedback };
        self.templates.render("question", context)
    }
}
