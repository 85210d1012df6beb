//! DTPP's network (Huang et al. 2024; `MCZhi/DTPP` `scenario_tree_prediction.py`, `prediction_modules.py`).

mod network;
mod scorer;

pub use network::{Dtpp, DtppConfig, DtppOutputs};
