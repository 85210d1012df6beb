//! The ego creeps in a traffic jam.

use crate::generator::prelude::*;

/// `low_magnitude_speed`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "low_magnitude_speed",
    seed: 7_000,
    group: TypeGroup::Nuplan14,
    setting,
    populate,
    shows: |log| log.slow(2.5),
});

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    if rng.bool(0.4) {
        let mut setting = stream::before_light(rng, [25.0, 60.0], [0.05, 0.3])?;
        setting.light = LightTiming::GreenFrom(rng.early_draw(0.0, 8.0));
        return Ok(setting);
    }
    stream::road(rng, [1, 3], [0.05, 0.25])
}

/// Everybody around the ego creeps until the jam dissolves.
fn populate(builder: &mut TrafficBuilder<'_, '_>) {
    let creep = builder.rng.uniform(0.4, 1.8);
    let dissolves = builder.rng.uniform(4.0, 13.0);
    for (place, lane) in builder.roads().route_lanes[0]
        .clone()
        .into_iter()
        .enumerate()
    {
        let mut s = builder.ego().s - builder.rng.uniform(18.0, 45.0);
        let end = builder.ego().s + builder.rng.uniform(30.0, 70.0);
        while s < end {
            if place != builder.ego_lane || (s - builder.ego().s).abs() > 10.0 {
                let chain = builder.roads().chain_on_route(0, lane);
                let kind = builder.car_or_long(0.1);
                if let Some(i) = builder.put(kind, chain, s, creep, 0.0) {
                    builder.traffic.movers[i].speed_cap = creep;
                    builder.traffic.movers[i].script = vec![Act::Limit {
                        at: dissolves,
                        speed: f64::INFINITY,
                    }];
                }
            }
            s += builder.rng.uniform(8.0, 13.0);
        }
    }
    builder.fill_lanes([0.5, 1.5], [80.0, 50.0]);
    builder.add_clutter();
}
