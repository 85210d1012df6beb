//! `ask`.

use super::data::DataArguments;
use super::model::ModelArguments;
use crate::picture::{PictureFile, picture_file};
use clap::{Args, value_parser};

/// Longest answer, tokens, unless the user sets another.
const DEFAULT_MAX_TOKENS: u32 = 256;

/// Arguments of `ask`.
#[derive(Debug, Args)]
pub(crate) struct AskArguments {
    /// The question.
    pub(crate) question: String,
    /// The scenario, as `simulate` takes it [default: one generated scenario].
    #[arg(long, value_name = "SCENARIO")]
    pub(crate) scenario: Option<String>,
    #[command(flatten)]
    pub(crate) data: DataArguments,
    /// Seconds after the start of the window.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub(crate) at: f64,
    /// Also give the model the text of the lane graph.
    #[arg(long)]
    pub(crate) lane_graph: bool,
    /// Longest answer, tokens.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_MAX_TOKENS, value_parser = value_parser!(u32).range(1..))]
    pub(crate) max_tokens: u32,
    /// Write the picture that the model is asked about to this file, a .png or .jpg.
    #[arg(long, value_name = "FILE", value_parser = picture_file())]
    pub(crate) image: Option<PictureFile>,
    #[command(flatten)]
    pub(super) model: ModelArguments,
}
