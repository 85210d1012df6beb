//! The ego follows a truck or bus.

use crate::generator::prelude::*;

/// `behind_long_vehicle`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "behind_long_vehicle",
    seed: 10_000,
    group: TypeGroup::Nuplan14,
    setting,
    populate,
    shows: |log| log.behind_long(),
});

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    if rng.bool(0.3) {
        let mut setting = stream::before_light(rng, [40.0, 80.0], [0.4, 0.7])?;
        setting.light = LightTiming::GreenFrom(rng.early_draw(2.0, 8.0));
        return Ok(setting);
    }
    let mut setting = stream::road(rng, [1, 3], [0.35, 0.7])?;
    setting.task.overtakes = rng.bool(0.25);
    Ok(setting)
}

fn populate(builder: &mut TrafficBuilder<'_, '_>) {
    let speed = builder.ego().speed;
    let gap = 3.0 + speed * builder.rng.uniform(0.7, 1.1);
    let lead_speed = speed * builder.rng.uniform(0.8, 1.0);
    if let Some(lead) = builder.put_ahead(VehicleKind::Long, gap, lead_speed) {
        builder.traffic.movers[lead].speed_cap = lead_speed.max(2.5);
        if builder.rng.situation(|rng| rng.bool(0.35)) {
            // It stops for a while, as at a bus stop.
            let at = builder.rng.uniform(1.0, 6.0);
            let again = Act::Limit {
                at: at + builder.rng.uniform(4.0, 8.0),
                speed: lead_speed.max(4.0),
            };
            builder.traffic.movers[lead].script = vec![again, Act::Limit { at, speed: 0.05 }];
        }
    }
    builder.fill_lanes([0.3, 1.5], [gap + 35.0, 14.0]);
    builder.add_clutter();
}
