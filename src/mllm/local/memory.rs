//! The memory that a model needs, and the memory that is free.

use super::picture::PictureNeed;
use super::sequence::MAX_TOKENS_IN_PASS;
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, in_bytes};
use crate::decoder::{MAX_ROWS, MAX_STATES};
use crate::source::Checkpoint;
use planagent_kernels::matrix::WeightFormat;
use std::path::Path;

/// What to do with a model that needs more memory than is free.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MemoryCheck {
    /// Refuse to load it.
    #[default]
    Refuse,
    /// Load it anyway.
    Ignore,
}

/// Memory that a model needs, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct MemoryNeed {
    pub weights: u64,
    /// Keys and values of a chat, and the states of layers that keep others.
    pub cache: u64,
    /// Activations of a pass, or a tensor during quantization, whichever is larger.
    pub work: u64,
    /// The picture, its tiles and patches, and the activations of the vision tower.
    pub picture: u64,
}

/// Tokens of a planning call with the long prompt set and the largest image of published models
/// (2928 tokens), rounded up.
const CALL_TOKENS: u64 = 4096;
/// Those of them that are text.
const TEXT_TOKENS: u64 = CALL_TOKENS - 2928;
/// Activations of a token that are alive at once: rows of the hidden width, and of the feed-forward
/// width.
pub(super) const ROWS: (u64, u64) = (8, 3);

impl MemoryNeed {
    /// The need of a checkpoint with this decoder, weights in the format `quantize`, and chats of
    /// at most `context` tokens.
    pub(crate) fn estimate(
        checkpoint: &Checkpoint,
        decoder: &LlamaConfig,
        picture: PictureNeed,
        quantize: Option<WeightFormat>,
        context: Option<usize>,
    ) -> Self {
        let float = size_of::<f32>() as u64;
        let embedding = checkpoint
            .weights
            .matrices(quantize)
            .find(|(name, ..)| name.ends_with("embed_tokens.weight"));
        // As the decoder holds them: beside rounded weights, keys and values have 16 bits.
        let lossless = quantize.is_none() && checkpoint.weights.is_lossless();
        let single = lossless
            || embedding.is_none_or(|(.., weight_format)| weight_format == WeightFormat::F32);
        let key_value = if single {
            float
        } else {
            size_of::<half::f16>() as u64
        };
        let call = CALL_TOKENS.max(picture.tokens.saturating_add(TEXT_TOKENS));
        let tokens = context
            .map_or(call, |context| context as u64)
            .min(decoder.context as u64);
        let shapes = || checkpoint.weights.shapes().map(|(_, shape)| shape);
        // Bounded by the weights: a configuration that exceeds them is refused when they are taken,
        // with the key at fault.
        let widest = shapes().flatten().copied().max().unwrap_or(0);
        let width = |width: usize| width.min(widest) as u64;
        let keys = (0..decoder.layers.min(shapes().count()))
            .filter_map(|layer| Some(width(decoder.kept_keys(layer)?)))
            .fold(0, u64::saturating_add);
        let own = decoder.own_state();
        let kept = (MAX_STATES.saturating_mul(own.state))
            .saturating_add(MAX_ROWS.saturating_mul(own.row)) as u64;
        let states = float
            .saturating_mul(kept)
            .saturating_mul(own.layers.min(shapes().count()) as u64);
        // A layer has those before, those it predicts and those it corrects at once.
        let further = decoder
            .streams
            .as_ref()
            .map_or(0, |streams| 3 * (streams.count - 1));
        // A pass has no more, but for an image that is not cut.
        let pass = tokens.min((MAX_TOKENS_IN_PASS as u64).saturating_add(picture.tokens));
        let alive = (ROWS.0 + further as u64) * width(decoder.hidden)
            + ROWS.1 * width(decoder.intermediate);
        Self {
            weights: checkpoint.weights.forecast(quantize).bytes(),
            cache: (2 * key_value * tokens)
                .saturating_mul(keys)
                .saturating_add(states),
            work: (float * pass * alive).max(checkpoint.weights.largest_reading(quantize)),
            picture: picture.bytes,
        }
    }

    pub fn total(&self) -> u64 {
        [self.cache, self.work, self.picture]
            .into_iter()
            .fold(self.weights, u64::saturating_add)
    }
}

