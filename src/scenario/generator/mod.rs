//! Seeded generator of drives: no download, any number, the same bytes for the same name.
//!
//! A drive is drawn in three steps: a recipe of its [`ScenarioType`] lays roads and puts people on them; the traffic is run
//! with a privileged rule-based expert at the wheel (documented in its module); the recording is judged and, where the expert touched something,
//! left the road or the drive is not of its type, drawn again from the next sub-seed.
//!
//! Another traffic seed puts the drive of a seed among other traffic: roads, route and what the drive is about stay, what
//! is luck is drawn anew (`dice.rs`).

mod expert;
mod log;
mod reader;
mod recipe;
mod rng;
mod road;
mod scenario_type;
#[cfg(test)]
mod tests;
mod traffic;

pub use log::Discard;
pub use reader::GeneratedReader;
pub use scenario_type::ScenarioType;

use super::Scenario;
use crate::world::Route;
use expert::Expert;
use log::{GeneratedLog, PAST};
use recipe::Stage;
use rng::SeededRng;
use road::Roads;
use std::fmt;
use std::str::FromStr;

/// First part of the id of every generated drive.
pub const SOURCE: &str = "generated";
/// How often a drive is drawn anew at most.
pub const MAX_DRAWS: usize = 60;

/// The name of a generated drive; it determines the drive wholly. Written `generated/<scenario type>/<seed>` or
/// `generated/<scenario type>/<seed>.<traffic>`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Spec {
    /// What kind of drive.
    pub scenario_type: ScenarioType,
    /// Which one.
    pub seed: u64,
    /// Among which traffic; 0 is not written.
    pub traffic: u64,
}

/// A drive worth seeing first: a slow leader, and a free lane beside it.
pub const DEFAULT: Spec = Spec::new(ScenarioType::ChangingLane, 2);

/// Why there is no such drive.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GeneratorError {
    /// The name has another form.
    #[error(
        "`{0}` does not name a generated scenario: expected generated/<scenario type>/<seed> or \
        generated/<scenario type>/<seed>.<traffic seed>"
    )]
    Form(String),
    /// No such type.
    #[error("`{0}` is not a scenario type that the generator makes")]
    UnknownType(String),
    /// The seed, or the traffic seed, is not a whole number.
    #[error("the {which} `{seed}` of `{id}` is not a whole number from 0 to 2^64 - 1")]
    Seed {
        /// Which of the two.
        which: &'static str,
        /// It as written.
        seed: String,
        /// The whole name.
        id: String,
    },
    /// Every draw was thrown away.
    #[error("no drive for {id} after {draws} draws; the last one was thrown away because {last}")]
    Exhausted {
        /// The name.
        id: String,
        /// How many draws.
        draws: usize,
        /// Why the last one was thrown away.
        last: Discard,
    },
}

impl Spec {
    /// The drive of a seed among its own traffic.
    pub const fn new(scenario_type: ScenarioType, seed: u64) -> Self {
        Self { scenario_type, seed, traffic: 0 }
    }

    /// The same among other traffic.
    #[must_use]
    pub const fn with_traffic_seed(self, traffic: u64) -> Self {
        Self { traffic, ..self }
    }

    /// Name of the log that the drive counts as cut from: that of its seed.
    pub fn log_name(&self) -> String {
        format!("{SOURCE}-{}", self.seed)
    }
}

impl fmt::Display for Spec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{SOURCE}/{}/{}", self.scenario_type, self.seed)?;
        if self.traffic == 0 { Ok(()) } else { write!(f, ".{}", self.traffic) }
    }
}

impl FromStr for Spec {
    type Err = GeneratorError;

    fn from_str(id: &str) -> Result<Self, Self::Err> {
        let mut parts = id.split('/');
        let (Some(SOURCE), Some(kind), Some(seed), None) = (parts.next(), parts.next(), parts.next(), parts.next())
        else {
            return Err(GeneratorError::Form(id.to_owned()));
        };
        let scenario_type = kind.parse()?;
        let number = |which, seed: &str| {
            seed.parse().map_err(|_| GeneratorError::Seed { which, seed: seed.to_owned(), id: id.to_owned() })
        };
        let (seed, traffic) = seed.split_once('.').unwrap_or((seed, "0"));
        Ok(Self { scenario_type, seed: number("seed", seed)?, traffic: number("traffic seed", traffic)? })
    }
}

