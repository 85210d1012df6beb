//! Recurrent layers over sequences of different lengths.

use super::{Linear, Weights};
use candle_core::{DType, Device, Result, Tensor};

/// Takes `NAME.weight_ih_lI`, `NAME.weight_hh_lI` and their biases for `gates` gates of this width.
fn gates(weights: &mut Weights, name: &str, layer: usize, [inputs, width, gates]: [usize; 3]) -> Result<[Linear; 2]> {
    let rows = gates * width;
    let mut part = |kind: &str, columns: usize| {
        let weight = weights.take(&format!("{name}.weight_{kind}_l{layer}"), &[rows, columns])?;
        Linear::of(&weight, Some(weights.take(&format!("{name}.bias_{kind}_l{layer}"), &[rows])?))
    };
    Ok([part("ih", inputs)?, part("hh", width)?])
}

fn sigmoid(x: &Tensor) -> Result<Tensor> {
    (x.neg()?.exp()? + 1.0)?.recip()
}

/// PyTorch's `GRU` of one layer.
#[derive(Debug, Clone)]
pub(in crate::planner::learned) struct Gru {
    width: usize,
    gates: [Linear; 2],
}

impl Gru {
    pub(in crate::planner::learned) fn take(
        weights: &mut Weights,
        name: &str,
        inputs: usize,
        width: usize,
    ) -> Result<Self> {
        Ok(Self { width, gates: gates(weights, name, 0, [inputs, width, 3])? })
    }

    /// The state after the first `lengths` steps of each of the sequences (N, T, inputs), or after all; zeros for length 0.
    pub(in crate::planner::learned) fn last(&self, x: &Tensor, lengths: Option<&[usize]>) -> Result<Tensor> {
        let (rows, steps, _) = x.dims3()?;
        let [of_input, of_state] = &self.gates;
        let inputs = of_input.forward(x)?;
        let mut state = Tensor::zeros((rows, self.width), DType::F32, &Device::Cpu)?;
        for step in 0..steps {
            let input = inputs.narrow(1, step, 1)?.squeeze(1)?;
            let own = of_state.forward(&state)?;
            let part = |x: &Tensor, i: usize| x.narrow(1, i * self.width, self.width);
            let reset = sigmoid(&(part(&input, 0)? + part(&own, 0)?)?)?;
            let update = sigmoid(&(part(&input, 1)? + part(&own, 1)?)?)?;
            let fresh = (part(&input, 2)? + (reset * part(&own, 2)?)?)?.tanh()?;
            let next = (&fresh + (update * (&state - &fresh)?)?)?;
            state = match lengths {
                None => next,
                Some(lengths) => {
                    let runs: Vec<u8> = lengths.iter().map(|&length| u8::from(step < length)).collect();
                    let runs = Tensor::from_vec(runs, (rows, 1), &Device::Cpu)?.broadcast_as((rows, self.width))?;
                    runs.where_cond(&next, &state)?
                }
            };
        }
        Ok(state)
    }
}

/// PyTorch's `LSTM` of several layers.
#[derive(Debug, Clone)]
pub(in crate::planner::learned) struct Lstm {
    width: usize,
    layers: Vec<[Linear; 2]>,
}

impl Lstm {
    pub(in crate::planner::learned) fn take(
        weights: &mut Weights,
        name: &str,
        [inputs, width, layers]: [usize; 3],
    ) -> Result<Self> {
        let inputs = |layer: usize| if layer == 0 { inputs } else { width };
        let layers = (0..layers).map(|layer| gates(weights, name, layer, [inputs(layer), width, 4]));
        Ok(Self { width, layers: layers.collect::<Result<_>>()? })
    }

    /// The output of the last step of sequences (N, T, inputs).
    pub(in crate::planner::learned) fn last(&self, x: &Tensor) -> Result<Tensor> {
        let (rows, steps, _) = x.dims3()?;
        let mut sequence = x.clone();
        let mut last = Tensor::zeros((rows, self.width), DType::F32, &Device::Cpu)?;
        for [of_input, of_state] in &self.layers {
            let inputs = of_input.forward(&sequence)?;
            let mut state = Tensor::zeros((rows, self.width), DType::F32, &Device::Cpu)?;
            let mut cell = state.clone();
            let mut outputs = Vec::with_capacity(steps);
            for step in 0..steps {
                let gates = (inputs.narrow(1, step, 1)?.squeeze(1)? + of_state.forward(&state)?)?;
                let part = |i: usize| gates.narrow(1, i * self.width, self.width);
                let (input, forget, output) = (sigmoid(&part(0)?)?, sigmoid(&part(1)?)?, sigmoid(&part(3)?)?);
                cell = ((forget * &cell)? + (input * part(2)?.tanh()?)?)?;
                state = (output * cell.tanh()?)?;
                outputs.push(state.clone());
            }
            last = state;
            sequence = Tensor::stack(&outputs, 1)?;
        }
        Ok(last)
    }
}
