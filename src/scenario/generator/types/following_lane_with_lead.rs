//! The ego follows a lead vehicle.

use crate::generator::prelude::*;

/// `following_lane_with_lead`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "following_lane_with_lead",
    seed: 14_000,
    group: TypeGroup::Nuplan14,
    setting,
    populate,
    shows: |log| log.follows(25.0, 3.0),
});

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let mut setting = stream::road(rng, [1, 4], [0.5, 0.95])?;
    setting.task.overtakes = rng.bool(0.3);
    Ok(setting)
}

fn populate(builder: &mut TrafficBuilder<'_, '_>) {
    let speed = builder.ego().speed;
    let gap = 4.0 + speed * builder.rng.uniform(0.8, 1.6);
    let kind = builder.mostly_a_car();
    let lead_speed = speed * builder.rng.uniform(0.75, 1.05);
    if let Some(lead) = builder.put_ahead(kind, gap, lead_speed) {
        builder.traffic.movers[lead].speed_cap = lead_speed.max(3.5);
        if builder.rng.situation(|rng| rng.bool(0.5)) {
            // The lead changes its speed once: to half of it at least, to 1.4 times at most.
            let (at, share) = (builder.rng.uniform(1.0, 8.0), builder.rng.uniform(0.5, 1.4));
            builder.traffic.movers[lead].script = vec![Act::Limit {
                at,
                speed: (lead_speed * share).max(3.0),
            }];
        }
    }
    builder.fill_lanes([0.3, 1.8], [gap + 22.0, 14.0]);
    stream::cut_in(builder, 0.25);
    builder.add_clutter();
}
