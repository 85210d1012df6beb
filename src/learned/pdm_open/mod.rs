//! PDM-Open and PDM-Hybrid (Dauner et al. 2023, "Parting with Misconceptions about Learning-based
//! Vehicle Motion Planning"); the network of the latter is PDM-Offset.

mod features;
mod hybrid;
mod network;
mod planner;
mod route;

pub use features::PdmFeatures;
pub(crate) use hybrid::entry as hybrid_entry;
pub use hybrid::{fused, sampled};
pub use network::{HIDDEN, PdmInputs, PdmNetwork};
pub(crate) use planner::entry;
