//! Candidate paths along the route, from which GameFormer's and DTPP's planners choose
//! (`state_lattice_path_planner.py`, `trajectory_tree_planner.py`). They lead from the ego onto a
//! lane at several distances, then along it.

mod bent;
mod course;
mod route;

pub use bent::{bent, curvature};
pub use course::{Course, course};
pub(crate) use course::{MAX_ROWS, ROW, every_tenth, relative_course};
pub(crate) use route::long_enough;
pub(crate) use route::starting_lanes;
pub use route::{Candidate, candidates, starting_block};
