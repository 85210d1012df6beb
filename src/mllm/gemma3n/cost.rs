//! What a picture costs in the vision tower, by the shapes of its blocks.

use super::blocks::Kind;
use super::config::TowerConfig;
use crate::family::TowerCost;

/// Maps that are alive at once: of a product, its input, its result and what a norm makes of it.
const MAPS: u64 = 3;
/// Numbers of windows that are laid out at once, at most (`planagent_kernels::Convolution`).
const WINDOWS: u64 = 1 << 24;

/// The cost of a square picture of `side` pixels.
pub(super) fn of_picture(config: &TowerConfig, side: usize) -> TowerCost {
    let mut cost = Sum {
        numbers: 0,
        products: 0,
    };
    let mut side = (side / 2) as u64;
    let stem = config.stem as u64;
    cost.add(side * side * (27 + MAPS * stem), side * side * 27 * stem);
    let mut maps = [0, 0];
    for block in config.stages.iter().flatten() {
        let before = side * side;
        side = side.div_ceil(block.stride as u64);
        let (pixels, inputs, outputs) = (side * side, block.inputs as u64, block.outputs as u64);
        match block.kind {
            Kind::Fused { kernel, wide } => {
                let (window, wide) = ((kernel * kernel) as u64 * inputs, wide as u64);
                let laid_out = WINDOWS.min(pixels * window);
                cost.add(
                    before * inputs + laid_out + pixels * MAPS * wide,
                    pixels * wide * (window + outputs),
                );
            }
            Kind::Inverted {
                start,
                middle,
                wide,
            } => {
                let [start, middle] = [start, middle].map(|kernel| (kernel * kernel) as u64);
                let wide = wide as u64;
                let each = before * start * inputs + pixels * middle * wide;
                cost.add(
                    before * (inputs + MAPS * wide),
                    each + wide * (before * inputs + pixels * outputs),
                );
            }
            Kind::Attention {
                heads,
                width,
                kernel,
                key_stride,
            } => {
                let positions = side.div_ceil(key_stride as u64).pow(2);
                let (queries, width) = ((heads * width) as u64, width as u64);
                let smaller = (kernel * kernel) as u64 * inputs + inputs * width;
                let mixed = pixels * queries * (inputs + outputs + 2 * positions);
                cost.add(
                    pixels * (MAPS * inputs + 2 * queries) + positions * (queries + 4 * width),
                    mixed + 2 * positions * smaller,
                );
            }
        }
        if block.stride > 1 {
            maps = [maps[1], 0];
        }
        maps[1] = outputs;
    }
    // The last stage but one has twice the side of the last.
    let (pixels, inputs) = (4 * side * side, maps[0] + maps[1]);
    let (wide, width) = (2 * inputs, config.width as u64);
    cost.add(
        pixels * (inputs + wide + MAPS * width),
        pixels * wide * (inputs + width),
    );
    TowerCost {
        bytes: cost.numbers.saturating_mul(size_of::<f32>() as u64),
        operations: cost.products.saturating_mul(2),
    }
}

/// What blocks cost together.
struct Sum {
    /// Of the block that holds the most numbers at once.
    numbers: u64,
    products: u64,
}

impl Sum {
    fn add(&mut self, numbers: u64, products: u64) {
        self.numbers = self.numbers.max(numbers);
        self.products = self.products.saturating_add(products);
    }
}
