//! Roads, where the ego starts on them, and what its traffic light shows.

use super::wide;
use crate::generator::expert::ExpertTask;
use crate::generator::rng::{EarlyDraw, SeededRng};
use crate::generator::road::{CirclePlan, Control, Course, CrossingPlan, Layout, RoadStyle, Turn};
use planagent_world::geometry::{GeometryError, Pose};
use std::f64::consts::PI;

/// Speed limits of city roads, m/s (20 to 45 mph).
pub const LIMITS: [f64; 6] = [8.9, 11.2, 13.4, 15.6, 17.9, 20.1];

/// Seconds that the traffic runs before the log begins, so that speeds and gaps settle.
pub(crate) const SETTLING: f64 = 2.0;
/// Seconds from the first instant of the traffic to iteration 0: settling and history.
pub(crate) const LEAD_IN: f64 = SETTLING + 2.1;
/// Seconds that the ego drives from iteration 0 on.
const DRIVEN: f64 = 15.0;
/// Road that must lie ahead of the ego at the end, meters.
const LOOKAHEAD: f64 = 165.0;
/// Road behind the ego at the start, meters.
pub const BEHIND: f64 = 62.0;

/// The ego's lane at the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LanePick {
    /// Any of the lanes that follow the route farthest.
    OnRoute,
    /// The rightmost of these.
    Rightmost,
    /// Any lane, also one that leads off the route.
    AnyLane,
}

/// The first traffic light on the ego's route. Times count from iteration 0, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum LightTiming {
    Any,
    /// Turns green at this time.
    GreenFrom(EarlyDraw),
    /// Turns yellow at this time.
    GreenUntil(EarlyDraw),
}

/// Roads and the ego on them.
#[derive(Debug)]
pub struct Setting {
    pub(crate) layout: Layout,
    /// Rear axle of the ego along the first road when the traffic starts, meters.
    pub(crate) start_s: f64,
    /// Speed of the ego then, as a share of the allowed speed.
    pub(crate) start_speed: f64,
    pub(crate) lane: LanePick,
    pub(crate) light: LightTiming,
    pub(crate) task: ExpertTask,
}

impl Setting {
    /// The ego starts at `start_s` meters of the first road with `start_speed` of the allowed
    /// speed.
    pub fn new(layout: Layout, start_s: f64, start_speed: f64) -> Self {
        let task = ExpertTask {
            change: None,
            overtakes: false,
        };
        Self {
            layout,
            start_s,
            start_speed,
            lane: LanePick::OnRoute,
            light: LightTiming::Any,
            task,
        }
    }
}

/// A random start pose.
pub(crate) fn anywhere(rng: &mut SeededRng) -> Pose {
    Pose::new(
        rng.uniform(-40.0, 40.0),
        rng.uniform(-40.0, 40.0),
        rng.uniform(-PI, PI),
    )
}

/// A random cross-section: numbers of lanes in both directions within bounds, and one of the
/// limits.
pub fn style(
    rng: &mut SeededRng,
    own: [usize; 2],
    oncoming: [usize; 2],
    limits: &[f64],
) -> RoadStyle {
    if rng.is_wide() {
        return wide::style(rng, own, oncoming, limits);
    }
    // A curb margin, a strip wide enough for bicycles, or a parking strip.
    let shoulder = |rng: &mut SeededRng| {
        let kind = rng.unit();
        if kind < 0.5 {
            rng.uniform(0.5, 0.9)
        } else if kind < 0.75 {
            rng.uniform(1.5, 1.9)
        } else {
            rng.uniform(2.5, 2.8)
        }
    };
    let (own, oncoming) = (
        rng.range(own[0], own[1]),
        rng.range(oncoming[0], oncoming[1]),
    );
    let left = if oncoming == 0 { 0.6 } else { shoulder(rng) };
    RoadStyle {
        own,
        oncoming,
        lane_width: rng.uniform(3.2, 3.8),
        extra: None,
        speed_limit: rng.choose(limits),
        shoulder: [shoulder(rng), left],
    }
}

/// Length of road that the ego needs ahead of its start, meters.
pub(crate) fn needed_ahead(style: &RoadStyle) -> f64 {
    style.speed_limit * (DRIVEN + LEAD_IN) + LOOKAHEAD
}

/// Largest curvature that allows a share of the speed limit, 1/m.
pub(crate) fn max_curvature(style: &RoadStyle, share: f64) -> f64 {
    1.8 / (style.speed_limit * share).powi(2)
}

/// A straight course, or with the probability `bendiness` a gentle bend.
pub(crate) fn course(
    rng: &mut SeededRng,
    length: f64,
    style: &RoadStyle,
    bendiness: f64,
) -> Course {
    if rng.bool(bendiness) {
        let curvature = rng.sign() * rng.uniform(0.3, 0.95) * max_curvature(style, 1.0).min(0.02);
        Course {
            length,
            curvature,
            lead: rng.uniform(0.0, 0.3) * length,
        }
    } else {
        Course::straight(length)
    }
}

