//! Second qualitative case of the paper: a light turns red when the ego can just no longer stop at
//! PDM-Closed's rate.

use crate::generator::prelude::*;

/// `case_red_light`.
pub(super) const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "case_red_light",
    seed: 18_000,
    group: TypeGroup::Case,
    setting,
    populate,
    shows: |log| log.stops_before_red(),
});

/// Speed limit, m/s (30 mph).
const LIMIT: f64 = 13.4;
/// When the light turns yellow, seconds from iteration 0. Planning calls every two seconds see it a
/// second later.
const YELLOW_AT: f64 = 1.0;
/// Distance from the ego's front to the crossing when the light turns red, at the speed until then,
/// meters. PDM-Closed's strongest braking (3 m/s²) needs more from the limit. A planner that brakes
/// for yellow has twice the distance.
const LEFT_AT_RED: [f64; 2] = [29.5, 31.0];

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let style = setting::style(rng, [2, 3], [2, 2], &[LIMIT]);
    let mut plan = setting::crossing(rng, &style, Turn::Straight);
    plan.control = Control::Signals {
        protected_left: false,
    };
    plan.from_minor = false;
    plan.crosswalks = [true; 4];
    let driven = EXPERT.speed_factor * LIMIT * (LEAD_IN + YELLOW_AT + YELLOW);
    let before = driven + rng.uniform(LEFT_AT_RED[0], LEFT_AT_RED[1]);
    let (layout, start) = setting::town(rng, &style, &plan, before)?;
    // The ego's position is that of its rear axle.
    let mut setting = Setting::new(layout, start - planagent_world::PACIFICA.front_length, 1.0);
    setting.light = LightTiming::GreenUntil(rng.early_draw(YELLOW_AT, YELLOW_AT));
    Ok(setting)
}

/// People wait at the crosswalk behind the stop line, and no vehicle drives ahead of the ego.
fn populate(builder: &mut TrafficBuilder<'_, '_>) {
    let first = builder
        .ego()
        .track
        .crosswalks
        .iter()
        .find(|walk| walk[0] > builder.ego().s)
        .copied();
    if let Some(walk) = first.and_then(|span| builder.crosswalk_at(span)) {
        for moment in [8.0, 9.0] {
            let from_far_side = builder.rng.bool(0.5);
            builder.wait_at(&walk, Departure::At(moment), from_far_side);
        }
    }
    let density = builder.rng.uniform(0.3, 0.6);
    builder.fill_lanes_to(density, [260.0, 30.0]);
}
