//! Text twins: pairs of scenes with byte-identical prompts, other pictures and other best codes.
//!
//! A pair is one generated scenario with two modifications ([`Twin`]). It counts if in each scene
//! the best code gains at least [`MIN_GAIN`] over the best code of the other. No code of the search
//! may be right in both. So a model that reads the text alone is right in one scene at most.

use super::label::{self, LabeledState};
use super::label_weights::DecisionWeights;
use super::scenes::SCENARIOS_PER_SEED;
use super::{DatasetError, Settings, Split, states};
use image::RgbImage;
use planagent_agent::environment::text::{self, Description};
use planagent_agent::environment::{
    BevView, CenterlineName, DEFAULT_NODE_LENGTH, GraphedScene, LaneGraph, SceneFacts, TextForm,
    bev,
};
use planagent_agent::reasoning::{
    Names, PlannerCode, PromptError, PromptSet, Round, round_prompt, system_prompt,
};
use planagent_agent::simulation::{Challenge, ClosedLoop};
use planagent_controls::search::{self, Candidate};
use planagent_scenario::Scenario;
use planagent_scenario::generator::{self, Ranges, ScenarioType, Spec, types};
use planagent_scenario::modified::{MARK, ModifiedName, Twin, TwinKind, TwinPart, TwinSide};
use planagent_world::SceneView;
use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

/// Minimum gain of the best code of a scene over that of its twin, in the search's value.
pub(crate) const MIN_GAIN: f64 = 0.1;
/// A code is right if its value is within this of the best.
pub(crate) const RIGHT_WITHIN: f64 = 0.05;
/// Candidates of a shard. Most of them are no pairs.
const CANDIDATES_PER_SHARD: u64 = 80;
/// Types of the scenarios: roads with two lanes on which the ego drives.
const TYPES: [ScenarioType; 4] = [
    types::near_multiple_vehicles::TYPE,
    types::following_lane_with_lead::TYPE,
    types::changing_lane::TYPE,
    types::traversing_pickup_dropoff::TYPE,
];

/// Name of a pair, `generated/changing_lane/20000003~twin_taper_left`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PairName {
    /// What the text does not tell.
    pub kind: TwinKind,
    /// Side of the other lane.
    pub side: TwinSide,
    /// The scenario that is modified.
    pub base: Spec,
}

impl PairName {
    /// The candidates of a seed; the first that fits counts. Their kind and type depend on `number`
    /// alone.
    pub fn candidates(seed: u64, number: u64, may_be_wide: bool) -> [Self; 2] {
        let kind = TwinKind::ALL[(number % 4) as usize];
        let base = Spec::new(TYPES[(number / 8 % 4) as usize], seed);
        let base = if may_be_wide && number / 32 % 2 == 1 {
            base.drawn_from(Ranges::Wide)
        } else {
            base
        };
        let of_side = |side| Self { kind, side, base };
        let sides = [TwinSide::Left, TwinSide::Right].map(of_side);
        if (number / 4).is_multiple_of(2) {
            sides
        } else {
            [sides[1], sides[0]]
        }
    }

    fn twin(&self, part: TwinPart) -> Twin {
        Twin {
            kind: self.kind,
            side: self.side,
            part,
        }
    }

    /// The words of its two scenes, as `simulate` takes them.
    pub fn words(&self) -> [String; 2] {
        TwinPart::ALL
            .map(|part| ModifiedName::of_twin(self.twin(part)).mark(&self.base.to_string()))
    }
}

impl fmt::Display for PairName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}{MARK}{}",
            self.base,
            self.twin(TwinPart::OwnClosed).pair()
        )
    }
}

/// A text that names no pair.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' names no text twins: expected SCENARIO{MARK}twin_KIND_SIDE, as generated/changing_lane/20000003{MARK}twin_taper_left"
)]
pub struct UnknownPair(String);

impl FromStr for PairName {
    type Err = UnknownPair;

    fn from_str(word: &str) -> Result<Self, UnknownPair> {
        let parse = || {
            let (base, name) = word.rsplit_once(MARK)?;
            let Twin { kind, side, .. } = Twin::named(&format!("{name}_a"))?;
            Some(Self {
                kind,
                side,
                base: base.parse().ok()?,
            })
        };
        parse().ok_or_else(|| UnknownPair(word.to_owned()))
    }
}

