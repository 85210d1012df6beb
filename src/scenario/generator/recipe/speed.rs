//! Scenes of free driving: fast, and through bends.

use super::follow::cut_in;
use super::lanes::close_ahead;
use super::setting::{BEHIND, LIMITS, Setting, anywhere, bend_for, corridor, extend, needed_ahead, style};
use super::stage::{Make, Stage};
use crate::geometry::GeometryError;
use crate::scenario::generator::expert::Task;
use crate::scenario::generator::rng::SeededRng;
use crate::scenario::generator::road::{Course, Layout};

pub(super) fn high_speed(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let style = style(rng, [1, 4], [0, 3], &LIMITS[2..]);
    let bendiness = rng.uniform(0.0, 0.6);
    let layout = corridor(rng, &style, bendiness)?;
    let mut setting = Setting::new(layout, BEHIND + rng.uniform(0.0, 20.0), rng.uniform(0.8, 1.0));
    setting.task.overtakes = rng.bool(0.5);
    Ok(setting)
}

pub(super) fn high_lateral(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let style = style(rng, [1, 3], [0, 2], &LIMITS[..4]);
    let curvature = rng.sign() * bend_for(&style, rng.uniform(0.6, 0.95)).min(0.055);
    let start = anywhere(rng);
    let lead = BEHIND + rng.uniform(45.0, 90.0);
    // The bend lies where the ego arrives within the first seconds.
    let length = lead + rng.uniform(70.0, 120.0);
    let mut layout = Layout::begin(start, &style, Course { length, curvature, lead })?;
    extend(&mut layout, rng, &style, needed_ahead(&style) - (length - BEHIND), 0.6)?;
    Ok(Setting::new(layout, BEHIND, rng.uniform(0.7, 1.0)))
}

pub(super) fn cast(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let speed = stage.ego().speed;
    let several = stage.roads().way[0].len() > 1;
    if several && stage.rng.situation(|rng| rng.bool(0.2)) {
        let ahead = speed * stage.rng.situation(|rng| rng.uniform(6.0, 11.0)) + 20.0;
        close_ahead(stage, ahead);
    } else if stage.rng.situation(|rng| rng.bool(0.4)) {
        let gap = 15.0 + speed * stage.rng.uniform(1.2, 3.0);
        let pace = speed * stage.rng.uniform(0.55, 1.1);
        if let Some(lead) = stage.put_ahead(Make::Car, gap, pace) {
            stage.traffic.movers[lead].speed_cap = pace.max(4.0);
        }
    }
    let density = stage.rng.situation(|rng| rng.uniform(0.1, 1.3));
    let ahead = stage.rng.uniform(60.0, 130.0);
    stage.populate(density, [ahead, 20.0]);
    cut_in(stage, 0.15);
    stage.add_clutter();
    task
}
