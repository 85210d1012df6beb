//! Scenes in which the ego changes lanes: its own is blocked, slow or leads elsewhere, or it simply wants to.

use super::setting::{BEHIND, LIMITS, LanePick, LightWish, Setting, corridor, crossing, style, town};
use super::stage::{Make, Stage};
use crate::geometry::GeometryError;
use crate::scenario::generator::expert::Task;
use crate::scenario::generator::rng::SeededRng;
use crate::scenario::generator::road::{Control, Turn};
use crate::world::ObjectKind;

pub(super) fn changing(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let style = style(rng, [2, 4], [0, 3], &LIMITS[..5]);
    if style.own >= 3 && style.oncoming > 0 && rng.bool(0.35) {
        // The ego must reach the lane that turns.
        let turn = if rng.bool(0.6) { Turn::Left } else { Turn::Right };
        let mut plan = crossing(rng, &style, turn);
        plan.control = Control::Signals { protected_left: rng.bool(0.4) };
        plan.from_minor = false;
        let before = style.speed_limit * rng.uniform(8.0, 10.0);
        let (layout, start) = town(rng, &style, &plan, before)?;
        let mut setting = Setting::new(layout, start, rng.uniform(0.6, 0.9));
        setting.pick = LanePick::Whichever;
        setting.light = LightWish::GreenFrom(rng.early_draw(-2.0, 10.0));
        return Ok(setting);
    }
    let bendiness = rng.uniform(0.0, 0.5);
    let layout = corridor(rng, &style, bendiness)?;
    let mut setting = Setting::new(layout, BEHIND + rng.uniform(0.0, 20.0), rng.uniform(0.6, 0.95));
    setting.task.overtakes = true;
    Ok(setting)
}

pub(super) fn cast(stage: &mut Stage<'_, '_>, mut task: Task) -> Task {
    let speed = stage.ego().speed;
    let roads = stage.roads();
    let lanes = &roads.way[0];
    let must_move = roads.reach(0, lanes[stage.ego_lane]) == 0 && roads.way.len() > 1;
    let cause = stage.rng.situation(|rng| rng.range(0, 5));
    let ahead = speed * stage.rng.situation(|rng| rng.uniform(5.0, 7.5)) + 20.0;
    if must_move || (cause <= 1 && close_ahead(stage, ahead)) {
        task.overtakes = false;
    } else if cause <= 2 {
        double_park(stage, ahead, 0.0);
    } else if cause == 3 {
        let pace = speed * stage.rng.uniform(0.25, 0.5);
        let make = if stage.rng.situation(|rng| rng.bool(0.6)) { Make::Car } else { Make::Long };
        if let Some(lead) = stage.put_ahead(make, ahead * 0.7, pace) {
            stage.traffic.movers[lead].speed_cap = pace.max(1.5);
        }
    } else {
        let left = if stage.ego_lane == 0 {
            false
        } else if stage.ego_lane + 1 == lanes.len() {
            true
        } else {
            stage.rng.situation(|rng| rng.bool(0.5))
        };
        task.change = Some((stage.rng.uniform(0.5, 5.0), left));
        let pace = speed * stage.rng.uniform(0.8, 1.1);
        if let Some(lead) = stage.put_ahead(Make::Car, 6.0 + 1.5 * speed, pace) {
            stage.traffic.movers[lead].speed_cap = pace.max(4.0);
        }
    }
    let density = stage.rng.situation(|rng| rng.uniform(0.2, 1.1));
    stage.populate(density, [ahead + 25.0, 16.0]);
    stage.add_clutter();
    task
}

/// Closes the ego's lane about `ahead` metres before it, where it is a lane with room before the next junction; whether it
/// could be closed.
pub(super) fn close_ahead(stage: &mut Stage<'_, '_>, ahead: f64) -> bool {
    let at = stage.ego().s + ahead;
    let span = stage.ego().track.span_at(at);
    let room = span.to - at - 10.0;
    let length = stage.rng.situation(|rng| rng.uniform(10.0, 45.0)).min(room);
    let closable = !span.connector && room > 8.0 && at - span.from > 16.0;
    if closable {
        let width = stage.roads().facts[span.lane.index()].map_or(3.4, |facts| facts.lane_width);
        stage.close_lane(span.lane, at - span.from, length, width);
    }
    closable
}

/// A vehicle stands in the ego's lane `ahead` metres before the ego, `aside` metres right of the middle.
pub(super) fn double_park(stage: &mut Stage<'_, '_>, ahead: f64, aside: f64) {
    let pose = stage.ego().track.pose_at(stage.ego().s + ahead).translated(0.0, -aside);
    let (length, width) = if stage.rng.situation(|rng| rng.bool(0.75)) {
        (stage.rng.uniform(4.3, 5.2), 1.9)
    } else {
        (stage.rng.uniform(7.0, 10.0), 2.4)
    };
    stage.put_fixture(ObjectKind::Vehicle, pose, length, width);
}