/// One scene of a pair, at its first iteration.
pub struct TwinScene {
    /// At its start, with non-reactive agents.
    pub simulation: ClosedLoop<'static>,
    pub graph: LaneGraph,
    /// What the search tried.
    pub tried: Vec<Candidate>,
    pub best: Candidate,
}

impl TwinScene {
    /// The value of a code here; none if it gives no plan.
    pub fn value(&self, code: PlannerCode) -> Option<f64> {
        let tried = self
            .tried
            .iter()
            .find(|candidate| candidate.code == code)
            .map(|candidate| candidate.value);
        tried.or_else(|| {
            search::attempt(&self.simulation, &self.graph, code).map(|candidate| candidate.value)
        })
    }

    /// Whether a code is as good as the best one, but for [`RIGHT_WITHIN`].
    pub(crate) fn is_right(&self, code: PlannerCode) -> bool {
        self.value(code)
            .is_some_and(|value| value >= self.best.value - RIGHT_WITHIN)
    }

    /// The gain of the best code over another; infinite over one without a plan.
    fn gain_over(&self, code: PlannerCode) -> f64 {
        self.value(code)
            .map_or(f64::INFINITY, |value| self.best.value - value)
    }
}

/// Why a name is no pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum NoPair {
    #[error("the scenario cannot be made, or the modification does not fit it")]
    NoScene,
    #[error("the prompts differ")]
    TextDiffers,
    #[error("the pictures are the same")]
    SamePicture,
    #[error("the search finds no code")]
    NoCode,
    #[error("the best code stays in the closed lane")]
    StaysInLane,
    #[error("a best code gains too little over that of the other scene")]
    SmallGain,
    #[error("one code is right in both scenes")]
    BothRight,
}

/// What a model is asked and may answer in a scene, but for the picture.
fn asked(
    scene: &SceneView<'_>,
    graph: &LaneGraph,
    prompts: &PromptSet,
) -> Result<(Vec<String>, BTreeSet<String>), PromptError> {
    let form = prompts.forms().scene_text;
    let graph = if form.names_oncoming_lane() {
        &graph.clone().with_oncoming_lane(scene)
    } else {
        graph
    };
    let names = Names::from_graph(graph);
    let scene_text = text::write(&Description::from_graph(graph), form);
    let mut texts = vec![system_prompt(prompts, "")?];
    for &round in Round::ALL {
        let first = round == Round::Understanding;
        texts.push(round_prompt(
            prompts,
            round,
            &names,
            first.then_some(scene_text.as_str()),
            None,
        )?);
    }
    // The grammar allows these names alone, so other names would tell the scenes apart without a
    // picture.
    let may_name = names.lead_agents.iter().map(ToString::to_string);
    Ok((
        texts,
        may_name
            .chain(names.centerlines.iter().map(ToString::to_string))
            .collect(),
    ))
}

/// Both scenes of a pair, if it is one in these prompt sets and this view.
///
/// # Errors
/// When a prompt cannot be made.
pub fn open(
    name: &PairName,
    prompts: &[PromptSet],
    view: &BevView,
) -> Result<Result<[TwinScene; 2], NoPair>, PromptError> {
    match generator::generate(&name.base) {
        Ok(base) => open_on(&base, name, prompts, view),
        Err(_) => Ok(Err(NoPair::NoScene)),
    }
}

/// As [`open`], for the first of names on one scenario that fits it.
///
/// # Errors
/// As [`open`].
pub(crate) fn open_first(
    names: &[PairName; 2],
    prompts: &[PromptSet],
    view: &BevView,
) -> Result<(PairName, Result<[TwinScene; 2], NoPair>), PromptError> {
    let [first, second] = names;
    let Ok(base) = generator::generate(&first.base) else {
        return Ok((*first, Err(NoPair::NoScene)));
    };
    match open_on(&base, first, prompts, view)? {
        Err(NoPair::NoScene) => Ok((*second, open_on(&base, second, prompts, view)?)),
        opened => Ok((*first, opened)),
    }
}

fn open_on(
    base: &Scenario,
    name: &PairName,
    prompts: &[PromptSet],
    view: &BevView,
) -> Result<Result<[TwinScene; 2], NoPair>, PromptError> {
    let Some(own) = scene(base, name.twin(TwinPart::OwnClosed)) else {
        return Ok(Err(NoPair::NoScene));
    };
    let Some(beside) = scene(base, name.twin(TwinPart::BesideClosed)) else {
        return Ok(Err(NoPair::NoScene));
    };
    for set in prompts {
        let [own, beside] =
            [&own, &beside].map(|(simulation, graph)| asked(&simulation.scene(), graph, set));
        if own? != beside? {
            return Ok(Err(NoPair::TextDiffers));
        }
    }
    if bev::render(&own.0.scene(), view) == bev::render(&beside.0.scene(), view) {
        return Ok(Err(NoPair::SamePicture));
    }
    Ok(searched(own, beside))
}

