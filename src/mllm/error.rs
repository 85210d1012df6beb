//! Errors of models, from the model folder to the answer.

use std::path::PathBuf;

/// An error while opening or running a vision-language model.
///
/// Each message names the file, key or tensor at fault, so that a user can repair a broken
/// checkpoint from it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MllmError {
    #[error("{folder}: the model folder has no {file}")]
    MissingFile { folder: PathBuf, file: String },
    #[error("not on this machine: there is no {}", path.display())]
    Absent { path: PathBuf },
    #[error(
        "{}: {problem}; if you trust these files, --trust-model or `trusted = true` in the model's description opens them \
         untried", place.display()
    )]
    Trial { place: PathBuf, problem: String },
    /// The child process that tried the files could not open them.
    #[error("{problem}")]
    Unopened { problem: String },
    #[error(
        "{}: a chat template and a tokenizer are programs by nature, and nobody vouches for these; AgentBuilder::trust_model \
         does, or `trusted = true` in the model's description", place.display()
    )]
    Untrusted { place: PathBuf },
    #[error("{}: opening the model panicked: {message}", place.display())]
    Panicked { place: PathBuf, message: String },
    #[error("cannot read {path}: {source}")]
    Read {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error(
        "{path}: this is a pointer of git-lfs, not the file; `git lfs pull` in its repository, or `planagent models fetch` \
         with the model's hub id, brings the file"
    )]
    LfsPointer { path: PathBuf },
    #[error("{path}: {source}")]
    Json {
        path: PathBuf,
        source: serde_json::Error,
    },
    #[error("{path}: {key}: {problem}")]
    Config {
        path: PathBuf,
        key: String,
        problem: String,
    },
    #[error("{path}: broken safetensors file: {problem}")]
    Safetensors { path: PathBuf, problem: String },
    #[error("{path}: broken GGUF file: {problem}")]
    Gguf { path: PathBuf, problem: String },
    #[error(
        "{place}: the checkpoint has tensor {name} twice, perhaps under the names of two layouts"
    )]
    TwiceStored { place: PathBuf, name: String },
    #[error("cannot write the {what}: {source}")]
    Write {
        what: String,
        source: std::io::Error,
    },
    #[error("{place}: {problem}")]
    Memory { place: PathBuf, problem: String },
    #[error("{folder}: tensor {name} is missing from the checkpoint")]
    MissingTensor { folder: PathBuf, name: String },
    #[error("{path}: tensor {name} has shape {found:?}; the configuration requires {expected:?}")]
    TensorShape {
        path: PathBuf,
        name: String,
        expected: Vec<usize>,
        found: Vec<usize>,
    },
    #[error(
        "{path}: tensor {name} has number format {found}; f32, f16 and bf16 are read from safetensors, others where \
         a quantization_config describes them: take the model's original repository (--quantize makes it small), or a GGUF file"
    )]
    TensorType {
        path: PathBuf,
        name: String,
        found: String,
    },
    /// A tensor or a layer of a quantizer's folder.
    #[error("{path}: {name}: {problem}")]
    PackedTensor {
        path: PathBuf,
        name: String,
        problem: String,
    },
    #[error(
        "{path}: tensor {name} has number format {format}, which is not read; take a file of the same model in Q4_K_M, \
         Q5_K_M, Q6_K or Q8_0"
    )]
    GgufFormat {
        path: PathBuf,
        name: String,
        format: &'static str,
    },
    #[error(
        "draft_model {place}: {problem}; a draft model has the vocabulary of the model that it drafts for"
    )]
    DraftModel { place: PathBuf, problem: String },
    #[error("adapter {}: {problem}", path.display())]
    Adapter { path: PathBuf, problem: String },
    #[error("{path}: element {element} of tensor {name} is {value}")]
    NonFiniteWeight {
        path: PathBuf,
        name: String,
        element: usize,
        value: f32,
    },
    #[error("{path}: {problem}")]
    Tokenizer { path: PathBuf, problem: String },
    #[error("token '{}' has id {id}, but the model's vocabulary has {vocabulary} entries", token.escape_debug())]
    Vocabulary {
        token: String,
        id: u32,
        vocabulary: usize,
    },
    #[error("the rendered prompt has {found} image tokens, expected {expected}")]
    ImagePlaceholder { expected: usize, found: usize },
    #[error("cannot use the image: {problem}")]
    Image { problem: String },
    #[error("{path}: chat template: {problem}")]
    ChatTemplate { path: PathBuf, problem: String },
    #[error("constraint {constraint}: {problem}")]
    Grammar { constraint: String, problem: String },
    #[error("request: {problem}")]
    Request { problem: String },
    #[error(
        "the prompt has {tokens} tokens and the model's context {context}; raise --context where it is lower than the \
         model allows, or choose a prompt set in fewer tokens (--prompt-set)"
    )]
    PromptTooLong { tokens: usize, context: usize },
    #[error("the logit of token {token} at position {position} is {value}")]
    NonFiniteLogits {
        position: usize,
        token: usize,
        value: f32,
    },
    #[error(
        "the decoder gave no logits after {position} tokens of the chat; this is a fault of the program: please report it with \
         the name of the model"
    )]
    MissingLogits { position: usize },
    #[error("{path}: {problem}")]
    Description { path: PathBuf, problem: String },
    #[error(
        "unknown model '{name}': not a description in {models}, a folder or a hub id; described models: {known}"
    )]
    UnknownModel {
        name: String,
        models: PathBuf,
        known: String,
    },
    #[error("there is no model file or folder {path}")]
    AbsentModel { path: PathBuf },
    #[error(
        "{path} is no model: name a folder as Hugging Face writes it, a GGUF file or a description (.toml){}",
        kind.map_or(String::new(), |kind| format!(" (the file is {kind})"))
    )]
    NoModelFile {
        path: PathBuf,
        /// What the file is, by its first bytes.
        kind: Option<&'static str>,
    },
    #[error("{path} is no model folder, but holds some: name one of {inner}")]
    OuterFolder { path: PathBuf, inner: String },
    #[error("unknown model shape '{name}'; choose one of {known}")]
    UnknownShape { name: String, known: String },
    #[error("{id} (revision {revision}): {file} is not in the cache {cache}; {advice}")]
    NotInCache {
        id: String,
        revision: Box<str>,
        file: String,
        cache: PathBuf,
        /// What is there instead, and how the file gets there.
        advice: Box<str>,
    },
    #[error("model '{word}': {problem}")]
    HubName { word: String, problem: String },
    #[error("{id} (revision {revision}): {problem}")]
    Hub {
        id: String,
        revision: String,
        problem: String,
    },
    #[error("the deadline of the planning call passed (agent.deadline_ms)")]
    Deadline,
    #[error("cannot read the API key of the endpoint: environment variable {variable} {problem}")]
    Key {
        variable: String,
        problem: &'static str,
    },
    #[error("mllm.offline forbids requests to {endpoint}{}", variable.map_or(String::new(), |variable| format!("; the environment variable {variable} sets it")))]
    Offline {
        endpoint: String,
        /// The variable that switches the network off, if one does.
        variable: Option<&'static str>,
    },
    #[error("model '{name}' has no files, because {endpoint} runs it")]
    NoFiles { name: String, endpoint: String },
    #[error("'{address}' is no address of a server: {problem}")]
    Address { address: String, problem: String },
    /// Nobody named a model, and the server's list does not decide.
    #[error(
        "{endpoint} offers {offered}; name one of its models behind the address, as in {endpoint}#NAME"
    )]
    ChooseModel { endpoint: String, offered: String },
    #[error("{endpoint}: {failure}")]
    Endpoint {
        endpoint: String,
        failure: EndpointFailure,
    },
    #[error("tensor operation failed: {0}")]
    Tensor(#[from] candle_core::Error),
}

