//! Which format each tensor of a checkpoint has in memory.

use super::packed::{Held, PackedForm};
use candle_core::quantized::GgmlDType;
use planagent_kernels::matrix::{StoredFormat, WeightFormat};

/// Chooses the format of tensors by the user's wish, their role, and their format in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct WeightFormatPlan {
    /// The wanted format; none for that of the file.
    pub quantize: Option<WeightFormat>,
    /// Decides the format where none is wanted.
    pub kind: FileKind,
    /// Whether the embedding is also the output layer.
    pub tied: bool,
    /// Whether rows fill whole blocks, as in a file. In memory, zeros may fill the last one.
    pub whole_blocks: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum FileKind {
    /// Training checkpoints: f32 by default.
    #[default]
    Safetensors,
    /// Checkpoints of which a quantizer packed some layers. The others are as in
    /// [`Self::Safetensors`].
    Quantized,
    /// Inference files: their own format by default.
    Gguf,
}

/// The format of one matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct PlannedFormat {
    pub weight_format: WeightFormat,
    /// Why it is not the wanted one or that of the file.
    pub reason: Option<&'static str>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    Decoder,
    /// The output layer decides the token; llama.cpp gives it more bits too.
    Output,
    /// Vision tower and projector are a small part of the weights, and their errors reach every
    /// image token.
    Vision,
}

/// Whether a tensor of this name and shape is the matrix of a linear layer or an embedding. All
/// others (norms, biases, positions, kernels, learned rows, coefficients of streams) are small and
/// stay in f32.
pub(crate) fn is_matrix(name: &str, shape: &[usize]) -> bool {
    shape.len() == 2
        && name.ends_with(".weight")
        && !name.contains("position_embedding")
        && !name.contains(".altup.")
        && !is_kernel(name)
}

/// Whether a tensor has the taps of a decoder layer's convolution. GGUF files hold it without its
/// side of 1.
pub(crate) fn is_kernel(name: &str) -> bool {
    name.ends_with(".conv.conv.weight") || name.ends_with(".conv1d.weight")
}

impl WeightFormatPlan {
    /// The format in memory of a matrix with `inputs` columns that has `format` in its file.
    pub(crate) fn matrix(
        self,
        name: &str,
        format: impl Into<StoredFormat>,
        inputs: usize,
    ) -> PlannedFormat {
        let format = format.into();
        let (wanted, reason) = match self.quantize {
            None => self.as_in_file(format),
            Some(asked) => self.asked_for(asked, name, format),
        };
        self.fitting(wanted, reason, inputs)
    }

    /// The format in memory of a matrix with `inputs` columns that a quantizer packed.
    pub(crate) fn packed_matrix(
        self,
        name: &str,
        form: &PackedForm,
        inputs: usize,
    ) -> PlannedFormat {
        let (wanted, reason) = match self.quantize {
            None => (form.weight_format, form.held.reason()),
            // Who asks for floats gets the numbers of the file, and unrounded activations.
            Some(asked @ (WeightFormat::F32 | WeightFormat::F16)) => (asked, None),
            Some(asked) => {
                let (wanted, reason) = self.at_least(asked, name);
                if form.held != Held::Rounded && form.weight_format.bits() <= wanted.bits() {
                    (form.weight_format, form.held.reason())
                } else {
                    (wanted, reason)
                }
            }
        };
        self.fitting(wanted, reason, inputs)
    }

    /// The format in memory of a matrix that an adapter was merged into in f32; its base has the
    /// format `base`. To round it to the steps of a base of few bits would undo changes that are
    /// smaller than a step.
    pub(crate) fn merged(self, name: &str, base: StoredFormat, inputs: usize) -> PlannedFormat {
        if self.quantize.is_some() {
            return self.matrix(name, GgmlDType::F32, inputs);
        }
        let wanted = if base.block_size() == 1 {
            WeightFormat::F32
        } else {
            WeightFormat::Q8_0
        };
        let weight_format = self.or_finer(wanted, inputs);
        PlannedFormat {
            weight_format,
            reason: (held_as(base) != Some(weight_format)).then_some(MERGED),
        }
    }

    /// Whether nothing is rounded on the way into memory, nor meant to be rounded while computing:
    /// safetensors as they are.
    pub(crate) fn is_lossless(self) -> bool {
        self.kind == FileKind::Safetensors && self.quantize.is_none()
    }

