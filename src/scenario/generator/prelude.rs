//! What the files of scenario types use.

pub(super) use super::expert::EXPERT;
pub use super::rng::SeededRng;
pub(super) use super::road::{Control, Course, Layout, Turn, YELLOW};
pub use super::scenario_type::{ScenarioType, TypeDefinition, TypeGroup};
pub use super::scene::builder::{TrafficBuilder, VehicleKind};
pub(super) use super::scene::obstacles::{close_ahead, double_park};
pub use super::scene::setting::{self, BEHIND, LIMITS, Setting};
pub(super) use super::scene::setting::{LEAD_IN, LanePick, LightTiming};
pub(super) use super::scene::{crossing, stream};
pub(super) use super::traffic::{Act, Departure};
pub use planagent_world::geometry::GeometryError;
