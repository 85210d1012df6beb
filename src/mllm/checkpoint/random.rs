//! Random numbers in the place of weights.

use std::collections::BTreeMap;

use candle_core::{Device, Tensor};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::mllm::MllmError;
use crate::mllm::matrix::{Matrix, Storage};

/// Rows that the matrices of one width and storage are composed of.
const POOL: usize = 256;
/// Largest magnitude of what is no matrix (norms, biases, embeddings of positions).
const VECTOR_RANGE: f32 = 0.1;

/// A source of random tensors. A matrix is composed of stored rows out of a small pool, so that 17 billion weights take as long
/// as copying them; how long it takes to multiply with them does not depend on their values.
#[derive(Debug)]
pub(crate) struct RandomWeights {
    random: Pcg64Mcg,
    pools: BTreeMap<(&'static str, usize), Vec<u8>>,
}

impl RandomWeights {
    /// The same seed gives the same tensors when they are asked for in the same order.
    pub(crate) fn new(seed: u64) -> Self {
        Self { random: Pcg64Mcg::seed_from_u64(seed), pools: BTreeMap::new() }
    }

    /// A tensor of small numbers.
    ///
    /// # Errors
    /// When there is no memory for this shape.
    pub(crate) fn tensor(&mut self, shape: &[usize]) -> Result<Tensor, MllmError> {
        let values = self.values(shape.iter().product(), VECTOR_RANGE);
        Ok(Tensor::from_vec(values, shape, &Device::Cpu)?)
    }

    /// A matrix that keeps the variance of what is multiplied with it.
    ///
    /// # Errors
    /// When the storage cannot hold this shape.
    pub(crate) fn matrix(&mut self, [outputs, inputs]: [usize; 2], storage: Storage) -> Result<Matrix, MllmError> {
        let range = (3.0 / inputs as f32).sqrt();
        if outputs <= POOL {
            let values = self.values(outputs * inputs, range);
            return Ok(Matrix::quantize(&values, outputs, inputs, storage)?);
        }
        let key = (storage.name(), inputs);
        if !self.pools.contains_key(&key) {
            let values = self.values(POOL * inputs, range);
            let mut rows = Vec::new();
            Matrix::quantize(&values, POOL, inputs, storage)?
                .write_blocks(&mut rows)
                .map_err(candle_core::Error::from)?;
            self.pools.insert(key, rows);
        }
        let Self { random, pools } = self;
        let pool = pools.get(&key).map_or(&[][..], Vec::as_slice);
        let width = pool.len() / POOL;
        let mut bytes = Vec::with_capacity(outputs * width);
        for _ in 0..outputs {
            let row = random.random_range(0..POOL) * width;
            bytes.extend_from_slice(pool.get(row..row + width).unwrap_or_default());
        }
        Ok(Matrix::from_blocks(storage, outputs, inputs, &bytes)?)
    }

    fn values(&mut self, count: usize, range: f32) -> Vec<f32> {
        (0..count).map(|_| self.random.random_range(-range..range)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_gives_the_same_finite_numbers_in_every_storage() {
        for storage in Storage::ALL {
            let bytes = |seed| {
                let mut weights = RandomWeights::new(seed);
                let mut bytes = Vec::new();
                for outputs in [3, POOL + 40] {
                    let matrix = weights.matrix([outputs, 512], storage).unwrap();
                    assert_eq!((matrix.storage(), matrix.outputs()), (storage, outputs));
                    matrix.write_blocks(&mut bytes).unwrap();
                }
                bytes
            };
            assert_eq!(bytes(1), bytes(1));
            assert_ne!(bytes(1), bytes(2));
            let matrix = RandomWeights::new(3).matrix([POOL + 40, 512], storage).unwrap();
            let rows: Vec<f32> = matrix.rows(&[0, 7, 290]).unwrap().flatten_all().unwrap().to_vec1().unwrap();
            let variance = rows.iter().map(|value| value * value).sum::<f32>() / rows.len() as f32;
            assert!((variance * 512.0 - 1.0).abs() < 0.2, "{storage}: {variance}");
        }
    }
}
