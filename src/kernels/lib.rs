//! The arithmetic of neural networks on the CPU: products with weights in every format, attention,
//! norms and activation functions.

mod activation;
pub mod attention;
mod awake;
mod convolution;
mod delta_rule;
mod layer_norm;
pub mod limits;
mod linear;
pub mod matrix;
pub mod pointwise;
mod read_ahead;
mod rms_norm;
mod sparse_gates;
pub mod values;
mod work;

pub use activation::Activation;
pub use awake::Awake;
pub use convolution::{Convolution, Depthwise, Grid};
pub use delta_rule::{DeltaHeads, GatedDeltaRule};
pub use layer_norm::LayerNorm;
pub use limits::Limits;
pub use linear::Linear;
pub use rms_norm::RmsNorm;
pub use sparse_gates::above_cutoff;
pub use work::Work;
