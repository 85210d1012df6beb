//! Several hidden states of a token beside one another ("streams"), of which a layer works on one
//! (Alternating Updates: Baykal et al., `arXiv:2301.13310`, in the form of Gemma 3n).

use super::layer::scaled_norm;
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, Weights};
use candle_core::{D, Result, Tensor};
use planagent_kernels::{Linear, RmsNorm};

/// Makes the streams of input rows, and one hidden state of the streams.
#[derive(Debug)]
pub(super) struct Streams {
    hidden: usize,
    /// To each stream but the first.
    split: Vec<Linear>,
    /// From each stream but the first.
    merge: Vec<Linear>,
}

impl Streams {
    /// Takes the weights, whose names begin with `prefix`; none for a decoder without streams.
    pub(super) fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        prefix: &str,
    ) -> std::result::Result<Option<Self>, MllmError> {
        if config.streams.is_none() {
            return Ok(None);
        }
        let mut take = |part: &str| projections(weights, config, &format!("{prefix}{part}"));
        Ok(Some(Self {
            hidden: config.hidden,
            split: take("altup_projections")?,
            merge: take("altup_unembed_projections")?,
        }))
    }

    /// The streams of rows (tokens, hidden), beside one another: (tokens, streams · hidden). The
    /// first is the rows; the others have their magnitude.
    pub(super) fn split(&self, rows: &Tensor) -> Result<Tensor> {
        let mut streams = vec![rows.clone()];
        let magnitude = magnitude(rows)?;
        for projection in &self.split {
            streams.push(with_magnitude(&projection.forward(rows)?, &magnitude)?);
        }
        Tensor::cat(&streams, 1)?.contiguous()
    }

    /// The mean of the streams, each mapped back to the magnitude of the first: (tokens, hidden).
    pub(super) fn merge(&self, streams: &Tensor) -> Result<Tensor> {
        let first = stream(streams, 0, self.hidden)?;
        let magnitude = magnitude(&first)?;
        let mut sum = first;
        for (index, projection) in self.merge.iter().enumerate() {
            let own = projection.forward(&stream(streams, index + 1, self.hidden)?)?;
            sum = (sum + with_magnitude(&own, &magnitude)?)?;
        }
        sum / (1 + self.merge.len()) as f64
    }
}

/// One of the streams of rows, (tokens, hidden).
fn stream(streams: &Tensor, index: usize, hidden: usize) -> Result<Tensor> {
    streams.narrow(1, index * hidden, hidden)?.contiguous()
}

/// The root of the mean square of each row, (tokens, 1).
fn magnitude(rows: &Tensor) -> Result<Tensor> {
    rows.sqr()?.mean_keepdim(D::Minus1)?.sqrt()
}

/// Rows of this magnitude. Rows of nearly zero become no larger than by the least square below.
fn with_magnitude(rows: &Tensor, magnitude: &Tensor) -> Result<Tensor> {
    /// Least mean square, as in transformers' `Gemma3nTextAltUp`.
    const LEAST: f32 = 1e-5;
    let own = rows
        .sqr()?
        .mean_keepdim(D::Minus1)?
        .maximum(LEAST)?
        .sqrt()?;
    rows.broadcast_mul(magnitude)?.broadcast_div(&own)
}

/// Projections of hidden states to each stream but the first: folders have them one by one,
/// llama.cpp's files as one tensor.
fn projections(
    weights: &mut Weights,
    config: &LlamaConfig,
    name: &str,
) -> std::result::Result<Vec<Linear>, MllmError> {
    let count = config.streams.as_ref().map_or(1, |streams| streams.count);
    let (others, hidden) = (count - 1, config.hidden);
    let all = format!("{name}.weight");
    if weights.contains(&all) {
        let all = weights.take(&all, &[others, hidden, hidden])?;
        let one = |index| Linear::from_tensors(&all.get(index)?.contiguous()?, None);
        return Ok((0..others).map(one).collect::<Result<Vec<_>>>()?);
    }
    let mut projections = Vec::with_capacity(others);
    for index in 0..others {
        let linear = weights.take_linear(&format!("{name}.{index}"), hidden, hidden, false)?;
        projections.push(config.without_norm_before(linear));
    }
    Ok(projections)
}

/// What moves the streams along that a layer does not work on.
#[derive(Debug)]
pub(super) struct StreamUpdate {
    count: usize,
    active: usize,
    hidden: usize,
    router_norm: RmsNorm,
    router: Linear,
    /// (streams · streams, streams)
    predicting: Vec<f32>,
    /// (streams, streams)
    correcting: Vec<f32>,
}

