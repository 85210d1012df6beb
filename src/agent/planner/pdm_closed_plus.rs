//! PDM-Closed with every means of the agent and no model: a control.

use super::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use crate::environment::lane_graph::Centerline;
use crate::environment::{DEFAULT_NODE_LENGTH, GraphedScene, LaneGraph};
use crate::reflection::{OvertakeRules, allowed_overtake};
use planagent_score::pdm::{
    DrivableLayers, Overtake, PdmError, PdmMemory, ReferencePath, plan_among,
};
use planagent_world::geometry::{OrientedBox, Polyline, Pose, Vector};
use planagent_world::{
    ObjectKind, PACIFICA, RoadblockId, SceneView, TrackToken, TrackedObject, Trajectory,
};

/// PDM-Closed with more proposals. Besides those along its own reference path, it has proposals
/// with lateral offsets along every centerline that a planner code could name. All are scored
/// together at every step, so that a better one takes over, as under monitoring.
#[derive(Debug, Clone, Default)]
pub struct PdmClosedPlus {
    memory: PdmMemory,
}

impl PdmClosedPlus {
    /// A planner that has not been initialized yet.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Planner for PdmClosedPlus {
    fn name(&self) -> &'static str {
        "pdm-closed-plus"
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        *self = Self::default();
        if initialization.route.lanes(initialization.map).is_empty() {
            Err(PlannerError::EmptyRoute)
        } else {
            Ok(())
        }
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let scene = &input.scene;
        let PdmMemory {
            collided,
            reference_path,
        } = &mut self.memory;
        let own = match reference_path {
            Some(own) => &*own,
            none => none.insert(
                ReferencePath::find(scene.map, scene.route, scene.ego).map_err(PdmError::from)?,
            ),
        };
        // Off the road there are no further lanes, and this is plain PDM-Closed.
        let Ok(graph) = LaneGraph::build(scene, DEFAULT_NODE_LENGTH) else {
            return Ok(plan_among(own, &[], None, scene, collided)?.trajectory);
        };
        let graph = graph.with_oncoming_lane(scene);
        let seen = GraphedScene::new(scene, &graph);
        let oncoming = allowed_overtake(seen);
        let others = paths_along(
            scene,
            own,
            graph
                .centerlines
                .iter()
                .chain(oncoming.map(|lane| &lane.centerline)),
        );
        let plan = if let Some(oncoming) = oncoming {
            let rules = OvertakeRules::new(oncoming, scene);
            let verdict = |poses: &[Pose]| rules.verdict(poses);
            let overtake = Overtake {
                lanes: &oncoming.lanes,
                steps: OvertakeRules::STEPS,
                verdict: &verdict,
            };
            plan_among(own, &others, Some(&overtake), scene, collided)?
        } else {
            let stop = stop_before(seen);
            let objects: Vec<TrackedObject> = scene.objects.iter().copied().chain(stop).collect();
            plan_among(
                own,
                &others,
                None,
                &SceneView {
                    objects: &objects,
                    ..*scene
                },
                collided,
            )?
        };
        Ok(plan.trajectory)
    }

    fn drivable_layers(&self) -> Option<DrivableLayers> {
        self.memory
            .reference_path
            .as_ref()
            .map(ReferencePath::layers)
    }
}

/// Reference paths along centerlines, on the route of `own`.
fn paths_along<'g>(
    scene: &SceneView<'_>,
    own: &ReferencePath,
    centerlines: impl Iterator<Item = &'g Centerline>,
) -> Vec<ReferencePath> {
    let mut blocks: Vec<RoadblockId> = own
        .lanes()
        .iter()
        .map(|&lane| scene.map[lane].roadblock)
        .collect();
    blocks.dedup();
    let along = |poses: Vec<Pose>| ReferencePath::along(scene.map, &blocks, &poses, scene.ego).ok();
    let ahead = |line: &Polyline| {
        // The path of the rear axle: from a little behind it to the end.
        let from = line.project(scene.ego.rear_axle.position()).s - PACIFICA.length();
        line.slice(from, line.length())
            .map(|line| line.vertex_poses())
    };
    centerlines
        .filter_map(|one| along(ahead(&one.path.centerline)?))
        .collect()
}

/// Length and width of [`stop_before`], meters.
const STOP_SIZE: (f64, f64) = (0.2, 1.0);

/// What stands for the end of the way in a blocked lane: a barrier that makes the proposals stop
/// where the ego can still leave the lane. None where the ego is beyond that place already.
fn stop_before(seen: GraphedScene<'_>) -> Option<TrackedObject> {
    let GraphedScene { scene, graph } = seen;
    let lane = &graph.ego_lane().path.centerline;
    let foot = lane.project(graph.stop_point()?);
    let is_ahead = foot.s > lane.project(PACIFICA.front_of(scene.ego.rear_axle)).s;
    let shape = OrientedBox::new(Pose::at(foot.point, foot.heading), STOP_SIZE.0, STOP_SIZE.1);
    let token = TrackToken(u32::MAX);
    is_ahead.then_some(TrackedObject {
        token,
        kind: ObjectKind::Barrier,
        shape,
        velocity: Vector::zeros(),
    })
}
