//! Attention of a batch with an additive bias, a few queries at a time: the logits of all queries
//! are never stored. Each query weighs all keys at once, so a bias may hide any of them.

use super::unit::add_product;
use crate::Work;
use crate::matrix::{Instructions, Kernel, LANES, Simd};
use crate::pointwise::softmax_in_place;
use crate::values::with_values;
use candle_core::{Device, Result, Tensor, bail};
use rayon::prelude::*;

/// Queries that a kernel computes at once, and vectors of keys.
const QUERIES: usize = 4;
const VECTORS: usize = 2;
/// Queries that a thread computes at once.
const TASK_QUERIES: usize = 8 * QUERIES;
/// Minimum multiplications for which other threads are worth waking.
const MIN_PARALLEL_PRODUCTS: usize = 1 << 18;

/// Keys and values of the heads of a batch, in the kernel's order; zeros fill the last vectors.
#[derive(Debug)]
pub struct PackedKeyValues {
    batch: usize,
    heads: usize,
    /// Numbers of a head's key.
    width: usize,
    /// Keys of a batch's member.
    count: usize,
    /// (batch, heads, width, vectors of keys).
    keys: Vec<[f32; LANES]>,
    /// (batch, heads, keys, vectors of a value).
    values: Vec<[f32; LANES]>,
}

impl PackedKeyValues {
    /// Packs keys and values (B, K, heads · width).
    ///
    /// # Errors
    /// When the shapes differ or the heads do not divide them.
    pub fn pack(keys: &Tensor, values: &Tensor, heads: usize) -> Result<Self> {
        let (batch, count, all) = keys.dims3()?;
        let width = all / heads;
        if keys.dims() != values.dims() || width * heads != all || count == 0 {
            bail!(
                "{:?} and {:?} are no keys and values of {heads} heads",
                keys.shape(),
                values.shape()
            );
        }
        let mut held = Self {
            batch,
            heads,
            width,
            count,
            keys: Vec::new(),
            values: Vec::new(),
        };
        with_values(keys, |keys| {
            held.fill_keys(keys);
            Ok(())
        })?;
        with_values(values, |values| {
            held.fill_values(values);
            Ok(())
        })?;
        Ok(held)
    }

    /// Keys lie feature by feature, so that one vector scores sixteen keys at once.
    fn fill_keys(&mut self, keys: &[f32]) {
        let (key_vectors, all) = (self.key_vectors(), self.heads * self.width);
        let (heads, width) = (self.heads, self.width);
        self.keys = vec![[0.0; LANES]; self.batch * heads * width * key_vectors];
        let packed = self.keys.chunks_exact_mut(width * key_vectors);
        for (place, packed) in packed.enumerate() {
            let (member, head) = (place / heads, place % heads);
            let rows = keys.chunks_exact(all).skip(member * self.count);
            for (i, key) in rows.take(self.count).enumerate() {
                for (row, value) in packed
                    .chunks_exact_mut(key_vectors)
                    .zip(&key[head * width..])
                {
                    row[i / LANES][i % LANES] = *value;
                }
            }
        }
    }

    /// Values lie key by key, as their weighted sum reads them.
    fn fill_values(&mut self, values: &[f32]) {
        let (value_vectors, all) = (self.value_vectors(), self.heads * self.width);
        let (heads, width) = (self.heads, self.width);
        self.values = vec![[0.0; LANES]; self.batch * heads * self.count * value_vectors];
        let packed = self.values.chunks_exact_mut(self.count * value_vectors);
        for (place, packed) in packed.enumerate() {
            let (member, head) = (place / heads, place % heads);
            let rows = values.chunks_exact(all).skip(member * self.count);
            for (packed, value) in packed.chunks_exact_mut(value_vectors).zip(rows) {
                packed.as_flattened_mut()[..width].copy_from_slice(&value[head * width..][..width]);
            }
        }
    }

