//! PDM-Closed, the rule-based planner whose scorer is Reflection's
//! (`autonomousvision/tuplan_garage` at `b51d5d0`, `pdm_planner/`). [`plan`] does a step of it.
//! First comes a constant-velocity [`Forecast`] of all objects. Then come [`Proposals`], fifteen
//! IDM roll-outs along the centerline of the [`ReferencePath`] and beside it, and their simulation
//! by a tracker. [`score_proposals`] and the emergency brake are last.
//!
//! The score is a second aggregation of the primitives of nuPlan's metrics. It differs from them in
//! these points. Other agents come from a forecast. A corner outside the drivable polygons counts
//! without tolerance. Movement against the direction is summed over whole segments off the route.
//! Progress is relative to the best proposal. Times to collision are tested at 0, 0.3, 0.6 and 0.9
//! s. Comfort uses the rear-axle acceleration and wider filters. There is no speed-limit and no
//! making-progress term.

mod areas;
mod centerline;
mod closed;
mod collision;
mod comfort;
mod contest;
mod current_lane;
mod emergency_brake;
mod encounters;
mod forecast;
mod lead;
mod parameters;
mod path;
mod placed;
mod proposals;
mod reference_path;
mod route;
mod scorer;
mod search;

pub use areas::{DrivableLayers, DrivableMap, EgoAreas};
pub use centerline::{centerline_poses, lane_chain};
pub use closed::{
    Overtake, PdmError, PdmInstant, PdmMemory, PdmPlan, plan, plan_along, plan_among, plan_tuned,
    simulate_proposals,
};
pub use collision::{FirstTouch, no_at_fault_collisions, time_to_collision};
pub(crate) use comfort::is_comfortable;
pub use contest::Contest;
pub use current_lane::{StartingBlock, current_lane, starting_block};
pub use emergency_brake::{
    EMERGENCY_TIME_S, braking_speed, emergency_brake, needs_emergency_brake,
};
pub use forecast::{Collided, Forecast, ForecastObject, MAX_DISTANCE};
pub use lead::LeadState;
pub use parameters::{PdmParameters, TRAJECTORY_STEPS};
pub use path::PdmPath;
pub use proposals::{
    FALLBACK_LIMIT, IdmState, LATERAL_OFFSETS, PROPOSAL_STEPS, Proposal, Proposals, SPEED_FRACTIONS,
};
pub use reference_path::{NoReferencePath, ReferencePath};
pub use route::corrected_route;
pub use scorer::{
    OvertakeVerdict, ProposalScore, ScoringScene, WEIGHT_COMFORT, WEIGHT_PROGRESS, WEIGHT_TTC,
    score_proposals,
};
pub use search::{SearchDirection, roadblock_chain};

use placed::Placed;
use scorer::score_overtake;
