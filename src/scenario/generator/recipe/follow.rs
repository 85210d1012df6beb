//! Scenes in a stream of traffic: leads that go steadily, slow down, stop; dense and standing traffic.

use super::setting::{LIMITS, LightWish, Setting, corridor, crossing, style, town};
use super::stage::{Make, Stage};
use crate::geometry::GeometryError;
use crate::scenario::generator::expert::Task;
use crate::scenario::generator::rng::SeededRng;
use crate::scenario::generator::road::{Control, Turn};
use crate::scenario::generator::traffic::Act;

/// A road or, now and then, a way over a crossing whose light is green; the ego at a share of the allowed speed.
fn stream(rng: &mut SeededRng, own: [usize; 2], share: [f64; 2]) -> Result<Setting, GeometryError> {
    let style = style(rng, own, [0, 3], &LIMITS[..5]);
    let bendiness = rng.uniform(0.0, 0.9);
    let layout = corridor(rng, &style, bendiness)?;
    let start = super::setting::BEHIND + rng.uniform(0.0, 20.0);
    Ok(Setting::new(layout, start, rng.uniform(share[0], share[1])))
}

/// A way up to a light.
fn before_light(rng: &mut SeededRng, before: [f64; 2], speed: [f64; 2]) -> Result<Setting, GeometryError> {
    let style = style(rng, [1, 3], [1, 2], &LIMITS[..4]);
    let mut plan = crossing(rng, &style, Turn::Straight);
    plan.control = Control::Signals { protected_left: rng.bool(0.4) };
    plan.from_minor = false;
    let distance = rng.uniform(before[0], before[1]);
    let (layout, start) = town(rng, &style, &plan, distance)?;
    Ok(Setting::new(layout, start - 4.1, rng.uniform(speed[0], speed[1])))
}

pub(super) fn following(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let mut setting = stream(rng, [1, 4], [0.5, 0.95])?;
    setting.task.overtakes = rng.bool(0.3);
    Ok(setting)
}

pub(super) fn cast_following(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let speed = stage.ego().speed;
    let gap = 4.0 + speed * stage.rng.uniform(0.8, 1.6);
    let make = stage.mostly_a_car();
    let pace = speed * stage.rng.uniform(0.75, 1.05);
    if let Some(lead) = stage.put_ahead(make, gap, pace) {
        stage.traffic.movers[lead].speed_cap = pace.max(3.5);
        if stage.rng.situation(|rng| rng.bool(0.5)) {
            // It slows down for a while, or picks up.
            let (at, share) = (stage.rng.uniform(1.0, 8.0), stage.rng.uniform(0.5, 1.4));
            stage.traffic.movers[lead].script = vec![Act::Limit { at, speed: (pace * share).max(3.0) }];
        }
    }
    let density = stage.rng.situation(|rng| rng.uniform(0.3, 1.8));
    stage.populate(density, [gap + 22.0, 14.0]);
    cut_in(stage, 0.25);
    stage.add_clutter();
    task
}

/// Somebody from a neighbouring lane moves in before the ego.
pub(super) fn cut_in(stage: &mut Stage<'_, '_>, probability: f64) {
    let way = &stage.roads().way[0];
    let sides: Vec<bool> = [(stage.ego_lane > 0, true), (stage.ego_lane + 1 < way.len(), false)]
        .into_iter()
        .filter(|s| s.0)
        .map(|s| s.1)
        .collect();
    if sides.is_empty() || !stage.rng.situation(|rng| rng.bool(probability)) {
        return;
    }
    let from_left = stage.rng.situation(|rng| rng.choose(&sides));
    let lane = way[if from_left { stage.ego_lane - 1 } else { stage.ego_lane + 1 }];
    let chain = stage.roads().chain_on_way(0, lane);
    let s = stage.ego().s + stage.rng.uniform(7.0, 16.0);
    let speed = stage.ego().speed * stage.rng.uniform(0.9, 1.1);
    if let Some(i) = stage.put(Make::Car, chain, s, speed, 0.0) {
        let (at, share) = (stage.rng.uniform(-1.0, 6.0), stage.rng.uniform(0.7, 1.0));
        stage.traffic.movers[i].speed_cap = (speed * 1.05).max(3.0);
        stage.traffic.movers[i].script = vec![
            Act::Limit { at: at + 2.5, speed: (speed * share).max(3.0) },
            Act::ChangeLane { at, left: !from_left },
        ];
    }
}

