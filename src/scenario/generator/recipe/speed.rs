//! Scenes of free driving: fast, and through bends.

use super::follow::cut_in;
use super::lanes::close_ahead;
use super::setting::{BEHIND, LIMITS, Setting, anywhere, bend_for, corridor, extend, needed_ahead, style};
use super::stage::{Make, Stage};
use crate::geometry::GeometryError;
use crate::scenario::generator::dice::Dice;
use crate::scenario::generator::expert::Task;
use crate::scenario::generator::road::{Course, Layout};

pub(super) fn high_speed(dice: &mut Dice) -> Result<Setting, GeometryError> {
    let style = style(dice, [1, 4], [0, 3], &LIMITS[2..]);
    let bendiness = dice.between(0.0, 0.6);
    let layout = corridor(dice, &style, bendiness)?;
    let mut setting = Setting::new(layout, BEHIND + dice.between(0.0, 20.0), dice.between(0.8, 1.0));
    setting.task.overtakes = dice.chance(0.5);
    Ok(setting)
}

pub(super) fn high_lateral(dice: &mut Dice) -> Result<Setting, GeometryError> {
    let style = style(dice, [1, 3], [0, 2], &LIMITS[..4]);
    let curvature = dice.sign() * bend_for(&style, dice.between(0.6, 0.95)).min(0.055);
    let start = anywhere(dice);
    let lead = BEHIND + dice.between(45.0, 90.0);
    // The bend lies where the ego arrives within the first seconds.
    let length = lead + dice.between(70.0, 120.0);
    let mut layout = Layout::begin(start, &style, Course { length, curvature, lead })?;
    extend(&mut layout, dice, &style, needed_ahead(&style) - (length - BEHIND), 0.6)?;
    Ok(Setting::new(layout, BEHIND, dice.between(0.7, 1.0)))
}

pub(super) fn cast(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let speed = stage.ego().speed;
    let several = stage.roads().way[0].len() > 1;
    if several && stage.dice.situation(|dice| dice.chance(0.2)) {
        let ahead = speed * stage.dice.situation(|dice| dice.between(6.0, 11.0)) + 20.0;
        close_ahead(stage, ahead);
    } else if stage.dice.situation(|dice| dice.chance(0.4)) {
        let gap = 15.0 + speed * stage.dice.between(1.2, 3.0);
        let pace = speed * stage.dice.between(0.55, 1.1);
        if let Some(lead) = stage.put_ahead(Make::Car, gap, pace) {
            stage.traffic.movers[lead].ceiling = pace.max(4.0);
        }
    }
    let density = stage.dice.situation(|dice| dice.between(0.1, 1.3));
    let ahead = stage.dice.between(60.0, 130.0);
    stage.populate(density, [ahead, 20.0]);
    cut_in(stage, 0.15);
    stage.garnish();
    task
}
