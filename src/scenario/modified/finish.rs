//! From the changes to the frames of the modified scenario.

use super::draft::{Draft, GoalPath, MovingVehicle};
use super::error::ModifyError;
use super::file::Modification;
use crate::{Frame, Scenario};
use planagent_world::dynamics::{CrossingActors, InteractiveTraffic};
use planagent_world::geometry::{OrientedBox, Pose, Vector};
use planagent_world::{
    EgoState, Goal, Interaction, InteractionKind, MICROS_PER_SECOND, ObjectKind, PACIFICA, Route,
    STEP_S, TrackToken, TrackedObject,
};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Room that a vehicle keeps to the ego and to others at the start, meters.
const ROOM: f64 = 1.0;
/// What has to be passed lies within this share of the way of the recorded driver.
const WITHIN: f64 = 0.9;

/// The modified scenario.
pub(super) fn finish(draft: Draft, modification: &Modification) -> Result<Scenario, ModifyError> {
    let unfit = |draft: &Draft, fault: String| ModifyError::Unfit {
        place: modification.place.clone(),
        scenario: draft.scenario.id.clone(),
        fault,
    };
    let mut draft = draft;
    if let Some(one) = draft
        .standing
        .iter()
        .find(|object| object.shape.overlaps(&draft.ego().footprint()))
    {
        let fault = format!(
            "a {} stands in the ego at the start; put it farther ahead",
            one.kind
        );
        return Err(unfit(&draft, fault));
    }
    let obstacles = obstacles(&draft, modification.kind);
    if modification.kind.is_some() && draft.goal.is_none() {
        let line = &draft.lanes.path.centerline;
        let farthest = obstacles
            .iter()
            .map(|&point| line.project(point).s - draft.lanes.start_s)
            .fold(0.0, f64::max);
        let driven = draft.driven_m();
        if farthest > WITHIN * driven {
            let fault = format!(
                "what has to be passed is {farthest:.1} m ahead, and the recorded driver gets {driven:.1} m far"
            );
            return Err(unfit(&draft, fault));
        }
    }
    // The ego comes first: what is on its path, and who has room, depends on its start.
    set_speed(&mut draft);
    set_goal_drive(&mut draft);
    remove_on_path(&mut draft);
    let moving = with_room(&draft);
    let behaviors = moving
        .iter()
        .filter_map(|one| Some((one.object.token, one.behavior?)))
        .collect();
    let interaction = Arc::new(Interaction {
        kind: modification.kind,
        standing: draft.standing.iter().map(|object| object.token).collect(),
        crossing: std::mem::take(&mut draft.crossing),
        behavior: draft.behavior,
        behaviors,
        halting: BTreeSet::new(),
        lane_changes: draft.lane_changes,
        seed: draft.draws.seed(),
        goal: draft.goal.as_ref().map(|goal| Goal {
            along: Arc::new(goal.path.centerline.clone()),
            at_s: goal.from_s + goal.length,
        }),
        obstacles,
    });
    let frames = frames(&draft, &moving, &interaction);
    let Draft {
        mut scenario, goal, ..
    } = draft;
    scenario.frames = frames;
    if let Some(goal) = goal {
        scenario.route = route(&scenario, &goal);
    }
    if let Some(kind) = modification.kind {
        kind.name().clone_into(&mut scenario.scenario_type);
    }
    scenario.interaction = Some(interaction);
    Ok(scenario)
}

/// What the ego has to pass, as its kind counts it: standing vehicles, cones, or the end points of
/// the walkers.
fn obstacles(
    draft: &Draft,
    kind: Option<InteractionKind>,
) -> Vec<planagent_world::geometry::Point> {
    use InteractionKind as Kind;
    let of = |wanted: ObjectKind| {
        let objects = draft
            .standing
            .iter()
            .filter(move |object| object.kind == wanted);
        objects
            .map(|object| object.shape.center.position())
            .collect()
    };
    match kind {
        Some(
            Kind::OvertakeParkedVehicle | Kind::NudgeAroundParkedVehicle | Kind::AvoidCrashedCars,
        ) => of(ObjectKind::Vehicle),
        Some(Kind::ApproachingConstructionZone) => of(ObjectKind::TrafficCone),
        Some(Kind::JaywalkingPedestrian) => draft.crossing.iter().map(|walker| walker.to).collect(),
        _ => Vec::new(),
    }
}

/// The speed of the ego's place in the traffic, with a past that fits.
fn set_speed(draft: &mut Draft) {
    let Some(speed) = draft.ego_speed else { return };
    let start = draft.scenario.start;
    let present = draft.scenario.frames[start].ego;
    let velocity = Vector::new(speed, 0.0);
    for frame in &mut draft.scenario.frames[..=start] {
        let before_s = (present.time_us - frame.ego.time_us) as f64 / MICROS_PER_SECOND;
        let rear_axle = present.rear_axle.translated(-speed * before_s, 0.0);
        frame.ego = EgoState::from_log(frame.ego.time_us, rear_axle, velocity, Vector::zeros());
    }
}

