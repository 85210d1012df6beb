//! Folders with packed layers for tests, written by packers of their own.

use candle_core::{DType, Device, Tensor};
use half::f16;
use safetensors::tensor::{Dtype, TensorView};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use tempfile::TempDir;

/// A tensor of a file to be written.
#[derive(Debug, Clone)]
pub(super) struct Written {
    pub dtype: Dtype,
    pub shape: Vec<usize>,
    pub bytes: Vec<u8>,
}

/// A folder to be written.
#[derive(Debug, Clone)]
pub(super) struct Folder {
    pub config: Value,
    pub tensors: BTreeMap<String, Written>,
}

impl Folder {
    pub(super) fn new(config: Value) -> Self {
        Self {
            config,
            tensors: BTreeMap::new(),
        }
    }

    /// The files of a model in f32.
    pub(super) fn of_model(folder: &Path) -> Self {
        let config = std::fs::read_to_string(folder.join("config.json")).unwrap();
        let mut model = Self::new(serde_json::from_str(&config).unwrap());
        let weights = folder.join("model.safetensors");
        for (name, tensor) in candle_core::safetensors::load(weights, &Device::Cpu).unwrap() {
            let tensor = tensor.to_dtype(DType::F32).unwrap();
            let values = tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
            model.add(&name, Dtype::F32, tensor.dims(), floats(&values));
        }
        model
    }

    pub(super) fn add(&mut self, name: &str, dtype: Dtype, shape: &[usize], bytes: Vec<u8>) {
        let shape = shape.to_vec();
        let written = Written {
            dtype,
            shape,
            bytes,
        };
        self.tensors.insert(name.to_owned(), written);
    }

    /// Writes configuration and weights.
    pub(super) fn write_to(&self, folder: &Path) {
        std::fs::write(folder.join("config.json"), self.config.to_string()).unwrap();
        let views = self.tensors.iter().map(|(name, written)| {
            let view = TensorView::new(written.dtype, written.shape.clone(), &written.bytes);
            (name.clone(), view.unwrap())
        });
        let bytes = safetensors::serialize(views, None).unwrap();
        std::fs::write(folder.join("model.safetensors"), bytes).unwrap();
    }

    pub(super) fn write(&self) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        self.write_to(folder.path());
        folder
    }
}

