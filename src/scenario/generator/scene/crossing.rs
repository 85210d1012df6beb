//! Scenes at crossings.

use super::builder::TrafficBuilder;
use super::setting::{self, LIMITS, LightTiming, Setting};
use crate::generator::rng::SeededRng;
use crate::generator::road::{Control, Turn};
use planagent_world::geometry::GeometryError;

/// A route over a crossing with this turn. `signals` is the probability of traffic lights.
pub(crate) fn turn(
    rng: &mut SeededRng,
    turn: Turn,
    signals: f64,
) -> Result<Setting, GeometryError> {
    let style = setting::style(rng, [1, 3], [1, 3], &LIMITS[..4]);
    let mut plan = setting::crossing(rng, &style, turn);
    if rng.bool(signals) {
        plan.control = Control::Signals {
            protected_left: rng.bool(0.4),
        };
        plan.from_minor = false;
    } else if matches!(plan.control, Control::Signals { .. }) {
        plan.control = if rng.bool(0.6) {
            Control::StopSigns
        } else {
            Control::Priority
        };
        plan.from_minor = style.own == 1 && rng.bool(0.5);
    }
    // The ego waits at the line or rolls up to it.
    let waiting = rng.bool(0.45);
    let before = if waiting {
        rng.uniform(6.0, 14.0)
    } else {
        rng.uniform(45.0, 85.0)
    };
    let speed = if waiting { 0.0 } else { rng.uniform(0.6, 0.95) };
    let (layout, start) = setting::town(rng, &style, &plan, before)?;
    let mut setting = Setting::new(layout, start - 4.1, speed);
    setting.light = match (waiting, rng.range(0, 2)) {
        (true, _) => LightTiming::GreenFrom(rng.early_draw(0.5, 4.5)),
        (false, 0) => LightTiming::GreenFrom(rng.early_draw(2.0, 7.0)),
        (false, 1) => LightTiming::GreenFrom(rng.early_draw(-4.0, 0.0)),
        (false, _) => LightTiming::GreenUntil(rng.early_draw(3.0, 9.0)),
    };
    Ok(setting)
}

/// Traffic around the crossing, now and then with a lead vehicle.
pub(crate) fn populate(builder: &mut TrafficBuilder<'_, '_>) {
    if builder.rng.situation(|rng| rng.bool(0.35)) {
        let (speed, kind) = (builder.ego().speed, builder.mostly_a_car());
        let gap = 4.0 + speed * builder.rng.uniform(1.0, 1.8);
        builder.put_ahead(kind, gap, speed);
    }
    let density = builder.rng.situation(|rng| rng.uniform(0.4, 2.2));
    let ahead = if builder.rng.bool(0.5) { 25.0 } else { 60.0 };
    builder.fill_lanes_to(density, [ahead, 14.0]);
    builder.add_clutter();
}
