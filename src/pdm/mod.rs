//! PDM-Closed, the rule-based planner whose scorer Reflection uses. So far its scorer: how good are simulated proposals against a constant-velocity forecast of everyone else
//! (`autonomousvision/tuplan_garage` at `b51d5d0`, `pdm_planner/{scoring,observation}`).
//!
//! It is a second aggregation of the primitives of nuPlan's metrics. It differs from them in these points: other agents
//! come from a [`Forecast`]; a corner outside the drivable polygons counts without tolerance; movement against the
//! direction is summed over whole stretches off the route; progress is relative to the best proposal; times to
//! collision are tested at 0, 0.3, 0.6 and 0.9 s; comfort uses the rear-axle acceleration and wider filters; there is
//! no speed-limit and no making-progress term.

mod areas;
mod collision;
mod comfort;
mod forecast;
mod scorer;

pub use areas::{DrivableLayers, DrivableMap, EgoAreas, MAP_RADIUS};
pub use collision::{FirstTouch, no_at_fault_collisions, time_to_collision};
pub use comfort::is_comfortable;
pub use forecast::{Collided, Forecast, ForecastObject, MAX_DISTANCE, RESOLUTION_STEPS};
pub use scorer::{ProposalScore, ScoringScene, WEIGHT_COMFORT, WEIGHT_PROGRESS, WEIGHT_TTC, score_proposals};
