//! GameFormer's network (Huang et al. 2023; `MCZhi/GameFormer-Planner` `predictor.py`, `predictor_modules.py`).

mod decoder;
mod encoder;
mod features;
mod network;
mod plan;

pub(in crate::planner::learned) use encoder::{Block, HEADS, SceneEncoder};
pub use encoder::{EncodedScene, SceneInputs};
pub use features::ActorFeatures;
pub use network::{GameFormer, GameFormerConfig, GameFormerOutputs};
