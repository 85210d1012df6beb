//! The ego drives fast.

use crate::generator::prelude::*;

/// `high_magnitude_speed`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "high_magnitude_speed",
    seed: 6_000,
    group: TypeGroup::Nuplan14,
    setting,
    populate: stream::populate_free_road,
    shows: |log| log.fast(9.0),
});

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let style = setting::style(rng, [1, 4], [0, 3], &LIMITS[2..]);
    let bendiness = rng.uniform(0.0, 0.6);
    let layout = setting::corridor(rng, &style, bendiness)?;
    let mut setting = Setting::new(
        layout,
        BEHIND + rng.uniform(0.0, 20.0),
        rng.uniform(0.8, 1.0),
    );
    setting.task.overtakes = rng.bool(0.5);
    Ok(setting)
}
