//! The measuring process of this program.

use super::budget::Layout;
use super::protocol::{LoadRequest, Loaded, ModelChoice, Reply, Request};
use crate::mllm::{Architecture, LatencyProbe, MllmError, ModelRegistry, ModelShape};
use std::io::{self, BufRead, Write};
use std::time::Instant;

/// Answers requests until there are no more.
///
/// # Errors
/// When a reply cannot be written; whatever else fails is a reply.
pub fn serve(registry: &ModelRegistry, requests: impl BufRead, mut replies: impl Write) -> io::Result<()> {
    let mut probe = None;
    for line in requests.lines() {
        let reply = match serde_json::from_str(&line?) {
            Ok(request) => {
                answer(registry, &mut probe, request).unwrap_or_else(|error| Reply::Failed(error.to_string()))
            }
            Err(error) => Reply::Failed(format!("this is no request: {error}")),
        };
        writeln!(replies, "{}", serde_json::to_string(&reply)?)?;
        replies.flush()?;
    }
    Ok(())
}

fn answer(registry: &ModelRegistry, probe: &mut Option<LatencyProbe>, request: Request) -> Result<Reply, MllmError> {
    if let Request::Load(request) = request {
        let (loaded, opened) = load(registry, &request)?;
        *probe = Some(opened);
        return Ok(Reply::Loaded(loaded));
    }
    let Some(probe) = probe else { return Ok(Reply::Failed("no model is loaded".into())) };
    match request {
        Request::Run(steps) => Ok(Reply::Ran(steps.into_iter().map(|step| probe.run(step)).collect::<Result<_, _>>()?)),
        Request::Load(_) | Request::Write(_) => Ok(Reply::Failed("GGUF files cannot be written yet".into())),
    }
}

fn load(registry: &ModelRegistry, request: &LoadRequest) -> Result<(Loaded, LatencyProbe), MllmError> {
    let start = Instant::now();
    let probe = match &request.model {
        ModelChoice::Random(shape) => {
            LatencyProbe::random(ModelShape::find(shape)?, request.storage.unwrap_or_default(), request.seed)?
        }
        ModelChoice::Named(name) => LatencyProbe::open(&registry.folder(&registry.find(name)?)?, request.seed)?,
        ModelChoice::Gguf(_) => todo!(),
    };
    let load_s = start.elapsed().as_secs_f64();
    let about = probe.describe()?;
    let layout = match about.architecture {
        Architecture::Llava | Architecture::LlavaNext => Layout::OpeningFirst,
        Architecture::CogVlm => Layout::ImageFirst,
    };
    let version = env!("CARGO_PKG_VERSION").to_owned();
    let loaded = Loaded {
        parameters: about.parameters,
        storage: about.storage,
        image_side: about.image_side,
        image_tokens: about.image_tokens,
        context: about.context,
        layout,
        load_s,
        version,
    };
    Ok((loaded, probe))
}
