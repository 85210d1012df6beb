//! The options about a model and how it is loaded.

use clap::Args;
use planagent_mllm::WeightFormat;
use std::num::NonZeroUsize;
use std::path::PathBuf;

/// Heading of these options.
const HEADING: &str = "Model";

/// What the options say; empty for a command without such options.
#[derive(Debug, Default)]
pub(crate) struct ModelFlags {
    pub(crate) model: Option<String>,
    pub(crate) prompt_set: Option<String>,
    pub(crate) adapter: Option<PathBuf>,
    pub(crate) quantize: Option<WeightFormat>,
    pub(crate) context: Option<usize>,
    pub(crate) ignore_memory: bool,
    pub(crate) offline: bool,
    pub(crate) trust_model: bool,
}

/// The model of a command.
#[derive(Debug, Args)]
pub(crate) struct ModelArguments {
    /// Model: a name of `models list`, a folder, a GGUF file, a hub id, or a description.
    ///
    /// A name of models/, a folder in Hugging Face's layout, a GGUF file, a hub id (ORG/NAME,
    /// ORG/NAME/FILE.gguf or ORG/NAME:QUANT), or a description FILE.toml. A description may name a
    /// server with OpenAI's chat completions.
    #[arg(long, value_name = "MODEL", help_heading = HEADING)]
    model: Option<String>,
    /// Prompt set: paper, brief, compact, compact-2, or a folder [default: the model's own].
    ///
    /// paper, brief, compact, compact-2, a folder of prompts/, or the path of a folder of
    /// templates. By default, the description of the model names it, or planagent.json among its
    /// files; else it is paper.
    #[arg(long, value_name = "SET", help_heading = HEADING, hide_short_help = true)]
    prompt_set: Option<String>,
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
}

/// What is merged into the weights.
#[derive(Debug, Args)]
pub(crate) struct AdapterArgument {
    /// Adapter to merge into the model: a PEFT folder, or a GGUF file of llama.cpp's LoRA.
    ///
    /// LoRA, rsLoRA, DoRA, PiSSA and OLoRA are merged when the model is loaded, into weights of any
    /// format. The default is that of the model's description.
    #[arg(long, value_name = "PATH", help_heading = HEADING, hide_short_help = true)]
    pub(crate) adapter: Option<PathBuf>,
}

/// Whether the user vouches for the files of the model.
#[derive(Debug, Args)]
pub(crate) struct TrustArgument {
    /// Trust the model's files: open its tokenizer and chat template without a trial.
    ///
    /// Both are programs by nature. By default, a child process with limits of memory and time
    /// tries them first, once for each content of the files.
    #[arg(long, help_heading = HEADING, hide_short_help = true)]
    trust_model: bool,
}

/// The format of weights in memory.
#[derive(Debug, Args)]
pub(crate) struct FormatArgument {
    /// Weight format in memory: `f32`, `f16`, `q8_0`, `q6_k`, `q5_1`, `q5_k`, `q5_0`, `q4_1`,
    /// `q4_k`, `q4_0` or `q3_k`.
    ///
    /// The default is that of the model's description, else of the files; bf16 becomes f32.
    #[arg(long, value_name = "KIND", help_heading = HEADING, hide_short_help = true)]
    quantize: Option<WeightFormat>,
}

/// How much memory a model may need, and what to do without enough.
#[derive(Debug, Args)]
pub(crate) struct MemoryArgument {
    /// Longest chat, tokens: prompts, image and answers [default: the model's].
    ///
    /// It bounds the memory of keys and values. A prompt that does not fit is an error; an answer
    /// ends there.
    #[arg(long, alias = "ctx-size", value_name = "TOKENS", help_heading = HEADING, hide_short_help = true)]
    context: Option<NonZeroUsize>,
    /// Load the model even if it seems to need more memory than is free.
    #[arg(long, help_heading = HEADING, hide_short_help = true)]
    ignore_memory: bool,
}

/// Whether the network may be used.
#[derive(Debug, Args)]
pub(crate) struct NetworkArgument {
    /// Do not use the network: models of the hub must be in the cache.
    #[arg(long, help_heading = HEADING, hide_short_help = true)]
    offline: bool,
}

impl ModelArguments {
    /// What the options say.
    pub(super) fn flags(&self) -> ModelFlags {
        let Self {
            model,
            prompt_set,
            adapter,
            format,
            memory,
            network,
            trust,
        } = self;
        let rest = ModelFlags::from_arguments(Some(format), Some(memory), network, Some(trust));
        ModelFlags {
            model: model.clone(),
            prompt_set: prompt_set.clone(),
            adapter: adapter.adapter.clone(),
            ..rest
        }
    }
}

impl ModelFlags {
    /// What the options of a command say that has some of them.
    pub(super) fn from_arguments(
        format: Option<&FormatArgument>,
        memory: Option<&MemoryArgument>,
        network: &NetworkArgument,
        trust: Option<&TrustArgument>,
    ) -> Self {
        Self {
            model: None,
            prompt_set: None,
            adapter: None,
            quantize: format.and_then(|format| format.quantize),
            context: memory
                .and_then(|memory| memory.context)
                .map(NonZeroUsize::get),
            ignore_memory: memory.is_some_and(|memory| memory.ignore_memory),
            offline: network.offline,
            trust_model: trust.is_some_and(|trust| trust.trust_model),
        }
    }
}