pub(super) fn floats(values: &[f32]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

pub(super) fn halves(values: &[f32]) -> Vec<u8> {
    let halves = values.iter().map(|value| f16::from_f32(*value));
    halves.flat_map(f16::to_le_bytes).collect()
}

pub(super) fn words(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// Bytes that look random, the same for the same seed.
pub(super) fn noise(seed: u32, count: usize) -> Vec<u8> {
    let mut state = seed.wrapping_mul(2_654_435_761) | 1;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    (0..count).map(|_| next()).collect()
}

/// Numbers from 0.05 to 0.3 that half precision holds.
fn scales(seed: u32, count: usize) -> Vec<f32> {
    let scale = |byte: u8| 0.0625 + f32::from(byte) / 1024.0;
    noise(seed, count).into_iter().map(scale).collect()
}

/// Rows and columns of the layer of a sample.
pub(super) const SAMPLE: [usize; 2] = [8, 64];
/// Its name.
pub(super) const LAYER: &str = "model.layer";

/// A folder with one packed layer in each layout, by the name of the layout.
#[allow(clippy::too_many_lines, reason = "a list of layouts")]
pub(super) fn samples() -> Vec<(&'static str, Folder)> {
    let [outputs, inputs] = SAMPLE;
    let groups = inputs / 32;
    let mut samples = Vec::new();
    let mut sample = |name: &'static str,
                      config: Value,
                      parts: &[(&str, Dtype, &[usize], Vec<u8>)]| {
        let mut folder = Folder::new(json!({"model_type": "llama", "quantization_config": config}));
        for (part, dtype, shape, bytes) in parts {
            folder.add(&format!("{LAYER}.{part}"), *dtype, shape, bytes.clone());
        }
        folder.add("model.norm.weight", Dtype::F16, &[4], halves(&[1.0; 4]));
        samples.push((name, folder));
    };
    let (i32s, f16s) = (Dtype::I32, Dtype::F16);
    let scale = |count: usize| halves(&scales(3, count));
    sample(
        "awq gemm",
        json!({"quant_method": "awq", "bits": 4, "group_size": 32, "version": "GEMM"}),
        &[
            (
                "qweight",
                i32s,
                &[inputs, outputs / 8],
                noise(1, 4 * inputs * outputs / 8),
            ),
            (
                "qzeros",
                i32s,
                &[groups, outputs / 8],
                noise(2, 4 * groups * outputs / 8),
            ),
            ("scales", f16s, &[groups, outputs], scale(groups * outputs)),
        ],
    );
    sample(
        "awq gemv",
        json!({"quant_method": "awq", "bits": 4, "group_size": 32, "version": "gemv"}),
        &[
            (
                "qweight",
                i32s,
                &[outputs, inputs / 8],
                noise(1, 4 * inputs * outputs / 8),
            ),
            ("qzeros", i32s, &[outputs, 4], noise(2, 16 * outputs)),
            ("scales", f16s, &[outputs, 32], scale(32 * outputs)),
        ],
    );
    sample(
        "awq gemv_fast",
        json!({"quant_method": "awq", "bits": 4, "group_size": 32, "version": "gemv_fast"}),
        &[
            (
                "qweight",
                Dtype::I16,
                &[outputs / 4, inputs],
                noise(1, 2 * inputs * outputs / 4),
            ),
            ("qzeros", f16s, &[8, outputs], scale(8 * outputs)),
            ("scales", f16s, &[8, outputs], scale(8 * outputs)),
        ],
    );
    for (name, bits, version) in [
        ("gptq 2", 2, "gptq_v2"),
        ("gptq 3", 3, "gptq"),
        ("gptq 4", 4, "gptq"),
        ("gptq 8", 8, "gptq"),
    ] {
        let zeros = (outputs * bits).div_ceil(32);
        let order: Vec<u32> = (0..inputs)
            .map(|column| (column * 7 % groups) as u32)
            .collect();
        sample(
            name,
            json!({"quant_method": "gptq", "bits": bits, "checkpoint_format": version}),
            &[
                (
                    "qweight",
                    i32s,
                    &[inputs * bits / 32, outputs],
                    noise(1, inputs * bits / 8 * outputs),
                ),
                (
                    "qzeros",
                    i32s,
                    &[groups, zeros],
                    noise(2, 4 * groups * zeros),
                ),
                ("scales", f16s, &[groups, outputs], scale(groups * outputs)),
                ("g_idx", i32s, &[inputs], words(&order)),
            ],
        );
    }
    let finite: Vec<u8> = noise(1, outputs * inputs)
        .into_iter()
        .map(|byte| byte & 0xf7)
        .collect();
    sample(
        "fp8 block",
        json!({"quant_method": "fp8", "weight_block_size": [3, 48]}),
        &[
            ("weight", Dtype::F8_E4M3, &[outputs, inputs], finite.clone()),
            (
                "weight_scale_inv",
                Dtype::F32,
                &[3, 2],
                floats(&scales(2, 6)),
            ),
            ("activation_scale", Dtype::F32, &[], floats(&[1.0])),
        ],
    );
    let group = |weights: Value| json!({"quant_method": "compressed-tensors", "config_groups": {"group_0": {"targets": ["Linear"], "weights": weights}}});
    for (name, bits) in [("ct 4", 4), ("ct 3", 3)] {
        let width = inputs * bits / 32;
        sample(
            name,
            group(json!({"num_bits": bits, "type": "int", "strategy": "group", "group_size": 32})),
            &[
                (
                    "weight_packed",
                    i32s,
                    &[outputs, width],
                    noise(1, 4 * outputs * width),
                ),
                (
                    "weight_scale",
                    f16s,
                    &[outputs, groups],
                    scale(outputs * groups),
                ),
                (
                    "weight_zero_point",
                    i32s,
                    &[(outputs * bits).div_ceil(32), groups],
                    noise(2, 4 * (outputs * bits).div_ceil(32) * groups),
                ),
                (
                    "weight_shape",
                    Dtype::I64,
                    &[2],
                    [outputs, inputs]
                        .iter()
                        .flat_map(|side| (*side as i64).to_le_bytes())
                        .collect(),
                ),
            ],
        );
    }
    sample(
        "ct int8",
        group(json!({"num_bits": 8, "type": "int", "strategy": "channel"})),
        &[
            (
                "weight",
                Dtype::I8,
                &[outputs, inputs],
                noise(1, outputs * inputs),
            ),
            (
                "weight_scale",
                Dtype::F32,
                &[outputs, 1],
                floats(&scales(2, outputs)),
            ),
            (
                "weight_zero_point",
                Dtype::I8,
                &[outputs, 1],
                noise(3, outputs),
            ),
        ],
    );
    sample(
        "ct fp8",
        group(json!({"num_bits": 8, "type": "float", "strategy": "channel"})),
        &[
            ("weight", Dtype::F8_E4M3, &[outputs, inputs], finite),
            (
                "weight_scale",
                Dtype::BF16,
                &[outputs, 1],
                [0x80, 0x3d].repeat(outputs),
            ),
            ("input_scale", Dtype::F32, &[1], floats(&[1.0])),
        ],
    );
    for (name, bits) in [("mlx 4", 4), ("mlx 6", 6)] {
        let width = inputs * bits / 32;
        sample(
            name,
            json!({"group_size": 32, "bits": bits}),
            &[
                (
                    "weight",
                    Dtype::U32,
                    &[outputs, width],
                    noise(1, 4 * outputs * width),
                ),
                ("scales", f16s, &[outputs, groups], scale(outputs * groups)),
                ("biases", f16s, &[outputs, groups], scale(outputs * groups)),
            ],
        );
    }
    let state = json!({"quant_type": "nf4", "blocksize": 64, "dtype": "float16", "shape": SAMPLE, "nested_blocksize": 4, "nested_offset": 0.5});
    let state = state.to_string().into_bytes();
    let runs = outputs * inputs / 64;
    sample(
        "bnb nf4",
        json!({"quant_method": "bitsandbytes", "load_in_4bit": true}),
        &[
            (
                "weight",
                Dtype::U8,
                &[outputs * inputs / 2, 1],
                noise(1, outputs * inputs / 2),
            ),
            ("weight.absmax", Dtype::U8, &[runs], noise(2, runs)),
            (
                "weight.quant_map",
                Dtype::F32,
                &[16],
                floats(&scales(3, 16)),
            ),
            (
                "weight.nested_absmax",
                Dtype::F32,
                &[2],
                floats(&scales(4, 2)),
            ),
            (
                "weight.nested_quant_map",
                Dtype::F32,
                &[256],
                floats(&scales(5, 256)),
            ),
            (
                "weight.quant_state.bitsandbytes__nf4",
                Dtype::U8,
                &[state.len()],
                state,
            ),
        ],
    );
    sample(
        "bnb int8",
        json!({"quant_method": "bitsandbytes", "load_in_8bit": true}),
        &[
            (
                "weight",
                Dtype::I8,
                &[outputs, inputs],
                noise(1, outputs * inputs),
            ),
            ("SCB", Dtype::F32, &[outputs], floats(&scales(2, outputs))),
            ("weight_format", Dtype::U8, &[], vec![0]),
        ],
    );
    samples
}

/// What a layer is packed into, and the numbers that it then has.
pub(super) type PackLayer = fn(&mut Folder, layer: &str, values: &Tensor) -> Vec<f32>;

/// Columns that share a scale.
const GROUP: usize = 32;

/// Rounds a matrix to four bits in groups: codes, zero points and scales, an entry for each row and
/// group of the last two.
fn rounded(values: &Tensor, symmetric: bool) -> (Vec<Vec<u32>>, Vec<u32>, Vec<f32>) {
    let (mut codes, mut zeros, mut scales) = (Vec::new(), Vec::new(), Vec::new());
    for row in values.to_vec2::<f32>().unwrap() {
        let mut row_codes = Vec::new();
        for group in row.chunks(GROUP) {
            let low = group.iter().copied().fold(0.0, f32::min);
            let high = group.iter().copied().fold(0.0, f32::max);
            let step = if symmetric {
                low.abs().max(high) / 7.0
            } else {
                (high - low) / 15.0
            };
            let scale = f16::from_f32(step).to_f32();
            let zero = if symmetric {
                8.0
            } else {
                (-low / scale).round()
            };
            row_codes.extend(
                group
                    .iter()
                    .map(|value| (value / scale + zero).round().clamp(0.0, 15.0) as u32),
            );
            zeros.push(zero as u32);
            scales.push(scale);
        }
        codes.push(row_codes);
    }
    (codes, zeros, scales)
}

fn numbers(codes: &[Vec<u32>], zeros: &[u32], scales: &[f32]) -> Vec<f32> {
    let groups = codes[0].len() / GROUP;
    let mut numbers = Vec::new();
    for (row, codes) in codes.iter().enumerate() {
        for (column, code) in codes.iter().enumerate() {
            let place = row * groups + column / GROUP;
            numbers.push((*code as f32 - zeros[place] as f32) * scales[place]);
        }
    }
    numbers
}

/// Packs a layer as autoawq does for `gemm`.
pub(super) fn pack_awq(folder: &mut Folder, layer: &str, values: &Tensor) -> Vec<f32> {
    const ORDER: [usize; 8] = [0, 2, 4, 6, 1, 3, 5, 7];
    let (codes, zeros, scales) = rounded(values, false);
    let (outputs, inputs) = values.dims2().unwrap();
    let groups = inputs / GROUP;
    let packed = |rows: usize, code: &dyn Fn(usize, usize) -> u32| {
        let mut packed = Vec::new();
        for row in 0..rows {
            for first in (0..outputs).step_by(8) {
                let place =
                    |(place, output): (usize, &usize)| code(row, first + output) << (4 * place);
                packed.push(
                    ORDER
                        .iter()
                        .enumerate()
                        .map(place)
                        .fold(0, |word, bits| word | bits),
                );
            }
        }
        words(&packed)
    };
    let weights = packed(inputs, &|input, output| codes[output][input]);
    let packed_zeros = packed(groups, &|group, output| zeros[output * groups + group]);
    let across: Vec<f32> = (0..groups)
        .flat_map(|group| (0..outputs).map(move |output| (group, output)))
        .map(|(group, output)| scales[output * groups + group])
        .collect();
    folder.add(
        &format!("{layer}.qweight"),
        Dtype::I32,
        &[inputs, outputs / 8],
        weights,
    );
    folder.add(
        &format!("{layer}.qzeros"),
        Dtype::I32,
        &[groups, outputs / 8],
        packed_zeros,
    );
    folder.add(
        &format!("{layer}.scales"),
        Dtype::F16,
        &[groups, outputs],
        halves(&across),
    );
    numbers(&codes, &zeros, &scales)
}

/// Packs a layer as compressed-tensors does for W4A16.
pub(super) fn pack_compressed(folder: &mut Folder, layer: &str, values: &Tensor) -> Vec<f32> {
    let (codes, zeros, scales) = rounded(values, true);
    let (outputs, inputs) = values.dims2().unwrap();
    let in_word = |codes: &[u32]| {
        codes
            .iter()
            .enumerate()
            .fold(0, |word, (place, code)| word | code << (4 * place))
    };
    let packed: Vec<u32> = codes
        .iter()
        .flat_map(|row| row.chunks(8).map(in_word))
        .collect();
    let shape: Vec<u8> = [outputs, inputs]
        .iter()
        .flat_map(|side| (*side as i64).to_le_bytes())
        .collect();
    folder.add(
        &format!("{layer}.weight_packed"),
        Dtype::I32,
        &[outputs, inputs / 8],
        words(&packed),
    );
    folder.add(
        &format!("{layer}.weight_scale"),
        Dtype::F16,
        &[outputs, inputs / GROUP],
        halves(&scales),
    );
    folder.add(&format!("{layer}.weight_shape"), Dtype::I64, &[2], shape);
    numbers(&codes, &zeros, &scales)
}
