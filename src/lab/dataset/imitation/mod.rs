//! Samples for imitation: the features of a logged scene by a learned planner's own feature
//! builder, and the logged driver's next eight seconds.

mod futures;
mod gameformer;
mod gc_pgp;
mod pdm_open;
mod plantf;
mod raster_model;
mod tensors;
mod urban_driver;

use super::Split;
use super::scenes::{MIX, SCENARIOS_PER_SEED};
use super::shard::ShardError;
use planagent_files::write_within;
use planagent_scenario::generator::Spec;
use planagent_scenario::{Frame, Scenario, ScenarioRef};
use planagent_world::{EgoState, HISTORY_SAMPLES, History, HistorySample, SceneView};
use rayon::prelude::*;
use serde::Serialize;
use std::ops::Range;
use std::path::Path;
use tensors::Columns;

/// Version of the layout of shards.
const FORMAT: u32 = 1;
/// Iterations between two samples of a scenario: a second.
const STRIDE: usize = 10;
/// Frames of a target: eight seconds.
const HORIZON: usize = 80;
/// Scenarios of a shard.
const SCENARIOS_PER_SHARD: usize = MIX.len();

/// A learned planner that samples can be made for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImitationPlanner {
    /// PDM-Open.
    PdmOpen,
    /// PlanTF.
    PlanTf,
    /// UrbanDriver.
    UrbanDriver,
    /// RasterModel.
    RasterModel,
    /// GC-PGP.
    GcPgp,
    /// GameFormer.
    GameFormer,
    /// DTPP.
    Dtpp,
}

impl ImitationPlanner {
    /// All, in the order of the registry.
    pub const ALL: [Self; 7] = [
        Self::PdmOpen,
        Self::PlanTf,
        Self::UrbanDriver,
        Self::RasterModel,
        Self::GcPgp,
        Self::GameFormer,
        Self::Dtpp,
    ];

    /// Name of the planner.
    pub fn name(self) -> &'static str {
        match self {
            Self::PdmOpen => "pdm-open",
            Self::PlanTf => "plantf",
            Self::UrbanDriver => "urban-driver",
            Self::RasterModel => "raster-model",
            Self::GcPgp => "gc-pgp",
            Self::GameFormer => "gameformer",
            Self::Dtpp => "dtpp",
        }
    }

    fn sample(self, moment: &Moment<'_>) -> Option<Columns> {
        match self {
            Self::PdmOpen => pdm_open::sample(moment),
            Self::PlanTf => plantf::sample(moment),
            Self::UrbanDriver => urban_driver::sample(moment),
            Self::RasterModel => Some(raster_model::sample(moment)),
            Self::GcPgp => gc_pgp::sample(moment),
            Self::GameFormer => gameformer::gameformer(moment),
            Self::Dtpp => gameformer::dtpp(moment),
        }
    }
}

/// Where the scenarios of a dataset come from.
#[derive(Debug, Clone, Copy)]
pub enum ImitationSource<'a> {
    /// Generated ones of a split's seeds.
    Generated { split: Split, seed: u64 },
    /// Those of a list, once each.
    Listed(&'a [ScenarioRef]),
}

#[derive(Debug, thiserror::Error)]
pub enum ImitationError {
    #[error(transparent)]
    Shard(#[from] ShardError),
    #[error("cannot write the tensors of a shard: {0}")]
    Tensors(#[from] safetensors::SafeTensorError),
    #[error(
        "the split {split} has no more scenarios for seed {seed}; ask for fewer samples, or use another seed below 100"
    )]
    NoScenarioLeft { split: &'static str, seed: u64 },
}

/// A moment of a log.
pub(super) struct Moment<'a> {
    pub(super) scene: SceneView<'a>,
    /// The ego in the next eight seconds.
    pub(super) future: &'a [EgoState],
    /// The frames of the next eight seconds; fewer at the end of a scenario.
    pub(super) frames: &'a [Frame],
}

#[derive(Serialize)]
struct Meta {
    format: u32,
    planner: &'static str,
    seed: u64,
    scenarios: Vec<String>,
    planagent: &'static str,
}

/// Writes shards until there are `samples` samples, or the listed scenarios end. Complete shards of
/// an earlier run stay. Gives the number of samples; `on_samples` gets that of each shard.
pub fn write_samples(
    folder: &Path,
    planner: ImitationPlanner,
    source: ImitationSource<'_>,
    samples: usize,
    on_samples: &dyn Fn(usize),
) -> Result<usize, ImitationError> {
    let (name, seed, listed) = match source {
        ImitationSource::Generated { split, seed } => (split.as_str(), seed, Vec::new()),
        ImitationSource::Listed(listed) => (
            "listed",
            0,
            listed.iter().map(ToString::to_string).collect(),
        ),
    };
    let meta = Meta {
        format: FORMAT,
        planner: planner.name(),
        seed,
        scenarios: listed,
        planagent: env!("CARGO_PKG_VERSION"),
    };
    super::shard::open_folder(folder, &meta)?;
    let (mut count, mut number) = (0, 0);
    while count < samples {
        let path = folder.join(format!("{name}-{number:05}.safetensors"));
        // A shard that exists is complete, so an interrupted run resumes behind it.
        let made = if let Some(present) = tensors::samples_in(&path) {
            present
        } else {
            let Some(scenarios) = source.shard(number)? else {
                break;
            };
            write_shard(&path, planner, &scenarios)?
        };
        on_samples(made);
        count += made;
        number += 1;
    }
    Ok(count)
}

