//! The road of a roll-out: what the plan follows, and where it stops.

use super::idm_plan::{IdmPlan, LeadPolicy};
use super::rollout::{LEAD_REFRESH, MIN_GAP, STOP_DECEL};
use crate::environment::lane_graph::STANDING;
use planagent_world::dynamics::Lead;
use planagent_world::geometry::{Corridor, OrientedBox, Point, Polyline, Pose, Vector};
use planagent_world::{ObjectKind, PACIFICA, STEP_S, SceneView, SignalStatus, TrackedObject};

/// The lead object: arc length of its rear on the path, and its speed along the path.
#[derive(Debug, Clone, Copy)]
pub(super) struct LeadOnPath {
    rear_s: f64,
    speed: f64,
}

impl LeadOnPath {
    /// As IDM takes it, for an ego whose rear axle is at arc length `progress`.
    pub(super) fn behind(self, progress: f64) -> Lead {
        Lead {
            gap: self.rear_s - progress - PACIFICA.front_length,
            speed: self.speed,
        }
    }
}

/// An object on the path.
#[derive(Debug, Clone, Copy)]
struct OnPath {
    /// Arc length of its center.
    center_s: f64,
    lead: LeadOnPath,
}

/// What the roll-outs along one path may follow, whatever their speed.
pub(super) struct Road<'a> {
    pub(super) path: &'a Polyline,
    /// Arc length of the ego's rear axle now.
    pub(super) start: f64,
    /// The objects on the path at each search for the lead object, [`LEAD_REFRESH`] steps apart.
    objects: Vec<Vec<OnPath>>,
    /// Arc length at which the front bumper stops: for a red light, before an obstacle, or at the end
    /// of the path.
    stop_s: f64,
    /// The hardest braking of the roll-outs, m/s²: the code's, or what the place before an obstacle
    /// needs.
    pub(super) decel_max: f64,
}

impl<'a> Road<'a> {
    /// The road of a path: what may come onto it, but for what stands beside it.
    /// Why: docs/decisions/115-past-what-stands.md.
    pub(super) fn new(
        plan: &IdmPlan,
        path: &'a Polyline,
        scene: &SceneView<'_>,
        steps: usize,
    ) -> Self {
        let corridor = Corridor::new(path.clone(), PACIFICA.width / 2.0);
        let seconds = steps as f64 * STEP_S;
        let footprint = scene.ego.footprint();
        let may_come = |object: &&TrackedObject| {
            let later = moved(object, seconds);
            let sweep = object.shape.bounds().joined(later.bounds());
            corridor.bounds().overlaps(&sweep) && !object.shape.overlaps(&footprint)
        };
        // Beside what stands there is nothing to follow: whether the ego touches it, the score
        // says. Nor is there behind what stands in the lane where the path leads past it.
        let start = path.project(scene.ego.rear_axle.position()).s;
        let front = start + PACIFICA.front_length;
        let is_beside = |object: &TrackedObject| {
            let rear_s = object
                .shape
                .corners()
                .map(|corner| path.project(corner).s)
                .into_iter()
                .fold(f64::INFINITY, f64::min);
            object.speed() < STANDING && rear_s < front
        };
        let named = plan
            .lead_agent
            .and_then(|token| scene.objects.iter().find(|o| o.token == token).copied());
        let (objects, named) = match plan.lead_policy {
            LeadPolicy::Named => (Vec::new(), named),
            LeadPolicy::Nearest => {
                let ahead = scene
                    .objects
                    .iter()
                    .filter(may_come)
                    .filter(|object| !is_beside(object));
                let is_passed = |object: &TrackedObject| {
                    object.speed() < STANDING && !corridor.meets_box(&object.shape)
                };
                (
                    ahead.copied().collect(),
                    named.filter(|object| !is_beside(object) && !is_passed(object)),
                )
            }
        };
        let (stop_s, decel_max) = match plan.lead_policy {
            LeadPolicy::Named => (path.length(), plan.code.decel_max),
            LeadPolicy::Nearest => {
                let wait = plan
                    .waiting_place
                    .map(|place| before_obstacle(plan, path, scene, place));
                let (obstacle_s, decel_max) = wait.unzip();
                let stops = red_light(plan, path, scene).into_iter().chain(obstacle_s);
                (
                    stops.fold(path.length(), f64::min),
                    decel_max.unwrap_or(plan.code.decel_max),
                )
            }
        };
        let after = |object: &TrackedObject, search: usize| {
            moved(object, (search * LEAD_REFRESH) as f64 * STEP_S)
        };
        // A person who walks across may stop on the path, so who came onto it stays there.
        let stays = |object: &TrackedObject| {
            plan.expects_people_to_stop() && object.kind == ObjectKind::Pedestrian
        };
        let on_path = |search: usize| {
            let at = |object| {
                let earliest = if stays(object) { 0 } else { search };
                let shapes = (earliest..=search)
                    .rev()
                    .map(|search| after(object, search));
                let mut on_path = shapes.filter(|shape| corridor.meets_box(shape));
                on_path.next().map(|shape| (object, shape))
            };
            let named = named.iter().map(|object| (object, after(object, search)));
            objects
                .iter()
                .filter_map(at)
                .chain(named)
                .filter_map(|(object, shape)| place(path, object, &shape, start))
                .collect()
        };
        Self {
            path,
            start,
            objects: (0..steps.div_ceil(LEAD_REFRESH)).map(on_path).collect(),
            stop_s,
            decel_max,
        }
    }

