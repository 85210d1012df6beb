//! What can go wrong between a model folder and an answer.

use std::path::PathBuf;

/// Everything that can go wrong while opening or running a multimodal language model.
///
/// Each variant names the file, the key or the tensor that is at fault, so that a broken checkpoint can be repaired
/// from the message alone.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MllmError {
    /// A file that every model folder must hold is not there.
    #[error("{folder}: no {file} in this model folder")]
    MissingFile {
        /// The model folder.
        folder: PathBuf,
        /// The file, or the alternatives that were looked for.
        file: String,
    },
    /// A file exists but cannot be read.
    #[error("{path}: cannot be read: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// A JSON file is not JSON, or not of the shape that its format asks for.
    #[error("{path}: {source}")]
    Json {
        /// The file.
        path: PathBuf,
        /// Line, column and problem.
        source: serde_json::Error,
    },
    /// A configuration key is missing, of the wrong type, unsupported, or contradicts another.
    #[error("{path}: {key}: {problem}")]
    Config {
        /// The configuration file.
        path: PathBuf,
        /// The key, with dots for nesting (`text_config.hidden_size`).
        key: String,
        /// What is wrong with its value.
        problem: String,
    },
    /// A weight file is truncated or its header is broken.
    #[error("{path}: broken safetensors file: {problem}")]
    Safetensors {
        /// The weight file.
        path: PathBuf,
        /// What the format check found.
        problem: String,
    },
    /// A GGUF file is truncated, or its header cannot be right.
    #[error("{path}: broken GGUF file: {problem}")]
    Gguf {
        /// The file.
        path: PathBuf,
        /// What is wrong, and at which byte or key.
        problem: String,
    },
    /// Two tensors of a checkpoint mean the same weights.
    #[error("{place}: tensor {name} occurs twice in the checkpoint, perhaps under names of two layouts")]
    TwiceStored {
        /// The model folder or file.
        place: PathBuf,
        /// One of the two, by its name in the file.
        name: String,
    },
    /// A file of a model cannot be written.
    #[error("the {what} cannot be written: {source}")]
    Write {
        /// Which part of the model.
        what: String,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// A model needs more memory than is free.
    #[error("{place}: {problem}")]
    Memory {
        /// The model folder or file.
        place: PathBuf,
        /// What it needs, what is free, and what to do.
        problem: String,
    },
    /// A tensor that the configuration asks for is in none of the weight files.
    #[error("{folder}: tensor {name} is missing from the checkpoint")]
    MissingTensor {
        /// The model folder.
        folder: PathBuf,
        /// The tensor, by its name in the current Hugging Face layout.
        name: String,
    },
    /// A tensor has another shape than the configuration asks for.
    #[error("{path}: tensor {name} has shape {found:?}, the configuration asks for {expected:?}")]
    TensorShape {
        /// The weight file.
        path: PathBuf,
        /// The tensor, by its name in the file.
        name: String,
        /// The shape that follows from `config.json`.
        expected: Vec<usize>,
        /// The shape in the file.
        found: Vec<usize>,
    },
    /// A tensor is stored in a number format that is not read.
    #[error("{path}: tensor {name} is stored as {found}; f32, f16 and bf16 are read")]
    TensorType {
        /// The weight file.
        path: PathBuf,
        /// The tensor, by its name in the file.
        name: String,
        /// Its number format.
        found: String,
    },
    /// A weight is NaN or infinite.
    #[error("{path}: tensor {name} holds {value} at element {element}")]
    NonFiniteWeight {
        /// The weight file.
        path: PathBuf,
        /// The tensor, by its name in the file.
        name: String,
        /// Index of the first such element, row-major.
        element: usize,
        /// Its value.
        value: f32,
    },
    /// The tokenizer file cannot be used.
    #[error("{path}: {problem}")]
    Tokenizer {
        /// The tokenizer file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// The tokenizer makes token ids that the model has no embedding for.
    #[error("token {token:?} has id {id}, but the model's vocabulary has {vocabulary} entries")]
    Vocabulary {
        /// The token.
        token: String,
        /// Its id.
        id: u32,
        /// Number of rows of the model's embedding.
        vocabulary: usize,
    },
    /// The rendered prompt does not hold the image placeholder exactly as often as there are images.
    #[error("the rendered prompt holds the image token {found} times, expected {expected}")]
    ImagePlaceholder {
        /// How often it should stand there: 1 with an image, 0 without.
        expected: usize,
        /// How often it stands there.
        found: usize,
    },
    /// The image given to a conversation cannot be used.
    #[error("the image cannot be used: {problem}")]
    Image {
        /// What is wrong with it.
        problem: String,
    },
    /// The chat template cannot be compiled or rendered.
    #[error("{path}: chat template: {problem}")]
    ChatTemplate {
        /// The file that the template came from.
        path: PathBuf,
        /// What the template engine said.
        problem: String,
    },
    /// A grammar cannot be compiled or followed. It is never silently dropped.
    #[error("constraint {constraint}: {problem}")]
    Grammar {
        /// The constraint, shortened.
        constraint: String,
        /// What the grammar engine said.
        problem: String,
    },
    /// A request asks for something impossible, such as a temperature below zero.
    #[error("request: {problem}")]
    Request {
        /// What is wrong with it.
        problem: String,
    },
    /// The prompt does not fit into the model's context.
    #[error(
        "the prompt has {tokens} tokens, the model's context holds {context}; a shorter prompt set may fit (reasoning.prompt_set)"
    )]
    PromptTooLong {
        /// Tokens of the whole chat so far, image tokens included.
        tokens: usize,
        /// The model's `max_position_embeddings`.
        context: usize,
    },
    /// The model computed NaN or infinite logits.
    #[error("the model computed the logit {value} for token {token} at position {position}")]
    NonFiniteLogits {
        /// Position in the chat.
        position: usize,
        /// Token id of the first such logit.
        token: usize,
        /// Its value.
        value: f32,
    },
    /// A model description (`models/NAME.toml`) cannot be read as one.
    #[error("{path}: {problem}")]
    Description {
        /// The description file.
        path: PathBuf,
        /// Line and problem.
        problem: String,
    },
    /// No model goes by this name.
    #[error(
        "no model {name:?}: it is neither a description in {models}, nor a folder, nor a hub id; described: {known}"
    )]
    UnknownModel {
        /// The name that was asked for.
        name: String,
        /// The folder of model descriptions.
        models: PathBuf,
        /// The names that exist there, joined by commas.
        known: String,
    },
    /// No shape goes by this name.
    #[error("no model shape {name:?}; known are {known}")]
    UnknownShape {
        /// The name that was asked for.
        name: String,
        /// The names that exist, joined by commas.
        known: String,
    },
    /// A model of the hub is not in the local cache and must not be downloaded.
    #[error("{id} (revision {revision}): {file} is not in the cache {cache}, and downloads are off")]
    NotInCache {
        /// The hub id, `organization/name`.
        id: String,
        /// The revision that was asked for.
        revision: String,
        /// The missing file.
        file: String,
        /// The cache folder that was searched.
        cache: PathBuf,
    },
    /// The hub could not be reached or refused.
    #[error("{id} (revision {revision}): {problem}")]
    Hub {
        /// The hub id, `organization/name`.
        id: String,
        /// The revision that was asked for.
        revision: String,
        /// What the hub client said.
        problem: String,
    },
    /// The planning call's deadline passed before the answer was there.
    #[error("the deadline of the planning call passed (agent.deadline_ms)")]
    Deadline,
    /// The environment variable that an endpoint's description names for its key cannot be used.
    #[error("the key of the endpoint is read from ${variable}, which {problem}")]
    Key {
        /// The variable.
        variable: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A server must not be asked.
    #[error("{endpoint} is asked over the network, which mllm.offline forbids")]
    Offline {
        /// Its address.
        endpoint: String,
    },
    /// There are no files of a model, since a server computes it.
    #[error("there are no files of {name:?}: {endpoint} computes it")]
    NoFiles {
        /// The model.
        name: String,
        /// The server's address.
        endpoint: String,
    },
    /// A server did not answer, or nonsense.
    #[error("{endpoint}: {failure}")]
    Endpoint {
        /// Its address.
        endpoint: String,
        /// What happened.
        failure: EndpointFailure,
    },
    /// A tensor operation failed.
    #[error("tensor operation failed: {0}")]
    Tensor(#[from] candle_core::Error),
}

impl MllmError {
    /// Whether the next planning call may well succeed: the deadline passed, or a server failed in a way that can pass.
    /// Such an error ends its planning call; any other ends the drive.
    pub fn is_transient(&self) -> bool {
        match self {
            Self::Deadline => true,
            Self::Endpoint { failure, .. } => !matches!(failure, EndpointFailure::Refused { .. }),
            _ => false,
        }
    }
}

/// What a server did instead of answering. No text of it holds the key.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EndpointFailure {
    /// No connection could be made.
    #[error("cannot connect: {0}")]
    Connect(String),
    /// The answer was not complete within the time limit.
    #[error("no complete answer within {0:.1?} (timeout_ms of the model's description)")]
    Timeout(std::time::Duration),
    /// The connection ended before the answer did.
    #[error("the connection was closed before the answer was complete: {0}")]
    Closed(String),
    /// It is too busy (429) or failed (5xx).
    #[error("status {status}: {message}")]
    Unavailable {
        /// HTTP status.
        status: u16,
        /// What the server says.
        message: String,
    },
    /// It asks to wait longer than a request may take.
    #[error("status {status}: it asks to wait {seconds} s (Retry-After), longer than a request may take")]
    Wait {
        /// HTTP status.
        status: u16,
        /// What it asks for, seconds.
        seconds: u64,
    },
    /// It refuses such requests: a wrong key, an unknown model or address, a field that it does not know.
    #[error("status {status}: {message}")]
    Refused {
        /// HTTP status.
        status: u16,
        /// What the server says.
        message: String,
    },
    /// It answered what is no chat completion.
    #[error("the answer is no chat completion: {0}")]
    InvalidReply(String),
    /// It answers without end.
    #[error("the answer is longer than {0} bytes")]
    TooLong(u64),
}
