//! The ego changes lanes: its own is closed, slow or leads off the route, or the expert changes for
//! no reason.

use crate::generator::prelude::*;

/// `changing_lane`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "changing_lane",
    seed: 13_000,
    group: TypeGroup::Nuplan14,
    setting,
    populate,
    shows: |log| log.changes_lane(),
});

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let style = setting::style(rng, [2, 4], [0, 3], &LIMITS[..5]);
    if style.own >= 3 && style.oncoming > 0 && rng.bool(0.35) {
        // The ego must reach the lane that turns.
        let turn = if rng.bool(0.6) {
            Turn::Left
        } else {
            Turn::Right
        };
        let mut plan = setting::crossing(rng, &style, turn);
        plan.control = Control::Signals {
            protected_left: rng.bool(0.4),
        };
        plan.from_minor = false;
        let before = style.speed_limit * rng.uniform(8.0, 10.0);
        let (layout, start) = setting::town(rng, &style, &plan, before)?;
        let mut setting = Setting::new(layout, start, rng.uniform(0.6, 0.9));
        setting.lane = LanePick::AnyLane;
        setting.light = LightTiming::GreenFrom(rng.early_draw(-2.0, 10.0));
        return Ok(setting);
    }
    let bendiness = rng.uniform(0.0, 0.5);
    let layout = setting::corridor(rng, &style, bendiness)?;
    let mut setting = Setting::new(
        layout,
        BEHIND + rng.uniform(0.0, 20.0),
        rng.uniform(0.6, 0.95),
    );
    setting.task.overtakes = true;
    Ok(setting)
}

fn populate(builder: &mut TrafficBuilder<'_, '_>) {
    let speed = builder.ego().speed;
    let roads = builder.roads();
    let lanes = &roads.route_lanes[0];
    let must_move = roads.reach(0, lanes[builder.ego_lane]) == 0 && roads.route_lanes.len() > 1;
    // What `situation` draws stays the same under another traffic seed; the rest is traffic.
    let cause = builder.rng.situation(|rng| rng.range(0, 5));
    let ahead = speed * builder.rng.situation(|rng| rng.uniform(5.0, 7.5)) + 20.0;
    if must_move || (cause <= 1 && close_ahead(builder, ahead)) {
        builder.task.overtakes = false;
    } else if cause <= 2 {
        double_park(builder, ahead, 0.0);
    } else if cause == 3 {
        let lead_speed = speed * builder.rng.uniform(0.25, 0.5);
        let kind = if builder.rng.situation(|rng| rng.bool(0.6)) {
            VehicleKind::Car
        } else {
            VehicleKind::Long
        };
        if let Some(lead) = builder.put_ahead(kind, ahead * 0.7, lead_speed) {
            builder.traffic.movers[lead].speed_cap = lead_speed.max(1.5);
        }
    } else {
        let left = if builder.ego_lane == 0 {
            false
        } else if builder.ego_lane + 1 == lanes.len() {
            true
        } else {
            builder.rng.situation(|rng| rng.bool(0.5))
        };
        builder.task.change = Some((builder.rng.uniform(0.5, 5.0), left));
        let lead_speed = speed * builder.rng.uniform(0.8, 1.1);
        if let Some(lead) = builder.put_ahead(VehicleKind::Car, 6.0 + 1.5 * speed, lead_speed) {
            builder.traffic.movers[lead].speed_cap = lead_speed.max(4.0);
        }
    }
    builder.fill_lanes([0.2, 1.1], [ahead + 25.0, 16.0]);
    builder.add_clutter();
}
