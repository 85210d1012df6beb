//! Samples of PlanTF. Agents and polygons of all samples are concatenated; `agents` and `polygons`
//! count those of each.

use super::futures::pose_in;
use super::tensors::Columns;
use super::{HORIZON, Moment};
use planagent_learned::plantf::{AgentHistory, PlanTfFeatures, PolygonFeatures};
use planagent_score::pdm::corrected_route;
use planagent_world::geometry::Pose;
use planagent_world::{ObjectKind, TrackToken};

/// Features and targets: the ego's poses (80, 3) minus the present one in its frame, and those of
/// all agents with their masks. The category of an agent is that of its kind, as upstream in
/// training.
pub(super) fn sample(moment: &Moment<'_>) -> Option<Columns> {
    let scene = &moment.scene;
    let frame = scene.ego.rear_axle;
    let route = corrected_route(scene.map, &scene.route.roadblocks, frame);
    let PlanTfFeatures {
        current_state,
        agents,
        tokens,
        map,
    } = PlanTfFeatures::from_scene(scene, &route);
    let step = |pose: Pose, from: Pose| {
        let (place, start) = (
            frame.to_local(pose.position()),
            frame.to_local(from.position()),
        );
        [
            (place.x - start.x) as f32,
            (place.y - start.y) as f32,
            (pose.heading - from.heading) as f32,
        ]
    };
    let ego: Vec<f32> = moment
        .future
        .iter()
        .flat_map(|ego| step(ego.rear_axle, frame))
        .collect();
    let present = |token: TrackToken| scene.objects.iter().find(|object| object.token == token);
    // Targets of agents begin at their own present poses.
    let (mut targets, mut seen) = (ego.clone(), vec![1u8; moment.future.len()]);
    let mut categories = vec![0u8];
    for object in tokens.iter().filter_map(|&token| present(token)) {
        categories.push(category(object.kind));
        for future in 0..HORIZON {
            let pose = moment
                .frames
                .get(future)
                .and_then(|frame| pose_in(frame, object.token));
            targets.extend(pose.map_or([0.0; 3], |pose| step(pose, object.shape.center)));
            seen.push(u8::from(pose.is_some()));
        }
    }
    let of_agents = |read: fn(&AgentHistory) -> &[f32]| {
        agents.iter().flat_map(read).copied().collect::<Vec<f32>>()
    };
    let steps = agents.first()?.valid.len();
    let polygons = &map.polygons;
    let points = planagent_learned::plantf::VECTORS;
    let of_lines = |read: fn(&PolygonFeatures) -> &[f32]| {
        polygons
            .iter()
            .flat_map(read)
            .copied()
            .collect::<Vec<f32>>()
    };
    let flags = |read: fn(&PolygonFeatures) -> u8| polygons.iter().map(read).collect::<Vec<u8>>();
    Some(
        Columns::default()
            .with("target", &[HORIZON, 3], ego)
            .with(
                "current_state",
                &[current_state.len()],
                current_state.to_vec(),
            )
            .with_small("agents", &[], vec![u8::try_from(agents.len()).ok()?])
            .with("polygons", &[], vec![polygons.len() as f32])
            .with(
                "agent.position",
                &[steps, 2],
                of_agents(|agent| agent.position.as_flattened()),
            )
            .with("agent.heading", &[steps], of_agents(|agent| &agent.heading))
            .with(
                "agent.velocity",
                &[steps, 2],
                of_agents(|agent| agent.velocity.as_flattened()),
            )
            .with(
                "agent.shape",
                &[steps, 2],
                of_agents(|agent| agent.shape.as_flattened()),
            )
            .with_small(
                "agent.valid",
                &[steps],
                agents
                    .iter()
                    .flat_map(|agent| agent.valid)
                    .map(u8::from)
                    .collect(),
            )
            .with_small("agent.category", &[], categories)
            .with("agent.target", &[HORIZON, 3], targets)
            .with_small("agent.target_valid", &[HORIZON], seen)
            .with(
                "map.point",
                &[points, 2],
                of_lines(|polygon| polygon.lines[0].point.as_flattened()),
            )
            .with(
                "map.vector",
                &[points, 2],
                of_lines(|polygon| polygon.lines[0].vector.as_flattened()),
            )
            .with(
                "map.orientation",
                &[points],
                of_lines(|polygon| &polygon.lines[0].orientation),
            )
            .with(
                "map.speed_limit",
                &[],
                polygons
                    .iter()
                    .map(|one| one.speed_limit.unwrap_or_default())
                    .collect(),
            )
            .with_small(
                "map.has_speed_limit",
                &[],
                flags(|polygon| u8::from(polygon.speed_limit.is_some())),
            )
            .with_small("map.kind", &[], flags(|polygon| polygon.kind as u8))
            .with_small(
                "map.on_route",
                &[],
                flags(|polygon| u8::from(polygon.on_route)),
            )
            .with_small("map.light", &[], flags(|polygon| polygon.light as u8))
            .with_small(
                "map.valid",
                &[points],
                polygons
                    .iter()
                    .flat_map(|one| one.valid)
                    .map(u8::from)
                    .collect(),
            ),
    )
}

/// Vehicle, pedestrian, bicycle; the ego is 0.
fn category(kind: ObjectKind) -> u8 {
    match kind {
        ObjectKind::Pedestrian => 2,
        ObjectKind::Bicycle => 3,
        _ => 1,
    }
}
