//! interPlan's own scenes (github.com/mh0797/interPlan, Apache-2.0): their names, their random
//! numbers, and their traffic, bit for bit.
//!
//! A word `LOG.db#TOKEN~dhgloa` names the scene that interPlan calls `TOKEN-dhgloa`. Its special
//! scenes (`s0` and so on) need the coordinates of its `interPlan_modifications.yaml`, which is not
//! part of this package.

mod density;
mod name;
mod python_random;
#[cfg(test)]
mod tests;

pub(crate) use density::Row;
pub(crate) use density::{Density, fill_row};
pub(crate) use name::{Command, InterPlanName};
pub(crate) use python_random::PythonRandom;