type Prepared = (ClosedLoop<'static>, LaneGraph);

/// A scene at its start.
fn scene(base: &Scenario, twin: Twin) -> Option<Prepared> {
    let scenario = ModifiedName::of_twin(twin)
        .read()
        .ok()?
        .apply(base.clone())
        .ok()?;
    let simulation = ClosedLoop::new(Arc::new(scenario), Challenge::CLOSED_LOOP[0]).ok()?;
    let graph = LaneGraph::build(&simulation.scene(), DEFAULT_NODE_LENGTH).ok()?;
    Some((simulation, graph))
}

fn searched(own: Prepared, beside: Prepared) -> Result<[TwinScene; 2], NoPair> {
    let search = |(simulation, graph): Prepared| {
        let tried = search::search(&simulation, &graph);
        let best = search::best(&tried)?.clone();
        Some(TwinScene {
            simulation,
            graph,
            tried,
            best,
        })
    };
    let own = search(own).ok_or(NoPair::NoCode)?;
    if own.best.code.centerline == CenterlineName::EgoLane {
        return Err(NoPair::StaysInLane);
    }
    let beside = search(beside).ok_or(NoPair::NoCode)?;
    if own.gain_over(beside.best.code) < MIN_GAIN || beside.gain_over(own.best.code) < MIN_GAIN {
        return Err(NoPair::SmallGain);
    }
    let mut tried = own
        .tried
        .iter()
        .chain(&beside.tried)
        .map(|candidate| candidate.code);
    if tried.any(|code| own.is_right(code) && beside.is_right(code)) {
        return Err(NoPair::BothRight);
    }
    Ok([own, beside])
}

/// The candidates of a shard.
pub(super) fn candidates(
    split: Split,
    shard: usize,
    settings: &Settings<'_>,
) -> Result<Vec<[PairName; 2]>, DatasetError> {
    let first = (shard as u64).saturating_mul(CANDIDATES_PER_SHARD);
    let last = first.saturating_add(CANDIDATES_PER_SHARD);
    let own = split
        .seeds()
        .start
        .saturating_add(settings.seed.saturating_mul(SCENARIOS_PER_SEED));
    if last > SCENARIOS_PER_SEED || own.saturating_add(last) > split.seeds().end {
        return Err(DatasetError::NoScenarioLeft {
            split: split.as_str(),
            seed: settings.seed,
        });
    }
    let may_be_wide = settings.prompts.forms().scene_text == TextForm::Compact2;
    Ok((first..last)
        .map(|number| PairName::candidates(own + number, number, may_be_wide))
        .collect())
}

/// The two labeled states of a pair; none if neither name is one.
pub(super) fn labeled(
    names: &[PairName; 2],
    settings: &Settings<'_>,
) -> Result<Option<[(LabeledState, RgbImage); 2]>, PromptError> {
    let (name, opened) = open_first(
        names,
        std::slice::from_ref(settings.prompts),
        &settings.view,
    )?;
    // A pair that does not count is no error: many names draw none.
    let Ok(pair) = opened else { return Ok(None) };
    let state = |one: &TwinScene| -> Result<Option<(LabeledState, RgbImage)>, PromptError> {
        let TwinScene {
            simulation,
            graph,
            tried,
            best,
        } = one;
        let Some(occupancy) = states::occupancy(simulation, graph, best, &settings.view) else {
            return Ok(None);
        };
        let scene = simulation.scene();
        let facts = SceneFacts::from_scene(GraphedScene::new(&scene, graph));
        let weights = DecisionWeights::from_candidates(best, tried, false);
        let state = format!("{}@0.0", simulation.scenario().id);
        let label = label::label(state, graph, &facts, best, weights, settings.prompts, None)?;
        let label = LabeledState {
            occupancy,
            twin: Some(name.to_string()),
            ..label
        };
        Ok(Some((label, bev::render(&scene, &settings.view))))
    };
    let [own, beside] = &pair;
    Ok(state(own)?
        .zip(state(beside)?)
        .map(|(own, beside)| [own, beside]))
}
