//! What stands on a lane permanently: a broken-down or crashed car, cones, a barrier. What waits
//! does not stand permanently.

use super::Centerline;
use planagent_world::geometry::{Corridor, Point, Polyline, wrap_angle};
use planagent_world::{LanePath, ObjectKind, PACIFICA, SceneView, TrackedObject};
use std::collections::BTreeMap;

/// Distance before what blocks the lane at which an ego that stands can still leave it, meters.
/// Why: docs/decisions/117-scenes-with-a-way.md.
pub(super) const PULL_OUT: f64 = 10.0;
/// Objects slower than this stand, m/s.
pub(crate) const STANDING: f64 = 0.2;
/// An object that moved by more than this within the two seconds of history has only just stopped,
/// meters.
const MOVED: f64 = 0.3;
/// Distance ahead of the ego's center in which a blocked lane matters, meters.
/// Why: docs/decisions/113-standing-progress.md.
const REACH: f64 = 60.0;
/// Distance behind the ego's center in which what the ego passes is looked for, meters.
const BEHIND: f64 = 40.0;
/// Maximum distance from the middle of its lane at which the ego is back in it, meters.
const BACK_IN_LANE: f64 = 1.0;
/// A vehicle this near to an intersection ahead of it waits there, meters.
/// Why: docs/decisions/113-standing-progress.md.
const JUNCTION: f64 = 15.0;
/// A vehicle this near behind traffic waits for it, meters.
/// Why: docs/decisions/115-past-what-stands.md.
const QUEUE_GAP: f64 = 12.0;
/// A person this near beside the lane's middle makes a vehicle wait, and is a cause to leave the
/// lane, meters.
const PERSON_ASIDE: f64 = 4.0;
/// A vehicle that stands straight in the middle of the lane: maximum angle (10 degrees) and
/// distance from the middle, meters.
const ALIGNED: (f64, f64) = (0.17, 0.6);
/// Gap between two obstacles that is too short to go back between them, meters.
const TOO_SHORT: f64 = 30.0;
/// Space that the ego needs beside an obstacle, beyond its width, meters.
const MARGIN: f64 = 0.1;
/// How far from the middle of its lane a plan passes what stands at the edge, at most, meters: the
/// lateral offset of PDM-Closed's proposals.
/// Why: docs/decisions/111-shift.md.
pub(crate) const MAX_SHIFT: f64 = 1.0;
/// A line that bends less counts as straight, 1/m: there the ego's corner swings out by 1 cm.
const STRAIGHT: f64 = 1e-3;
/// Space between the ego's rear bumper and what it has passed, from which on it is past that,
/// meters.
/// Why: docs/decisions/135-within-the-lane.md.
pub(super) const CLEARANCE_BEHIND: f64 = 1.0;
/// Steps in which the edge of a lane is looked for, and how far from its middle at most, meters.
const EDGE_STEP: f64 = 0.1;
const MAX_HALF_WIDTH: f64 = 4.0;

/// The stretch of a lane that is blocked by something that stands permanently. Arc lengths on the
/// lane's centerline, meters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockedStretch {
    /// Where the first obstacle begins.
    pub from_s: f64,
    /// Where the last one ends.
    pub to_s: f64,
    /// How far the obstacles reach to the right and to the left of the middle of the lane, positive
    /// to the left, meters.
    pub across: (f64, f64),
    /// Whether vehicles stand in it as in a queue. The reason may be out of sight, so nobody passes
    /// them against traffic.
    pub may_queue: bool,
}

/// An object in the strip that the ego would sweep.
struct InStrip<'a> {
    object: &'a TrackedObject,
    from_s: f64,
    to_s: f64,
    across: (f64, f64),
    waits: bool,
}

impl InStrip<'_> {
    fn moves(&self) -> bool {
        self.object.speed() >= STANDING
    }
}

