//! Reads the vectors of the learned planners and compares tensors with them.
//! `tests/fixtures/learned/README.md` says what they are.

use candle_core::{DType, Device, Tensor};
use planagent_learned::Weights;
use safetensors::{Dtype, SafeTensors};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Tolerance of networks: absolute, and relative to the expected value.
pub(super) const NETWORK: f32 = 1e-4;
/// Tolerance of features.
pub(super) const FEATURES: f32 = 1e-5;

/// A file that the repository has.
pub(super) fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/learned")
        .join(name)
}

pub(super) fn json(name: &str) -> Value {
    serde_json::from_str(&std::fs::read_to_string(fixture(name)).unwrap()).unwrap()
}

/// The numbers of nested lists.
pub(super) fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        number => vec![number.as_f64().unwrap()],
    }
}

/// The tensors of a file.
pub(super) struct Vectors(BTreeMap<String, Tensor>);

impl Vectors {
    pub(super) fn open(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let tensor = |view: safetensors::tensor::TensorView<'_>| {
            let (data, shape) = (view.data(), view.shape());
            let floats = |data: &[u8]| {
                data.as_chunks()
                    .0
                    .iter()
                    .map(|&b| f32::from_le_bytes(b))
                    .collect::<Vec<f32>>()
            };
            let longs = |data: &[u8]| {
                data.as_chunks()
                    .0
                    .iter()
                    .map(|&b| i64::from_le_bytes(b))
                    .collect::<Vec<i64>>()
            };
            let ints = |data: &[u8]| {
                data.as_chunks()
                    .0
                    .iter()
                    .map(|&b| i32::from_le_bytes(b).into())
                    .collect::<Vec<i64>>()
            };
            match view.dtype() {
                Dtype::F32 => Tensor::from_vec(floats(data), shape, &Device::Cpu),
                Dtype::U8 => Tensor::from_vec(data.to_vec(), shape, &Device::Cpu),
                Dtype::I8 => Tensor::from_vec(
                    data.iter().map(|&b| i64::from(b as i8)).collect(),
                    shape,
                    &Device::Cpu,
                ),
                Dtype::I32 => Tensor::from_vec(ints(data), shape, &Device::Cpu),
                Dtype::I64 => Tensor::from_vec(longs(data), shape, &Device::Cpu),
                other => panic!("{other:?} in {}", path.display()),
            }
            .unwrap()
        };
        Self(
            file.tensors()
                .into_iter()
                .map(|(name, view)| (name, tensor(view)))
                .collect(),
        )
    }

    pub(super) fn get(&self, name: &str) -> &Tensor {
        self.0
            .get(name)
            .unwrap_or_else(|| panic!("no {name} among {:?}", self.0.keys()))
    }

    pub(super) fn find(&self, name: &str) -> Option<&Tensor> {
        self.0.get(name)
    }

    pub(super) fn of_kind(&self, dtype: DType, name: &str) -> Tensor {
        self.get(name).to_dtype(dtype).unwrap()
    }

    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }
}

/// Asserts that each number is within the tolerance; says how far off the worst is.
#[allow(
    clippy::print_stdout,
    reason = "with --nocapture, a test prints its deviations"
)]
pub(super) fn assert_close(what: &str, found: &Tensor, expected: &Tensor, tolerance: f32) {
    assert_eq!(found.dims(), expected.dims(), "{what}");
    let numbers = |tensor: &Tensor| -> Vec<f32> {
        tensor
            .to_dtype(DType::F32)
            .unwrap()
            .flatten_all()
            .unwrap()
            .to_vec1()
            .unwrap()
    };
    let mut worst = (0.0f32, 0usize, 0.0f32, 0.0f32);
    for (i, (found, expected)) in numbers(found)
        .into_iter()
        .zip(numbers(expected))
        .enumerate()
    {
        let deviation = (found - expected).abs() / (1.0 + expected.abs());
        if deviation.is_nan() || deviation > worst.0 {
            worst = (deviation, i, found, expected);
        }
    }
    println!("{what}: worst deviation {:e}", worst.0);
    let (deviation, at, found, expected) = worst;
    assert!(
        deviation <= tolerance,
        "{what}: {found} instead of {expected} at {at} (deviation {deviation:e})"
    );
}

