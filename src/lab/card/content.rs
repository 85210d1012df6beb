//! What `card.json` has.

use super::calibration::Calibration;
use super::calls::CallCounts;
use super::measured::Measured;
use super::outcome::Part;
use super::pictures::PictureAnswers;
use super::reasoning::Reasoning;
use super::scores::SourceScore;
use crate::twins::TwinResults;
use planagent_mllm::{MergedAdapter, ModelDescription, Server};
use planagent_runs::worker::statistics::Bootstrap;
use serde::Serialize;

/// Version of the format.
pub(super) const FORMAT: u32 = 1;

/// A card. All but [`Card::measured`] is the same each time that it is made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Card {
    pub(super) format: u32,
    pub(super) planagent: &'static str,
    /// Results of other versions are not comparable.
    pub(super) result_version: u32,
    /// The command that makes it.
    pub(super) command: String,
    pub(super) model: CardModel,
    pub(super) seed: u64,
    pub(super) limit: usize,
    pub(super) bootstrap: Bootstrap,
    /// Of each suite and challenge, the model and the sources that it is compared with.
    pub(super) scores: Vec<SourceScore>,
    /// The planning calls of the model in these simulations.
    pub(super) calls: Vec<CallCounts>,
    /// States at which it was asked, and those at which it gave no answer.
    pub(super) states: StateCounts,
    pub(super) calibration: Part<Calibration>,
    pub(super) pictures: Part<Vec<PictureAnswers>>,
    pub(super) twins: Part<TwinResults>,
    pub(super) reasoning: Reasoning,
    /// Measurements, and what follows from them.
    pub(super) measured: Part<Measured>,
}

/// The model of a card.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct CardModel {
    pub(super) name: String,
    pub(super) architecture: String,
    /// Number of weights; 0 for a server.
    pub(super) parameters: u64,
    pub(super) weights_blake3: String,
    /// The adapter that is merged into these weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) adapter: Option<MergedAdapter>,
    /// Whether it is asked with a picture.
    pub(super) sees: bool,
    pub(super) server: Option<Server>,
    pub(super) prompt_set: String,
    pub(super) prompts_blake3: String,
}

impl CardModel {
    pub(super) fn new(
        about: &ModelDescription,
        sees: bool,
        prompt_set: &str,
        prompts_blake3: &str,
    ) -> Self {
        Self {
            name: about.name.clone(),
            architecture: about.architecture.clone(),
            parameters: about.parameters,
            weights_blake3: about.weights_blake3.clone(),
            adapter: about.load.adapter.clone(),
            sees,
            server: about.server.clone(),
            prompt_set: prompt_set.to_owned(),
            prompts_blake3: prompts_blake3.to_owned(),
        }
    }
}

/// States at which a model was asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub(super) struct StateCounts {
    pub(super) asked: usize,
    /// The model failed, or its deadline passed: they are no part of any share.
    pub(super) unanswered: usize,
}