    /// The lead object at a step of a roll-out, for an ego at arc length `progress`. What has its
    /// center behind the ego's rear axle is none.
    pub(super) fn lead(&self, progress: f64, step: usize) -> Option<LeadOnPath> {
        let front = progress + PACIFICA.front_length;
        let on_path = self.objects.get(step / LEAD_REFRESH).into_iter().flatten();
        let ahead = on_path
            .filter(|object| object.center_s > progress)
            .map(|object| object.lead);
        let stop = (self.stop_s > front - MIN_GAP).then_some(LeadOnPath {
            rear_s: self.stop_s,
            speed: 0.0,
        });
        ahead
            .chain(stop)
            .min_by(|a, b| a.rear_s.total_cmp(&b.rear_s))
    }
}

/// The object's place on the path; `None` when its center lies behind arc length `start`.
fn place(
    path: &Polyline,
    object: &TrackedObject,
    shape: &OrientedBox,
    start: f64,
) -> Option<OnPath> {
    let foot = path.project(shape.center.position());
    if foot.s <= start {
        return None;
    }
    let rear_s = shape
        .corners()
        .iter()
        .map(|&corner| path.project(corner).s)
        .fold(f64::INFINITY, f64::min);
    let along = Vector::new(foot.heading.cos(), foot.heading.sin());
    Some(OnPath {
        center_s: foot.s,
        lead: LeadOnPath {
            rear_s,
            speed: object.velocity.dot(&along).max(0.0),
        },
    })
}

/// The box of an object that keeps its velocity.
fn moved(object: &TrackedObject, seconds: f64) -> OrientedBox {
    let at = object.shape.center.position() + object.velocity * seconds;
    object
        .shape
        .moved_to(Pose::at(at, object.shape.center.heading))
}

/// Arc length on the path at which the front bumper stops before an obstacle, and the braking for
/// that, m/s²: what reaches the waiting place, at least the code's. An ego that cannot reach it, or
/// is beyond, stops as soon as it may.
fn before_obstacle(
    plan: &IdmPlan,
    path: &Polyline,
    scene: &SceneView<'_>,
    place: Point,
) -> (f64, f64) {
    let stop_s = path.project(place).s;
    let front = path.project(scene.ego.rear_axle.position()).s + PACIFICA.front_length;
    let at_once = front + MIN_GAP;
    let half_square = scene.ego.velocity.x.max(0.0).powi(2) / 2.0;
    let needed = half_square / (stop_s - at_once).max(f64::MIN_POSITIVE);
    let decel = plan.code.decel_max.max(needed.min(STOP_DECEL));
    (stop_s.max(at_once + half_square / decel), decel)
}

/// Arc length on the path of the first red light ahead: the start of its connector.
fn red_light(plan: &IdmPlan, path: &Polyline, scene: &SceneView<'_>) -> Option<f64> {
    let here = plan
        .lanes
        .centerline
        .project(scene.ego.rear_axle.position())
        .s
        + PACIFICA.front_length;
    let lanes = plan.lanes.lanes.iter().zip(&plan.lanes.starts);
    let red = lanes.filter(|&(&lane, &start)| {
        start >= here - MIN_GAP && scene.lights.status(lane) == Some(SignalStatus::Red)
    });
    let start = red.map(|(_, &start)| start).next()?;
    Some(path.project(plan.lanes.centerline.point_at(start)).s)
}
