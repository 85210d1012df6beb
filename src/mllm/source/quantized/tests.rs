//! Packed folders: whole vision models, and folders that say wrong things.

use super::open;
use super::test_folders::{
    Folder, LAYER, PackLayer, SAMPLE, floats, noise, pack_awq, pack_compressed, samples,
};
use crate::MllmError;
use crate::checkpoint::{ModelFiles, Weights};
use crate::decoder::Logits;
use crate::families::Families;
use crate::family::VisionLanguageModel;
use crate::local::test_reference::fixture;
use crate::local::{LocalModel, Sequence};
use crate::source::{Checkpoint, ModelPlace};
use candle_core::{Device, Tensor};
use planagent_kernels::matrix::WeightFormat;
use proptest::prelude::*;
use safetensors::Dtype;
use serde_json::{Value, json};
use std::path::Path;
use tempfile::TempDir;

fn opened(folder: &Path, quantize: Option<WeightFormat>) -> Result<Weights, MllmError> {
    let files = ModelFiles::folder(folder)?;
    open(&files, folder, quantize, |name| Some(name.to_owned()))
}

/// Opens a folder and reads its layer in the format of its blocks and in f32.
fn read(folder: &Folder) -> Result<(Vec<f32>, WeightFormat), MllmError> {
    let folder = folder.write();
    let name = format!("{LAYER}.weight");
    let values = opened(folder.path(), Some(WeightFormat::F32))?.take(&name, &SAMPLE)?;
    let matrix = opened(folder.path(), None)?.take_matrix(&name, SAMPLE)?;
    Ok((values.flatten_all()?.to_vec1()?, matrix.weight_format()))
}

/// The layers of the decoder of a tiny LLaVA packed, and the same numbers plain.
fn packed_llava(config: Value, pack: PackLayer) -> [TempDir; 2] {
    let from = fixture("tiny_llava");
    let mut plain = Folder::of_model(&from);
    let mut packed = plain.clone();
    for (name, written) in plain.tensors.clone() {
        let layer = name
            .strip_suffix(".weight")
            .filter(|layer| layer.ends_with("_proj"));
        let Some(layer) = layer.filter(|layer| layer.starts_with("language_model.")) else {
            continue;
        };
        let values: Vec<f32> = written
            .bytes
            .as_chunks::<4>()
            .0
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect();
        let values = Tensor::from_vec(values, written.shape.as_slice(), &Device::Cpu).unwrap();
        packed.tensors.remove(&name);
        let numbers = pack(&mut packed, layer, &values);
        plain.add(&name, Dtype::F32, &written.shape, floats(&numbers));
    }
    packed.config["quantization_config"] = config;
    [plain, packed].map(|files| {
        let folder = tempfile::tempdir().unwrap();
        for entry in std::fs::read_dir(&from).unwrap() {
            let path = entry.unwrap().path();
            std::fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
        }
        files.write_to(folder.path());
        folder
    })
}

/// Logits of an image and some tokens.
fn test_logits(place: &ModelPlace, quantize: Option<WeightFormat>) -> Vec<f32> {
    let mut checkpoint = Checkpoint::open(place, quantize, &Families::default()).unwrap();
    let model = checkpoint.open_model().unwrap();
    let model: &dyn VisionLanguageModel = &*model;
    let image = image::RgbImage::from_raw(32, 32, noise(7, 3 * 32 * 32)).unwrap();
    let features = model.encode_image(&image).unwrap();
    let mut ids = vec![1, 5];
    let tokens = std::iter::repeat_n(model.info().image_token, features.tokens());
    ids.extend(tokens.chain([7, 8, 9]));
    let logits = Sequence::new(model).append(model, &ids, Some(&features), Logits::All);
    logits
        .unwrap()
        .unwrap()
        .flatten_all()
        .unwrap()
        .to_vec1()
        .unwrap()
}

/// Checks that a packed model opens whole, and that it computes with the numbers of its file.
fn check_llava(config: Value, pack: PackLayer, said: &str) {
    let [plain, packed] = packed_llava(config, pack);
    let [plain, packed] =
        [&plain, &packed].map(|folder| ModelPlace::Folder(folder.path().to_path_buf()));
    let expected = test_logits(&plain, None);
    assert_eq!(test_logits(&packed, Some(WeightFormat::F32)), expected);
    let held = test_logits(&packed, None);
    let largest = expected
        .iter()
        .fold(0.0_f32, |largest, logit| largest.max(logit.abs()));
    let differences = held
        .iter()
        .zip(&expected)
        .map(|(held, expected)| (held - expected).abs());
    let difference = differences.fold(0.0, f32::max) / largest;
    assert!(
        difference > 0.0 && difference < 0.05,
        "the logits differ by {difference}"
    );
    let model = LocalModel::open("packed", packed.path()).unwrap();
    let notes = crate::Mllm::describe(&model).load.notes;
    assert!(notes.iter().any(|note| note == said), "{notes:?}");
}