/// The first stretch of a lane that is blocked ahead of the ego or beside it, with nothing before
/// it that moves or waits. People and bicycles never block in this sense. Nor does a vehicle that
/// may be waiting, at an intersection or for a light, a person or the traffic before it. What
/// leaves room for the ego in its lane does not block either.
pub(super) fn blocked_stretch(scene: &SceneView<'_>, lane: &Centerline) -> Option<BlockedStretch> {
    let line = &lane.path.centerline;
    let (from, to) = (
        (lane.ego_s - BEHIND).max(0.0),
        (lane.ego_s + REACH).min(line.length()),
    );
    let strip = Corridor::new(line.slice(from, to)?, PACIFICA.width / 2.0);
    let footprint = scene.ego.footprint();
    let met = scene
        .objects
        .iter()
        .filter(|object| strip.meets_box(&object.shape) && !object.shape.overlaps(&footprint));
    let mut found: Vec<InStrip<'_>> = met.map(|object| in_strip(&lane.path, object)).collect();
    found.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    let before = first_seen(scene);
    for place in (0..found.len()).rev() {
        let (this, ahead) = found.split_at(place + 1);
        let Some(one) = this.last() else { continue };
        let waits = waits(scene, &lane.path, one, ahead) || has_just_stopped(one.object, &before);
        if let Some(one) = found.get_mut(place) {
            one.waits = waits;
        }
    }
    // What lies behind the rear bumper is passed. An ego that is not back in its lane needs some
    // space to come back.
    let is_back = line.project(scene.ego.center().position()).lateral.abs() <= BACK_IN_LANE;
    let clearance = if is_back { 0.0 } else { CLEARANCE_BEHIND };
    let rear = lane.ego_s - PACIFICA.length() / 2.0 - clearance;
    let follows = |one: &InStrip<'_>| {
        one.to_s <= lane.ego_s - PACIFICA.length() / 2.0 && (one.waits || one.moves())
    };
    let counts = |one: &&InStrip<'_>| {
        one.to_s > rear && !follows(one) && !leaves_room(scene, &lane.path, one)
    };
    let mut ahead = found.iter().filter(counts);
    let first = ahead.next().filter(|one| !one.waits && !one.moves())?;
    let mut stretch = BlockedStretch {
        from_s: first.from_s,
        to_s: first.to_s,
        across: first.across,
        may_queue: false,
    };
    let mut last = first;
    for next in ahead.take_while(|one| !one.waits && !one.moves()) {
        if next.from_s - stretch.to_s > TOO_SHORT {
            break;
        }
        let is_close = next.from_s - last.to_s <= QUEUE_GAP;
        stretch.may_queue |=
            is_close && is_aligned(&lane.path, last) && is_aligned(&lane.path, next);
        last = next;
        stretch.to_s = stretch.to_s.max(next.to_s);
        stretch.across = (
            stretch.across.0.min(next.across.0),
            stretch.across.1.max(next.across.1),
        );
    }
    // Before a taper: an ego that stopped between its first cone and the one that closes the lane
    // could not leave the lane.
    let narrows = |one: &&InStrip<'_>| {
        one.from_s < first.from_s && one.to_s > rear && !one.waits && !one.moves()
    };
    for one in found.iter().filter(narrows).rev() {
        if stretch.from_s - one.to_s <= PULL_OUT {
            stretch.from_s = stretch.from_s.min(one.from_s);
            stretch.across = (
                stretch.across.0.min(one.across.0),
                stretch.across.1.max(one.across.1),
            );
        }
    }
    Some(stretch)
}

/// Whether a person or a bicycle is ahead of the ego in a lane or near it.
pub(super) fn has_person_near(scene: &SceneView<'_>, lane: &Centerline) -> bool {
    let ahead = lane.ego_s..lane.ego_s + REACH;
    people_near(scene, &lane.path.centerline).any(|s| ahead.contains(&s))
}

/// Arc lengths of the people and bicycles on a line or near it.
fn people_near(scene: &SceneView<'_>, line: &Polyline) -> impl Iterator<Item = f64> {
    let people = scene.objects.iter().filter(|one| one.kind.is_vulnerable());
    people
        .map(|person| line.project(person.shape.center.position()))
        .filter(|foot| foot.lateral.abs() <= PERSON_ASIDE)
        .map(|foot| foot.s)
}

fn in_strip<'a>(path: &LanePath, object: &'a TrackedObject) -> InStrip<'a> {
    let corners = object
        .shape
        .corners()
        .map(|corner| path.centerline.project(corner));
    let bounds = |values: [f64; 4]| {
        (
            values.into_iter().fold(f64::INFINITY, f64::min),
            values.into_iter().fold(f64::NEG_INFINITY, f64::max),
        )
    };
    let (from_s, to_s) = bounds(corners.map(|corner| corner.s));
    InStrip {
        object,
        from_s,
        to_s,
        across: bounds(corners.map(|corner| corner.lateral)),
        waits: false,
    }
}

/// Where each object was in the oldest sample of the history.
fn first_seen(scene: &SceneView<'_>) -> BTreeMap<u32, Point> {
    let oldest = scene.history.samples().next();
    let objects = oldest.into_iter().flat_map(|sample| sample.objects.iter());
    objects
        .map(|object| (object.token.0, object.shape.center.position()))
        .collect()
}

