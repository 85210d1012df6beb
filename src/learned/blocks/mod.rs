//! Layers that the networks share, with PyTorch's parameter names and results; inference only.

mod activation;
mod attend;
mod attention;
mod conv;
mod linear;
mod norm;
mod pooling;
mod probe;
mod recurrent;
mod weights;

pub(super) use activation::{gelu, leaky_relu, relu, softmax};
pub(super) use attend::Memory;
pub(super) use attention::{MultiheadAttention, key_bias};
pub(super) use conv::Conv1d;
pub(super) use linear::{GroupLinear, Linear, Mlp};
pub(super) use norm::{BatchNorm, LayerNorm};
pub(super) use pooling::{largest, largest_where};
pub use probe::Probe;
pub(super) use recurrent::{Gru, Lstm};
pub use weights::{Mismatch, Weights};
