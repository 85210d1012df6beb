//! Scenes in a stream of traffic: leads that go steadily, slow down, stop; dense and standing traffic.

use super::setting::{LIMITS, LightWish, Setting, corridor, crossing, style, town};
use super::stage::{Make, Stage};
use crate::geometry::GeometryError;
use crate::scenario::generator::dice::Dice;
use crate::scenario::generator::expert::Task;
use crate::scenario::generator::road::{Control, Turn};
use crate::scenario::generator::traffic::Act;

/// A road or, now and then, a way over a crossing whose light is green; the ego at a share of the allowed speed.
fn stream(dice: &mut Dice, own: [usize; 2], share: [f64; 2]) -> Result<Setting, GeometryError> {
    let style = style(dice, own, [0, 3], &LIMITS[..5]);
    let bendiness = dice.between(0.0, 0.9);
    let layout = corridor(dice, &style, bendiness)?;
    let start = super::setting::BEHIND + dice.between(0.0, 20.0);
    Ok(Setting::new(layout, start, dice.between(share[0], share[1])))
}

/// A way up to a light.
fn before_light(dice: &mut Dice, before: [f64; 2], speed: [f64; 2]) -> Result<Setting, GeometryError> {
    let style = style(dice, [1, 3], [1, 2], &LIMITS[..4]);
    let mut plan = crossing(dice, &style, Turn::Straight);
    plan.control = Control::Signals { protected_left: dice.chance(0.4) };
    plan.from_minor = false;
    let distance = dice.between(before[0], before[1]);
    let (layout, start) = town(dice, &style, &plan, distance)?;
    Ok(Setting::new(layout, start - 4.1, dice.between(speed[0], speed[1])))
}

pub(super) fn following(dice: &mut Dice) -> Result<Setting, GeometryError> {
    let mut setting = stream(dice, [1, 4], [0.5, 0.95])?;
    setting.task.overtakes = dice.chance(0.3);
    Ok(setting)
}

pub(super) fn cast_following(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let speed = stage.ego().speed;
    let gap = 4.0 + speed * stage.dice.between(0.8, 1.6);
    let make = stage.mostly_a_car();
    let pace = speed * stage.dice.between(0.75, 1.05);
    if let Some(lead) = stage.put_ahead(make, gap, pace) {
        stage.traffic.movers[lead].ceiling = pace.max(3.5);
        if stage.dice.situation(|dice| dice.chance(0.5)) {
            // It slows down for a while, or picks up.
            let (at, share) = (stage.dice.between(1.0, 8.0), stage.dice.between(0.5, 1.4));
            stage.traffic.movers[lead].script = vec![Act::Limit { at, speed: (pace * share).max(3.0) }];
        }
    }
    let density = stage.dice.situation(|dice| dice.between(0.3, 1.8));
    stage.populate(density, [gap + 22.0, 14.0]);
    cut_in(stage, 0.25);
    stage.garnish();
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
    if sides.is_empty() || !stage.dice.situation(|dice| dice.chance(probability)) {
        return;
    }
    let from_left = stage.dice.situation(|dice| dice.pick(&sides));
    let lane = way[if from_left { stage.ego_lane - 1 } else { stage.ego_lane + 1 }];
    let chain = stage.roads().chain_on_way(0, lane);
    let s = stage.ego().s + stage.dice.between(7.0, 16.0);
    let speed = stage.ego().speed * stage.dice.between(0.9, 1.1);
    if let Some(i) = stage.put(Make::Car, chain, s, speed, 0.0) {
        let (at, share) = (stage.dice.between(-1.0, 6.0), stage.dice.between(0.7, 1.0));
        stage.traffic.movers[i].ceiling = (speed * 1.05).max(3.0);
        stage.traffic.movers[i].script = vec![
            Act::Limit { at: at + 2.5, speed: (speed * share).max(3.0) },
            Act::ChangeLane { at, left: !from_left },
        ];
    }
}

pub(super) fn stopping(dice: &mut Dice) -> Result<Setting, GeometryError> {
    if dice.chance(0.5) {
        let mut setting = before_light(dice, [75.0, 110.0], [0.7, 0.95])?;
        setting.light = LightWish::GreenFrom(dice.early(7.0, 14.0));
        Ok(setting)
    } else {
        stream(dice, [1, 4], [0.6, 0.95])
    }
}

pub(super) fn cast_stopping(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let speed = stage.ego().speed;
    let gap = 5.0 + speed * stage.dice.between(0.9, 1.5);
    let make = stage.mostly_a_car();
    if let Some(lead) = stage.put_ahead(make, gap, speed) {
        stage.traffic.movers[lead].ceiling = speed.max(4.0);
        let at = stage.dice.between(-0.5, 3.5);
        let mut script = vec![Act::Limit { at, speed: 0.05 }];
        if stage.dice.situation(|dice| dice.chance(0.6)) {
            script.insert(0, Act::Limit { at: at + stage.dice.between(6.0, 10.0), speed: speed.max(5.0) });
        }
        // At a light it stops by itself.
        if stage.roads().signals.is_empty() || stage.dice.situation(|dice| dice.chance(0.3)) {
            stage.traffic.movers[lead].script = script;
            stage.traffic.movers[lead].temper.decel = stage.dice.between(1.4, 2.6);
        }
    }
    let density = stage.dice.situation(|dice| dice.between(0.3, 1.6));
    stage.populate(density, [gap + 25.0, 14.0]);
    stage.garnish();
    task
}

