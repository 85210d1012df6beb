//! Scenes in a stream of traffic, and on a free road.

use super::builder::{TrafficBuilder, VehicleKind};
use super::obstacles::close_ahead;
use super::setting::{self, BEHIND, LIMITS, Setting};
use crate::generator::rng::SeededRng;
use crate::generator::road::{Control, Turn};
use crate::generator::traffic::Act;
use planagent_world::geometry::GeometryError;

/// A road with `own` lanes in the ego's direction. The ego starts with a share of the allowed
/// speed.
pub(crate) fn road(
    rng: &mut SeededRng,
    own: [usize; 2],
    share: [f64; 2],
) -> Result<Setting, GeometryError> {
    let style = setting::style(rng, own, [0, 3], &LIMITS[..5]);
    let bendiness = rng.uniform(0.0, 0.9);
    let layout = setting::corridor(rng, &style, bendiness)?;
    let start = BEHIND + rng.uniform(0.0, 20.0);
    Ok(Setting::new(layout, start, rng.uniform(share[0], share[1])))
}

/// A road that leads to a traffic light, `before` meters ahead of the ego.
pub(crate) fn before_light(
    rng: &mut SeededRng,
    before: [f64; 2],
    share: [f64; 2],
) -> Result<Setting, GeometryError> {
    let style = setting::style(rng, [1, 3], [1, 2], &LIMITS[..4]);
    let mut plan = setting::crossing(rng, &style, Turn::Straight);
    plan.control = Control::Signals {
        protected_left: rng.bool(0.4),
    };
    plan.from_minor = false;
    let distance = rng.uniform(before[0], before[1]);
    let (layout, start) = setting::town(rng, &style, &plan, distance)?;
    Ok(Setting::new(
        layout,
        start - 4.1,
        rng.uniform(share[0], share[1]),
    ))
}

/// A driver from a neighboring lane cuts in ahead of the ego.
pub(crate) fn cut_in(builder: &mut TrafficBuilder<'_, '_>, probability: f64) {
    let lanes = &builder.roads().route_lanes[0];
    let sides: Vec<bool> = [
        (builder.ego_lane > 0, true),
        (builder.ego_lane + 1 < lanes.len(), false),
    ]
    .into_iter()
    .filter(|s| s.0)
    .map(|s| s.1)
    .collect();
    if sides.is_empty() || !builder.rng.situation(|rng| rng.bool(probability)) {
        return;
    }
    let from_left = builder.rng.situation(|rng| rng.choose(&sides));
    let lane = lanes[if from_left {
        builder.ego_lane - 1
    } else {
        builder.ego_lane + 1
    }];
    let chain = builder.roads().chain_on_route(0, lane);
    let s = builder.ego().s + builder.rng.uniform(7.0, 16.0);
    let speed = builder.ego().speed * builder.rng.uniform(0.9, 1.1);
    if let Some(i) = builder.put(VehicleKind::Car, chain, s, speed, 0.0) {
        let (at, share) = (
            builder.rng.uniform(-1.0, 6.0),
            builder.rng.uniform(0.7, 1.0),
        );
        // Capped: a driver that speeds up in its own lane would be gone before the change.
        builder.traffic.movers[i].speed_cap = (speed * 1.05).max(3.0);
        builder.traffic.movers[i].script = vec![
            Act::Limit {
                at: at + 2.5,
                speed: (speed * share).max(3.0),
            },
            Act::ChangeLane {
                at,
                left: !from_left,
            },
        ];
    }
}

/// A free road, now and then with a closed lane or a lead vehicle.
pub(crate) fn populate_free_road(builder: &mut TrafficBuilder<'_, '_>) {
    let speed = builder.ego().speed;
    let several = builder.roads().route_lanes[0].len() > 1;
    if several && builder.rng.situation(|rng| rng.bool(0.2)) {
        let ahead = speed * builder.rng.situation(|rng| rng.uniform(6.0, 11.0)) + 20.0;
        close_ahead(builder, ahead);
    } else if builder.rng.situation(|rng| rng.bool(0.4)) {
        let gap = 15.0 + speed * builder.rng.uniform(1.2, 3.0);
        let lead_speed = speed * builder.rng.uniform(0.55, 1.1);
        if let Some(lead) = builder.put_ahead(VehicleKind::Car, gap, lead_speed) {
            builder.traffic.movers[lead].speed_cap = lead_speed.max(4.0);
        }
    }
    let density = builder.rng.situation(|rng| rng.uniform(0.1, 1.3));
    let ahead = builder.rng.uniform(60.0, 130.0);
    builder.fill_lanes_to(density, [ahead, 20.0]);
    cut_in(builder, 0.15);
    builder.add_clutter();
}