/// Checks that a model fits into the free memory.
///
/// # Errors
/// When it does not. The error names formats that need less.
pub(super) fn check(
    checkpoint: &Checkpoint,
    decoder: &LlamaConfig,
    picture: PictureNeed,
    quantize: Option<WeightFormat>,
    context: Option<usize>,
) -> Result<(), MllmError> {
    let Some(free) = free_memory() else {
        return Ok(());
    };
    check_against(free, checkpoint, decoder, picture, quantize, context)
}

fn check_against(
    free: u64,
    checkpoint: &Checkpoint,
    decoder: &LlamaConfig,
    picture: PictureNeed,
    quantize: Option<WeightFormat>,
    context: Option<usize>,
) -> Result<(), MllmError> {
    let need_as = |quantize| MemoryNeed::estimate(checkpoint, decoder, picture, quantize, context);
    let need = need_as(quantize);
    if need.total() <= free {
        return Ok(());
    }
    let smaller = [WeightFormat::Q8_0, WeightFormat::Q4K]
        .map(|weight_format| (weight_format, need_as(Some(weight_format)).total()))
        .into_iter()
        // A file may be smaller than these formats already.
        .filter(|(_, total)| *total < need.total());
    let hints: Vec<String> = smaller
        .map(|(weight_format, total)| {
            format!("--quantize {weight_format} would take {}", in_bytes(total))
        })
        .collect();
    let hint = if hints.is_empty() {
        "no format is smaller".to_string()
    } else {
        hints.join(", ")
    };
    Err(MllmError::Memory {
        place: checkpoint.files.place().to_path_buf(),
        problem: format!(
            "it needs about {} (weights {}, cache {}, work {}, picture {}), but {} are free; {hint}; --ignore-memory loads it anyway",
            in_bytes(need.total()),
            in_bytes(need.weights),
            in_bytes(need.cache),
            in_bytes(need.work),
            in_bytes(need.picture),
            in_bytes(free)
        ),
    })
}

/// Memory that this process may still take, bytes: available memory without swapping, within the
/// limit of the control group. None where neither can be read (systems other than Linux).
fn free_memory() -> Option<u64> {
    let system = available(&std::fs::read_to_string("/proc/meminfo").ok()?)?;
    let group = std::fs::read_to_string("/proc/self/cgroup")
        .ok()
        .and_then(|text| group_left(&text));
    Some(group.map_or(system, |left| left.min(system)))
}

/// `MemAvailable` of `/proc/meminfo`, bytes.
fn available(meminfo: &str) -> Option<u64> {
    let line = meminfo
        .lines()
        .find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim()
        .strip_suffix("kB")?
        .trim()
        .parse::<u64>()
        .ok()?
        .checked_mul(1024)
}

/// Bytes that the limits of the control group (version 2) and its ancestors leave; none without a
/// limit.
fn group_left(cgroup: &str) -> Option<u64> {
    let path = cgroup.lines().find_map(|line| line.strip_prefix("0::/"))?;
    let root = Path::new("/sys/fs/cgroup");
    let number = |file: &Path| {
        std::fs::read_to_string(file)
            .ok()?
            .trim()
            .parse::<u64>()
            .ok()
    };
    let left = |group: &Path| {
        let limit = number(&group.join("memory.max"))?;
        // The kernel reclaims pages of files when memory is short.
        let file = std::fs::read_to_string(group.join("memory.stat"))
            .ok()
            .and_then(|stat| inactive_file(&stat));
        Some(limit.saturating_sub(
            number(&group.join("memory.current"))?.saturating_sub(file.unwrap_or(0)),
        ))
    };
    root.join(path)
        .ancestors()
        .take_while(|group| group.starts_with(root))
        .filter_map(left)
        .min()
}