impl MllmError {
    /// Whether a later planning call can succeed: the deadline passed, or a server failed for a
    /// time. A transient error ends its planning call, a permanent one the simulation.
    pub fn is_transient(&self) -> bool {
        match self {
            Self::Deadline => true,
            Self::Endpoint { failure, .. } => {
                use EndpointFailure::{Loading, Refused, Unusable};
                !matches!(failure, Refused { .. } | Unusable(_) | Loading { .. })
            }
            _ => false,
        }
    }
}

/// Why a server gave no answer. No text contains the API key.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EndpointFailure {
    #[error("cannot connect: {0}")]
    Connect(String),
    #[error("no complete answer within {0:.1?} (timeout_ms of the model's description)")]
    Timeout(std::time::Duration),
    #[error("the connection ended before the answer was complete: {0}")]
    Closed(String),
    #[error("status {status}: {message}")]
    Unavailable { status: u16, message: String },
    #[error(
        "status {status}: the server asks for a wait of {seconds} s (Retry-After), longer than timeout_ms"
    )]
    Wait { status: u16, seconds: u64 },
    /// The server says that it loads its model, and has not answered a request yet.
    #[error(
        "status {status}: {message}; the server still loaded its model after {waited:.0?}: start again when it is ready, or \
         raise timeout_ms"
    )]
    Loading {
        status: u16,
        message: String,
        waited: std::time::Duration,
    },
    #[error("status {status}: {message}")]
    Refused { status: u16, message: String },
    #[error("the answer is not a chat completion: {0}")]
    InvalidReply(String),
    /// A filter or the model itself refuses this prompt, and perhaps no other.
    #[error("no answer: {0}")]
    Withheld(String),
    /// A complete reply has no text of an answer.
    #[error("no answer: {0}")]
    NoAnswer(String),
    /// The first reply was of one of these kinds: the server or its address is not what the
    /// description says.
    #[error(
        "{0}; this was the server's first reply, so the address, the model or a setting is wrong"
    )]
    Unusable(String),
    #[error("the answer is longer than {0} bytes")]
    TooLong(u64),
}
