//! The measuring process of this program.

use super::budget::Layout;
use super::candle::{CandleError, CandleProbe};
use super::protocol::{ExportedFolder, GgufPair, LoadRequest, Loaded, ModelChoice, Reply, Request};
use planagent_mllm::{
    LatencyProbe, Limits, MllmError, ModelPlace, ModelRegistry, ModelShape, Step, StepTime,
};
use std::fmt::Display;
use std::io::{self, BufRead, Write};
use std::time::Instant;

/// A model whose steps are timed.
trait Probe: Sized {
    type Error: Display;

    fn open(registry: &ModelRegistry, request: &LoadRequest)
    -> Result<(Loaded, Self), Self::Error>;

    fn run(&mut self, step: Step) -> Result<StepTime, Self::Error>;

    fn answer(&mut self, prompt: &[u32], count: usize)
    -> Result<(Vec<f32>, Vec<u32>), Self::Error>;

    /// The tokens of a picture of ramps, and the numbers of at most `most` of them; none of an
    /// engine without a vision tower.
    fn features(&self, side: u32, most: usize) -> Result<(usize, Vec<f32>), Self::Error>;
}

impl Probe for LatencyProbe {
    type Error = MllmError;

    fn open(registry: &ModelRegistry, request: &LoadRequest) -> Result<(Loaded, Self), MllmError> {
        load(registry, request)
    }

    fn run(&mut self, step: Step) -> Result<StepTime, MllmError> {
        self.run(step)
    }

    fn answer(&mut self, prompt: &[u32], count: usize) -> Result<(Vec<f32>, Vec<u32>), MllmError> {
        self.answer(prompt, count)
    }

    fn features(&self, side: u32, most: usize) -> Result<(usize, Vec<f32>), MllmError> {
        self.features(side, most)
    }
}

impl Probe for CandleProbe {
    type Error = CandleError;

    fn open(
        registry: &ModelRegistry,
        request: &LoadRequest,
    ) -> Result<(Loaded, Self), CandleError> {
        Self::open(registry, request)
    }

    fn run(&mut self, step: Step) -> Result<StepTime, CandleError> {
        self.run(step)
    }

    fn answer(
        &mut self,
        prompt: &[u32],
        count: usize,
    ) -> Result<(Vec<f32>, Vec<u32>), CandleError> {
        self.answer(prompt, count)
    }

    fn features(&self, _side: u32, _most: usize) -> Result<(usize, Vec<f32>), CandleError> {
        Ok((0, Vec::new()))
    }
}

/// Answers requests until the input ends.
///
/// # Errors
/// When a reply cannot be written. Any other failure is a reply.
pub fn serve(
    registry: &ModelRegistry,
    requests: impl BufRead,
    replies: impl Write,
) -> io::Result<()> {
    serve_with::<LatencyProbe>(registry, requests, replies)
}

/// As [`serve`], with candle's decoders.
///
/// # Errors
/// When a reply cannot be written. Any other failure is a reply.
pub fn serve_candle(
    registry: &ModelRegistry,
    requests: impl BufRead,
    replies: impl Write,
) -> io::Result<()> {
    serve_with::<CandleProbe>(registry, requests, replies)
}

fn serve_with<P: Probe>(
    registry: &ModelRegistry,
    requests: impl BufRead,
    mut replies: impl Write,
) -> io::Result<()> {
    let mut probe: Option<P> = None;
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

fn answer<P: Probe>(
    registry: &ModelRegistry,
    probe: &mut Option<P>,
    request: Request,
) -> Result<Reply, P::Error> {
    // All but loading and the limits need the model of an earlier request.
    Ok(match (request, probe) {
        (Request::Load(request), probe) => {
            let (loaded, opened) = P::open(registry, &request)?;
            *probe = Some(opened);
            Reply::Loaded(loaded)
        }
        (Request::Run(steps), Some(probe)) => Reply::Ran(
            steps
                .into_iter()
                .map(|step| probe.run(step))
                .collect::<Result<_, _>>()?,
        ),
        (Request::Answer { prompt, count }, Some(probe)) => {
            let (logits, tokens) = probe.answer(&prompt, count)?;
            Reply::Answered { logits, tokens }
        }
        (Request::Features { side, most }, Some(probe)) => {
            let (tokens, values) = probe.features(side, most)?;
            Reply::Encoded { tokens, values }
        }
        (Request::Prepare(_), _) => {
            Reply::Failed("this program reads all files as they are".into())
        }
        (Request::Limits, _) => Reply::Limits(Limits::measure()),
        (Request::Run(_) | Request::Answer { .. } | Request::Features { .. }, None) => {
            Reply::Failed("no model is loaded".into())
        }
    })
}

fn load(
    registry: &ModelRegistry,
    request: &LoadRequest,
) -> Result<(Loaded, LatencyProbe), MllmError> {
    // Finding the files counts as loading, as it does for a user.
    let start = Instant::now();
    let registry = registry.clone().with_quantize(request.weight_format);
    let (place, mut loading) = match &request.model {
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
            let place = match projector {
                Some(projector) => ModelPlace::Gguf {
                    model: decoder.clone(),
                    mmproj: Some(projector.clone()),
                },
                None => ModelPlace::Decoder(decoder.clone()),
            };
            (place, registry.plain_loading())
        }
        ModelChoice::Exported(ExportedFolder { folder, .. }) => {
            (ModelPlace::Folder(folder.clone()), registry.plain_loading())
        }
    };
    loading.image.size = request.image_size.or(loading.image.size);
    let probe = LatencyProbe::open(&place, &loading, request.seed)?;
    let load_s = start.elapsed().as_secs_f64();
    let (model, image_tokens) = (probe.model(), probe.image_tokens()?);
    let info = model.info();
    let loaded = Loaded {
        parameters: info.parameters,
        weight_format: probe.weight_format().to_string(),
        image_side: info.image_size.map_or(0, |side| side as u32),
        image_tokens,
        vocabulary: info.vocabulary,
        image_token: Some(info.image_token),
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