pub(super) fn behind_long(dice: &mut Dice) -> Result<Setting, GeometryError> {
    if dice.chance(0.3) {
        let mut setting = before_light(dice, [40.0, 80.0], [0.4, 0.7])?;
        setting.light = LightWish::GreenFrom(dice.early(2.0, 8.0));
        return Ok(setting);
    }
    let mut setting = stream(dice, [1, 3], [0.35, 0.7])?;
    setting.task.overtakes = dice.chance(0.25);
    Ok(setting)
}

pub(super) fn cast_behind_long(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let speed = stage.ego().speed;
    let gap = 3.0 + speed * stage.dice.between(0.7, 1.1);
    let pace = speed * stage.dice.between(0.8, 1.0);
    if let Some(lead) = stage.put_ahead(Make::Long, gap, pace) {
        stage.traffic.movers[lead].ceiling = pace.max(2.5);
        if stage.dice.situation(|dice| dice.chance(0.35)) {
            let at = stage.dice.between(1.0, 6.0);
            let again = Act::Limit { at: at + stage.dice.between(4.0, 8.0), speed: pace.max(4.0) };
            stage.traffic.movers[lead].script = vec![again, Act::Limit { at, speed: 0.05 }];
        }
    }
    let density = stage.dice.situation(|dice| dice.between(0.3, 1.5));
    stage.populate(density, [gap + 35.0, 14.0]);
    stage.garnish();
    task
}

pub(super) fn stationary(dice: &mut Dice) -> Result<Setting, GeometryError> {
    let mut setting = before_light(dice, [12.0, 45.0], [0.0, 0.0])?;
    setting.light = LightWish::GreenFrom(dice.early(4.0, 13.0));
    Ok(setting)
}

pub(super) fn cast_stationary(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    // A queue from the line back past the ego in its lane, and in the lanes beside it.
    queue(stage, 0.95);
    let density = stage.dice.situation(|dice| dice.between(0.6, 1.8));
    stage.populate(density, [8.0, 10.0]);
    stage.garnish();
    task
}

/// Standing vehicles in all lanes of the ego's first road, from its end back to some way behind the ego.
fn queue(stage: &mut Stage<'_, '_>, share: f64) {
    let lanes = stage.roads().way[0].clone();
    for (place, lane) in lanes.into_iter().enumerate() {
        let length = stage.roads().map[lane].centerline.length();
        let mut s = length - stage.dice.between(3.5, 5.0);
        let back = stage.ego().s - stage.dice.between(8.0, 40.0);
        while s > back {
            let chain = if place == stage.ego_lane { stage.roads().chain_on_way(0, lane) } else { stage.wander(lane) };
            let make = if stage.dice.chance(0.08) { Make::Long } else { Make::Car };
            if stage.dice.chance(share) {
                stage.put(make, chain, s, 0.0, 0.0);
            }
            s -= stage.dice.between(7.2, 9.5);
        }
    }
}

pub(super) fn near_many(dice: &mut Dice) -> Result<Setting, GeometryError> {
    stream(dice, [2, 4], [0.45, 0.8])
}

pub(super) fn cast_near_many(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let speed = stage.ego().speed;
    let lanes = stage.roads().way[0].clone();
    // A platoon around the ego that moves at its speed.
    for (place, lane) in lanes.into_iter().enumerate() {
        let mut s = stage.ego().s - stage.dice.between(14.0, 34.0);
        let end = stage.ego().s + 50.0;
        while s < end {
            let apart = (s - stage.ego().s).abs() > 11.0 + speed * 0.6;
            if place != stage.ego_lane || apart {
                let chain = stage.roads().chain_on_way(0, lane);
                let make = if stage.dice.chance(0.08) { Make::Long } else { Make::Car };
                let pace = speed * stage.dice.between(0.9, 1.0);
                if let Some(i) = stage.put(make, chain, s, pace, 0.0) {
                    stage.traffic.movers[i].ceiling = (speed * stage.dice.between(0.92, 1.02)).max(3.0);
                }
            }
            s += 7.5 + speed * stage.dice.between(0.5, 1.1);
        }
    }
    let density = stage.dice.situation(|dice| dice.between(0.5, 1.2));
    stage.populate(density, [70.0, 40.0]);
    cut_in(stage, 0.4);
    stage.garnish();
    task
}

pub(super) fn low_speed(dice: &mut Dice) -> Result<Setting, GeometryError> {
    if dice.chance(0.4) {
        let mut setting = before_light(dice, [25.0, 60.0], [0.05, 0.3])?;
        setting.light = LightWish::GreenFrom(dice.early(0.0, 8.0));
        return Ok(setting);
    }
    stream(dice, [1, 3], [0.05, 0.25])
}

pub(super) fn cast_low_speed(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    // A slow jam: everybody creeps.
    let lanes = stage.roads().way[0].clone();
    let creep = stage.dice.between(0.4, 1.8);
    let released = stage.dice.between(4.0, 13.0);
    for (place, lane) in lanes.into_iter().enumerate() {
        let mut s = stage.ego().s - stage.dice.between(18.0, 45.0);
        let end = stage.ego().s + stage.dice.between(30.0, 70.0);
        while s < end {
            if place != stage.ego_lane || (s - stage.ego().s).abs() > 10.0 {
                let chain = stage.roads().chain_on_way(0, lane);
                let make = if stage.dice.chance(0.1) { Make::Long } else { Make::Car };
                if let Some(i) = stage.put(make, chain, s, creep, 0.0) {
                    stage.traffic.movers[i].ceiling = creep;
                    stage.traffic.movers[i].script = vec![Act::Limit { at: released, speed: f64::INFINITY }];
                }
            }
            s += stage.dice.between(8.0, 13.0);
        }
    }
    let density = stage.dice.situation(|dice| dice.between(0.5, 1.5));
    stage.populate(density, [80.0, 50.0]);
    stage.garnish();
    task
}
