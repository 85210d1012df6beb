//! The most similar items of a memory. Descriptions are compared as bags of words, so that no
//! network is needed: a change from the original, which embeds them by OpenAI's ada-002.

use super::item::DiluItem;
use std::collections::BTreeMap;

/// Features of a description.
const FEATURES: usize = 1024;
/// Numbers within the same step of this size are the same word.
const NUMBER_STEP: f64 = 5.0;

/// A memory with the features of its items.
pub(super) struct Recall {
    items: Vec<(Features, DiluItem)>,
}

/// Counts of words and of pairs of words by their hash. Most are zero, and a memory may have
/// 100,000 items, so only the others are kept.
struct Features {
    /// Place and count, in the order of the places.
    counts: Vec<(u16, u16)>,
    /// Length of the vector of counts; 1 where it is empty.
    length: f64,
}

impl Features {
    /// The product of two vectors of length 1.
    fn similarity(&self, query: &[f64]) -> f64 {
        let counts = self.counts.iter();
        counts
            .filter_map(|(place, count)| {
                Some(f64::from(*count) / self.length * query.get(usize::from(*place))?)
            })
            .sum()
    }

    /// All counts, of length 1.
    fn dense(&self) -> Vec<f64> {
        let mut values = vec![0.0; FEATURES];
        for (place, count) in &self.counts {
            if let Some(value) = values.get_mut(usize::from(*place)) {
                *value = f64::from(*count) / self.length;
            }
        }
        values
    }
}

impl Recall {
    pub(super) fn new(items: Vec<DiluItem>) -> Self {
        let items = items.into_iter();
        Self {
            items: items
                .map(|item| (features(&item.description), item))
                .collect(),
        }
    }

    /// The most similar items, the most similar first, the earlier of equals.
    pub(super) fn nearest(&self, description: &str, count: usize) -> Vec<&DiluItem> {
        let query = features(description).dense();
        let mut found: Vec<(f64, &DiluItem)> = self
            .items
            .iter()
            .map(|(features, item)| (features.similarity(&query), item))
            .collect();
        found.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        found
            .into_iter()
            .take(count)
            .map(|(_, item)| item)
            .collect()
    }
}

/// The features of a text. Numbers are rounded.
fn features(text: &str) -> Features {
    let words: Vec<String> = text
        .split(|c: char| !(c.is_alphanumeric() || c == '.' || c == '-' || c == '_'))
        .map(|word| word.trim_end_matches('.').to_lowercase())
        .filter(|word| !word.is_empty())
        .map(|word| match word.parse::<f64>() {
            Ok(number) if number.is_finite() => format!("n{:.0}", number / NUMBER_STEP),
            _ => word,
        })
        .collect();
    let pairs = words.windows(2).map(|pair| pair.join(" "));
    let mut counted: BTreeMap<u16, u16> = BTreeMap::new();
    for word in words.iter().cloned().chain(pairs) {
        let count = counted.entry((hash(&word) % FEATURES as u64) as u16);
        let count = count.or_default();
        *count = count.saturating_add(1);
    }
    let counts: Vec<(u16, u16)> = counted.into_iter().collect();
    let squares = counts
        .iter()
        .map(|(_, count)| f64::from(*count) * f64::from(*count));
    let length = squares.sum::<f64>().sqrt();
    Features {
        counts,
        length: if length > 0.0 { length } else { 1.0 },
    }
}

/// FNV-1a, 64 bits: the same on every machine.
fn hash(text: &str) -> u64 {
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::reasoning::DrivingAction;

    #[test]
    fn the_most_similar_descriptions_come_first() {
        let item = |description: &str| DiluItem {
            description: description.to_owned(),
            answer: String::new(),
            action: DrivingAction::Idle,
            comment: String::new(),
        };
        let near = "vehicle 3 in your lane, ahead: speed 2.00 m/s, lane position 11.00 m";
        let recall = Recall::new(vec![
            item("The light is red."),
            item(
                "vehicle 9 in the lane to your left, behind: speed 20.00 m/s, lane position -60.00 m",
            ),
            item(near),
            item(near),
        ]);
        let query = "vehicle 3 in your lane, ahead: speed 2.10 m/s, lane position 12.00 m";
        let found = recall.nearest(query, 3);
        assert_eq!(found.len(), 3);
        assert_eq!(
            (found[0].description.as_str(), found[1].description.as_str()),
            (near, near)
        );
        assert!(found[2].description.contains("left"));
        assert_eq!(recall.nearest(query, 9).len(), 4);
        assert!(Recall::new(Vec::new()).nearest(query, 3).is_empty());
        let itself = features(query);
        assert!((itself.similarity(&itself.dense()) - 1.0).abs() < 1e-12);
        assert!(features("").similarity(&itself.dense()).abs() < 1e-12);
    }
}