/// A road, long enough for the scenario.
pub fn corridor(
    rng: &mut SeededRng,
    style: &RoadStyle,
    bendiness: f64,
) -> Result<Layout, GeometryError> {
    let start = anywhere(rng);
    let total = BEHIND + 25.0 + needed_ahead(style);
    let first = rng.uniform(130.0, 240.0).min(total);
    let first_course = course(rng, first, style, bendiness);
    let mut layout = Layout::begin(start, style, first_course)?;
    extend(&mut layout, rng, style, total - first, bendiness)?;
    Ok(layout)
}

/// Adds `length` meters of road: joints, some with a crosswalk, and some crossings.
pub(crate) fn extend(
    layout: &mut Layout,
    rng: &mut SeededRng,
    style: &RoadStyle,
    length: f64,
    bendiness: f64,
) -> Result<(), GeometryError> {
    let mut left = length;
    while left > 0.0 {
        let piece = rng.uniform(110.0, 230.0).min(left.max(60.0));
        let next = course(rng, piece, style, bendiness);
        if rng.bool(0.25) && style.speed_limit < 18.0 {
            let plan = crossing(rng, style, Turn::Straight);
            layout.crossing(&plan, style, next, rng)?;
        } else {
            layout.joint(rng.uniform(8.0, 14.0), rng.bool(0.3), style, next)?;
        }
        left -= piece + 10.0;
    }
    Ok(())
}

/// A random crossing at which the route takes this turn.
pub(crate) fn crossing(rng: &mut SeededRng, style: &RoadStyle, turn: Turn) -> CrossingPlan {
    let mut arms = [true; 3];
    if rng.bool(0.3) {
        // A T-junction lacks an arm that the route does not need.
        let spare = match turn {
            Turn::Left => [1, 2],
            Turn::Straight => [0, 2],
            Turn::Right => [0, 1],
        };
        arms[rng.choose(&spare)] = false;
    }
    let width = rng.range(1, 2);
    let mut side = self::style(rng, [width, width], [width, width], &LIMITS[..3]);
    if !rng.is_wide() {
        side.lane_width = style.lane_width;
    }
    let kind = rng.unit();
    let control = if kind < 0.6 {
        Control::Signals {
            protected_left: rng.bool(0.4),
        }
    } else if kind < 0.85 {
        Control::StopSigns
    } else {
        Control::Priority
    };
    let from_minor = match control {
        Control::Signals { .. } => false,
        _ => style.own == 1 && rng.bool(0.4),
    };
    let walks = rng.bool(0.7);
    let mut walk = || walks && rng.bool(0.8);
    let crosswalks = [walk(), walk(), walk(), walk()];
    CrossingPlan {
        control,
        turn,
        arms,
        crosswalks,
        side,
        from_minor,
        skew: if rng.bool(0.4) {
            rng.uniform(-0.22, 0.22)
        } else {
            0.0
        },
        corner: rng.uniform(4.5, 9.0),
        arm_length: rng.uniform(75.0, 120.0),
    }
}

/// A road to a crossing and on behind it. The ego starts `before` meters ahead of the crossing.
pub(crate) fn town(
    rng: &mut SeededRng,
    style: &RoadStyle,
    plan: &CrossingPlan,
    before: f64,
) -> Result<(Layout, f64), GeometryError> {
    let start = anywhere(rng);
    let approach = BEHIND + before + rng.uniform(0.0, 25.0);
    let course_in = course(rng, approach, style, 0.25);
    let mut layout = Layout::begin(start, style, course_in)?;
    let onward = if plan.turn == Turn::Straight {
        *style
    } else {
        plan.side
    };
    let need = needed_ahead(&onward) - before;
    let piece = rng.uniform(120.0, 190.0).min(need.max(60.0));
    let next = course(rng, piece, &onward, 0.3);
    layout.crossing(plan, &onward, next, rng)?;
    extend(&mut layout, rng, &onward, need - piece, 0.3)?;
    Ok((layout, approach - before))
}

/// A road to a roundabout and on behind it. The ego starts `before` meters ahead of the roundabout.
pub(crate) fn roundabout(
    rng: &mut SeededRng,
    style: &RoadStyle,
    before: f64,
) -> Result<(Layout, f64), GeometryError> {
    let start = anywhere(rng);
    let approach = BEHIND + before + rng.uniform(0.0, 25.0);
    let mut layout = Layout::begin(start, style, Course::straight(approach))?;
    let arms = rng.range(3, 4);
    let lanes = style.own.min(2);
    let mut side = self::style(rng, [lanes, lanes], [lanes, lanes], &LIMITS[..3]);
    side.lane_width = style.lane_width;
    let plan = CirclePlan {
        island: rng.uniform(10.0, 17.0),
        lanes,
        arms,
        exit: rng.range(0, arms - 2),
        side,
        arm_length: rng.uniform(75.0, 110.0),
    };
    let need = needed_ahead(style) - before;
    let piece = rng.uniform(120.0, 180.0).min(need.max(60.0));
    layout.roundabout(&plan, style, Course::straight(piece))?;
    extend(&mut layout, rng, style, need - piece, 0.3)?;
    Ok((layout, approach - before))
}
