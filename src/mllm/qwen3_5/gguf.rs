//! Qwen3.5 in llama.cpp's GGUF files.

use crate::MllmError;
use crate::gguf::names::{Names, QWEN35_LAYERS, VISION_LAYERS};
use crate::gguf::{Changed, Header, PairLayout, VisionFiles, Written, qwen35};
use crate::qwen3_vl::{self, IMAGE, QWEN_NAMES};

const DEEP: &str = "clip.vision.is_deepstack_layers";

/// The files of a Qwen3.5.
pub(super) static LAYOUT: PairLayout = PairLayout {
    decoders: &[qwen35::ARCHITECTURE],
    projector: "qwen3vl_merger",
    model_type: "qwen3_5",
    placeholder: IMAGE,
    names: Names {
        single: &QWEN_NAMES,
        layers: &[QWEN35_LAYERS, VISION_LAYERS],
    },
    renamed: qwen35::renamed,
    vision,
    changed: Changed::NormsAndHeads,
    written: Written::Not("layers with a delta rule"),
};

fn vision(tower: &Header, notes: &mut Vec<String>) -> Result<VisionFiles, MllmError> {
    let deep: Option<Vec<bool>> = tower.list(DEEP, "a list of true and false")?;
    if deep.is_some_and(|deep| deep.contains(&true)) {
        let problem = "layers of the tower that go to the decoder are not those of this family";
        return Err(tower.error(DEEP, problem));
    }
    qwen3_vl::vision(tower, notes)
}
