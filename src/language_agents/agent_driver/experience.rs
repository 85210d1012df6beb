//! The memory of experiences: logged motions with what followed.

use super::item::ExperienceItem;
use planagent_agent::environment::coordinates::EgoFacts;

/// Experiences that the model chooses from.
pub(super) const CANDIDATES: usize = 3;
/// Weights of the distances between motions, goals and pasts: the original's.
const WEIGHTS: [f64; 3] = [1.0, 10.0, 1.0];

/// The most similar experiences with their similarity, the most similar first, the earlier of
/// equals. Distances are squared and not scaled, as in the original.
pub(super) fn nearest<'a>(
    items: &'a [ExperienceItem],
    ego: &EgoFacts,
) -> Vec<(f64, &'a ExperienceItem)> {
    let mut found: Vec<(f64, &ExperienceItem)> = items
        .iter()
        .map(|item| (distance(item, ego), item))
        .collect();
    found.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    found
        .into_iter()
        .take(CANDIDATES)
        .map(|(distance, item)| ((-distance).exp(), item))
        .collect()
}

fn distance(item: &ExperienceItem, ego: &EgoFacts) -> f64 {
    let squared =
        |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum() };
    // Two places of a vector with one 1 in it differ where the goals do.
    let goals = if item.goal == ego.goal { 0.0 } else { 2.0 };
    let past: f64 = item
        .past
        .iter()
        .zip(&ego.past)
        .map(|(then, now)| {
            let (x, y) = now.unwrap_or((then[0], then[1]));
            squared(then, &[x, y])
        })
        .sum();
    let [of_motion, of_goal, of_past] = WEIGHTS;
    of_motion * squared(&item.motion, &ego.motion) + of_goal * goals + of_past * past
}
