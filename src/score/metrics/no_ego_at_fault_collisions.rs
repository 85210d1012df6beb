//! `no_ego_at_fault_collisions`: 0 after an at-fault collision with a vehicle, pedestrian or
//! bicycle, 0.5 after one with a static object.

use super::collision::{Collision, CollisionGroup};
use super::{MetricCategory, MetricList, MetricResult, MetricSpec, Statistic, StatisticKind};

pub(super) const SPEC: MetricSpec = MetricSpec::new("no_ego_at_fault_collisions", |input| {
    Ok(Some(no_ego_at_fault_collisions(input.collisions())))
})
.only(MetricList::ClosedLoop)
.multiplier()
.category(MetricCategory::Dynamics)
.label("coll");

/// 1 without an at-fault collision, else the product over the groups of max(0, 1 − number /
/// (tolerated + 1)).
pub fn no_ego_at_fault_collisions(collisions: &[Collision]) -> MetricResult {
    let by_group: Vec<(CollisionGroup, Vec<f64>)> = CollisionGroup::ALL
        .into_iter()
        .map(|group| {
            let own = collisions
                .iter()
                .filter(|c| c.at_fault && CollisionGroup::from_kind(c.kind) == group);
            (group, own.map(|c| c.delta_v).collect())
        })
        .collect();
    let total: usize = by_group.iter().map(|(_, energies)| energies.len()).sum();
    let score = by_group
        .iter()
        .map(|(group, energies)| {
            (1.0 - energies.len() as f64 / (group.tolerated() + 1) as f64).max(0.0)
        })
        .product();
    let mut statistics = vec![
        Statistic::boolean(SPEC.name, total == 0),
        Statistic::count("number_of_all_at_fault_collisions", total),
    ];
    for (group, energies) in &by_group {
        let group = group.as_str();
        statistics.push(Statistic::count(
            format!("number_of_at_fault_collisions_with_{group}"),
            energies.len(),
        ));
    }
    // Groups without a collision have no energies: their extremes would be infinite.
    for (group, energies) in by_group.iter().filter(|(_, energies)| !energies.is_empty()) {
        let of = |kind, prefix: &str, value| {
            let name = format!("{prefix}_collision_energy_with_{}", group.as_str());
            Statistic::new(kind, name, "meters_per_second", value)
        };
        statistics.extend([
            of(
                StatisticKind::Max,
                "max",
                energies.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            ),
            of(
                StatisticKind::Min,
                "min",
                energies.iter().copied().fold(f64::INFINITY, f64::min),
            ),
            of(
                StatisticKind::Mean,
                "mean",
                energies.iter().sum::<f64>() / energies.len() as f64,
            ),
        ]);
    }
    SPEC.scored(score, statistics)
}
