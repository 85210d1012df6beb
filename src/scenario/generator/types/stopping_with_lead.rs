//! The ego comes to a stop behind a lead vehicle.

use crate::generator::prelude::*;

/// `stopping_with_lead`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "stopping_with_lead",
    seed: 4_000,
    group: TypeGroup::Nuplan14,
    setting,
    populate,
    shows: |log| log.stops_behind_lead(),
});

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    if rng.bool(0.5) {
        let mut setting = stream::before_light(rng, [75.0, 110.0], [0.7, 0.95])?;
        setting.light = LightTiming::GreenFrom(rng.early_draw(7.0, 14.0));
        Ok(setting)
    } else {
        stream::road(rng, [1, 4], [0.6, 0.95])
    }
}

fn populate(builder: &mut TrafficBuilder<'_, '_>) {
    let speed = builder.ego().speed;
    let gap = 5.0 + speed * builder.rng.uniform(0.9, 1.5);
    let kind = builder.mostly_a_car();
    if let Some(lead) = builder.put_ahead(kind, gap, speed) {
        builder.traffic.movers[lead].speed_cap = speed.max(4.0);
        let at = builder.rng.uniform(-0.5, 3.5);
        let mut script = vec![Act::Limit { at, speed: 0.05 }];
        if builder.rng.situation(|rng| rng.bool(0.6)) {
            script.insert(
                0,
                Act::Limit {
                    at: at + builder.rng.uniform(6.0, 10.0),
                    speed: speed.max(5.0),
                },
            );
        }
        // At a light it stops without a script.
        if builder.roads().signals.is_empty() || builder.rng.situation(|rng| rng.bool(0.3)) {
            builder.traffic.movers[lead].script = script;
            builder.traffic.movers[lead].profile.decel = builder.rng.uniform(1.4, 2.6);
        }
    }
    builder.fill_lanes([0.3, 1.6], [gap + 25.0, 14.0]);
    builder.add_clutter();
}