fn has_just_stopped(object: &TrackedObject, before: &BTreeMap<u32, Point>) -> bool {
    before
        .get(&object.token.0)
        .is_some_and(|from| (object.shape.center.position() - from).norm() > MOVED)
}

/// Whether an object that stands may move on soon.
fn waits(scene: &SceneView<'_>, path: &LanePath, one: &InStrip<'_>, ahead: &[InStrip<'_>]) -> bool {
    if one.moves() || one.object.kind.is_vulnerable() {
        return true;
    }
    if one.object.kind != ObjectKind::Vehicle || !is_along(path, one) {
        return false;
    }
    let within = |from_s: f64, reach: f64| from_s > one.from_s && from_s - one.to_s <= reach;
    let at_junction = path.lanes.iter().zip(&path.starts).any(|(&lane, &start)| {
        let is_junction = scene.map[lane].is_connector() || scene.lights.status(lane).is_some();
        is_junction && within(start, JUNCTION)
    });
    let behind_traffic = ahead
        .iter()
        .any(|next| next.waits && within(next.from_s, QUEUE_GAP));
    let for_person = people_near(scene, &path.centerline).any(|s| within(s, QUEUE_GAP));
    at_junction || behind_traffic || for_person
}

/// Whether a vehicle stands as one in a queue does.
fn is_aligned(path: &LanePath, one: &InStrip<'_>) -> bool {
    let foot = path.centerline.project(one.object.shape.center.position());
    one.object.kind == ObjectKind::Vehicle && is_along(path, one) && foot.lateral.abs() <= ALIGNED.1
}

/// Whether an object stands along the lane, as who waits in it does.
fn is_along(path: &LanePath, one: &InStrip<'_>) -> bool {
    let foot = path.centerline.project(one.object.shape.center.position());
    wrap_angle(foot.heading - one.object.shape.center.heading).abs() <= ALIGNED.0
}

/// Whether the ego fits between an object and an edge of the lane, and a plan keeps far enough from
/// the middle of the lane to pass there.
fn leaves_room(scene: &SceneView<'_>, path: &LanePath, one: &InStrip<'_>) -> bool {
    let s = f64::midpoint(one.from_s, one.to_s);
    let (right, left) = edges(scene, path, s);
    let needed = PACIFICA.width + MARGIN;
    let passes = |room: f64, inner: f64, object_is_left: bool| {
        let swing = swing(&path.centerline, (one.from_s, one.to_s), object_is_left);
        room >= needed + swing && inner + swing + PACIFICA.width / 2.0 <= MAX_SHIFT
    };
    passes(left - one.across.1, one.across.1, false)
        || passes(one.across.0 - right, -one.across.0, true)
}

/// How far the front corner on one side swings out beyond the ego's side while its rear axle follows
/// a line past a stretch of it, meters: only on the outer side of a bend.
pub(crate) fn swing(line: &Polyline, (from_s, to_s): (f64, f64), to_the_left: bool) -> f64 {
    let half = PACIFICA.width / 2.0;
    let beyond = |s: f64| {
        let curvature = line.curvature_at(s.clamp(0.0, line.length()));
        if (curvature < 0.0) != to_the_left || curvature.abs() < STRAIGHT {
            return 0.0;
        }
        let side = 1.0 / curvature.abs() + half;
        side.hypot(PACIFICA.front_length) - side
    };
    let first = from_s - PACIFICA.front_length;
    (0..=(to_s - first).max(0.0).ceil() as usize)
        .map(|meter| beyond((first + meter as f64).min(to_s)))
        .fold(0.0, f64::max)
}

/// The edges of the lane at an arc length of its centerline, to the right and to the left, positive
/// to the left, meters.
pub(super) fn edges(scene: &SceneView<'_>, path: &LanePath, s: f64) -> (f64, f64) {
    let polygon = &scene.map[path.lane_at(s)].polygon;
    let edge = |side: f64| {
        let steps = 1..=(MAX_HALF_WIDTH / EDGE_STEP) as u32;
        let beyond = |&lateral: &f64| !polygon.contains(path.centerline.frenet_to_map(s, lateral));
        steps
            .map(|step| side * f64::from(step) * EDGE_STEP)
            .find(beyond)
            .unwrap_or(side * MAX_HALF_WIDTH)
    };
    (edge(-1.0), edge(1.0))
}
