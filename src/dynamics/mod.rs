//! How things move: the intelligent driver model, the kinematic bicycle, the LQR tracker and reactive IDM traffic.

mod idm;

pub use idm::{IdmParameters, Lead};
