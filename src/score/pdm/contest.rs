//! The proposals of one batch, judged as far as their scores are asked for.

use super::areas::NearAreas;
use super::collision::{SimulatedProposal, approach, collide};
use super::encounters::Encounters;
use super::scorer::{OvertakeVerdict, ProposalScore, ScoringScene};
use super::{EgoAreas, Placed, is_comfortable};
use crate::metrics::{MetricError, direction_score};
use planagent_world::geometry::{Bounds, Polyline};
use planagent_world::{EgoState, LaneId, LaneMap, STEP_S};

/// Below this best progress, standing still is as good as any, meters.
const PROGRESS_THRESHOLD: f64 = 0.1;

/// A batch of proposals, of which each is judged once, when its score first matters. The progress
/// of all is known at once; it bounds what a proposal can score, so most need no judging where
/// only the best is asked for.
pub struct Contest<'a> {
    map: &'a LaneMap,
    proposals: &'a [Vec<EgoState>],
    placed: Vec<Vec<Placed>>,
    /// The polygons and objects that the batch may touch.
    areas: NearAreas<'a>,
    encounters: Encounters<'a>,
    /// The areas with lanes against traffic on the route, and who may use them.
    overtake: Option<(NearAreas<'a>, &'a [OvertakeVerdict])>,
    /// Progress of each proposal along the centerline, meters, not below 0.
    progress_m: Vec<f64>,
    /// The best progress of a proposal times its multipliers, or of a rival, meters.
    best_m: f64,
    /// The terms of each judged proposal, without `total` and relative `progress`.
    judged: Vec<Option<ProposalScore>>,
}

impl<'a> Contest<'a> {
    /// The contest of proposals: each a sequence of simulated states 0.1 s apart, the present one
    /// first. Judges those that may have the best progress, to which all progress is relative.
    ///
    /// # Errors
    /// When a proposal has fewer than 4 states.
    pub fn new(
        scene: &ScoringScene<'a>,
        proposals: &'a [Vec<EgoState>],
    ) -> Result<Self, MetricError> {
        Self::begin(scene, None, proposals)
    }

