//! Gates of what the heads of an attention give (Qiu et al., arXiv:2505.06708).

use crate::checkpoint::LlamaConfig;
use candle_core::{Result, Tensor};

/// The gates that the projection of queries gives: for each head its query, then its gate.
#[derive(Debug, Clone, Copy)]
pub(super) struct OutputGate {
    heads: usize,
    head_dim: usize,
}

impl OutputGate {
    /// Those of an attention.
    pub(super) fn new(config: &LlamaConfig) -> Self {
        Self {
            heads: config.heads,
            head_dim: config.head_dim,
        }
    }

    /// Numbers of a token's gates.
    pub(super) fn width(&self) -> usize {
        self.heads * self.head_dim
    }

    /// Queries, keys and values, and the gates, of rows of queries with gates, keys and values.
    pub(super) fn split(&self, rows: &Tensor) -> Result<(Tensor, Tensor)> {
        let (tokens, all) = rows.dims2()?;
        let width = self.width();
        let pairs = rows.narrow(1, 0, 2 * width)?;
        let pairs = pairs.reshape((tokens, self.heads, 2, self.head_dim))?;
        let part = |index: usize| pairs.narrow(2, index, 1)?.reshape((tokens, width));
        let others = rows.narrow(1, 2 * width, all - 2 * width)?;
        Ok((Tensor::cat(&[part(0)?, others], 1)?, part(1)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn each_head_has_its_gate_behind_its_query() {
        let gate = OutputGate {
            heads: 2,
            head_dim: 2,
        };
        let rows = Tensor::arange(0_f32, 20.0, &Device::Cpu).unwrap();
        let rows = rows.reshape((2, 10)).unwrap();
        let (qkv, gates) = gate.split(&rows).unwrap();
        let second = |tensor: Tensor| tensor.to_vec2::<f32>().unwrap().remove(1);
        assert_eq!(second(qkv), [10.0, 11.0, 14.0, 15.0, 18.0, 19.0]);
        assert_eq!(second(gates), [12.0, 13.0, 16.0, 17.0]);
    }
}
