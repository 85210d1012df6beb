//! The two cases by which the paper shows where PlanAgent and PDM-Closed part (its section on qualitative results).

use super::LEAD_IN;
use super::setting::{LanePick, LightWish, Setting, circus, crossing, style, town};
use super::stage::{Make, Stage};
use crate::geometry::GeometryError;
use crate::scenario::generator::expert::{EXPERT, Task};
use crate::scenario::generator::rng::SeededRng;
use crate::scenario::generator::road::{Control, Turn, YELLOW};
use crate::scenario::generator::traffic::{Act, Departure};

/// Speed limit of both, m/s (25 and 30 mph).
const ROUNDABOUT_LIMIT: f64 = 11.2;
const RED_LIGHT_LIMIT: f64 = 13.4;
/// When the light turns yellow, seconds from iteration 0. Calls of the agent every two seconds see it a second later.
const YELLOW_AT: f64 = 1.0;
/// Distance of the ego's front from the crossing when the light turns red, metres, if it goes on at its speed till then: less
/// than PDM-Closed's strongest braking (3 m/s²) takes from the limit. Who brakes for yellow has twice that.
const LEFT_AT_RED: [f64; 2] = [29.5, 31.0];

/// Two lanes lead into a roundabout.
pub(super) fn roundabout(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let style = style(rng, [2, 2], [2, 2], &[ROUNDABOUT_LIMIT]);
    let before = rng.uniform(76.0, 84.0);
    let (layout, start) = circus(rng, &style, before)?;
    let mut setting = Setting::new(layout, start, rng.uniform(0.7, 0.8));
    setting.pick = LanePick::Rightmost;
    Ok(setting)
}

/// Somebody stands at the entry in the ego's lane and lets others go, who come round; the lane beside is free.
pub(super) fn cast_roundabout(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let track = stage.ego().track.clone();
    let entry = track.spans.iter().find(|span| span.connector && span.from > stage.ego().s).map(|span| span.from);
    if let Some(waiting) = entry.and_then(|entry| stage.put_on(Make::Car, track, entry - 3.6, 0.0, 0.0)) {
        // It goes for no gap in the time of the drive, which the expert, who goes round what stands for good, must not know
        // before the drive begins.
        stage.traffic.movers[waiting].speed_cap = 0.3;
        stage.traffic.movers[waiting].script = vec![Act::Limit { at: 0.0, speed: 0.05 }];
    }
    let density = stage.rng.uniform(0.2, 0.4);
    stage.populate(density, [110.0, 40.0]);
    stage.add_clutter();
    task
}

/// A crossing whose light turns red when the ego can just no longer stop at PDM-Closed's rate.
pub(super) fn red_light(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let style = style(rng, [2, 3], [2, 2], &[RED_LIGHT_LIMIT]);
    let mut plan = crossing(rng, &style, Turn::Straight);
    plan.control = Control::Signals { protected_left: false };
    plan.from_minor = false;
    plan.crosswalks = [true; 4];
    let driven = EXPERT.speed_factor * RED_LIGHT_LIMIT * (LEAD_IN + YELLOW_AT + YELLOW);
    let before = driven + rng.uniform(LEFT_AT_RED[0], LEFT_AT_RED[1]);
    let (layout, start) = town(rng, &style, &plan, before)?;
    // The ego's place is that of its rear axle.
    let mut setting = Setting::new(layout, start - crate::world::PACIFICA.front_length, 1.0);
    setting.light = LightWish::GreenUntil(rng.early_draw(YELLOW_AT, YELLOW_AT));
    Ok(setting)
}

/// People wait at the crosswalk behind the stop line, and nobody drives before the ego.
pub(super) fn cast_red_light(stage: &mut Stage<'_, '_>, task: Task) -> Task {
    let first = stage.ego().track.crosswalks.iter().find(|walk| walk[0] > stage.ego().s).copied();
    if let Some(span) = first {
        let at = stage.ego().track.pose_at(f64::midpoint(span[0], span[1])).position();
        let walk = stage.roads().map.crosswalks().iter().find(|walk| walk.contains(at)).cloned();
        for moment in [8.0, 9.0] {
            if let Some(walk) = &walk {
                let other_way = stage.rng.bool(0.5);
                stage.wait_at(walk, Departure::At(moment), other_way);
            }
        }
    }
    let density = stage.rng.uniform(0.3, 0.6);
    stage.populate(density, [260.0, 30.0]);
    task
}