#[test]
fn a_vision_folder_in_awq_opens_whole() {
    let config = json!({"quant_method": "awq", "bits": 4, "group_size": 32, "version": "gemm", "modules_to_not_convert": ["vision_tower"]});
    check_llava(
        config,
        pack_awq,
        "awq 4 bits: 14 layers in q5_0, which holds their numbers exactly",
    );
}

#[test]
fn a_vision_folder_in_compressed_tensors_opens_whole() {
    let config = json!({
        "quant_method": "compressed-tensors", "format": "pack-quantized", "ignore": ["lm_head", "re:vision_tower.*"],
        "config_groups": {"group_0": {"targets": ["Linear"], "weights": {"num_bits": 4, "type": "int", "group_size": 32}}},
    });
    let said = "compressed-tensors 4 bits: 14 layers in q4_0, which holds their numbers exactly";
    check_llava(config, pack_compressed, said);
}

#[test]
fn the_numbers_of_every_layout_are_held_or_rounded_as_reported() {
    for (name, folder) in samples() {
        let (values, format) = read(&folder).unwrap_or_else(|error| panic!("{name}: {error}"));
        let folder = folder.write();
        let mut weights = opened(folder.path(), None).unwrap();
        let tensor = format!("{LAYER}.weight");
        let matrix = weights.take_matrix(&tensor, SAMPLE).unwrap();
        let ids: Vec<u32> = (0..SAMPLE[0] as u32).collect();
        let rows = matrix
            .rows(&ids)
            .unwrap()
            .flatten_all()
            .unwrap()
            .to_vec1::<f32>()
            .unwrap();
        let differences = rows
            .iter()
            .zip(&values)
            .map(|(row, value)| (row - value).abs());
        let worst = differences.fold(0.0, f32::max);
        let reported = weights
            .report()
            .exceptions
            .iter()
            .find_map(|exception| exception.largest_error);
        let reported = reported.unwrap_or(0.0);
        assert!(
            worst <= reported * 1.01,
            "{name} in {format}: {worst}, but {reported} is reported"
        );
        assert!(
            values.iter().any(|value| *value != 0.0),
            "{name} has no numbers"
        );
    }
}

#[test]
fn a_layer_without_one_of_its_tensors_is_refused_by_name() {
    // Tensors that a layer may lack.
    const OPTIONAL: [&str; 5] = [
        "g_idx",
        "activation_scale",
        "input_scale",
        "weight_zero_point",
        "weight_format",
    ];
    for (name, folder) in samples() {
        let parts = folder.tensors.keys().filter(|part| part.starts_with(LAYER));
        for part in parts.filter(|part| !OPTIONAL.iter().any(|optional| part.ends_with(optional))) {
            let mut lacking = folder.clone();
            lacking.tensors.remove(part);
            let error = read(&lacking).unwrap_err().to_string();
            assert!(error.contains(LAYER), "{name} without {part}: {error}");
        }
    }
}

#[test]
fn scales_that_are_not_finite_are_refused_by_name() {
    for (name, folder) in samples() {
        let is_scale = |part: &str| {
            ["scales", "scale", "scale_inv", "SCB", "nested_absmax"]
                .iter()
                .any(|end| part.ends_with(end))
                && !part.contains("input")
                && !part.contains("activation")
        };
        let scale = folder
            .tensors
            .keys()
            .find(|part| is_scale(part))
            .unwrap()
            .clone();
        let mut broken = folder.clone();
        let written = broken.tensors.get_mut(&scale).unwrap();
        let last = written.bytes.len();
        written.bytes[last - 2..].copy_from_slice(if written.dtype == Dtype::F16 {
            &[0, 0x7e]
        } else {
            &[0xc0, 0x7f]
        });
        let error = read(&broken).unwrap_err().to_string();
        assert!(
            error.contains(&scale) && error.contains("NaN"),
            "{name}: {error}"
        );
    }
}

