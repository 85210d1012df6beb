//! Shared parts of image encoding: preprocessing, the CLIP tower, attention.

mod attention;
mod clip;
mod pixels;
mod processor;
mod resample;

pub(crate) use attention::{SelfAttention, embed, unfold};
pub(crate) use clip::ClipVisionTower;
pub(crate) use pixels::{PixelScale, check_not_empty};
pub(crate) use processor::{ClipImageProcessor, ProcessorKeys, read_processor};
pub(crate) use resample::{Filter, resize};