pub(super) fn stopping(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    if rng.bool(0.5) {
        let mut setting = before_light(rng, [75.0, 110.0], [0.7, 0.95])?;
        setting.light = LightWish::GreenFrom(rng.early_draw(7.0, 14.0));
        Ok(setting)
    } else {
        stream(rng, [1, 4], [0.6, 0.95])
    }
}

pub(super) fn cast_stopping(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let speed = stage.ego().speed;
    let gap = 5.0 + speed * stage.rng.uniform(0.9, 1.5);
    let make = stage.mostly_a_car();
    if let Some(lead) = stage.put_ahead(make, gap, speed) {
        stage.traffic.movers[lead].speed_cap = speed.max(4.0);
        let at = stage.rng.uniform(-0.5, 3.5);
        let mut script = vec![Act::Limit { at, speed: 0.05 }];
        if stage.rng.situation(|rng| rng.bool(0.6)) {
            script.insert(0, Act::Limit { at: at + stage.rng.uniform(6.0, 10.0), speed: speed.max(5.0) });
        }
        // At a light it stops by itself.
        if stage.roads().signals.is_empty() || stage.rng.situation(|rng| rng.bool(0.3)) {
            stage.traffic.movers[lead].script = script;
            stage.traffic.movers[lead].profile.decel = stage.rng.uniform(1.4, 2.6);
        }
    }
    let density = stage.rng.situation(|rng| rng.uniform(0.3, 1.6));
    stage.populate(density, [gap + 25.0, 14.0]);
    stage.add_clutter();
    task
}

pub(super) fn behind_long(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    if rng.bool(0.3) {
        let mut setting = before_light(rng, [40.0, 80.0], [0.4, 0.7])?;
        setting.light = LightWish::GreenFrom(rng.early_draw(2.0, 8.0));
        return Ok(setting);
    }
    let mut setting = stream(rng, [1, 3], [0.35, 0.7])?;
    setting.task.overtakes = rng.bool(0.25);
    Ok(setting)
}

pub(super) fn cast_behind_long(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let speed = stage.ego().speed;
    let gap = 3.0 + speed * stage.rng.uniform(0.7, 1.1);
    let pace = speed * stage.rng.uniform(0.8, 1.0);
    if let Some(lead) = stage.put_ahead(Make::Long, gap, pace) {
        stage.traffic.movers[lead].speed_cap = pace.max(2.5);
        if stage.rng.situation(|rng| rng.bool(0.35)) {
            let at = stage.rng.uniform(1.0, 6.0);
            let again = Act::Limit { at: at + stage.rng.uniform(4.0, 8.0), speed: pace.max(4.0) };
            stage.traffic.movers[lead].script = vec![again, Act::Limit { at, speed: 0.05 }];
        }
    }
    let density = stage.rng.situation(|rng| rng.uniform(0.3, 1.5));
    stage.populate(density, [gap + 35.0, 14.0]);
    stage.add_clutter();
    task
}

pub(super) fn stationary(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let mut setting = before_light(rng, [12.0, 45.0], [0.0, 0.0])?;
    setting.light = LightWish::GreenFrom(rng.early_draw(4.0, 13.0));
    Ok(setting)
}

pub(super) fn cast_stationary(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    // A queue from the line back past the ego in its lane, and in the lanes beside it.
    queue(stage, 0.95);
    let density = stage.rng.situation(|rng| rng.uniform(0.6, 1.8));
    stage.populate(density, [8.0, 10.0]);
    stage.add_clutter();
    task
}