    /// A format that can hold rows of `inputs` numbers.
    fn fitting(
        self,
        wanted: WeightFormat,
        reason: Option<&'static str>,
        inputs: usize,
    ) -> PlannedFormat {
        let weight_format = self.or_finer(wanted, inputs);
        let reason = if weight_format == wanted {
            reason
        } else {
            Some("the rows are no whole blocks of the wanted format")
        };
        PlannedFormat {
            weight_format,
            reason,
        }
    }

    fn or_finer(self, wanted: WeightFormat, inputs: usize) -> WeightFormat {
        if self.whole_blocks {
            wanted.or_finer(inputs)
        } else {
            wanted.or_finer_in_memory(inputs)
        }
    }

    fn as_in_file(self, format: StoredFormat) -> (WeightFormat, Option<&'static str>) {
        match (self.kind, held_as(format)) {
            (FileKind::Safetensors | FileKind::Quantized, Some(WeightFormat::F16)) => {
                (WeightFormat::F16, None)
            }
            (FileKind::Safetensors | FileKind::Quantized, _) => (WeightFormat::F32, None),
            (FileKind::Gguf, Some(weight_format)) => (weight_format, None),
            (FileKind::Gguf, None) => replacement(format),
        }
    }

    /// The asked format, or the smallest for the role.
    fn at_least(self, asked: WeightFormat, name: &str) -> (WeightFormat, Option<&'static str>) {
        match self.role(name) {
            Role::Output if asked.bits() < WeightFormat::Q6K.bits() => {
                (WeightFormat::Q6K, Some("the output layer gets more bits"))
            }
            Role::Vision if asked.bits() < WeightFormat::Q8_0.bits() => {
                let eight_bits = if self.whole_blocks {
                    WeightFormat::Q8_0
                } else {
                    WeightFormat::Q8Of256
                };
                let reason = "vision tower and projector get at least 8 bits";
                (eight_bits, Some(reason))
            }
            _ => (asked, None),
        }
    }

    fn asked_for(
        self,
        asked: WeightFormat,
        name: &str,
        format: StoredFormat,
    ) -> (WeightFormat, Option<&'static str>) {
        let (wanted, reason) = self.at_least(asked, name);
        match held_as(format) {
            // A matrix that was rounded to few bits gains nothing from other blocks of more bits, and
            // loses by as many. Written out as plain numbers, it loses nothing.
            Some(held)
                if held.block() > 1
                    && wanted.block() > 1
                    && held != wanted
                    && held.bits() <= wanted.bits() =>
            {
                (held, Some("the file has no more bits"))
            }
            _ => (wanted, reason),
        }
    }

    fn role(self, name: &str) -> Role {
        let output = if self.tied {
            "embed_tokens.weight"
        } else {
            "lm_head.weight"
        };
        if name.ends_with(output) {
            Role::Output
        } else if ["vision_tower.", "vision.", "multi_modal_projector."]
            .iter()
            .any(|part| name.starts_with(part))
        {
            Role::Vision
        } else {
            Role::Decoder
        }
    }
}

/// The format in memory that equals a file's format.
pub(crate) fn held_as(format: impl Into<StoredFormat>) -> Option<WeightFormat> {
    let format = match format.into() {
        StoredFormat::Ggml(format) => format,
        StoredFormat::Iq4Nl => return Some(WeightFormat::Iq4Nl),
        StoredFormat::Iq4Xs => return Some(WeightFormat::Iq4Xs),
        StoredFormat::Mxfp4 => return Some(WeightFormat::Mxfp4),
        StoredFormat::Q8Of256 => return Some(WeightFormat::Q8Of256),
    };
    match format {
        GgmlDType::F32 => Some(WeightFormat::F32),
        GgmlDType::F16 => Some(WeightFormat::F16),
        GgmlDType::Q8_0 => Some(WeightFormat::Q8_0),
        GgmlDType::Q6K => Some(WeightFormat::Q6K),
        GgmlDType::Q5_1 => Some(WeightFormat::Q5_1),
        GgmlDType::Q5K => Some(WeightFormat::Q5K),
        GgmlDType::Q5_0 => Some(WeightFormat::Q5_0),
        GgmlDType::Q4_1 => Some(WeightFormat::Q4_1),
        GgmlDType::Q4K => Some(WeightFormat::Q4K),
        GgmlDType::Q4_0 => Some(WeightFormat::Q4_0),
        GgmlDType::Q3K => Some(WeightFormat::Q3K),
        _ => None,
    }
}

/// Why a matrix has a finer format than its file.
const MERGED: &str = "an adapter is merged into it (--quantize chooses another format)";

