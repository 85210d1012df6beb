//! Layers that the networks share beside those of the kernels, with PyTorch's parameter names and
//! results; inference only.

mod activation;
mod attention;
mod conv;
mod linear;
mod norm;
mod pooling;
mod probe;
mod recurrent;
mod weights;

pub(super) use activation::{gelu, leaky_relu, relu, softmax};
pub(super) use attention::{MultiheadAttention, key_bias};
pub(super) use conv::Conv1d;
pub(super) use linear::{GroupLinear, Mlp};
pub(super) use norm::BatchNorm;
pub(super) use planagent_kernels::attention::PackedKeyValues;
pub(super) use planagent_kernels::{LayerNorm, Linear};
pub(super) use pooling::{largest, largest_where};
pub use probe::Probe;
pub(super) use recurrent::{Gru, Lstm};
pub use weights::{Mismatch, Weights};