/// As [`assert_close`], where a file of a network of the published size keeps every n-th entry along
/// an axis (`tests/fixtures/learned/thin.py`).
pub(super) fn assert_close_thinned(what: &str, found: &Tensor, expected: &Tensor, tolerance: f32) {
    let mut found = found.clone();
    for (axis, &kept) in expected.dims().iter().enumerate() {
        let size = found.dim(axis).unwrap();
        if kept < size && size.is_multiple_of(kept) {
            let step = (size / kept) as u32;
            let places = Tensor::arange_step(0, size as u32, step, &Device::Cpu).unwrap();
            found = found.index_select(&places, axis).unwrap();
        }
    }
    assert_close(what, &found, expected, tolerance);
}

/// How tensors are compared with a file of this name.
pub(super) fn comparison(name: &str) -> fn(&str, &Tensor, &Tensor, f32) {
    if name.contains("_full") {
        assert_close_thinned
    } else {
        assert_close
    }
}

/// Weights by the recipe of the vectors: a generated number for each name and place.
pub(super) fn generated(manifest: &[(String, Vec<usize>)]) -> Weights {
    Weights::new(tensors(manifest))
}

/// The tensors of [`generated`].
pub(super) fn tensors(manifest: &[(String, Vec<usize>)]) -> BTreeMap<String, Tensor> {
    manifest
        .iter()
        .map(|(name, shape)| (name.clone(), recipe(name, shape)))
        .collect()
}

fn recipe(name: &str, shape: &[usize]) -> Tensor {
    // All interaction stages of GameFormer share the encoder of futures.
    let shared = name.replace(
        "interaction_stage.1.future_encoder",
        "interaction_stage.0.future_encoder",
    );
    let name = shared.as_str();
    let last = name.rsplit('.').next().unwrap();
    let inner: usize = shape.iter().skip(1).product();
    let value = |u: f64| {
        let w = 2.0 * u - 1.0;
        match (last, shape.len()) {
            ("num_batches_tracked", _) => 100.0,
            ("running_mean", _) => 0.2 * w,
            ("running_var", _) => 0.5 + u,
            (_, rank) if rank >= 2 => w * (3.0 / inner as f64).sqrt(),
            ("weight", _) => 1.0 + 0.2 * w,
            _ => 0.1 * w,
        }
    };
    let values: Vec<f32> = uniform(name, shape.iter().product())
        .map(|u| value(u) as f32)
        .collect();
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}

/// Numbers in [0, 1) from a key.
pub(super) fn uniform(key: &str, count: usize) -> impl Iterator<Item = f64> {
    let seed = key.bytes().fold(0xcbf2_9ce4_8422_2325u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    });
    (1..=count as u64).map(move |i| {
        let mut z = seed.wrapping_add(i.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 40) as f64 / f64::from(1u32 << 24)
    })
}

/// Inputs by the recipe: numbers within ±`bound`.
pub(super) fn input(name: &str, count: usize, bound: f64) -> Vec<f32> {
    uniform(&format!("input:{name}"), count)
        .map(|u| (-bound + 2.0 * bound * u) as f32)
        .collect()
}

/// A network with weights by the recipe: the names and shapes are those that it asks for.
pub(super) fn network<M>(take: impl Fn(&mut Weights) -> candle_core::Result<M>) -> M {
    let manifest = manifest_of(&take);
    let mut weights = generated(&manifest);
    let network = take(&mut weights).unwrap();
    weights.finish().unwrap();
    network
}

/// The names and shapes that a network asks for.
pub(super) fn manifest_of<M>(
    take: impl Fn(&mut Weights) -> candle_core::Result<M>,
) -> Vec<(String, Vec<usize>)> {
    let mut asked = Weights::new(BTreeMap::new());
    take(&mut asked).unwrap();
    asked.manifest().to_vec()
}

/// Asserts that a network asks for exactly the tensors of a manifest.
pub(super) fn assert_manifest<M>(
    file: &str,
    take: impl Fn(&mut Weights) -> candle_core::Result<M>,
) {
    let mut asked = manifest_of(take);
    asked.sort();
    let tensor = |tensor: &Value| {
        let shape = tensor["shape"]
            .as_array()
            .unwrap()
            .iter()
            .map(|size| size.as_u64().unwrap() as usize)
            .collect();
        (tensor["key"].as_str().unwrap().to_owned(), shape)
    };
    let mut expected: Vec<(String, Vec<usize>)> = json(file)["tensors"]
        .as_array()
        .unwrap()
        .iter()
        .map(tensor)
        .collect();
    expected.sort();
    assert_eq!(asked, expected);
}
