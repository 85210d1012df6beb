//! Scenes at crossings and roundabouts.

use super::setting::{LIMITS, LightWish, Setting, circus, crossing, style, town};
use super::stage::Stage;
use crate::geometry::GeometryError;
use crate::scenario::generator::dice::Dice;
use crate::scenario::generator::expert::Task;
use crate::scenario::generator::road::{Control, Turn};

/// A way over a crossing with this turn; mostly with lights when `signals` says so.
fn turning(dice: &mut Dice, turn: Turn, signals: f64) -> Result<Setting, GeometryError> {
    let style = style(dice, [1, 3], [1, 3], &LIMITS[..4]);
    let mut plan = crossing(dice, &style, turn);
    if dice.chance(signals) {
        plan.control = Control::Signals { protected_left: dice.chance(0.4) };
        plan.from_minor = false;
    } else if matches!(plan.control, Control::Signals { .. }) {
        plan.control = if dice.chance(0.6) { Control::StopSigns } else { Control::Priority };
        plan.from_minor = style.own == 1 && dice.chance(0.5);
    }
    // Waiting at the line, or rolling up to it.
    let waiting = dice.chance(0.45);
    let before = if waiting { dice.between(6.0, 14.0) } else { dice.between(45.0, 85.0) };
    let speed = if waiting { 0.0 } else { dice.between(0.6, 0.95) };
    let (layout, start) = town(dice, &style, &plan, before)?;
    let mut setting = Setting::new(layout, start - 4.1, speed);
    setting.light = match (waiting, dice.whole(0, 2)) {
        (true, _) => LightWish::GreenFrom(dice.early(0.5, 4.5)),
        (false, 0) => LightWish::GreenFrom(dice.early(2.0, 7.0)),
        (false, 1) => LightWish::GreenFrom(dice.early(-4.0, 0.0)),
        (false, _) => LightWish::GreenUntil(dice.early(3.0, 9.0)),
    };
    Ok(setting)
}

pub(super) fn left_turn(dice: &mut Dice) -> Result<Setting, GeometryError> {
    turning(dice, Turn::Left, 0.65)
}

pub(super) fn right_turn(dice: &mut Dice) -> Result<Setting, GeometryError> {
    turning(dice, Turn::Right, 0.6)
}

pub(super) fn straight_at_light(dice: &mut Dice) -> Result<Setting, GeometryError> {
    turning(dice, Turn::Straight, 1.0)
}

pub(super) fn unsignalled(dice: &mut Dice) -> Result<Setting, GeometryError> {
    turning(dice, Turn::Straight, 0.0)
}

pub(super) fn roundabout(dice: &mut Dice) -> Result<Setting, GeometryError> {
    let lanes = dice.whole(1, 2);
    let style = style(dice, [lanes, lanes], [lanes, lanes], &LIMITS[..3]);
    let before = dice.between(25.0, 70.0);
    let (layout, start) = circus(dice, &style, before)?;
    Ok(Setting::new(layout, start - 4.1, dice.between(0.5, 0.95)))
}

pub(super) fn cast(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    if stage.dice.situation(|dice| dice.chance(0.35)) {
        let (speed, make) = (stage.ego().speed, stage.mostly_a_car());
        let gap = 4.0 + speed * stage.dice.between(1.0, 1.8);
        stage.put_ahead(make, gap, speed);
    }
    let density = stage.dice.situation(|dice| dice.between(0.4, 2.2));
    let ahead = if stage.dice.chance(0.5) { 25.0 } else { 60.0 };
    stage.populate(density, [ahead, 14.0]);
    stage.garnish();
    task
}
