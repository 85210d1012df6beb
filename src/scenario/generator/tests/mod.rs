//! What must hold for every generated scenario.

mod behaviour;
mod contract;
mod distribution;
mod frozen;
mod logs;
mod maps;
mod names;
mod traffic;

use super::{Generated, Spec, generate_with_record, types};
use rayon::prelude::*;
use std::sync::LazyLock;

/// Seeds of each type in the tests.
const SEEDS: u64 = 10;

/// The scenarios of all types with the first seeds.
static CORPUS: LazyLock<Vec<Generated>> = LazyLock::new(|| {
    let specs: Vec<Spec> = types::in_suites()
        .flat_map(|scenario_type| (0..SEEDS).map(move |seed| Spec::new(scenario_type, seed)))
        .collect();
    specs
        .par_iter()
        .map(|spec| generate_with_record(spec).unwrap_or_else(|error| panic!("{error}")))
        .collect()
});

/// One scenario of each type.
fn one_each() -> impl Iterator<Item = &'static Generated> {
    CORPUS.iter().step_by(SEEDS as usize)
}
