//! Activation functions by their names in configurations.

use serde::Deserialize;

/// An activation function.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// With the error function.
    Gelu,
    /// With tanh.
    #[serde(rename = "gelu_pytorch_tanh", alias = "gelu_new")]
    GeluTanh,
    /// x·σ(1.702 x).
    QuickGelu,
    /// 0 below 0.
    Relu,
    /// x·σ(x).
    #[serde(alias = "swish")]
    Silu,
}