fn inactive_file(stat: &str) -> Option<u64> {
    stat.lines()
        .find_map(|line| line.strip_prefix("inactive_file "))?
        .trim()
        .parse()
        .ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::Families;
    use crate::family::ImageSettings;
    use crate::local::test_reference::{fixture, open_checkpoint};

    #[test]
    fn the_kernels_tables_are_read() {
        assert_eq!(
            available("MemTotal: 9 kB\nMemAvailable:   24031204 kB\nBuffers: 1 kB"),
            Some(24_031_204 * 1024)
        );
        assert_eq!(available("MemTotal: 9 kB"), None);
        assert_eq!(inactive_file("anon 3\ninactive_file 4096\n"), Some(4096));
        assert_eq!(group_left("1:name=systemd:/"), None);
        #[cfg(target_os = "linux")]
        assert!(free_memory().unwrap() > 0);
    }

    #[test]
    fn states_of_layers_are_part_of_the_need() {
        let checkpoint = open_checkpoint(&fixture("tiny_lfm2"));
        let decoder = (checkpoint.family.family().decoder_config)(&checkpoint.files).unwrap();
        let need = MemoryNeed::estimate(
            &checkpoint,
            &decoder,
            PictureNeed::default(),
            None,
            Some(100),
        );
        // Two layers with one head of keys and values of 8 numbers; four that keep three rows of 32
        // in twelve copies, and 48 of them.
        let (keys, states) = (2 * 4 * 100 * 8 * 2, 4 * 4 * (12 * 3 * 32 + 48 * 32));
        assert_eq!(need.cache, keys + states);
    }

    /// Of the table of layers, the largest tensor: 282 times 56 numbers of 16 bits.
    #[test]
    fn a_tensor_is_once_as_in_its_file_and_rounded_by_way_of_f32() {
        let checkpoint = open_checkpoint(&fixture("tiny_gemma3n"));
        let decoder = checkpoint.decoder_config().unwrap();
        let work = |quantize| {
            let picture = PictureNeed::default();
            MemoryNeed::estimate(&checkpoint, &decoder, picture, quantize, Some(1)).work
        };
        let numbers = 282 * 56;
        assert_eq!(work(Some(WeightFormat::F32)), (2 + 4 + 4) * numbers);
        assert_eq!(work(Some(WeightFormat::F16)), (2 + 4 + 2) * numbers);
        // Of matrices in f32, nothing is rounded; the kernel of patches is copied.
        let weights = open_checkpoint(&fixture("tiny_llava")).weights;
        let (kernel, embedding) = (32 * 3 * 8 * 8, 352 * 32);
        assert_eq!(weights.largest_reading(None), (4 + 4) * kernel);
        let rounded = weights.largest_reading(Some(WeightFormat::F16));
        assert_eq!(rounded, (4 + 4 + 2) * embedding);
    }

    /// The table of layers has half of the numbers, and is never whole beside the weights.
    #[test]
    fn a_described_model_needs_little_beside_its_weights() {
        let shape = crate::ModelShape::find("gemma-3n-e2b").unwrap();
        let checkpoint = shape.checkpoint(&Families::default()).unwrap();
        let decoder = checkpoint.decoder_config().unwrap();
        let picture = PictureNeed::estimate(&checkpoint, ImageSettings::default());
        for quantize in [WeightFormat::Q4K, WeightFormat::F16] {
            let need = MemoryNeed::estimate(&checkpoint, &decoder, picture, Some(quantize), None);
            assert!(need.work + need.picture < need.weights / 4, "{need:?}");
        }
    }

    #[test]
    fn a_model_that_does_not_fit_is_refused_with_what_would() {
        let checkpoint = open_checkpoint(&fixture("tiny_llava"));
        let decoder = (checkpoint.family.family().decoder_config)(&checkpoint.files).unwrap();
        let picture = PictureNeed::estimate(&checkpoint, ImageSettings::default());
        // 32 x 32 pixels in patches of 8.
        assert_eq!(picture.tokens, 16);
        let need_as = |quantize, context| {
            MemoryNeed::estimate(&checkpoint, &decoder, picture, quantize, context)
        };
        let need = need_as(None, None);
        assert_eq!(need.picture, picture.bytes);
        assert!(need.picture > 4 * 6 * 32 * 32, "{need:?}");
        // 299,352 bytes of f32, but for the header.
        assert!((280_000..299_352).contains(&need.weights), "{need:?}");
        // 256 positions, two layers, two heads of 8 numbers.
        assert_eq!(need.cache, 2 * 4 * 256 * 16 * 2);
        assert!(check_against(need.total(), &checkpoint, &decoder, picture, None, None).is_ok());
        let error = check_against(need.total() - 1, &checkpoint, &decoder, picture, None, None)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("--quantize q8_0 would take") && error.contains("--ignore-memory"),
            "{error}"
        );
        let rounded = need_as(Some(WeightFormat::Q8_0), None);
        assert!(rounded.weights < need.weights / 2 && rounded.cache == need.cache / 2);
        let short = need_as(None, Some(64));
        assert_eq!((short.cache, short.weights), (need.cache / 4, need.weights));
    }
}