/// Standing vehicles in all lanes of the ego's first road, from its end back to some way behind the ego.
fn queue(stage: &mut Stage<'_, '_>, share: f64) {
    let lanes = stage.roads().way[0].clone();
    for (place, lane) in lanes.into_iter().enumerate() {
        let length = stage.roads().map[lane].centerline.length();
        let mut s = length - stage.rng.uniform(3.5, 5.0);
        let back = stage.ego().s - stage.rng.uniform(8.0, 40.0);
        while s > back {
            let chain = if place == stage.ego_lane { stage.roads().chain_on_way(0, lane) } else { stage.wander(lane) };
            let make = if stage.rng.bool(0.08) { Make::Long } else { Make::Car };
            if stage.rng.bool(share) {
                stage.put(make, chain, s, 0.0, 0.0);
            }
            s -= stage.rng.uniform(7.2, 9.5);
        }
    }
}

pub(super) fn near_many(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    stream(rng, [2, 4], [0.45, 0.8])
}

pub(super) fn cast_near_many(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let speed = stage.ego().speed;
    let lanes = stage.roads().way[0].clone();
    // A platoon around the ego that moves at its speed.
    for (place, lane) in lanes.into_iter().enumerate() {
        let mut s = stage.ego().s - stage.rng.uniform(14.0, 34.0);
        let end = stage.ego().s + 50.0;
        while s < end {
            let apart = (s - stage.ego().s).abs() > 11.0 + speed * 0.6;
            if place != stage.ego_lane || apart {
                let chain = stage.roads().chain_on_way(0, lane);
                let make = if stage.rng.bool(0.08) { Make::Long } else { Make::Car };
                let pace = speed * stage.rng.uniform(0.9, 1.0);
                if let Some(i) = stage.put(make, chain, s, pace, 0.0) {
                    stage.traffic.movers[i].speed_cap = (speed * stage.rng.uniform(0.92, 1.02)).max(3.0);
                }
            }
            s += 7.5 + speed * stage.rng.uniform(0.5, 1.1);
        }
    }
    let density = stage.rng.situation(|rng| rng.uniform(0.5, 1.2));
    stage.populate(density, [70.0, 40.0]);
    cut_in(stage, 0.4);
    stage.add_clutter();
    task
}

pub(super) fn low_speed(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    if rng.bool(0.4) {
        let mut setting = before_light(rng, [25.0, 60.0], [0.05, 0.3])?;
        setting.light = LightWish::GreenFrom(rng.early_draw(0.0, 8.0));
        return Ok(setting);
    }
    stream(rng, [1, 3], [0.05, 0.25])
}

pub(super) fn cast_low_speed(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    // A slow jam: everybody creeps.
    let lanes = stage.roads().way[0].clone();
    let creep = stage.rng.uniform(0.4, 1.8);
    let released = stage.rng.uniform(4.0, 13.0);
    for (place, lane) in lanes.into_iter().enumerate() {
        let mut s = stage.ego().s - stage.rng.uniform(18.0, 45.0);
        let end = stage.ego().s + stage.rng.uniform(30.0, 70.0);
        while s < end {
            if place != stage.ego_lane || (s - stage.ego().s).abs() > 10.0 {
                let chain = stage.roads().chain_on_way(0, lane);
                let make = if stage.rng.bool(0.1) { Make::Long } else { Make::Car };
                if let Some(i) = stage.put(make, chain, s, creep, 0.0) {
                    stage.traffic.movers[i].speed_cap = creep;
                    stage.traffic.movers[i].script = vec![Act::Limit { at: released, speed: f64::INFINITY }];
                }
            }
            s += stage.rng.uniform(8.0, 13.0);
        }
    }
    let density = stage.rng.situation(|rng| rng.uniform(0.5, 1.5));
    stage.populate(density, [80.0, 50.0]);
    stage.add_clutter();
    task
}
