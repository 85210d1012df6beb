//! Scenes about people: at crosswalks, stepping out between them, and where they get in and out of cars.

use super::clutter::walker;
use super::lanes::double_park;
use super::setting::{
    BEHIND, LIMITS, LanePick, LightWish, Setting, anywhere, course, crossing, extend, needed_ahead, style, town,
};
use super::stage::Stage;
use crate::geometry::{GeometryError, OrientedBox, Point};
use crate::scenario::generator::expert::Task;
use crate::scenario::generator::rng::SeededRng;
use crate::scenario::generator::road::{Control, Course, Layout, Turn};
use crate::scenario::generator::traffic::{Departure, Walker};

pub(super) fn waiting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let style = style(rng, [1, 3], [0, 2], &LIMITS[..3]);
    if rng.bool(0.4) {
        // A crosswalk at a crossing, on the way in or after a turn.
        let turn = rng.choose(&[Turn::Left, Turn::Straight, Turn::Right]);
        let mut style = style;
        style.oncoming = style.oncoming.max(1);
        let mut plan = crossing(rng, &style, turn);
        plan.crosswalks = [true; 4];
        if turn == Turn::Straight {
            plan.control = Control::Priority;
            plan.from_minor = false;
        }
        let before = rng.uniform(30.0, 60.0);
        let (layout, start) = town(rng, &style, &plan, before)?;
        let mut setting = Setting::new(layout, start - 4.1, rng.uniform(0.5, 0.9));
        setting.light = LightWish::GreenFrom(rng.early_draw(-3.0, 1.0));
        return Ok(setting);
    }
    let start = anywhere(rng);
    let before = rng.uniform(45.0, 95.0);
    let first = course(rng, BEHIND + before, &style, 0.3);
    let mut layout = Layout::begin(start, &style, first)?;
    let next = Course::straight(rng.uniform(120.0, 180.0));
    layout.joint(rng.uniform(8.0, 12.0), true, &style, next)?;
    extend(&mut layout, rng, &style, needed_ahead(&style) - before - next.length, 0.3)?;
    Ok(Setting::new(layout, BEHIND, rng.uniform(0.5, 0.95)))
}

pub(super) fn cast_waiting(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let speed = stage.ego().speed;
    let first = stage.ego().track.crosswalks.iter().find(|walk| walk[0] > stage.ego().s + 15.0).copied();
    if let Some(span) = first {
        let at = stage.ego().track.pose_at(f64::midpoint(span[0], span[1])).position();
        let walks = stage.roads().map.crosswalks().to_vec();
        let walk = walks.iter().find(|walk| walk.contains(at)).cloned();
        let arrives = (span[0] - stage.ego().front_s()) / speed.max(3.0) - super::LEAD_IN;
        if let Some(walk) = walk {
            for k in 0..stage.rng.situation(|rng| rng.range(1, 4)) {
                // The first one is on the way when the ego comes near.
                let early = if k == 0 { stage.rng.uniform(2.0, 4.5) } else { stage.rng.uniform(-2.0, 5.0) };
                let other_way = stage.rng.bool(0.5);
                stage.wait_at(&walk, Departure::At(arrives - early), other_way);
            }
        }
    }
    let density = stage.rng.situation(|rng| rng.uniform(0.2, 1.2));
    let ahead = stage.rng.uniform(20.0, 90.0);
    stage.populate(density, [ahead, 14.0]);
    stage.add_clutter();
    if stage.rng.situation(|rng| rng.bool(0.2)) {
        jaywalker(stage);
    }
    task
}

/// Somebody who crosses the road away from any crosswalk, where nothing stands in the way.
fn jaywalker(stage: &mut Stage<'_, '_>) {
    const REACH: f64 = 14.0;
    const TRIES: usize = 5;
    for _ in 0..TRIES {
        let (s, side) = (stage.ego().s + stage.rng.uniform(50.0, 110.0), stage.rng.sign());
        let early = stage.rng.uniform(8.0, 12.0);
        let pose = stage.ego().track.pose_at(s);
        let (from, to) = (pose.to_map(Point::new(0.0, side * REACH)), pose.to_map(Point::new(1.0, -side * REACH)));
        let blocked = stage.traffic.fixtures.iter().any(|fixture| {
            let wide = OrientedBox::new(fixture.shape.center, fixture.shape.length + 1.2, fixture.shape.width + 1.2);
            wide.meets_segment(from, to)
        });
        if blocked || stage.ego().track.span_at(s).connector {
            continue;
        }
        let arrives = (s - stage.ego().s) / stage.ego().speed.max(3.0) - super::LEAD_IN;
        let pace = stage.rng.uniform(1.2, 1.9);
        stage.put_walker(Walker { pace, departure: Departure::At(arrives - early), ..walker(from, to) });
        return;
    }
}

pub(super) fn pickup(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let mut style = style(rng, [1, 3], [0, 2], &LIMITS[..3]);
    style.shoulder[0] = rng.uniform(0.5, 0.8);
    let start = anywhere(rng);
    let before = rng.uniform(15.0, 50.0);
    let bay = rng.uniform(45.0, 80.0);
    let mut layout = Layout::begin(start, &style, Course::straight(BEHIND + before + bay + 15.0))?;
    layout.bay(rng.uniform(2.5, 3.0), BEHIND + before, bay)?;
    extend(&mut layout, rng, &style, needed_ahead(&style) - before - bay, 0.3)?;
    let mut setting = Setting::new(layout, BEHIND, rng.uniform(0.4, 0.9));
    if rng.bool(0.7) {
        setting.pick = LanePick::Rightmost;
    }
    Ok(setting)
}

pub(super) fn cast_pickup(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let single = stage.roads().way[0].len() == 1;
    stage.fill_bay();
    if stage.rng.situation(|rng| rng.bool(0.55)) {
        let ahead = stage.rng.situation(|rng| rng.uniform(45.0, 95.0));
        // Where there is no lane to move to, it stands so far to the side that it can be passed within the lane.
        let rightmost = stage.ego_lane + 1 == stage.roads().way[0].len();
        if !single && rightmost {
            let aside = stage.rng.uniform(0.0, 0.4);
            double_park(stage, ahead, aside);
        } else if single {
            let aside = stage.rng.uniform(1.7, 2.4);
            double_park(stage, ahead, aside);
        }
    }
    let density = stage.rng.situation(|rng| rng.uniform(0.2, 1.2));
    stage.populate(density, [105.0, 14.0]);
    stage.add_clutter();
    if stage.rng.situation(|rng| rng.bool(0.3)) {
        jaywalker(stage);
    }
    task
}