/// A generated drive and how it came about.
#[derive(Debug, Clone)]
pub struct Generated {
    /// The drive.
    pub scenario: Scenario,
    /// Why each draw before it was thrown away, in order.
    pub discarded: Vec<Discard>,
}

/// Makes the drive of a name: 2.1 s of history, then 15 s driven by the expert.
///
/// # Errors
/// When [`MAX_DRAWS`] draws were thrown away.
pub fn generate(spec: &Spec) -> Result<Scenario, GeneratorError> {
    generate_with_record(spec).map(|generated| generated.scenario)
}

/// As [`generate`], with the draws that were thrown away; those of the drive among its own traffic come first.
///
/// # Errors
/// When [`MAX_DRAWS`] draws were thrown away.
pub fn generate_with_record(spec: &Spec) -> Result<Generated, GeneratorError> {
    let (own, rng) = first_of(&spec.with_traffic_seed(0), |number| rng_of(spec.scenario_type, spec.seed, number))?;
    if spec.traffic == 0 {
        return Ok(own);
    }
    let luck = spec.seed ^ SeededRng::new(spec.traffic, TRAFFIC).next_u64();
    let other = |number| rng_of(spec.scenario_type, luck, number).among_other_traffic(&rng);
    let (generated, _) = first_of(spec, other)?;
    Ok(Generated { discarded: [own.discarded, generated.discarded].concat(), ..generated })
}

/// Purpose of the dice that make traffic seeds into seeds of luck.
const TRAFFIC: u64 = 1;

/// Dice of one draw of a seed.
fn rng_of(kind: ScenarioType, seed: u64, draw: u64) -> SeededRng {
    SeededRng::new(seed, (kind as u64 + 1) * 1000 + draw)
}

/// The first of several draws that is worth keeping, with its dice as they are afterwards.
fn first_of(spec: &Spec, rng: impl Fn(u64) -> SeededRng) -> Result<(Generated, SeededRng), GeneratorError> {
    let mut discarded = Vec::new();
    for number in 0..MAX_DRAWS {
        let mut rng = rng(number as u64);
        match draw(spec, &mut rng) {
            Ok(scenario) => return Ok((Generated { scenario, discarded }, rng)),
            Err(reason) => discarded.push(reason),
        }
    }
    let last = discarded.last().copied().unwrap_or(Discard::Roads);
    Err(GeneratorError::Exhausted { id: spec.to_string(), draws: MAX_DRAWS, last })
}

/// One draw.
fn draw(spec: &Spec, rng: &mut SeededRng) -> Result<Scenario, Discard> {
    let kind = spec.scenario_type;
    let mut setting = rng.situation(|rng| recipe::setting(kind, rng)).map_err(|_| Discard::Roads)?;
    let layout = std::mem::take(&mut setting.layout);
    // Other traffic drives on the same map.
    let mut roads = Roads::new(layout, spec.with_traffic_seed(0).to_string()).map_err(|_| Discard::Roads)?;
    let (chain, ego_lane) = recipe::prepare(&mut roads, &setting, rng);
    let mut stage = Stage::new(&roads, chain, ego_lane, &setting, rng).ok_or(Discard::Roads)?;
    let task = recipe::cast(kind, &mut stage, setting.task);
    let (traffic, task) = stage.finish(task);
    if !rng.kept_situation() {
        return Err(Discard::OtherSituation);
    }
    let log = GeneratedLog::record(traffic, Expert::new(task))?;
    if !recipe::holds(kind, &log) {
        return Err(Discard::OtherType);
    }
    let goal = log.frames.last().map(|frame| frame.ego.center());
    Ok(Scenario {
        id: spec.to_string(),
        scenario_type: kind.name().to_owned(),
        log_name: spec.log_name(),
        map: roads.map.clone(),
        route: Route { roadblocks: roads.route(), goal },
        frames: log.frames,
        start: PAST,
        future: Vec::new(),
    })
}