    fn key_vectors(&self) -> usize {
        self.count.div_ceil(VECTORS * LANES) * VECTORS
    }

    fn value_vectors(&self) -> usize {
        self.width.div_ceil(LANES)
    }

    /// Attends from queries (B, Q, heads · width); returns their shape. `bias`, which has the shape
    /// (B, heads, Q, K) or ones in the place of the first three, is added to the logits.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn attend(&self, queries: &Tensor, bias: Option<&Tensor>) -> Result<Tensor> {
        let (batch, count, all) = queries.dims3()?;
        if batch != self.batch || all != self.heads * self.width {
            bail!(
                "queries {:?} do not fit {} times {} heads of {}",
                queries.shape(),
                self.batch,
                self.heads,
                self.width
            );
        }
        let held = 2 * batch * self.count * all * size_of::<f32>();
        Work::count(2 * batch * count, all, self.count, held);
        let bias = bias
            .map(|bias| Bias::from_tensor(bias, [batch, self.heads, count, self.count]))
            .transpose()?;
        with_values(queries, |values| {
            let mut out = vec![0f32; values.len()];
            let piece = |member: usize, first: usize, out: &mut [f32]| {
                let queries = &values[(member * count + first) * all..][..out.len()];
                Instructions::best().run(Piece {
                    held: self,
                    bias: bias.as_ref(),
                    member,
                    first,
                    queries,
                    out,
                });
            };
            // Pieces do not cross a batch's members.
            let member = |(member, out): (usize, &mut [f32])| {
                if 2 * batch * count * all * self.count < MIN_PARALLEL_PRODUCTS {
                    piece(member, 0, out);
                } else {
                    let pieces = out.par_chunks_mut(TASK_QUERIES * all).enumerate();
                    pieces.for_each(|(i, out)| piece(member, i * TASK_QUERIES, out));
                }
            };
            if count > 0
                && batch > 1
                && 2 * batch * count * all * self.count >= MIN_PARALLEL_PRODUCTS
            {
                out.par_chunks_exact_mut(count * all)
                    .enumerate()
                    .for_each(member);
            } else if count > 0 {
                out.chunks_exact_mut(count * all)
                    .enumerate()
                    .for_each(member);
            }
            Tensor::from_vec(out, (batch, count, all), &Device::Cpu)
        })
    }
}

/// Numbers that are added to the logits.
struct Bias {
    values: Vec<f32>,
    /// Numbers from one to the next member, head and query; 0 where they have the same.
    steps: [usize; 3],
    keys: usize,
}

impl Bias {
    fn from_tensor(bias: &Tensor, shape: [usize; 4]) -> Result<Self> {
        let dims = bias.dims();
        let fits = dims.len() == 4
            && dims[3] == shape[3]
            && dims
                .iter()
                .zip(shape)
                .all(|(&own, all)| own == all || own == 1);
        if !fits {
            bail!(
                "a bias of {:?} does not fit logits of {shape:?}",
                bias.shape()
            );
        }
        let step = |i: usize| {
            if dims[i] == 1 {
                0
            } else {
                dims[i + 1..].iter().product()
            }
        };
        Ok(Self {
            steps: [step(0), step(1), step(2)],
            keys: shape[3],
            values: bias.flatten_all()?.to_vec1()?,
        })
    }

    /// The numbers of a member, head and query.
    #[inline(always)]
    fn row(&self, place: [usize; 3]) -> &[f32] {
        let first: usize = self.steps.iter().zip(place).map(|(step, i)| step * i).sum();
        &self.values[first..][..self.keys]
    }
}

/// Some queries of a member, from the `first` on.
struct Piece<'a> {
    held: &'a PackedKeyValues,
    bias: Option<&'a Bias>,
    member: usize,
    first: usize,
    queries: &'a [f32],
    out: &'a mut [f32],
}

