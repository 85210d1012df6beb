//! What the generator needs of a scenario type.

use super::log::GeneratedLog;
use super::rng::SeededRng;
use super::scene::builder::TrafficBuilder;
use super::scene::setting::Setting;
use planagent_world::geometry::GeometryError;
use std::cmp::Ordering;
use std::fmt;
use std::hash::{Hash, Hasher};

/// A scenario type, as data and functions.
#[derive(Debug)]
pub struct TypeDefinition {
    /// Name as nuPlan writes it; the second part of the scenarios' ids.
    pub name: &'static str,
    /// Selects the random numbers of the type. It must never change, since every scenario of the
    /// type would change with it. The number of the draw is added, so two types differ by at least
    /// [`super::MAX_DRAWS`].
    pub seed: u64,
    /// Suites that hold the type.
    pub group: TypeGroup,
    /// Draws the roads and the start of the ego. The draws are those of the situation.
    pub setting: fn(&mut SeededRng) -> Result<Setting, GeometryError>,
    /// Puts agents and objects on the roads.
    pub populate: fn(&mut TrafficBuilder<'_, '_>),
    /// True if the recorded scenario shows what its type says.
    pub shows: fn(&GeneratedLog) -> bool,
}

/// Suites that hold a type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TypeGroup {
    /// `generated-test14` and its variants: the types of nuPlan's benchmarks (Val14, Test14).
    Nuplan14,
    /// `generated` alone.
    Additional,
    /// None: a qualitative case of the paper, simulated by its name.
    Case,
}

/// A scenario type of the generator, ordered by its seed constant.
#[derive(Clone, Copy)]
pub struct ScenarioType(&'static TypeDefinition);

impl ScenarioType {
    /// The handle of a definition.
    pub const fn new(definition: &'static TypeDefinition) -> Self {
        Self(definition)
    }

    /// Name as nuPlan writes it.
    pub fn name(self) -> &'static str {
        self.0.name
    }

    pub(crate) fn group(self) -> TypeGroup {
        self.0.group
    }

    pub(crate) fn definition(self) -> &'static TypeDefinition {
        self.0
    }

    fn key(self) -> (u64, &'static str) {
        (self.0.seed, self.0.name)
    }
}

impl PartialEq for ScenarioType {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl Eq for ScenarioType {}

impl PartialOrd for ScenarioType {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for ScenarioType {
    fn cmp(&self, other: &Self) -> Ordering {
        self.key().cmp(&other.key())
    }
}

impl Hash for ScenarioType {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.key().hash(state);
    }
}

impl fmt::Debug for ScenarioType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Display for ScenarioType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
