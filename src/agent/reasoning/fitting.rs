//! Which built-in prompt sets fit the context of a model.

use super::engine::{ReasoningSettings, ScenarioPrompt, round_prompt, system_prompt};
use super::error::ReasoningError;
use super::prompt_set::PromptSet;
use super::prompt_source::built_in_sets;
use crate::environment::text;
use planagent_mllm::{Mllm, MllmError};

/// A planning call whose prompts may fit.
pub(super) struct Fitting<'a> {
    pub(super) model: &'a dyn Mllm,
    pub(super) prompts: &'a PromptSet,
    pub(super) settings: &'a ReasoningSettings,
    pub(super) scenario: &'a ScenarioPrompt,
}

impl Fitting<'_> {
    /// The error of a permanent failure after a chat with these texts. A prompt that is too long
    /// names the prompt sets that fit.
    pub(super) fn failed<'t>(
        &self,
        source: MllmError,
        texts: impl IntoIterator<Item = &'t str>,
    ) -> ReasoningError {
        let MllmError::PromptTooLong { tokens, context } = source else {
            return source.into();
        };
        let texts = texts.into_iter().map(|text| self.model.count_tokens(text));
        let Some(of_texts) = texts.sum::<Option<usize>>() else {
            return source.into();
        };
        // Image and chat template.
        let beside = tokens.saturating_sub(of_texts);
        let fits = |name: &&str| {
            let set = PromptSet::open(name).ok();
            let needed = set.and_then(|set| self.needed(&set));
            needed.is_some_and(|needed| beside + needed < context)
        };
        let others = built_in_sets().filter(|name| *name != self.prompts.name());
        let fitting = others.filter(fits).collect();
        ReasoningError::PromptTooLong {
            source: Box::new(source),
            fitting,
        }
    }

    /// Tokens of the texts and the longest answers of a first attempt.
    fn needed(&self, set: &PromptSet) -> Option<usize> {
        let system = system_prompt(set, &self.scenario.legend).ok()?;
        let mut needed = self.model.count_tokens(&system)?;
        let description = self.scenario.description.as_ref();
        let scene = description.map(|described| text::write(described, set.forms().scene_text));
        let mut scene = scene.as_deref();
        for &round in &self.settings.rounds {
            let prompt = round_prompt(set, round, &self.scenario.names, scene.take(), None).ok()?;
            let of_model = self.settings.max_new_tokens(round);
            let answer = set.forms().max_tokens(round, of_model);
            needed += self.model.count_tokens(&prompt)? + answer;
        }
        Some(needed)
    }
}
