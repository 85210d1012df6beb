//! The ego gives way to a pedestrian at a crosswalk.

use crate::generator::prelude::*;

/// `waiting_for_pedestrian_to_cross`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "waiting_for_pedestrian_to_cross",
    seed: 9_000,
    group: TypeGroup::Nuplan14,
    setting,
    populate,
    shows: |log| log.waits_for_pedestrian(),
});

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let style = setting::style(rng, [1, 3], [0, 2], &LIMITS[..3]);
    if rng.bool(0.4) {
        // The crosswalk is at a crossing, before it or after a turn.
        let turn = rng.choose(&[Turn::Left, Turn::Straight, Turn::Right]);
        let mut style = style;
        style.oncoming = style.oncoming.max(1);
        let mut plan = setting::crossing(rng, &style, turn);
        plan.crosswalks = [true; 4];
        if turn == Turn::Straight {
            plan.control = Control::Priority;
            plan.from_minor = false;
        }
        let before = rng.uniform(30.0, 60.0);
        let (layout, start) = setting::town(rng, &style, &plan, before)?;
        let mut setting = Setting::new(layout, start - 4.1, rng.uniform(0.5, 0.9));
        setting.light = LightTiming::GreenFrom(rng.early_draw(-3.0, 1.0));
        return Ok(setting);
    }
    let start = setting::anywhere(rng);
    let before = rng.uniform(45.0, 95.0);
    let first = setting::course(rng, BEHIND + before, &style, 0.3);
    let mut layout = Layout::begin(start, &style, first)?;
    let next = Course::straight(rng.uniform(120.0, 180.0));
    layout.joint(rng.uniform(8.0, 12.0), true, &style, next)?;
    setting::extend(
        &mut layout,
        rng,
        &style,
        setting::needed_ahead(&style) - before - next.length,
        0.3,
    )?;
    Ok(Setting::new(layout, BEHIND, rng.uniform(0.5, 0.95)))
}

fn populate(builder: &mut TrafficBuilder<'_, '_>) {
    let speed = builder.ego().speed;
    let first = builder
        .ego()
        .track
        .crosswalks
        .iter()
        .find(|walk| walk[0] > builder.ego().s + 15.0)
        .copied();
    if let Some(span) = first {
        let arrives = (span[0] - builder.ego().front_s()) / speed.max(3.0) - LEAD_IN;
        if let Some(walk) = builder.crosswalk_at(span) {
            for k in 0..builder.rng.situation(|rng| rng.range(1, 4)) {
                // The first pedestrian is on the way when the ego comes near.
                let early = if k == 0 {
                    builder.rng.uniform(2.0, 4.5)
                } else {
                    builder.rng.uniform(-2.0, 5.0)
                };
                let from_far_side = builder.rng.bool(0.5);
                builder.wait_at(&walk, Departure::At(arrives - early), from_far_side);
            }
        }
    }
    let density = builder.rng.situation(|rng| rng.uniform(0.2, 1.2));
    let ahead = builder.rng.uniform(20.0, 90.0);
    builder.fill_lanes_to(density, [ahead, 14.0]);
    builder.add_clutter();
    if builder.rng.situation(|rng| rng.bool(0.2)) {
        builder.add_jaywalker();
    }
}