impl StreamUpdate {
    /// Takes that of a layer, by its name.
    pub(super) fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        name: &str,
    ) -> std::result::Result<Self, MllmError> {
        let (count, active) = config
            .streams
            .as_ref()
            .map_or((1, 0), |streams| (streams.count, streams.active));
        let hidden = config.hidden;
        // Small, and every number of a token passes through them: they stay in f32.
        let mut numbers = |part: &str, rows: usize, inputs: usize| {
            weights.take(&format!("{name}.{part}.weight"), &[rows, inputs])
        };
        let router = numbers("modality_router", count, hidden)?;
        let predicting = numbers("prediction_coefs", count * count, count)?;
        let correcting = numbers("correction_coefs", count, count)?;
        let norm = format!("{name}.router_norm");
        Ok(Self {
            count,
            active,
            hidden,
            router_norm: scaled_norm(weights, &norm, hidden, config, 1.0 / hidden as f32)?,
            router: Linear::from_tensors(&router.contiguous()?, None)?,
            predicting: predicting.flatten_all()?.to_vec1()?,
            correcting: correcting.flatten_all()?.to_vec1()?,
        })
    }

    /// The stream that the layer works on, (tokens, hidden).
    pub(super) fn active(&self, streams: &Tensor) -> Result<Tensor> {
        stream(streams, self.active, self.hidden)
    }

    /// The streams as they are expected behind the layer, (tokens, streams · hidden): each and a
    /// mixture of all.
    pub(super) fn predict(&self, streams: &Tensor) -> Result<Tensor> {
        let routes = self.routes(&self.active(streams)?)?;
        let known: Vec<f32> = streams.flatten_all()?.to_vec1()?;
        let mut predicted = known.clone();
        let width = self.count * self.hidden;
        let rows = known
            .chunks_exact(width)
            .zip(routes.chunks_exact(self.count));
        for (out, (known, route)) in predicted.chunks_exact_mut(width).zip(rows) {
            let factors = products(&self.predicting, route);
            let parts = out.chunks_exact_mut(self.hidden);
            for (out, factors) in parts.zip(factors.chunks_exact(self.count)) {
                for (known, factor) in known.chunks_exact(self.hidden).zip(factors) {
                    add(out, known, *factor);
                }
            }
        }
        Tensor::from_vec(predicted, streams.shape(), streams.device())
    }

    /// The predicted streams, corrected by what the layer made of the active one, (tokens, hidden).
    pub(super) fn correct(&self, predicted: &Tensor, made: &Tensor) -> Result<Tensor> {
        let routes = self.routes(made)?;
        let news = (made - self.active(predicted)?)?;
        let news: Vec<f32> = news.flatten_all()?.to_vec1()?;
        let mut corrected: Vec<f32> = predicted.flatten_all()?.to_vec1()?;
        let rows = news
            .chunks_exact(self.hidden)
            .zip(routes.chunks_exact(self.count));
        let width = self.count * self.hidden;
        for (out, (news, route)) in corrected.chunks_exact_mut(width).zip(rows) {
            let factors = products(&self.correcting, route);
            for (out, factor) in out.chunks_exact_mut(self.hidden).zip(factors) {
                add(out, news, factor + 1.0);
            }
        }
        Tensor::from_vec(corrected, predicted.shape(), predicted.device())
    }

    /// Streams with these rows, (tokens, hidden), added to each but the first.
    pub(super) fn add_to_others(&self, streams: &Tensor, rows: &Tensor) -> Result<Tensor> {
        let mut parts = vec![rows.zeros_like()?];
        parts.extend(std::iter::repeat_n(rows.clone(), self.count - 1));
        streams + Tensor::cat(&parts, 1)?
    }

    /// What decides the factors of each token, (tokens, streams).
    fn routes(&self, active: &Tensor) -> Result<Vec<f32>> {
        let routes = self.router.forward(&self.router_norm.forward(active)?)?;
        routes.tanh()?.flatten_all()?.to_vec1()
    }
}

/// The products of a matrix's rows, which lie one behind the other, with a vector.
fn products(matrix: &[f32], vector: &[f32]) -> Vec<f32> {
    let rows = matrix.chunks_exact(vector.len().max(1));
    rows.map(|row| row.iter().zip(vector).map(|(one, other)| one * other).sum())
        .collect()
}

/// out += factor · row.
fn add(out: &mut [f32], row: &[f32], factor: f32) {
    for (out, value) in out.iter_mut().zip(row) {
        *out += factor * value;
    }
}