/// The expert's drive to a goal. The log's driver did not go there, so a steady drive takes its
/// place.
fn set_goal_drive(draft: &mut Draft) {
    let Some(goal) = &draft.goal else { return };
    let start = draft.scenario.start;
    let steps = draft.scenario.iterations() - 1;
    let speed = goal.length / (steps as f64 * STEP_S);
    let state = |time_us: i64, step: usize| {
        let s = goal.from_s + goal.length * step as f64 / steps as f64;
        let center = goal.path.centerline.pose_at(s);
        EgoState::from_log(
            time_us,
            PACIFICA.rear_axle_of(center),
            Vector::new(speed, 0.0),
            Vector::zeros(),
        )
    };
    for (step, frame) in draft.scenario.frames[start..]
        .iter_mut()
        .enumerate()
        .skip(1)
    {
        frame.ego = state(frame.ego.time_us, step);
    }
    for (step, ego) in draft.scenario.future.iter_mut().enumerate() {
        *ego = state(ego.time_us, steps + 1 + step);
    }
}

/// Leaves out logged vehicles that drive through what stands.
fn remove_on_path(draft: &mut Draft) {
    let meets = |object: &&TrackedObject| {
        draft
            .standing
            .iter()
            .any(|one| one.shape.overlaps(&object.shape))
    };
    let objects = draft
        .scenario
        .frames
        .iter()
        .flat_map(|frame| frame.objects.iter());
    let tokens: BTreeSet<TrackToken> = objects.filter(meets).map(|object| object.token).collect();
    draft.removed.extend(tokens);
}

/// The driving vehicles that have room at the start, in their order.
fn with_room(draft: &Draft) -> Vec<MovingVehicle> {
    let grown = |shape: &OrientedBox| {
        OrientedBox::new(shape.center, shape.length + ROOM, shape.width + 0.1)
    };
    let first = &draft.scenario.frames[draft.scenario.start];
    let logged = first
        .objects
        .iter()
        .filter(|object| !draft.removed.contains(&object.token));
    let mut taken: Vec<OrientedBox> = logged
        .chain(&draft.standing)
        .map(|object| object.shape)
        .collect();
    taken.push(first.ego.footprint());
    let mut kept = Vec::new();
    for one in &draft.moving {
        if !taken
            .iter()
            .any(|shape| grown(&one.object.shape).overlaps(shape))
        {
            taken.push(one.object.shape);
            kept.push(*one);
        }
    }
    kept
}

/// The frames: logged objects that stay, what stands, and the moving vehicles and people beside an
/// ego that replays the log.
fn frames(draft: &Draft, moving: &[MovingVehicle], interaction: &Interaction) -> Vec<Frame> {
    let (start, base) = (draft.scenario.start, &draft.scenario.frames);
    let fixed = |frame: &Frame| -> Vec<TrackedObject> {
        let logged = frame
            .objects
            .iter()
            .filter(|object| !draft.removed.contains(&object.token));
        logged.chain(&draft.standing).copied().collect()
    };
    let mut frames: Vec<Frame> = Vec::with_capacity(base.len());
    // Vehicles that move at the start moved before it: the history must not contradict their speed.
    for frame in &base[..start] {
        let before_s = (base[start].ego.time_us - frame.ego.time_us) as f64 / MICROS_PER_SECOND;
        let earlier = |one: &MovingVehicle| {
            let center: Pose = one
                .object
                .shape
                .center
                .translated(-one.object.speed() * before_s, 0.0);
            TrackedObject {
                shape: one.object.shape.moved_to(center),
                ..one.object
            }
        };
        let objects = fixed(frame)
            .into_iter()
            .chain(moving.iter().map(earlier))
            .collect();
        frames.push(Frame {
            objects,
            ..frame.clone()
        });
    }
    let first: Vec<TrackedObject> = fixed(&base[start])
        .into_iter()
        .chain(moving.iter().map(|one| one.object))
        .collect();
    let ego = &base[start].ego;
    let mut traffic = InteractiveTraffic::new(&draft.scenario.map, &first, ego, interaction);
    let mut crossing = CrossingActors::new(&interaction.crossing, ego);
    let own: BTreeSet<TrackToken> = moving.iter().map(|one| one.object.token).collect();
    frames.push(Frame {
        objects: first.into_iter().chain(crossing.objects()).collect(),
        ..base[start].clone()
    });
    for pair in base[start..].windows(2) {
        let [before, frame] = pair else { continue };
        let dt_s = (frame.ego.time_us - before.ego.time_us) as f64 / MICROS_PER_SECOND;
        let logged = fixed(frame);
        traffic.step(&before.ego, &logged, &frame.lights, dt_s);
        crossing.step(&before.ego, dt_s);
        let driving: BTreeMap<TrackToken, TrackedObject> = traffic
            .objects()
            .iter()
            .filter(|o| own.contains(&o.token))
            .map(|o| (o.token, *o))
            .collect();
        let objects = logged
            .into_iter()
            .chain(driving.into_values())
            .chain(crossing.objects())
            .collect();
        frames.push(Frame {
            objects,
            ..frame.clone()
        });
    }
    frames
}

/// The route to a goal: the recorded one where that holds all roadblocks of the way, else those of
/// the way.
fn route(scenario: &Scenario, goal: &GoalPath) -> Route {
    let recorded = &scenario.route;
    let is_on = goal
        .roadblocks
        .iter()
        .all(|block| recorded.contains(*block));
    let roadblocks = if is_on {
        recorded.roadblocks.clone()
    } else {
        goal.roadblocks.clone()
    };
    let at_s = goal.from_s + goal.length;
    let center = goal.path.centerline.pose_at(at_s);
    Route {
        roadblocks,
        goal: Some(PACIFICA.rear_axle_of(center)),
        goal_lane: Some(goal.path.lane_at(at_s)),
    }
}