impl Kernel for Piece<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self {
            held,
            bias,
            member,
            first,
            queries,
            out,
        } = self;
        let &PackedKeyValues {
            heads,
            width,
            count,
            ..
        } = held;
        let (key_vectors, value_vectors, all) =
            (held.key_vectors(), held.value_vectors(), heads * width);
        let scale = 1.0 / (width as f32).sqrt();
        let mut logits = vec![[0f32; LANES]; QUERIES * key_vectors];
        for head in 0..heads {
            let place = member * heads + head;
            let keys = &held.keys[place * width * key_vectors..][..width * key_vectors];
            let values = &held.values[place * count * value_vectors..][..count * value_vectors];
            let groups = queries
                .chunks(QUERIES * all)
                .zip(out.chunks_mut(QUERIES * all));
            for (group, (queries, out)) in groups.enumerate() {
                let rows = queries.len() / all;
                // A missing query repeats the last.
                let query = |i: usize| &queries[i.min(rows - 1) * all + head * width..][..width];
                score(simd, std::array::from_fn(query), keys, scale, &mut logits);
                for (i, logits) in logits.chunks_exact_mut(key_vectors).enumerate().take(rows) {
                    let logits = &mut logits.as_flattened_mut()[..count];
                    if let Some(bias) = bias {
                        let bias = bias.row([member, head, first + group * QUERIES + i]);
                        logits
                            .iter_mut()
                            .zip(bias)
                            .for_each(|(logit, bias)| *logit += bias);
                    }
                    softmax_in_place(logits);
                }
                mix(simd, &logits, values, value_vectors, |i, column, sums| {
                    if i < rows && column < width {
                        let end = width.min(column + LANES);
                        out[i * all + head * width..][column..end]
                            .copy_from_slice(&sums[..end - column]);
                    }
                });
            }
        }
    }
}

/// The scaled products of queries with all keys.
#[inline(always)]
fn score<S: Simd>(
    simd: S,
    queries: [&[f32]; QUERIES],
    keys: &[[f32; LANES]],
    scale: f32,
    logits: &mut [[f32; LANES]],
) {
    let vectors = logits.len() / QUERIES;
    let width = queries[0].len();
    for vector in (0..vectors).step_by(VECTORS) {
        let zero = [[simd.floats(0.0); VECTORS]; QUERIES];
        let column_of = |i: usize| std::array::from_fn(|r| queries[r][i]);
        let columns = (0..width).map(column_of);
        let sums = add_product(simd, columns, &keys[vector..], vectors, zero);
        for (row, sums) in logits.chunks_exact_mut(vectors).zip(sums) {
            for (logits, sum) in row[vector..].iter_mut().zip(sums) {
                simd.store(simd.mul(sum, simd.floats(scale)), logits);
            }
        }
    }
}

