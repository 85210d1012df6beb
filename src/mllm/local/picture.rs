//! What the drawn picture costs, by the shapes of the vision tower's tensors.

use super::memory::ROWS;
use crate::checkpoint::{WeightFormatPlan, Weights};
use crate::family::ImageSettings;
use crate::source::Checkpoint;
use std::collections::BTreeSet;

/// The drawn picture on its way to the decoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct PictureNeed {
    /// Tokens that it becomes.
    pub(super) tokens: u64,
    /// Patches that the tower reads; of a tower of maps, as many as would cost the same if each
    /// were multiplied by all weights.
    pub(super) patches: u64,
    /// Bytes of its pixels and patches, and of the activations that are alive at once.
    pub(super) bytes: u64,
    /// Operations of products and attention in tower and projector.
    pub(super) operations: u64,
}

impl PictureNeed {
    /// The need of the picture that is drawn for the model of a checkpoint. Nothing for a model
    /// that reads text alone, or for a configuration that cannot be opened: opening the model says
    /// why.
    pub(crate) fn estimate(checkpoint: &Checkpoint, image: ImageSettings) -> Self {
        let mut listed = Weights::empty(checkpoint.files.place(), WeightFormatPlan::default());
        listed.only_list();
        let opened = (checkpoint.family.family().open)(&checkpoint.files, &mut listed);
        let Ok(mut model) = opened else {
            return Self::default();
        };
        // Opening the model says which settings the family refuses.
        let _ = model.set_images(image);
        let Some(side) = model.info().image_size.map(|side| side as u32) else {
            return Self::default();
        };
        let (Ok(layout), Ok(pixels)) = (
            model.image_layout(side, side),
            model.tower_pixels(side, side),
        ) else {
            return Self::default();
        };
        let (values, tower) = (3 * pixels as u64, Tower::from_tensors(listed.listed()));
        if let Some(cost) = model.tower_cost(side, side) {
            let tokens = layout.tokens as u64;
            let projector = tower.operations(listed.listed(), 0, tokens);
            // The values once in rows of pixels, once in a map.
            let numbers = 2 * values * size_of::<f32>() as u64;
            let weights = listed.listed().iter();
            let weights = weights.filter(|(name, _)| name.starts_with("vision"));
            let weights = weights.map(|(_, shape)| shape.iter().product::<usize>() as u64);
            return Self {
                tokens,
                patches: cost.operations / 2 / weights.sum::<u64>().max(1),
                bytes: cost.bytes.saturating_add(numbers),
                operations: cost.operations.saturating_add(projector),
            };
        }
        let (tokens, patches) = (layout.tokens as u64, pixels as u64 / tower.patch.max(1));
        let row = ROWS.0 * tower.hidden + ROWS.1 * tower.intermediate;
        // The values once in rows of pixels, once in patches.
        let numbers = patches.saturating_mul(row).saturating_add(2 * values);
        Self {
            tokens,
            patches,
            bytes: numbers.saturating_mul(size_of::<f32>() as u64),
            operations: tower.operations(listed.listed(), patches, tokens),
        }
    }
}

/// Sizes of a vision tower, by its tensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Tower {
    /// Pixels of a patch.
    patch: u64,
    hidden: u64,
    intermediate: u64,
    /// Places in its table of positions: patches that attend to each other. None without a table.
    positions: Option<u64>,
    /// Its blocks.
    blocks: u64,
}

impl Tower {
    fn from_tensors(tensors: &[(String, Vec<usize>)]) -> Self {
        let vision = || {
            tensors
                .iter()
                .filter(|(name, _)| name.starts_with("vision"))
        };
        let kernel = vision()
            .find(|(name, _)| name.contains("patch_embed") && name.ends_with(".weight"))
            .map(|(_, shape)| shape.as_slice());
        let (hidden, patch) = match kernel {
            Some([hidden, .., rows, columns]) if *rows == *columns => (*hidden, rows * columns),
            Some([hidden, values]) => (*hidden, values / 3),
            _ => (0, 0),
        };
        let wide = vision().filter_map(|(_, shape)| match shape.as_slice() {
            [outputs, inputs] if *inputs == hidden => Some(*outputs),
            _ => None,
        });
        let positions = vision().find_map(|(name, shape)| match shape.as_slice() {
            [places, width] if name.contains("position_embedding") && *width == hidden => {
                Some(*places as u64)
            }
            _ => None,
        });
        let blocks: BTreeSet<&str> = vision().filter_map(|(name, _)| block(name)).collect();
        Self {
            positions,
            blocks: blocks.len() as u64,
            patch: patch as u64,
            hidden: hidden as u64,
            // The table of positions is no layer, and wider than one only for tiny patches.
            intermediate: wide.max().unwrap_or(hidden) as u64,
        }
    }

