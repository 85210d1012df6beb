//! The measuring process of this program.

use super::budget::Layout;
use super::protocol::{GgufPair, LoadRequest, Loaded, ModelChoice, Reply, Request};
use planagent_mllm::{LatencyProbe, MllmError, ModelPlace, ModelRegistry, ModelShape};
use std::io::{self, BufRead, Write};
use std::time::Instant;

/// Answers requests until the input ends.
///
/// # Errors
/// When a reply cannot be written. Any other failure is a reply.
pub fn serve(
    registry: &ModelRegistry,
    requests: impl BufRead,
    mut replies: impl Write,
) -> io::Result<()> {
    let mut probe = None;
    for line in requests.lines() {
        let reply = match serde_json::from_str(&line?) {
            Ok(request) => answer(registry, &mut probe, request)
                .unwrap_or_else(|error| Reply::Failed(error.to_string())),
            Err(error) => Reply::Failed(format!("invalid request: {error}")),
        };
        writeln!(replies, "{}", serde_json::to_string(&reply)?)?;
        replies.flush()?;
    }
    Ok(())
}

fn answer(
    registry: &ModelRegistry,
    probe: &mut Option<LatencyProbe>,
    request: Request,
) -> Result<Reply, MllmError> {
    Ok(match (request, probe) {
        (Request::Load(request), probe) => {
            let (loaded, opened) = load(registry, &request)?;
            *probe = Some(opened);
            Reply::Loaded(loaded)
        }
        (Request::Run(steps), Some(probe)) => Reply::Ran(
            steps
                .into_iter()
                .map(|step| probe.run(step))
                .collect::<Result<_, _>>()?,
        ),
        (Request::Run(_), None) => Reply::Failed("no model is loaded".into()),
    })
}

fn load(
    registry: &ModelRegistry,
    request: &LoadRequest,
) -> Result<(Loaded, LatencyProbe), MllmError> {
    let start = Instant::now();
    let registry = registry.clone().with_quantize(request.weight_format);
    let (place, loading) = match &request.model {
        ModelChoice::Named(name) => {
            let spec = registry.find(name)?;
            (registry.place(&spec)?, registry.loading(&spec)?)
        }
        ModelChoice::Random(shape) => {
            let place = ModelPlace::Random {
                shape: ModelShape::find(shape)?,
                seed: request.seed,
            };
            (place, registry.plain_loading())
        }
        ModelChoice::Gguf(GgufPair { decoder, projector }) => {
            let place = ModelPlace::Gguf {
                model: decoder.clone(),
                mmproj: Some(projector.clone()),
            };
            (place, registry.plain_loading())
        }
    };
    let probe = LatencyProbe::open(&place, &loading, request.seed)?;
    let load_s = start.elapsed().as_secs_f64();
    let (model, image_tokens) = (probe.model(), probe.image_tokens()?);
    let info = model.info();
    let loaded = Loaded {
        parameters: info.parameters,
        weight_format: probe.weight_format().to_string(),
        image_side: info.image_size.map_or(0, |side| side as u32),
        image_tokens,
        context: model.context(image_tokens),
        layout: if info.image_first {
            Layout::ImageFirst
        } else {
            Layout::PrefixFirst
        },
        load_s,
        version: env!("CARGO_PKG_VERSION").to_owned(),
    };
    Ok((loaded, probe))
}