/// The sums of values, weighted with the shares of each query; `write` takes the query, a column
/// and the numbers from there on.
#[inline(always)]
fn mix<S: Simd>(
    simd: S,
    shares: &[[f32; LANES]],
    values: &[[f32; LANES]],
    value_vectors: usize,
    mut write: impl FnMut(usize, usize, &[f32; LANES]),
) {
    let row = shares.len() / QUERIES * LANES;
    let shares = shares.as_flattened();
    let shares: [&[f32]; QUERIES] = std::array::from_fn(|i| &shares[i * row..][..row]);
    for vector in 0..value_vectors {
        let zero = [[simd.floats(0.0)]; QUERIES];
        let column_of = |key: usize| std::array::from_fn(|r| shares[r][key]);
        let columns = (0..row).map(column_of);
        let sums = add_product(simd, columns, &values[vector..], value_vectors, zero);
        for (i, [sum]) in sums.into_iter().enumerate() {
            let mut numbers = [0.0; LANES];
            simd.store(sum, &mut numbers);
            write(i, vector * LANES, &numbers);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::DType;

    fn scattered(shape: &[usize], seed: usize) -> Tensor {
        let count: usize = shape.iter().product();
        let values: Vec<f32> = (0..count)
            .map(|i| ((i * 7919 + seed) % 1009) as f32 / 504.5 - 1.0)
            .collect();
        Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
    }

    /// By candle, operation by operation, in f64.
    fn expected(
        query: &Tensor,
        [key, value]: [&Tensor; 2],
        heads: usize,
        bias: Option<&Tensor>,
    ) -> Tensor {
        let split = |x: &Tensor| {
            let (batch, rows, all) = x.dims3().unwrap();
            let x = x
                .to_dtype(DType::F64)
                .unwrap()
                .reshape((batch, rows, heads, all / heads))
                .unwrap();
            x.transpose(1, 2).unwrap().contiguous().unwrap()
        };
        let (query, key, value) = (split(query), split(key), split(value));
        let scale = 1.0 / (query.dim(3).unwrap() as f64).sqrt();
        let logits = (query
            .matmul(&key.transpose(2, 3).unwrap().contiguous().unwrap())
            .unwrap()
            * scale)
            .unwrap();
        let logits = bias.map_or(logits.clone(), |bias| {
            logits
                .broadcast_add(&bias.to_dtype(DType::F64).unwrap())
                .unwrap()
        });
        let mixed = candle_nn::ops::softmax(&logits, 3)
            .unwrap()
            .matmul(&value)
            .unwrap();
        let (batch, heads, rows, width) = mixed.dims4().unwrap();
        mixed
            .transpose(1, 2)
            .unwrap()
            .reshape((batch, rows, heads * width))
            .unwrap()
            .to_dtype(DType::F32)
            .unwrap()
    }

    #[test]
    fn attention_is_what_candle_computes() {
        for (batch, heads, width, queries, keys) in [
            (1, 8, 32, 67, 236),
            (3, 2, 16, 20, 20),
            (2, 4, 5, 1, 1),
            (1, 1, 48, 9, 33),
        ] {
            let tensor = |rows, seed| scattered(&[batch, rows, heads * width], seed);
            let (query, key, value) = (tensor(queries, 1), tensor(keys, 2), tensor(keys, 3));
            let hidden = scattered(&[batch, 1, queries, keys], 4);
            let hidden = hidden.gt(0.5).unwrap().where_cond(
                &Tensor::full(f32::NEG_INFINITY, hidden.dims(), &Device::Cpu).unwrap(),
                &hidden,
            );
            let hidden = hidden.unwrap();
            // Each query sees its first key.
            let first = Tensor::zeros((batch, 1, queries, 1), DType::F32, &Device::Cpu).unwrap();
            let hidden = Tensor::cat(&[first, hidden.narrow(3, 1, keys - 1).unwrap()], 3).unwrap();
            let by_head = scattered(&[1, heads, 1, keys], 5);
            for bias in [None, Some(&hidden), Some(&by_head)] {
                let found = PackedKeyValues::pack(&key, &value, heads)
                    .unwrap()
                    .attend(&query, bias)
                    .unwrap();
                let expected = expected(&query, [&key, &value], heads, bias);
                let off = (found - expected)
                    .unwrap()
                    .abs()
                    .unwrap()
                    .max_all()
                    .unwrap()
                    .to_scalar::<f32>()
                    .unwrap();
                assert!(
                    off < 1e-6,
                    "{batch} {heads} {width} {queries} {keys}: {off}"
                );
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_an_error() {
        let x = scattered(&[1, 4, 6], 0);
        assert!(PackedKeyValues::pack(&x, &x, 4).is_err());
        assert!(PackedKeyValues::pack(&x, &x.narrow(1, 0, 3).unwrap(), 2).is_err());
        let held = PackedKeyValues::pack(&x, &x, 2).unwrap();
        assert!(held.attend(&scattered(&[1, 4, 4], 0), None).is_err());
        assert!(held.attend(&x, Some(&scattered(&[1, 3, 4, 4], 0))).is_err());
    }
}