/// The format in memory for a file's format that has no equal, and why. It is 8 bits, which hold
/// the numbers of most formats exactly and round those of the others little. bf16 needs f32, whose
/// range f16 does not have.
fn replacement(format: StoredFormat) -> (WeightFormat, Option<&'static str>) {
    if format.block_size() > 1 {
        (
            WeightFormat::Q8_0,
            Some(
                "rounded to 8 bits; the file's format has no fast product (--quantize f16 rounds less)",
            ),
        )
    } else {
        (
            WeightFormat::F32,
            Some("the file's format has no fast product"),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DECODER: &str = "language_model.layers.0.mlp.up_proj.weight";
    const TOWER: &str = "vision_tower.encoder.layers.3.mlp.fc1.weight";

    fn asked(weight_format: WeightFormat) -> WeightFormatPlan {
        WeightFormatPlan {
            quantize: Some(weight_format),
            ..WeightFormatPlan::default()
        }
    }

    #[test]
    fn output_layer_and_vision_get_more_bits() {
        let plan = asked(WeightFormat::Q4K);
        for (name, expected) in [
            (DECODER, WeightFormat::Q4K),
            (
                "layers.1.self_attn.vision_expert_dense.weight",
                WeightFormat::Q4K,
            ),
            ("language_model.embed_tokens.weight", WeightFormat::Q4K),
            ("lm_head.weight", WeightFormat::Q6K),
            (TOWER, WeightFormat::Q8Of256),
            ("vision.linear_proj.gate_proj.weight", WeightFormat::Q8Of256),
        ] {
            assert_eq!(
                plan.matrix(name, GgmlDType::F16, 512).weight_format,
                expected,
                "{name}"
            );
        }
        let tied = WeightFormatPlan { tied: true, ..plan };
        assert_eq!(
            tied.matrix("language_model.embed_tokens.weight", GgmlDType::F16, 512)
                .weight_format,
            WeightFormat::Q6K
        );
        assert_eq!(
            asked(WeightFormat::F16)
                .matrix(TOWER, GgmlDType::F32, 512)
                .weight_format,
            WeightFormat::F16
        );
        assert_eq!(
            asked(WeightFormat::F32)
                .matrix(TOWER, GgmlDType::F16, 512)
                .weight_format,
            WeightFormat::F32
        );
    }

    #[test]
    fn rows_that_are_no_whole_blocks_fall_back_to_the_next_format() {
        for (inputs, expected) in [
            (512, WeightFormat::Q4K),
            (96, WeightFormat::Q5_0),
            (100, WeightFormat::F16),
        ] {
            let planned = asked(WeightFormat::Q4K).matrix(DECODER, GgmlDType::F32, inputs);
            assert_eq!(
                (planned.weight_format, planned.reason.is_some()),
                (expected, inputs != 512)
            );
        }
    }

    #[test]
    fn a_file_holds_whole_blocks_and_the_memory_fills_them() {
        let in_memory = asked(WeightFormat::Q4K);
        let in_file = WeightFormatPlan {
            whole_blocks: true,
            ..in_memory
        };
        let planned = |plan: WeightFormatPlan| plan.matrix(TOWER, GgmlDType::F16, 4304);
        assert_eq!(planned(in_memory).weight_format, WeightFormat::Q8Of256);
        assert_eq!(planned(in_file).weight_format, WeightFormat::F16);
    }

    #[test]
    fn a_quantized_file_keeps_its_format() {
        let plan = WeightFormatPlan {
            kind: FileKind::Gguf,
            ..WeightFormatPlan::default()
        };
        for (format, expected, said) in [
            (GgmlDType::Q4K, WeightFormat::Q4K, false),
            (GgmlDType::F16, WeightFormat::F16, false),
            (GgmlDType::Q4_0, WeightFormat::Q4_0, false),
            (GgmlDType::Q3K, WeightFormat::Q3K, false),
            (GgmlDType::Q5K, WeightFormat::Q5K, false),
            (GgmlDType::Q5_1, WeightFormat::Q5_1, false),
            (GgmlDType::Q2K, WeightFormat::Q8_0, true),
            (GgmlDType::BF16, WeightFormat::F32, true),
        ] {
            let planned = plan.matrix(DECODER, format, 512);
            assert_eq!(
                (planned.weight_format, planned.reason.is_some()),
                (expected, said),
                "{format:?}"
            );
        }
        // More bits than the file has change nothing; fewer do.
        let again = |weight_format| WeightFormatPlan {
            quantize: Some(weight_format),
            ..plan
        };
        assert_eq!(
            again(WeightFormat::Q8_0)
                .matrix(DECODER, GgmlDType::Q4K, 512)
                .weight_format,
            WeightFormat::Q4K
        );
        assert_eq!(
            again(WeightFormat::Q4K)
                .matrix(DECODER, GgmlDType::Q8_0, 512)
                .weight_format,
            WeightFormat::Q4K
        );
        assert_eq!(
            again(WeightFormat::Q8_0)
                .matrix(DECODER, GgmlDType::Q5K, 512)
                .weight_format,
            WeightFormat::Q5K
        );
        // Four bits are not rounded to four others; five bits are, where that is asked for.
        assert_eq!(
            again(WeightFormat::Q4K)
                .matrix(DECODER, GgmlDType::Q4_0, 512)
                .weight_format,
            WeightFormat::Q4_0
        );
        assert_eq!(
            again(WeightFormat::F32).matrix(DECODER, GgmlDType::Q4_0, 512),
            PlannedFormat {
                weight_format: WeightFormat::F32,
                reason: None
            }
        );
        assert_eq!(
            again(WeightFormat::Q4K)
                .matrix(DECODER, GgmlDType::Q5_0, 512)
                .weight_format,
            WeightFormat::Q4K
        );
        assert_eq!(
            again(WeightFormat::F16)
                .matrix(DECODER, GgmlDType::Q2K, 512)
                .weight_format,
            WeightFormat::F16
        );
        let mxfp4 = again(WeightFormat::Q4K).matrix(DECODER, StoredFormat::Mxfp4, 512);
        assert_eq!(
            (mxfp4.weight_format, mxfp4.reason),
            (WeightFormat::Mxfp4, Some("the file has no more bits"))
        );
        let safetensors = |format: GgmlDType| {
            WeightFormatPlan::default()
                .matrix(DECODER, format, 512)
                .weight_format
        };
        assert_eq!(
            [GgmlDType::BF16, GgmlDType::F32].map(safetensors),
            [WeightFormat::F32; 2]
        );
        assert_eq!(safetensors(GgmlDType::F16), WeightFormat::F16);
    }

    #[test]
    fn packed_matrices_keep_their_numbers_unless_fewer_bits_are_asked_for() {
        let planned = |quantize, format, held, inputs| {
            let form = PackedForm {
                label: "awq 4 bits".into(),
                weight_format: format,
                held,
            };
            let plan = WeightFormatPlan {
                quantize,
                kind: FileKind::Quantized,
                ..WeightFormatPlan::default()
            };
            plan.packed_matrix(DECODER, &form, inputs)
        };
        let of_awq = |quantize| planned(quantize, WeightFormat::Q5_0, Held::Exactly, 512);
        let own = of_awq(None);
        assert_eq!((own.weight_format, own.reason), (WeightFormat::Q5_0, None));
        for (asked, expected) in [
            (WeightFormat::F32, WeightFormat::F32),
            (WeightFormat::F16, WeightFormat::F16),
            (WeightFormat::Q8_0, WeightFormat::Q5_0),
            (WeightFormat::Q4K, WeightFormat::Q4K),
        ] {
            assert_eq!(of_awq(Some(asked)).weight_format, expected, "{asked}");
        }
        let rounded =
            |quantize, inputs| planned(quantize, WeightFormat::Q8_0, Held::Rounded, inputs);
        assert_eq!(rounded(None, 512).weight_format, WeightFormat::Q8_0);
        assert!(
            rounded(None, 512)
                .reason
                .unwrap()
                .contains("rounded to 8 bits")
        );
        assert_eq!(rounded(None, 40).weight_format, WeightFormat::F16);
        let four = rounded(Some(WeightFormat::Q4K), 512);
        assert_eq!(four.weight_format, WeightFormat::Q4K);
        let lossless = |kind| {
            let plan = WeightFormatPlan {
                kind,
                ..WeightFormatPlan::default()
            };
            plan.is_lossless()
        };
        assert!(lossless(FileKind::Safetensors) && !lossless(FileKind::Quantized));
    }

    #[test]
    fn matrices_are_told_from_the_rest() {
        assert!(is_matrix("lm_head.weight", &[4, 4]));
        assert!(is_matrix("vision.linear_proj.linear_proj.weight", &[4, 4]));
        assert!(!is_matrix(
            "vision_tower.embeddings.position_embedding.weight",
            &[4, 4]
        ));
        assert!(!is_matrix(
            "vision_tower.embeddings.patch_embedding.weight",
            &[4, 3, 2, 2]
        ));
        assert!(!is_matrix("vision.patch_embedding.cls_embedding", &[1, 4]));
        assert!(!is_matrix("language_model.norm.weight", &[4]));
    }
}
