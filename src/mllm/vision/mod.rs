//! Shared parts of image encoding: preprocessing, the CLIP tower, attention.

mod attention;
mod clip;
mod layer;
mod patches;
mod pixels;
mod processor;
mod resample;
mod siglip;

pub(crate) use attention::{Part, SelfAttention, embed};
pub(crate) use clip::ClipVisionTower;
pub(crate) use layer::VisionLayer;
pub(crate) use patches::{merge_blocks, take_patch_embedding, unfold};
pub(crate) use pixels::{PixelScale, check_not_empty, check_picture, check_tiles};
pub(crate) use processor::{ClipImageProcessor, ProcessorKeys, Side, Sides, read_processor};
pub(crate) use resample::{Filter, resize};
pub(crate) use siglip::SiglipVisionTower;