impl ImitationSource<'_> {
    /// The scenarios of a shard; `None` behind the last one.
    fn shard(self, number: usize) -> Result<Option<Vec<ScenarioRef>>, ImitationError> {
        match self {
            Self::Listed(listed) => Ok(listed
                .chunks(SCENARIOS_PER_SHARD)
                .nth(number)
                .map(<[ScenarioRef]>::to_vec)),
            Self::Generated { split, seed } => {
                let Range { start, end } = split.seeds();
                let first = start.saturating_add(seed.saturating_mul(SCENARIOS_PER_SEED));
                let from = first.saturating_add((number * SCENARIOS_PER_SHARD) as u64);
                let to = from.saturating_add(SCENARIOS_PER_SHARD as u64);
                if to > first.saturating_add(SCENARIOS_PER_SEED).min(end) {
                    return Err(ImitationError::NoScenarioLeft {
                        split: split.as_str(),
                        seed,
                    });
                }
                let spec = |seed: u64| Spec::new(MIX[seed as usize % MIX.len()], seed);
                Ok(Some((from..to).map(|seed| spec(seed).into()).collect()))
            }
        }
    }
}

fn write_shard(
    path: &Path,
    planner: ImitationPlanner,
    scenarios: &[ScenarioRef],
) -> Result<usize, ImitationError> {
    // A scenario whose draws the generator discards, or that cannot be opened, gives no sample.
    let of_scenario = |source: &ScenarioRef| {
        source
            .open()
            .map_or_else(|_| Vec::new(), |log| samples(planner, &log))
    };
    let samples: Vec<Columns> = scenarios.par_iter().flat_map_iter(of_scenario).collect();
    let written = |source| ShardError::Write {
        path: path.to_owned(),
        source,
    };
    write_within(path, &tensors::serialized(&samples)?).map_err(written)?;
    Ok(samples.len())
}

/// A sample a second, while the log has eight more.
fn samples(planner: ImitationPlanner, log: &Scenario) -> Vec<Columns> {
    let egos: Vec<EgoState> = log
        .frames
        .iter()
        .map(|frame| &frame.ego)
        .chain(&log.future)
        .copied()
        .collect();
    let moments = (log.start..log.frames.len()).step_by(STRIDE);
    let sample = |now: usize| {
        let mut history = History::default();
        for frame in &log.frames[(now + 1).saturating_sub(HISTORY_SAMPLES)..=now] {
            history.push(HistorySample {
                ego: frame.ego,
                objects: frame.objects.clone(),
            });
        }
        let future = egos.get(now + 1..=now + HORIZON)?;
        let frames = &log.frames[now + 1..log.frames.len().min(now + 1 + HORIZON)];
        planner.sample(&Moment {
            scene: log.scene(&log.frames[now], &history),
            future,
            frames,
        })
    };
    moments.filter_map(sample).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_scenario::generator;
    use std::fs;

    #[test]
    fn seeds_stay_in_their_split() {
        let source = |split, seed| ImitationSource::Generated { split, seed };
        let words = |source: ImitationSource<'_>, number| {
            let shard = source.shard(number).unwrap().unwrap();
            (
                shard[0].to_string(),
                shard[SCENARIOS_PER_SHARD - 1].to_string(),
            )
        };
        let last = SCENARIOS_PER_SEED as usize / SCENARIOS_PER_SHARD - 1;
        assert!(words(source(Split::Train, 0), 0).0.ends_with("/10000000"));
        assert!(
            words(source(Split::Train, 99), last)
                .1
                .ends_with("/19999999")
        );
        assert!(
            words(source(Split::Validation, 1), 0)
                .0
                .ends_with("/20100000")
        );
        for (seed, number) in [(0, last + 1), (100, 0), (u64::MAX, 0)] {
            let error = source(Split::Train, seed)
                .shard(number)
                .unwrap_err()
                .to_string();
            assert!(
                error.contains(&format!("no more scenarios for seed {seed}")),
                "{error}"
            );
        }
    }

    #[test]
    fn a_scenario_gives_a_sample_a_second_of_equal_columns() {
        let log = generator::generate(&Spec::new(MIX[0], 10_000_000)).unwrap();
        for planner in ImitationPlanner::ALL {
            let samples = samples(planner, &log);
            // DTPP's have a candidate near the driver.
            let all = log.iterations().div_ceil(STRIDE);
            assert!(
                samples.len() == all
                    || (planner == ImitationPlanner::Dtpp
                        && (all / 2..=all).contains(&samples.len()))
            );
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a.safetensors");
            fs::write(&path, tensors::serialized(&samples).unwrap()).unwrap();
            assert_eq!(tensors::samples_in(&path), Some(samples.len()));
        }
    }
}
