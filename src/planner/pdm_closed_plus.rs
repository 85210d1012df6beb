//! PDM-Closed with every means of the agent and no model: a control.

use super::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use crate::environment::{DEFAULT_NODE_LENGTH, LaneGraph};
use crate::geometry::Pose;
use crate::pdm::{DrivableLayers, PdmError, PdmMemory, ReferencePath, plan_among};
use crate::reflection::allowed_pass;
use crate::world::{LaneId, PACIFICA, RoadblockId, SceneView, Trajectory};

/// PDM-Closed with more proposals. Besides those along its own reference path, it has proposals with lateral offsets along
/// every centerline that a planner code could name. All are scored together at every step, so that a better one takes over,
/// as under monitoring.
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

    fn initialize(&mut self, initialization: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        *self = Self::default();
        if initialization.route.lanes(initialization.map).is_empty() { Err(PlannerError::EmptyRoute) } else { Ok(()) }
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let scene = &input.scene;
        let PdmMemory { collided, reference_path } = &mut self.memory;
        let own = match reference_path {
            Some(own) => &*own,
            none => none.insert(ReferencePath::find(scene.map, scene.route, scene.ego).map_err(PdmError::from)?),
        };
        let (others, passed) = centerlines(scene, own);
        let plan = plan_among(own, &others, &passed, scene, collided)?;
        Ok(plan.trajectory)
    }

    fn drivable_layers(&self) -> Option<DrivableLayers> {
        self.memory.reference_path.as_ref().map(ReferencePath::layers)
    }
}

/// Reference paths along the centerlines of the lane graph, on the route of `own`; none without a lane graph. Then the lanes
/// against traffic on which the ego may now pass what blocks its lane.
fn centerlines(scene: &SceneView<'_>, own: &ReferencePath) -> (Vec<ReferencePath>, Vec<LaneId>) {
    let Ok(graph) = LaneGraph::build(scene, DEFAULT_NODE_LENGTH) else { return (Vec::new(), Vec::new()) };
    let graph = graph.with_oncoming_lane(scene);
    let mut blocks: Vec<RoadblockId> = own.lanes().iter().map(|&lane| scene.map[lane].roadblock).collect();
    blocks.dedup();
    let along = |poses: Vec<Pose>| ReferencePath::along(scene.map, &blocks, &poses, scene.ego).ok();
    let ahead = |line: &crate::geometry::Polyline| {
        // The path of the rear axle: from a little behind it to the end.
        let from = line.project(scene.ego.rear_axle.position()).s - PACIFICA.length();
        line.slice(from, line.length()).map(|line| line.vertex_poses())
    };
    let pass = allowed_pass(scene, &graph);
    let lines = graph.centerlines.iter().chain(pass.map(|pass| &pass.centerline));
    let paths = lines.filter_map(|one| along(ahead(&one.path.centerline)?)).collect();
    (paths, pass.map(|pass| pass.lanes.clone()).unwrap_or_default())
}