#[test]
fn wrong_shapes_and_types_are_refused_by_name() {
    for (name, folder) in samples() {
        for part in folder.tensors.keys().filter(|part| part.starts_with(LAYER)) {
            if ["activation_scale", "input_scale"]
                .iter()
                .any(|end| part.ends_with(end))
            {
                continue;
            }
            let mut wide = folder.clone();
            let written = wide.tensors.get_mut(part).unwrap();
            written.bytes.extend(written.bytes.clone());
            match written.shape.first_mut() {
                Some(side) => *side *= 2,
                None => written.shape = vec![2],
            }
            let twice = read(&wide).map(|(values, _)| values.len());
            // Padding of scales and a second byte of a format change nothing.
            let harmless = part.ends_with("weight_format") || name.starts_with("awq gemv");
            assert!(
                harmless || twice.is_err(),
                "{name}: {part} of twice the size is accepted"
            );
            let mut typed = folder.clone();
            let written = typed.tensors.get_mut(part).unwrap();
            let size = written.dtype.bitsize() / 8;
            written.dtype =
                [Dtype::U8, Dtype::U16, Dtype::U32, Dtype::U64][size.trailing_zeros() as usize];
            let same = written.dtype == folder.tensors[part].dtype;
            let typed = read(&typed);
            // The bytes of four bits may have any type.
            assert!(
                same || typed.is_err() || name == "bnb nf4" || part.ends_with("scale"),
                "{name}: {part} of another type is accepted"
            );
        }
    }
}

/// A sample with a change, and what the error says.
type Fault = (&'static str, fn(&mut Folder), &'static str);

#[test]
#[allow(clippy::too_many_lines, reason = "a table of faults")]
fn what_is_not_read_is_refused_with_what_to_take() {
    const METHOD: &str = "/quantization_config/quant_method";
    let faults: &[Fault] = &[
        (
            "awq gemm",
            |folder| folder.config["quantization_config"]["version"] = json!("llm-awq"),
            "'llm-awq'",
        ),
        (
            "awq gemm",
            |folder| folder.config["quantization_config"]["bits"] = json!(8),
            "4 bits",
        ),
        (
            "awq gemm",
            |folder| folder.add("model.act.scales", Dtype::F16, &[1], vec![0, 0]),
            "activation",
        ),
        (
            "gptq 4",
            |folder| folder.config["quantization_config"]["checkpoint_format"] = json!("marlin"),
            "'marlin'",
        ),
        (
            "gptq 4",
            |folder| folder.config["quantization_config"]["pack_dtype"] = json!("int16"),
            "int16",
        ),
        (
            "gptq 4",
            |folder| {
                let order = folder.tensors.get_mut(&format!("{LAYER}.g_idx")).unwrap();
                order.bytes[4..8].copy_from_slice(&(-1_i32).to_le_bytes());
            },
            "group -1",
        ),
        (
            "fp8 block",
            |folder| folder.config["quantization_config"]["fmt"] = json!("e5m2"),
            "'e5m2'",
        ),
        (
            "fp8 block",
            |folder| folder.config["quantization_config"]["weight_block_size"] = json!([0, 4]),
            "without rows",
        ),
        (
            "fp8 block",
            |folder| {
                let weight = folder.tensors.get_mut(&format!("{LAYER}.weight")).unwrap();
                weight.bytes[5] = 0x7f;
            },
            "NaN",
        ),
        (
            "ct 4",
            |folder| folder.config["quantization_config"]["format"] = json!("marlin-24"),
            "'marlin-24'",
        ),
        (
            "ct 4",
            |folder| {
                folder.config["quantization_config"]["transform_config"] =
                    json!({"config_groups": {"u": {}}});
            },
            "transform_config",
        ),
        (
            "ct 4",
            |folder| {
                folder.config["quantization_config"]["config_groups"]["group_0"]["weights"]["num_bits"] =
                    json!(5);
            },
            "words",
        ),
        (
            "ct 4",
            |folder| {
                let shape = folder
                    .tensors
                    .get_mut(&format!("{LAYER}.weight_shape"))
                    .unwrap();
                shape.bytes[8..].copy_from_slice(&i64::MAX.to_le_bytes());
            },
            "sides of a matrix",
        ),
        (
            "mlx 4",
            |folder| folder.config["quantization_config"]["mode"] = json!("mxfp4"),
            "'mxfp4'",
        ),
        (
            "mlx 4",
            |folder| folder.config["quantization_config"]["bits"] = json!(3),
            "do not fit",
        ),
        (
            "bnb int8",
            |folder| {
                folder
                    .tensors
                    .get_mut(&format!("{LAYER}.weight_format"))
                    .unwrap()
                    .bytes[0] = 2;
            },
            "tiles for a GPU",
        ),
        (
            "bnb nf4",
            |folder| {
                let state = json!({"quant_type": "nf4", "blocksize": 64, "shape": [1_u64 << 40, 1_u64 << 40]}).to_string();
                folder.add(
                    &format!("{LAYER}.weight.quant_state.bitsandbytes__nf4"),
                    Dtype::U8,
                    &[state.len()],
                    state.into_bytes(),
                );
            },
            "do not hold",
        ),
    ];
    for (name, fault, said) in faults {
        let mut folder = samples()
            .into_iter()
            .find(|(sample, _)| sample == name)
            .unwrap()
            .1;
        fault(&mut folder);
        let error = read(&folder).unwrap_err().to_string();
        assert!(error.contains(said), "{name}, {said}: {error}");
    }
    for method in [
        "hqq",
        "aqlm",
        "quanto",
        "torchao",
        "eetq",
        "auto-round",
        "exl2",
        "mxfp4",
        "new",
    ] {
        let mut folder = samples().remove(0).1;
        *folder.config.pointer_mut(METHOD).unwrap() = json!(method);
        let error = read(&folder).unwrap_err().to_string();
        let said = [
            &format!("'{method}'"),
            "--quantize",
            "GGUF",
            "config.json",
            "quant_method",
        ];
        assert!(said.iter().all(|said| error.contains(said)), "{error}");
    }
}

