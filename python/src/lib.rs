//! The native half of the Python package `planagent`: types and functions of `planagent._core`.
//!
//! `python/planagent` holds the public API with its documentation. What crosses the border is
//! bytes, numbers and texts, so that numpy is needed on the Python side alone. All work runs
//! without the GIL (`work`); a panic becomes an exception (`errors`).

#![allow(
    clippy::needless_pass_by_value,
    reason = "PyO3 hands owned values over"
)]

mod command;
mod episode;
mod errors;
mod interrupts;
mod model;
mod nuplan;
mod observation;
mod planner;
mod python_planner;
mod relay;
mod reward;
mod run;
mod run_results;
mod scenario;
mod settings;
mod simulation;
mod table;
mod tables;
mod trajectory;
mod vector;
mod work;

use mimalloc::MiMalloc;
use pyo3::prelude::*;

/// As in the program (`src/main.rs`), for what this library allocates: Python keeps its own. Memory
/// that was free for a second goes back to the system.
#[global_allocator]
static ALLOCATOR: MiMalloc = MiMalloc;

/// The native half of `planagent`.
#[pymodule]
mod _core {
    #[pymodule_export]
    use crate::command::command;
    #[pymodule_export]
    use crate::model::Model;
    #[pymodule_export]
    use crate::nuplan::NuPlanWorld;
    #[pymodule_export]
    use crate::observation::{Observation, score_trajectories};
    #[pymodule_export]
    use crate::planner::{Planner, planners};
    #[pymodule_export]
    use crate::reward::rewards;
    #[pymodule_export]
    use crate::run::{Run, shard_of_environment};
    #[pymodule_export]
    use crate::run_results::{RunResults, merge, read_run, statistics, write_report};
    #[pymodule_export]
    use crate::scenario::{Scenario, find, open, scenario_types};
    #[pymodule_export]
    use crate::simulation::Simulation;
    #[pymodule_export]
    use crate::table::Table;
    #[pymodule_export]
    use crate::tables::scenario_of_tables;
    #[pymodule_export]
    use crate::trajectory::Trajectory;
    #[pymodule_export]
    use crate::vector::Vector;
    #[pymodule_export]
    use crate::work::{after_fork, before_fork, set_threads, threads};

    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        planagent_runs::worker::panic_guard::install_hook();
        if let Some(commit) = option_env!("PLANAGENT_COMMIT") {
            planagent_runs::runner::set_build_commit(commit);
        }
        crate::command::remember_interpreter(module.py())?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
