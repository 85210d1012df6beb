//! Layers that the networks share, with PyTorch's parameter names and results; inference only.

mod activation;
mod attention;
mod conv;
mod linear;
mod norm;
mod probe;
mod recurrent;
mod weights;

pub(super) use activation::{gelu, leaky_relu, masked, relu, softmax};
pub(super) use attention::{Memory, MultiheadAttention, key_bias};
pub(super) use conv::Conv1d;
pub(super) use linear::{Linear, Mlp};
pub(super) use norm::{BatchNorm, LayerNorm};
pub use probe::Probe;
pub(super) use recurrent::{Gru, Lstm};
pub use weights::{Mismatch, Weights};
