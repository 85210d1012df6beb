//! The estimate of memory beside what a process takes.

use super::Loading;
use super::memory::MemoryNeed;
use super::picture::PictureNeed;
use crate::family::ImageSettings;
use crate::source::{ModelPlace, ModelShape};
use crate::{LatencyProbe, Step};
use planagent_kernels::matrix::WeightFormat;

/// Shapes with a state of convolutions, with keys alone, and with a large table of layers.
const SHAPES: [&str; 3] = ["lfm2-vl-450m", "qwen3-vl-2b", "gemma-3n-e2b"];
/// Text of the prompt, tokens: that of two passes.
const TEXT: usize = 1024;
/// Part of the estimate that a peak may be above or below it.
const TOLERANCE: f64 = 0.25;

/// A number of `/proc/self/status`, bytes.
fn status(key: &str) -> u64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix(key));
    let size = line.unwrap().trim().strip_suffix(" kB").unwrap();
    size.trim().parse::<u64>().unwrap() * 1024
}

#[test]
#[ignore = "takes 4 GiB of memory and some minutes, on Linux, with no test beside it"]
fn peaks_are_near_the_estimate() {
    // The allocator keeps what a model gave back, and the next takes that.
    let before = status("VmRSS:");
    for name in SHAPES {
        // The kernel begins a new peak.
        std::fs::write("/proc/self/clear_refs", "5").unwrap();
        let shape = ModelShape::find(name).unwrap();
        let place = ModelPlace::Random { shape, seed: 0 };
        let quantize = Some(WeightFormat::Q4K);
        let loading = Loading {
            quantize,
            ..Loading::default()
        };
        let checkpoint = loading.checkpoint(&place).unwrap();
        let decoder = checkpoint.decoder_config().unwrap();
        let picture = PictureNeed::estimate(&checkpoint, ImageSettings::default());
        let mut probe = LatencyProbe::open(&place, &loading, 0).unwrap();
        let tokens = TEXT + probe.image_tokens().unwrap();
        for step in [
            Step::Encode,
            Step::Text(TEXT / 4),
            Step::Image,
            Step::Text(TEXT - TEXT / 4),
            Step::Sampled(2),
        ] {
            probe.run(step).unwrap();
        }
        let need = MemoryNeed::estimate(&checkpoint, &decoder, picture, quantize, Some(tokens));
        let peak = status("VmHWM:").saturating_sub(before);
        let ratio = peak as f64 / need.total() as f64;
        println!("{name}: peak {peak}, {ratio:.2} of {need:?}");
        assert!((ratio - 1.0).abs() < TOLERANCE, "{name}: {ratio}");
    }
}
