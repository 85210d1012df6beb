//! The ego stands in a queue before a red light.

use crate::generator::prelude::*;

/// `stationary_in_traffic`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "stationary_in_traffic",
    seed: 11_000,
    group: TypeGroup::Nuplan14,
    setting,
    populate,
    shows: |log| log.stands_in_traffic(),
});

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let mut setting = stream::before_light(rng, [12.0, 45.0], [0.0, 0.0])?;
    setting.light = LightTiming::GreenFrom(rng.early_draw(4.0, 13.0));
    Ok(setting)
}

/// A queue in all lanes of the ego's first road, from the stop line to some way behind the ego.
fn populate(builder: &mut TrafficBuilder<'_, '_>) {
    for (place, lane) in builder.roads().route_lanes[0]
        .clone()
        .into_iter()
        .enumerate()
    {
        let length = builder.roads().map[lane].centerline.length();
        let mut s = length - builder.rng.uniform(3.5, 5.0);
        let back = builder.ego().s - builder.rng.uniform(8.0, 40.0);
        while s > back {
            let chain = if place == builder.ego_lane {
                builder.roads().chain_on_route(0, lane)
            } else {
                builder.wander(lane)
            };
            let kind = builder.car_or_long(0.08);
            if builder.rng.bool(0.95) {
                builder.put(kind, chain, s, 0.0, 0.0);
            }
            s -= builder.rng.uniform(7.2, 9.5);
        }
    }
    builder.fill_lanes([0.6, 1.8], [8.0, 10.0]);
    builder.add_clutter();
}
