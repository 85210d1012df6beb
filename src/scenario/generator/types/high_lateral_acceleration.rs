//! The ego drives through a bend with noticeable lateral acceleration.

use crate::generator::prelude::*;

/// `high_lateral_acceleration`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "high_lateral_acceleration",
    seed: 5_000,
    group: TypeGroup::Nuplan14,
    setting,
    populate: stream::populate_free_road,
    shows: |log| log.lateral(1.2),
});

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let style = setting::style(rng, [1, 3], [0, 2], &LIMITS[..4]);
    let curvature = rng.sign() * setting::max_curvature(&style, rng.uniform(0.6, 0.95)).min(0.055);
    let start = setting::anywhere(rng);
    let lead = BEHIND + rng.uniform(45.0, 90.0);
    // The ego reaches the bend within the first seconds.
    let length = lead + rng.uniform(70.0, 120.0);
    let mut layout = Layout::begin(
        start,
        &style,
        Course {
            length,
            curvature,
            lead,
        },
    )?;
    setting::extend(
        &mut layout,
        rng,
        &style,
        setting::needed_ahead(&style) - (length - BEHIND),
        0.6,
    )?;
    Ok(Setting::new(layout, BEHIND, rng.uniform(0.7, 1.0)))
}
