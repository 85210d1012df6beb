//! Scenes at crossings and roundabouts.

use super::setting::{LIMITS, LightWish, Setting, circus, crossing, style, town};
use super::stage::Stage;
use crate::geometry::GeometryError;
use crate::scenario::generator::expert::Task;
use crate::scenario::generator::rng::SeededRng;
use crate::scenario::generator::road::{Control, Turn};

/// A way over a crossing with this turn; mostly with lights when `signals` says so.
fn turning(rng: &mut SeededRng, turn: Turn, signals: f64) -> Result<Setting, GeometryError> {
    let style = style(rng, [1, 3], [1, 3], &LIMITS[..4]);
    let mut plan = crossing(rng, &style, turn);
    if rng.bool(signals) {
        plan.control = Control::Signals { protected_left: rng.bool(0.4) };
        plan.from_minor = false;
    } else if matches!(plan.control, Control::Signals { .. }) {
        plan.control = if rng.bool(0.6) { Control::StopSigns } else { Control::Priority };
        plan.from_minor = style.own == 1 && rng.bool(0.5);
    }
    // Waiting at the line, or rolling up to it.
    let waiting = rng.bool(0.45);
    let before = if waiting { rng.uniform(6.0, 14.0) } else { rng.uniform(45.0, 85.0) };
    let speed = if waiting { 0.0 } else { rng.uniform(0.6, 0.95) };
    let (layout, start) = town(rng, &style, &plan, before)?;
    let mut setting = Setting::new(layout, start - 4.1, speed);
    setting.light = match (waiting, rng.range(0, 2)) {
        (true, _) => LightWish::GreenFrom(rng.early_draw(0.5, 4.5)),
        (false, 0) => LightWish::GreenFrom(rng.early_draw(2.0, 7.0)),
        (false, 1) => LightWish::GreenFrom(rng.early_draw(-4.0, 0.0)),
        (false, _) => LightWish::GreenUntil(rng.early_draw(3.0, 9.0)),
    };
    Ok(setting)
}

pub(super) fn left_turn(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    turning(rng, Turn::Left, 0.65)
}

pub(super) fn right_turn(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    turning(rng, Turn::Right, 0.6)
}

pub(super) fn straight_at_light(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    turning(rng, Turn::Straight, 1.0)
}

pub(super) fn unsignalled(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    turning(rng, Turn::Straight, 0.0)
}

pub(super) fn roundabout(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let lanes = rng.range(1, 2);
    let style = style(rng, [lanes, lanes], [lanes, lanes], &LIMITS[..3]);
    let before = rng.uniform(25.0, 70.0);
    let (layout, start) = circus(rng, &style, before)?;
    Ok(Setting::new(layout, start - 4.1, rng.uniform(0.5, 0.95)))
}

pub(super) fn cast(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    if stage.rng.situation(|rng| rng.bool(0.35)) {
        let (speed, make) = (stage.ego().speed, stage.mostly_a_car());
        let gap = 4.0 + speed * stage.rng.uniform(1.0, 1.8);
        stage.put_ahead(make, gap, speed);
    }
    let density = stage.rng.situation(|rng| rng.uniform(0.4, 2.2));
    let ahead = if stage.rng.bool(0.5) { 25.0 } else { 60.0 };
    stage.populate(density, [ahead, 14.0]);
    stage.add_clutter();
    task
}