#[test]
fn a_description_of_plain_weights_is_ignored_with_a_note() {
    for config in [
        json!({"quant_method": "gguf"}),
        json!({"quant_method": "awq"}),
        json!({}),
    ] {
        let mut folder = Folder::new(json!({"model_type": "llama", "quantization_config": config}));
        folder.add(
            &format!("{LAYER}.weight"),
            Dtype::F32,
            &SAMPLE,
            floats(&[0.5; 512]),
        );
        folder.add(
            &format!("{LAYER}.weight_scale"),
            Dtype::F32,
            &[1],
            floats(&[0.5]),
        );
        let weights = opened(folder.write().path(), None).unwrap();
        assert!(
            weights.report().notes[0].contains("is ignored"),
            "{:?}",
            weights.report().notes
        );
        assert!(weights.is_lossless());
    }
}

#[test]
fn the_description_is_found_in_all_its_places() {
    let (_, folder) = samples().remove(0);
    let description = folder.config["quantization_config"].clone();
    let mut nested = folder.clone();
    nested.config = json!({"text_config": {"quantization_config": description.clone()}});
    read(&nested).unwrap();
    let mut beside = folder.clone();
    beside.config = json!({});
    assert!(read(&beside).unwrap_err().to_string().contains("I32"));
    let place = beside.write();
    std::fs::write(
        place.path().join("quant_config.json"),
        json!({"w_bit": 4, "q_group_size": 32}).to_string(),
    )
    .unwrap();
    opened(place.path(), None).unwrap();
    let mut mlx = samples()
        .into_iter()
        .find(|(name, _)| *name == "mlx 4")
        .unwrap()
        .1;
    mlx.config = json!({"quantization": {"group_size": 64, "bits": 8, LAYER: {"group_size": 32, "bits": 4}}});
    read(&mlx).unwrap();
}

#[test]
fn kernels_of_mlx_have_their_channels_last() {
    let mut folder = samples()
        .into_iter()
        .find(|(name, _)| *name == "mlx 4")
        .unwrap()
        .1;
    let values: Vec<f32> = (0..24).map(|value| value as f32).collect();
    folder.add(
        "vision_tower.patch.weight",
        Dtype::F32,
        &[2, 2, 2, 3],
        floats(&values),
    );
    let place = folder.write();
    let mut weights = opened(place.path(), None).unwrap();
    let kernel = weights
        .take("vision_tower.patch.weight", &[2, 3, 2, 2])
        .unwrap();
    let kernel = kernel.flatten_all().unwrap().to_vec1::<f32>().unwrap();
    assert_eq!(kernel[..5], [0.0, 3.0, 6.0, 9.0, 1.0]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn changed_bytes_are_errors_or_numbers(sample in 0_usize..16, at in any::<prop::sample::Index>(), byte in any::<u8>(), in_config in any::<bool>()) {
        let samples = samples();
        let (_, folder) = &samples[sample % samples.len()];
        let place = folder.write();
        let path = place.path().join(if in_config { "config.json" } else { "model.safetensors" });
        let mut bytes = std::fs::read(&path).unwrap();
        let at = at.index(bytes.len());
        bytes[at] = byte;
        std::fs::write(&path, bytes).unwrap();
        for quantize in [None, Some(WeightFormat::F32)] {
            if let Ok(mut weights) = opened(place.path(), quantize) {
                let _ = weights.forecast(quantize);
                let _ = weights.take_matrix(&format!("{LAYER}.weight"), SAMPLE);
            }
        }
    }
}