    /// Operations for a picture of `patches` that becomes `tokens`. Windows of attention are counted
    /// as if they were whole.
    fn operations(&self, tensors: &[(String, Vec<usize>)], patches: u64, tokens: u64) -> u64 {
        let products = tensors.iter().map(|(name, shape)| {
            let rows = match (is_projector(name), name.starts_with("vision")) {
                (true, _) => tokens,
                (false, true) if name.ends_with(".weight") && !name.contains("position") => patches,
                _ => 0,
            };
            match shape.as_slice() {
                // A vector scales or adds.
                [] | [_] => 0,
                sides => sides.iter().fold(2 * rows, |product, side| {
                    product.saturating_mul(*side as u64)
                }),
            }
        });
        let seen = self.positions.map_or(patches, |places| places.min(patches));
        // Queries with keys, then weights with values: a product and its sum are two operations.
        let attention = [4, self.blocks, patches, seen, self.hidden];
        let attention = attention.into_iter().fold(1, u64::saturating_mul);
        products.fold(attention, u64::saturating_add)
    }
}

/// Whether a tensor belongs to the projector, which sees tokens in place of patches.
fn is_projector(name: &str) -> bool {
    ["multi_modal_projector.", "vision.linear_proj."]
        .iter()
        .any(|prefix| name.starts_with(prefix))
}

/// The beginning of a tensor's name up to the number of its block: `vision_tower.encoder.layers.3`.
fn block(name: &str) -> Option<&str> {
    let numbered = |part: &str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
    let mut end = 0;
    for part in name.split('.') {
        end += part.len();
        if numbered(part) {
            return name.get(..end);
        }
        end += 1;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::local::test_reference::{fixture, open_checkpoint};

    #[test]
    fn operations_of_a_tower_are_counted() {
        let tensor = |name: &str, shape: &[usize]| (name.to_owned(), shape.to_vec());
        let tensors = [
            tensor(
                "vision_tower.embeddings.patch_embedding.weight",
                &[8, 3, 2, 2],
            ),
            tensor(
                "vision_tower.embeddings.position_embedding.weight",
                &[16, 8],
            ),
            tensor("vision_tower.encoder.layers.0.mlp.fc1.weight", &[32, 8]),
            tensor("vision_tower.encoder.layers.0.mlp.fc1.bias", &[32]),
            tensor("vision_tower.encoder.layers.1.mlp.fc1.weight", &[32, 8]),
            tensor("multi_modal_projector.linear_1.weight", &[64, 8]),
            tensor("language_model.layers.0.mlp.up_proj.weight", &[9, 9]),
        ];
        let tower = Tower::from_tensors(&tensors);
        assert_eq!((tower.positions, tower.blocks), (Some(16), 2));
        // Two tiles of 16 patches, which become 10 tokens.
        let products = 2 * 32 * (8 * 12 + 2 * 32 * 8) + 2 * 10 * 64 * 8;
        let attention = 4 * 2 * 32 * 16 * 8;
        assert_eq!(tower.operations(&tensors, 32, 10), products + attention);
    }

    /// The products that are computed, which kernels count.
    #[test]
    fn a_tower_of_maps_counts_its_blocks() {
        let folder = fixture("tiny_gemma3n_vision");
        let picture = PictureNeed::estimate(&open_checkpoint(&folder), ImageSettings::default());
        let model = crate::local::test_prompts::Prompts::open_at(&folder);
        let model = model.model();
        let image = image::RgbImage::new(96, 96);
        let cost = model.tower_cost(96, 96).unwrap();
        assert!(model.encode_image(&image).is_ok());
        // The stem and the fusion alone.
        let (stem, fusion) = (48 * 48 * 27 * 8, 36 * (16 * 32 + 32 * 64));
        assert!(cost.operations > 2 * (stem + fusion), "{cost:?}");
        assert!(picture.operations > cost.operations && picture.patches > 0);
        assert!(picture.bytes > cost.bytes && cost.bytes > 4 * 36 * 64);
    }

    #[test]
    fn the_fixture_counts_its_own_picture() {
        let checkpoint = open_checkpoint(&fixture("tiny_llava"));
        let picture = PictureNeed::estimate(&checkpoint, ImageSettings::default());
        assert!(picture.operations > 0, "{picture:?}");
    }
}
