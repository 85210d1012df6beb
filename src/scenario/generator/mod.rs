//! Seeded generator of scenarios: no download, any number of scenarios, the same bytes for the same
//! name.
//!
//! A scenario is drawn in three steps:
//!
//! 1. Its type (`types`) draws roads and puts agents and objects on them (`scene`, `road`).
//! 2. The traffic runs with a privileged rule-based expert as the ego's driver (`traffic`,
//!    `expert`).
//! 3. The log is checked (`log`). If the expert collides or leaves the road, or the log does not
//!    show what its type says, the next sub-seed is drawn.
//!
//! A traffic seed puts the scenario of a seed into other traffic. Roads, route and the draws of the
//! situation stay, all other draws change (`rng`).

mod expert;
mod log;
pub mod prelude;
mod ranges;
mod reader;
mod rng;
mod road;
mod scenario_type;
mod scene;
mod spec;
#[cfg(test)]
mod tests;
mod traffic;
pub mod types;

pub use log::{Discard, GeneratedLog};
pub use ranges::Ranges;
pub(crate) use reader::GeneratedReader;
pub use scenario_type::{ScenarioType, TypeDefinition, TypeGroup};
pub(crate) use spec::SOURCE;
pub use spec::{GeneratorError, Spec};

use super::Scenario;
use expert::Expert;
use log::PAST;
use planagent_world::Route;
use rng::SeededRng;
use road::Roads;
use scene::builder::{TrafficBuilder, prepare};
use std::sync::Arc;

/// Maximum number of draws for a scenario.
pub(crate) const MAX_DRAWS: usize = 60;

/// The generated scenario that modifications change where none is named: a slow lead vehicle, and
/// a free lane beside it.
pub const DEFAULT: Spec = Spec::new(types::changing_lane::TYPE, 2);

/// A generated scenario and the draws before it.
#[derive(Debug, Clone)]
pub struct Generated {
    /// 2.1 s of history, then 15 s in which the expert controls the ego, then up to 8 s of the ego
    /// alone.
    pub scenario: Scenario,
    /// Why each earlier draw was discarded, in order.
    pub discarded: Vec<Discard>,
}

/// Generates the scenario of a name.
///
/// # Errors
/// When [`MAX_DRAWS`] draws were discarded.
pub fn generate(spec: &Spec) -> Result<Scenario, GeneratorError> {
    generate_with_record(spec).map(|generated| generated.scenario)
}

/// As [`generate`], with the discarded draws. Those of the scenario with its own traffic come
/// first.
///
/// # Errors
/// When [`MAX_DRAWS`] draws were discarded.
pub(crate) fn generate_with_record(spec: &Spec) -> Result<Generated, GeneratorError> {
    let (own, rng) = first_kept(&spec.with_traffic_seed(0), |number| {
        rng_of(spec, spec.seed, number)
    })?;
    if spec.traffic_seed == 0 {
        return Ok(own);
    }
    let seed = spec.seed ^ SeededRng::new(spec.traffic_seed, TRAFFIC).next_u64();
    let other = |number| rng_of(spec, seed, number).with_situation_of(&rng);
    let (generated, _) = first_kept(spec, other)?;
    Ok(Generated {
        discarded: [own.discarded, generated.discarded].concat(),
        ..generated
    })
}

/// Purpose of the random numbers that turn traffic seeds into seeds.
const TRAFFIC: u64 = 1;

/// Added to the seed of a type for draws from wider ranges, and from still wider ones.
const WIDE: u64 = 1_000_000;
const WIDER: u64 = 3_000_000;
/// Added to the seed of a type for what a recording of a map would change.
const MAP: u64 = 2_000_000;

fn rng_of(spec: &Spec, seed: u64, draw: u64) -> SeededRng {
    let of_ranges = match spec.ranges {
        Ranges::First => 0,
        Ranges::Wide => WIDE,
        Ranges::Wider => WIDER,
    };
    let purpose = spec.scenario_type.definition().seed + draw + of_ranges;
    SeededRng::new(seed, purpose).drawn_from(spec.ranges)
}

/// The first draw that is not discarded, and its random numbers after the draw.
fn first_kept(
    spec: &Spec,
    rng: impl Fn(u64) -> SeededRng,
) -> Result<(Generated, SeededRng), GeneratorError> {
    let mut discarded = Vec::new();
    for number in 0..MAX_DRAWS {
        let mut rng = rng(number as u64);
        match draw(spec, &mut rng) {
            Ok(scenario) => {
                return Ok((
                    Generated {
                        scenario,
                        discarded,
                    },
                    rng,
                ));
            }
            Err(reason) => discarded.push(reason),
        }
    }
    let last = discarded.last().copied().unwrap_or(Discard::Roads);
    Err(GeneratorError::Exhausted {
        id: spec.to_string(),
        draws: MAX_DRAWS,
        last,
    })
}

fn draw(spec: &Spec, rng: &mut SeededRng) -> Result<Scenario, Discard> {
    let kind = spec.scenario_type.definition();
    let mut setting = rng.situation(kind.setting).map_err(|_| Discard::Roads)?;
    let layout = std::mem::take(&mut setting.layout);
    // The map does not depend on the traffic seed, so its name does not either.
    let mut roads =
        Roads::new(layout, spec.with_traffic_seed(0).to_string()).map_err(|_| Discard::Roads)?;
    let (chain, ego_lane) = prepare(&mut roads, &setting, rng);
    let mut builder =
        TrafficBuilder::new(&roads, chain, ego_lane, &setting, rng).ok_or(Discard::Roads)?;
    (kind.populate)(&mut builder);
    let (mut traffic, task) = builder.finish();
    if !rng.kept_situation() {
        return Err(Discard::OtherSituation);
    }
    let mut expert = Expert::new(task);
    let log = GeneratedLog::record(&mut traffic, &mut expert)?;
    if !(kind.shows)(&log) {
        return Err(Discard::OtherType);
    }
    let future = log.future(&mut traffic, &mut expert);
    let goal = log.frames.last().map(|frame| frame.ego.center());
    // The traffic ran on the lines as they were drawn: their vertices must not move its last bits.
    let map = if rng.is_wide() {
        let mut random = SeededRng::new(spec.seed, kind.seed + MAP).drawn_from(spec.ranges);
        scene::recorded_map::as_recorded(&roads.map, &mut random).map_err(|_| Discard::Roads)?
    } else {
        (*roads.map).clone().with_dense_baselines()
    };
    Ok(Scenario {
        id: spec.to_string(),
        scenario_type: kind.name.to_owned(),
        log_name: spec.log_name(),
        map: Arc::new(map),
        route: Route {
            roadblocks: roads.route(),
            goal,
            goal_lane: None,
        },
        frames: log.frames,
        start: PAST,
        future,
        interaction: None,
    })
}