    /// The same where lanes against traffic count as the route's for each proposal that is allowed
    /// to use them; the n-th verdict belongs to the n-th proposal.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn overtaking(
        scene: &ScoringScene<'a>,
        against_traffic: &[LaneId],
        verdicts: &'a [OvertakeVerdict],
        proposals: &'a [Vec<EgoState>],
    ) -> Result<Self, MetricError> {
        Self::begin(scene, Some((against_traffic, verdicts)), proposals)
    }

    fn begin(
        scene: &ScoringScene<'a>,
        overtake: Option<(&[LaneId], &'a [OvertakeVerdict])>,
        proposals: &'a [Vec<EgoState>],
    ) -> Result<Self, MetricError> {
        let placed: Vec<Vec<Placed>> = proposals
            .iter()
            .map(|states| states.iter().map(Placed::from_state).collect())
            .collect();
        // Polygons beyond this decide nothing, and preparing them takes time.
        let reach = placed
            .iter()
            .flatten()
            .fold(Bounds::around(&[]), |reach, placed| {
                reach.joined(placed.bounds())
            });
        let overtake = overtake.map(|(lanes, verdicts)| {
            let allowing = scene.drivable.allowing(lanes).near(&reach);
            (allowing, verdicts)
        });
        let mut contest = Self {
            map: scene.drivable.map(),
            proposals,
            areas: scene.drivable.near(&reach),
            encounters: Encounters::from_forecast(scene.forecast, &placed),
            placed,
            overtake,
            progress_m: proposals
                .iter()
                .map(|states| progress(scene.centerline, states))
                .collect(),
            best_m: scene.rival_progress.max(0.0),
            judged: vec![None; proposals.len()],
        };
        contest.settle_best_progress()?;
        Ok(contest)
    }

    /// Judges the proposals that may have more than the best progress, the farthest first.
    fn settle_best_progress(&mut self) -> Result<(), MetricError> {
        let mut by_progress: Vec<(usize, f64)> =
            self.progress_m.iter().copied().enumerate().collect();
        by_progress.sort_by(|a, b| b.1.total_cmp(&a.1));
        for (index, progress_m) in by_progress {
            if progress_m <= self.best_m {
                break;
            }
            let multiplier = self.judge(index)?.multiplier();
            self.best_m = self.best_m.max(progress_m * multiplier);
        }
        Ok(())
    }

    /// The scores of all proposals, in their order.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn scores(mut self) -> Result<Vec<ProposalScore>, MetricError> {
        (0..self.proposals.len())
            .map(|index| {
                let terms = self.judge(index)?;
                Ok(self.compared(terms))
            })
            .collect()
    }

    /// The proposal with the highest score among some, the first one of equals.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn best(
        &mut self,
        among: impl Fn(usize) -> bool,
    ) -> Result<Option<(usize, ProposalScore)>, MetricError> {
        loop {
            // Reversed, because `max_by` takes the last of equals and the first should win.
            let most_promising = (0..self.proposals.len())
                .filter(|&index| among(index))
                .rev()
                .max_by(|&a, &b| self.at_most(a).total_cmp(&self.at_most(b)));
            let Some(index) = most_promising else {
                return Ok(None);
            };
            if let Some(terms) = self.judged[index] {
                return Ok(Some((index, self.compared(terms))));
            }
            self.judge(index)?;
        }
    }

    /// The total of a judged proposal, or what another one scores if it loses nothing.
    fn at_most(&self, index: usize) -> f64 {
        let flawless = || ProposalScore::flawless(self.progress_m[index]);
        self.compared(self.judged[index].unwrap_or_else(flawless))
            .total
    }

    /// Terms with their progress relative to the best.
    fn compared(&self, terms: ProposalScore) -> ProposalScore {
        terms.with_progress(if self.best_m > PROGRESS_THRESHOLD {
            terms.progress_m * terms.multiplier() / self.best_m
        } else {
            f64::from(u8::from(terms.multiplier() > 0.0))
        })
    }

    /// All terms of a proposal but its relative progress.
    fn judge(&mut self, index: usize) -> Result<ProposalScore, MetricError> {
        if let Some(terms) = self.judged[index] {
            return Ok(terms);
        }
        let (areas, is_refused) = match &self.overtake {
            None => (&self.areas, false),
            Some((allowing, verdicts)) => match verdicts[index] {
                OvertakeVerdict::Stays => (&self.areas, false),
                OvertakeVerdict::Allowed => (allowing, false),
                OvertakeVerdict::Refused => (&self.areas, true),
            },
        };
        let mut terms = self.terms(index, areas)?;
        if is_refused {
            terms.driving_direction = 0.0;
        }
        self.judged[index] = Some(terms);
        Ok(terms)
    }

    fn terms(&self, index: usize, areas: &NearAreas<'_>) -> Result<ProposalScore, MetricError> {
        let (states, placed) = (&self.proposals[index], &self.placed[index]);
        let areas: Vec<EgoAreas> = placed.iter().map(|placed| areas.areas_of(placed)).collect();
        let proposal = SimulatedProposal {
            states,
            placed,
            areas: &areas,
        };
        let collisions = collide(proposal, &self.encounters);
        let ttc = approach(self.map, proposal, &self.encounters);
        let seconds = |state: Option<usize>| state.map(|i| i as f64 * STEP_S);
        Ok(ProposalScore {
            no_at_fault_collisions: collisions.score,
            drivable_area: f64::from(u8::from(!areas.iter().any(|a| a.non_drivable))),
            driving_direction: direction_score(longest_oncoming(placed, &areas)),
            time_to_collision: ttc.score,
            comfort: f64::from(u8::from(is_comfortable(states)?)),
            first_at_fault_s: seconds(collisions.state),
            first_ttc_s: seconds(ttc.state),
            ..ProposalScore::flawless(self.progress_m[index])
        })
    }
}

/// The longest distance of the center in one segment off the route, meters.
fn longest_oncoming(placed: &[Placed], areas: &[EgoAreas]) -> f64 {
    let (mut longest, mut stretch) = (0.0f64, 0.0);
    for (pair, areas) in placed.windows(2).zip(areas.iter().skip(1)) {
        stretch = if areas.oncoming {
            stretch + pair[0].shape.center.distance(&pair[1].shape.center)
        } else {
            0.0
        };
        longest = longest.max(stretch);
    }
    longest
}

fn progress(centerline: &Polyline, states: &[EgoState]) -> f64 {
    let along = |ego: &EgoState| centerline.project(ego.center().position()).s;
    match states {
        [first, .., last] => (along(last) - along(first)).max(0.0),
        _ => 0.0,
    }
}
