//! `models`.

use super::model::{
    AdapterArgument, FormatArgument, MemoryArgument, ModelFlags, NetworkArgument, TrustArgument,
};
use crate::help;
use clap::{Args, Subcommand};
use planagent_mllm::WeightFormat;
use std::path::PathBuf;

/// Subcommands of `models`.
#[derive(Debug, Subcommand)]
pub(crate) enum ModelsCommand {
    /// List the described models: size, license, image tokens, memory.
    ///
    /// `--json` and `--csv` have all that is known of them, bytes and sources among it.
    #[command(after_long_help = help::MODELS_LIST)]
    List {
        /// Print data on stdout as CSV.
        #[arg(long, conflicts_with = "json")]
        csv: bool,
    },
    /// Show what is known of a model: source, license, memory in every weight format.
    ///
    /// No weights are read.
    #[command(after_long_help = help::MODELS_SHOW)]
    Show {
        /// The model, as `--model` takes it.
        model: String,
        #[command(flatten)]
        adapter: AdapterArgument,
    },
    /// Check the files of models without reading the weights, and report every fault.
    ///
    /// The exit code is 1 if a model has a fault, or if one that is named is not on this machine.
    #[command(after_long_help = help::MODELS_CHECK)]
    Check {
        /// Models as `--model` takes them [default: all described models].
        models: Vec<String>,
        #[command(flatten)]
        adapter: AdapterArgument,
        #[command(flatten)]
        format: FormatArgument,
        #[command(flatten)]
        memory: MemoryArgument,
        #[command(flatten)]
        network: NetworkArgument,
        #[command(flatten)]
        trust: TrustArgument,
    },
    /// Download models of the hub.
    #[command(after_long_help = help::MODELS_FETCH)]
    Fetch {
        /// Models as `--model` takes them.
        #[arg(required = true)]
        models: Vec<String>,
        #[command(flatten)]
        network: NetworkArgument,
    },
    /// List the families of models: what opens, in which formats, and an example.
    #[command(after_long_help = help::MODELS_FAMILIES)]
    Families {
        /// Print the page docs/supported-models.md.
        #[arg(long, conflicts_with = "json")]
        markdown: bool,
    },
    /// Write a model as GGUF, for a faster start and for llama.cpp.
    #[command(after_long_help = help::MODELS_QUANTIZE)]
    Quantize(QuantizeArguments),
}

/// Arguments of `models quantize`.
#[derive(Debug, Args)]
pub(crate) struct QuantizeArguments {
    /// The model, as `--model` takes it.
    #[arg(value_name = "MODEL")]
    pub(crate) source: String,
    /// Weight format: `f32`, `f16`, `q8_0`, `q6_k`, `q5_1`, `q5_k`, `q5_0`, `q4_1`, `q4_k`, `q4_0`
    /// or `q3_k`.
    #[arg(long, value_name = "KIND")]
    pub(crate) to: WeightFormat,
    /// The file, NAME.gguf.
    ///
    /// The vision tower of a pair for llama.cpp is written beside it as mmproj-NAME.gguf.
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Overwrite existing files.
    #[arg(long)]
    pub(crate) force: bool,
    #[command(flatten)]
    adapter: AdapterArgument,
    #[command(flatten)]
    memory: MemoryArgument,
    #[command(flatten)]
    network: NetworkArgument,
    #[command(flatten)]
    trust: TrustArgument,
}

impl ModelsCommand {
    /// What the options about models say.
    pub(super) fn flags(&self) -> ModelFlags {
        // One match: an arm is a subcommand, and passes on the options that it has.
        match self {
            Self::List { .. } | Self::Families { .. } => ModelFlags::default(),
            Self::Show { adapter, .. } => ModelFlags {
                adapter: adapter.adapter.clone(),
                ..ModelFlags::default()
            },
            Self::Check {
                adapter,
                format,
                memory,
                network,
                trust,
                ..
            } => ModelFlags {
                adapter: adapter.adapter.clone(),
                ..ModelFlags::from_arguments(Some(format), Some(memory), network, Some(trust))
            },
            Self::Fetch { network, .. } => ModelFlags::from_arguments(None, None, network, None),
            Self::Quantize(QuantizeArguments {
                adapter,
                memory,
                network,
                trust,
                ..
            }) => ModelFlags {
                adapter: adapter.adapter.clone(),
                ..ModelFlags::from_arguments(None, Some(memory), network, Some(trust))
            },
        }
    }
}
