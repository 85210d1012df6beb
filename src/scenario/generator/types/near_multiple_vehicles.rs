//! The ego drives in a platoon.

use crate::generator::prelude::*;

/// `near_multiple_vehicles`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "near_multiple_vehicles",
    seed: 12_000,
    group: TypeGroup::Nuplan14,
    setting: |rng| stream::road(rng, [2, 4], [0.45, 0.8]),
    populate,
    shows: |log| log.near_vehicles(5),
});

fn populate(builder: &mut TrafficBuilder<'_, '_>) {
    let speed = builder.ego().speed;
    for (place, lane) in builder.roads().route_lanes[0]
        .clone()
        .into_iter()
        .enumerate()
    {
        let mut s = builder.ego().s - builder.rng.uniform(14.0, 34.0);
        let end = builder.ego().s + 50.0;
        while s < end {
            let apart = (s - builder.ego().s).abs() > 11.0 + speed * 0.6;
            if place != builder.ego_lane || apart {
                let chain = builder.roads().chain_on_route(0, lane);
                let kind = builder.car_or_long(0.08);
                let own_speed = speed * builder.rng.uniform(0.9, 1.0);
                if let Some(i) = builder.put(kind, chain, s, own_speed, 0.0) {
                    builder.traffic.movers[i].speed_cap =
                        (speed * builder.rng.uniform(0.92, 1.02)).max(3.0);
                }
            }
            s += 7.5 + speed * builder.rng.uniform(0.5, 1.1);
        }
    }
    builder.fill_lanes([0.5, 1.2], [70.0, 40.0]);
    stream::cut_in(builder, 0.4);
    builder.add_clutter();
}
