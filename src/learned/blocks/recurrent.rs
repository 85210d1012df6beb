//! Recurrent layers over sequences of different lengths.
#![allow(
    clippy::inline_always,
    reason = "kernels must be inlined into the functions that enable the instructions"
)]

use super::{Linear, Weights};
use candle_core::{DType, Device, IndexOp, Result, Tensor};
use planagent_kernels::matrix::{Instructions, Kernel, Simd};
use planagent_kernels::pointwise::{sigmoid, tanh};
use planagent_kernels::values::with_values;

/// Takes `NAME.weight_ih_lI`, `NAME.weight_hh_lI` and their biases for `gates` gates of this width.
fn gates(
    weights: &mut Weights,
    name: &str,
    layer: usize,
    [inputs, width, gates]: [usize; 3],
) -> Result<[Linear; 2]> {
    let rows = gates * width;
    let mut part = |kind: &str, columns: usize| {
        let weight = weights.take(&format!("{name}.weight_{kind}_l{layer}"), &[rows, columns])?;
        Linear::from_tensors(
            &weight,
            Some(weights.take(&format!("{name}.bias_{kind}_l{layer}"), &[rows])?),
        )
    };
    Ok([part("ih", inputs)?, part("hh", width)?])
}

/// PyTorch's `GRU` of one layer.
#[derive(Debug, Clone)]
pub(crate) struct Gru {
    width: usize,
    gates: [Linear; 2],
}

impl Gru {
    pub(crate) fn take(
        weights: &mut Weights,
        name: &str,
        inputs: usize,
        width: usize,
    ) -> Result<Self> {
        Ok(Self {
            width,
            gates: gates(weights, name, 0, [inputs, width, 3])?,
        })
    }

    /// The state after the first `lengths` steps of each of the sequences (N, T, inputs), or after
    /// all; zeros for length 0.
    pub(crate) fn last(&self, x: &Tensor, lengths: Option<&[usize]>) -> Result<Tensor> {
        let (rows, steps, _) = x.dims3()?;
        let [of_input, of_state] = &self.gates;
        let inputs = of_input.forward(&x.transpose(0, 1)?)?;
        let mut state = Tensor::zeros((rows, self.width), DType::F32, &Device::Cpu)?;
        for step in 0..steps {
            let state_gates = of_state.forward(&state)?;
            let mut next = state.flatten_all()?.to_vec1::<f32>()?;
            let runs = |row: usize| {
                lengths.is_none_or(|lengths| lengths.get(row).is_some_and(|&length| step < length))
            };
            with_values(&inputs.i(step)?, |input_gates| {
                with_values(&state_gates, |state_gates| {
                    let cell = GruCell {
                        width: self.width,
                        input_gates,
                        state_gates,
                        runs,
                        state: &mut next,
                    };
                    Instructions::best().run(cell);
                    Ok(())
                })
            })?;
            state = Tensor::from_vec(next, (rows, self.width), &Device::Cpu)?;
        }
        Ok(state)
    }
}

/// A step of a GRU: the state of each row that still runs, from the gates' parts of input and
/// state, in the order reset, update, new.
struct GruCell<'a, R> {
    width: usize,
    input_gates: &'a [f32],
    state_gates: &'a [f32],
    runs: R,
    state: &'a mut [f32],
}

impl<R: Fn(usize) -> bool> Kernel for GruCell<'_, R> {
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let width = self.width;
        let gates = self
            .input_gates
            .chunks_exact(3 * width)
            .zip(self.state_gates.chunks_exact(3 * width));
        for (row, (state, (of_input, of_state))) in
            self.state.chunks_exact_mut(width).zip(gates).enumerate()
        {
            if !(self.runs)(row) {
                continue;
            }
            let ((reset, of_input), (state_reset, of_state)) =
                (of_input.split_at(width), of_state.split_at(width));
            let ((update, fresh), (state_update, state_fresh)) =
                (of_input.split_at(width), of_state.split_at(width));
            // The compiler vectorizes the loop where it knows all lengths.
            let (state, fresh, state_fresh) =
                (&mut state[..width], &fresh[..width], &state_fresh[..width]);
            for i in 0..width {
                let reset = sigmoid(reset[i] + state_reset[i]);
                let update = sigmoid(update[i] + state_update[i]);
                let fresh = tanh(fresh[i] + reset * state_fresh[i]);
                state[i] = fresh + update * (state[i] - fresh);
            }
        }
    }
}

/// PyTorch's `LSTM` of several layers.
#[derive(Debug, Clone)]
pub(crate) struct Lstm {
    width: usize,
    layers: Vec<[Linear; 2]>,
}

impl Lstm {
    pub(crate) fn take(
        weights: &mut Weights,
        name: &str,
        [inputs, width, layers]: [usize; 3],
    ) -> Result<Self> {
        let inputs = |layer: usize| if layer == 0 { inputs } else { width };
        let layers =
            (0..layers).map(|layer| gates(weights, name, layer, [inputs(layer), width, 4]));
        Ok(Self {
            width,
            layers: layers.collect::<Result<_>>()?,
        })
    }

    /// The output of the last step of sequences (N, T, inputs).
    pub(crate) fn last(&self, x: &Tensor) -> Result<Tensor> {
        let (rows, steps, _) = x.dims3()?;
        let mut sequence = x.transpose(0, 1)?;
        let mut state = Tensor::zeros((rows, self.width), DType::F32, &Device::Cpu)?;
        for [of_input, of_state] in &self.layers {
            let inputs = of_input.forward(&sequence)?;
            let mut cell = vec![0f32; rows * self.width];
            let mut outputs = Vec::with_capacity(steps);
            state = state.zeros_like()?;
            for step in 0..steps {
                let gates = of_state.forward_onto(&state, &inputs.i(step)?)?;
                let mut next = vec![0f32; rows * self.width];
                with_values(&gates, |gates| {
                    let cell = LstmCell {
                        width: self.width,
                        gates,
                        cell: &mut cell,
                        state: &mut next,
                    };
                    Instructions::best().run(cell);
                    Ok(())
                })?;
                state = Tensor::from_vec(next, (rows, self.width), &Device::Cpu)?;
                outputs.push(state.clone());
            }
            sequence = Tensor::stack(&outputs, 0)?;
        }
        Ok(state)
    }
}

/// A step of an LSTM: cell and state of each row from its gates, in the order input, forget, new,
/// output.
struct LstmCell<'a> {
    width: usize,
    gates: &'a [f32],
    cell: &'a mut [f32],
    state: &'a mut [f32],
}

impl Kernel for LstmCell<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let width = self.width;
        let rows = self
            .state
            .chunks_exact_mut(width)
            .zip(self.cell.chunks_exact_mut(width));
        for ((state, cell), gates) in rows.zip(self.gates.chunks_exact(4 * width)) {
            let (first, last) = gates.split_at(2 * width);
            let ((input, forget), (fresh, output)) = (first.split_at(width), last.split_at(width));
            // As above.
            let (forget, output) = (&forget[..width], &output[..width]);
            let (state, cell) = (&mut state[..width], &mut cell[..width]);
            for i in 0..width {
                cell[i] = sigmoid(forget[i]) * cell[i] + sigmoid(input[i]) * tanh(fresh[i]);
                state[i] = sigmoid(output[i]) * tanh(cell[i]);
            }
        }
    }
}
