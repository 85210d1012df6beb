//! Section `reasoning` of the configuration.

use super::{PromptError, PromptSet, Proposals, ReasoningSettings, Round, Speculation};
use planagent_mllm::{GenerationSettings, Sampling};
use serde::{Deserialize, Serialize};

/// How the model is asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReasoningConfig {
    /// `paper`, `brief`, `compact`, a folder of `prompts/`, or the path of a folder of templates;
    /// `None` for the set that the model's description or its own files name.
    pub prompt_set: Option<String>,
    /// The rounds in order; the last must be `code`.
    pub rounds: Vec<Round>,
    /// Sampling temperature of later attempts; 0 takes the most likely token. The model's
    /// description decides for the first.
    pub rethink_temperature: f64,
    /// Whether answers are decoded under grammars.
    pub grammar: bool,
    /// Where drafts of answers come from: `none` or `history`, the default. No answer depends on
    /// it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speculation: Option<Speculation>,
    /// Codes that an attempt proposes, 1 to 4: the likeliest ones under the grammar. Reflection
    /// tries all of them out, and the best one is the attempt's. 1 is the paper's.
    #[serde(skip_serializing_if = "Proposals::is_one")]
    pub proposals: Proposals,
}

impl Default for ReasoningConfig {
    fn default() -> Self {
        Self {
            prompt_set: None,
            rounds: Round::ALL.to_vec(),
            rethink_temperature: 0.7,
            grammar: true,
            speculation: None,
            proposals: Proposals::default(),
        }
    }
}

impl ReasoningConfig {
    /// The prompt set for a model whose own is `of_model`.
    pub fn prompts(&self, of_model: &str) -> Result<PromptSet, PromptError> {
        PromptSet::open(self.prompt_set.as_deref().unwrap_or(of_model))
    }

    /// The settings for a model with these generation settings.
    pub fn settings(&self, generation: GenerationSettings) -> ReasoningSettings {
        let rethink_sampling = if self.rethink_temperature > 0.0 {
            Sampling::Sample {
                temperature: self.rethink_temperature,
                top_p: 1.0,
            }
        } else {
            Sampling::Greedy
        };
        let speculation = self.speculation.unwrap_or_default();
        ReasoningSettings {
            rounds: self.rounds.clone(),
            generation,
            rethink_sampling,
            grammar: self.grammar,
            speculation,
            proposals: self.proposals,
        }
    }
}
