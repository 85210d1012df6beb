//! Checkpoints with random weights, for benchmarks.

use super::Checkpoint;
use crate::MllmError;
use crate::checkpoint::{
    FileKind, ModelFiles, RowOrder, TensorPlace, TensorSource, WeightFormatPlan, Weights, held_as,
    is_matrix,
};
use crate::families::Families;
use candle_core::quantized::GgmlDType;
use planagent_kernels::matrix::{Matrix, WeightFormat};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Rows that the matrices of one width and format are composed of.
const POOL: usize = 256;
/// Largest magnitude of tensors other than matrices (norms, biases, positions).
const VECTOR_RANGE: f32 = 0.1;

/// Random tensors in place of a weight file. A matrix is composed of rows from a small pool, so
/// that 17 billion weights take no longer than a copy. The time of products does not depend on the
/// values.
#[derive(Debug)]
struct RandomTensors {
    /// Their name in messages.
    path: PathBuf,
    seed: u64,
    pools: Mutex<Pools>,
}

/// Encoded rows, by the name of their format and their width.
type Pools = BTreeMap<(&'static str, usize), Arc<Vec<u8>>>;

impl RandomTensors {
    /// The same seed gives the same tensor at the same place.
    fn new(path: &Path, seed: u64) -> Self {
        Self {
            path: path.to_path_buf(),
            seed,
            pools: Mutex::new(BTreeMap::new()),
        }
    }

    /// The encoded rows of one width, drawn at the first call.
    fn pool(&self, weight_format: WeightFormat, inputs: usize) -> Result<Arc<Vec<u8>>, MllmError> {
        let mut pools = self.pools.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pool) = pools.get(&(weight_format.name(), inputs)) {
            return Ok(Arc::clone(pool));
        }
        let pool = Arc::new(pool(weight_format, inputs, self.seed)?);
        pools.insert((weight_format.name(), inputs), Arc::clone(&pool));
        Ok(pool)
    }
}

impl TensorSource for RandomTensors {
    fn path(&self) -> &Path {
        &self.path
    }

    fn bytes(&self, place: &TensorPlace) -> Result<Vec<u8>, MllmError> {
        let mut random = Pcg64Mcg::seed_from_u64(self.seed ^ place.begin);
        let weight_format =
            held_as(place.format).expect("random tensors have a format of the memory");
        match place.shape.as_slice() {
            &[outputs, inputs] if outputs > POOL || weight_format != WeightFormat::F32 => {
                let pool = self.pool(weight_format, inputs)?;
                let width = pool.len() / POOL;
                let mut bytes = Vec::with_capacity(outputs * width);
                for _ in 0..outputs {
                    let row = random.random_range(0..POOL) * width;
                    bytes.extend_from_slice(&pool[row..row + width]);
                }
                Ok(bytes)
            }
            shape => {
                let count = shape.iter().product();
                Ok(values(&mut random, count, VECTOR_RANGE)
                    .flat_map(f32::to_le_bytes)
                    .collect())
            }
        }
    }

    // As of a weight file, so that a model of random weights needs no more memory than another.
    fn reads_parts(&self) -> bool {
        true
    }

    fn hash(&self, hasher: &mut blake3::Hasher) -> Result<(), MllmError> {
        hasher.update(&self.seed.to_le_bytes());
        Ok(())
    }
}

/// Encoded rows that keep the variance of the activations.
fn pool(weight_format: WeightFormat, inputs: usize, seed: u64) -> Result<Vec<u8>, MllmError> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let range = (3.0 / inputs as f32).sqrt();
    let values: Vec<f32> = values(&mut random, POOL * inputs, range).collect();
    let mut bytes = Vec::new();
    Matrix::quantize(&values, POOL, inputs, weight_format)?
        .write_blocks(&mut bytes)
        .map_err(candle_core::Error::from)?;
    Ok(bytes)
}

fn values(random: &mut Pcg64Mcg, count: usize, range: f32) -> impl Iterator<Item = f32> {
    (0..count).map(move |_| random.random_range(-range..range))
}

/// A checkpoint with random weights in `weight_format` for a model with these files.
pub(super) fn checkpoint(
    files: ModelFiles,
    weight_format: WeightFormat,
    seed: u64,
    families: &Families,
) -> Result<Checkpoint, MllmError> {
    let family = families.detect_in(&files)?;
    let plan = WeightFormatPlan {
        quantize: Some(weight_format),
        kind: FileKind::Gguf,
        tied: false,
        whole_blocks: false,
    };
    let mut asked = Weights::empty(files.place(), plan);
    // The family's own code says which tensors it needs, so no list of them can grow old.
    asked.only_list();
    (family.family().open)(&files, &mut asked)?;
    let mut weights = Weights::empty(files.place(), plan);
    let tied = !asked
        .listed()
        .iter()
        .any(|(name, _)| name == "lm_head.weight");
    let file = weights.add_file(RandomTensors::new(files.place(), seed));
    let mut begin = 0;
    for (name, shape) in asked.listed() {
        let weight_format = match shape.as_slice() {
            [_, inputs] if is_matrix(name, shape) => {
                let in_file = WeightFormatPlan {
                    tied,
                    whole_blocks: true,
                    ..plan
                };
                in_file.matrix(name, GgmlDType::F32, *inputs).weight_format
            }
            _ => WeightFormat::F32,
        };
        let elements: usize = shape.iter().product();
        let bytes = (elements / weight_format.block() * weight_format.block_bytes()) as u64;
        let place = TensorPlace {
            format: weight_format.stored(),
            shape: shape.clone(),
            begin,
            bytes,
        };
        weights.add(name.clone(), file, name.clone(), place, RowOrder::Plain)?;
        begin += bytes;
    }
    Ok(Checkpoint {
        family,
        files,
        weights,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_gives_the_same_finite_numbers_in_every_format() {
        for weight_format in WeightFormat::ALL {
            let shape = vec![POOL + 40, 512];
            let bytes = |seed, begin| {
                let place = TensorPlace {
                    format: weight_format.stored(),
                    shape: shape.clone(),
                    begin,
                    bytes: 0,
                };
                RandomTensors::new(Path::new(""), seed)
                    .bytes(&place)
                    .unwrap()
            };
            assert_eq!(
                bytes(1, 0).len(),
                weight_format.matrix_bytes(POOL + 40, 512).unwrap()
            );
            assert_eq!(bytes(1, 7), bytes(1, 7));
            assert_ne!(bytes(1, 0), bytes(2, 0));
            assert_ne!(bytes(1, 0), bytes(1, 7));
            let values = weight_format.stored().widen(bytes(1, 0)).unwrap();
            let variance =
                values.iter().map(|value| value * value).sum::<f32>() / values.len() as f32;
            assert!(
                (variance * 512.0 - 1.0).abs() < 0.1,
                "{weight_format}: {variance}"
            );
        }
    }
}
