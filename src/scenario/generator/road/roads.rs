//! Finished roads: the checked map with everything that drivers must know beside it.

use super::layout::Layout;
use super::network::{Passage, RoadIndex};
use super::signal::SignalPlan;
use crate::geometry::SpatialIndex;
use crate::world::{LaneId, LaneKind, LaneMap, MapError, RoadblockId, TrafficLights};
use std::sync::Arc;

/// Why a layout cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum RoadsError {
    /// Its relations do not hold.
    #[error(transparent)]
    Map(#[from] MapError),
    /// Two roads run over each other.
    #[error("roads {0} and {1} overlap")]
    Overlap(usize, usize),
    /// A road runs into a junction that it does not belong to.
    #[error("road {0} runs into junction {1}")]
    RunsInto(usize, usize),
    /// Two junctions share ground.
    #[error("junctions {0} and {1} overlap")]
    JunctionsOverlap(usize, usize),
}

/// Cross-section of a finished road.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RoadFacts {
    /// Width of its lanes, metres.
    pub(crate) lane_width: f64,
    /// Paved width right of the lanes along its line and left of the oncoming ones, metres.
    pub(crate) shoulder: [f64; 2],
}

/// A map with right of way, lights and the way of the ego.
#[derive(Debug, Clone)]
pub(crate) struct Roads {
    /// The map.
    pub(crate) map: Arc<LaneMap>,
    /// Right of way by lane; `None` for lanes of roads.
    pub(crate) passages: Vec<Option<Passage>>,
    /// Lights.
    pub(crate) signals: Vec<SignalPlan>,
    /// Lanes of the ego's way, road after road, leftmost first.
    pub(crate) way: Vec<Vec<LaneId>>,
    /// Cross-section of the road of each lane; `None` for connectors.
    pub(crate) facts: Vec<Option<RoadFacts>>,
}

impl Roads {
    /// Checks and finishes a layout.
    ///
    /// # Errors
    /// When roads overlap or relations do not hold.
    pub(crate) fn new(layout: Layout, name: String) -> Result<Self, RoadsError> {
        let Layout { mut network, way } = layout;
        network.find_conflicts();
        check_overlaps(&network.roads, &network.parts.intersections, &network.touching)?;
        let mut facts = vec![None; network.parts.lanes.len()];
        for road in &network.roads {
            let here = RoadFacts { lane_width: road.plan.lane_width, shoulder: road.plan.shoulder };
            for lane in &road.forward {
                facts[lane.index()] = Some(here);
            }
            let turned = RoadFacts { shoulder: [here.shoulder[1], here.shoulder[0]], ..here };
            for lane in &road.backward {
                facts[lane.index()] = Some(turned);
            }
        }
        let way = way.iter().map(|&road| network.roads[road].forward.clone()).collect();
        network.parts.name = name;
        // One number names one thing, whichever layer it lies in, as in nuPlan's maps: roadblocks count on behind the lanes.
        let lanes = network.parts.lanes.len() as i64;
        for block in &mut network.parts.roadblocks {
            block.source_id += lanes;
        }
        let map = Arc::new(LaneMap::new(network.parts.with_roadblocks_as_road())?);
        Ok(Self { map, passages: network.passages, signals: network.signals, way, facts })
    }

    /// What all lights show at `time` seconds.
    pub(crate) fn lights(&self, time: f64) -> TrafficLights {
        let mut lights = TrafficLights::default();
        for signal in &self.signals {
            signal.show(time, &mut lights);
        }
        lights
    }

    /// The roadblocks of the way, connectors included.
    pub(crate) fn route(&self) -> Vec<RoadblockId> {
        let block = |lanes: &[LaneId]| self.map[lanes[0]].roadblock;
        let mut route = vec![block(&self.way[0])];
        for pair in self.way.windows(2) {
            let (before, after) = (block(&pair[0]), block(&pair[1]));
            let between = self.map[before].outgoing.iter().find(|&&b| self.map[b].outgoing.contains(&after));
            route.extend(between);
            route.push(after);
        }
        route
    }

    /// The chains of lanes that stay on the way from `lane`, a lane of the road number `place` of it, to the way's end,
    /// as far as lanes connect; straight on first.
    pub(crate) fn chain_on_way(&self, place: usize, lane: LaneId) -> Vec<LaneId> {
        let mut chain = vec![lane];
        for next in place + 1..self.way.len() {
            let last = chain[chain.len() - 1];
            let Some((connector, after)) = self.onward(last, next) else { break };
            chain.extend([connector, after]);
        }
        chain
    }

    /// The connector from a lane to the road number `next` of the way, and the lane that it leads to: the one from which
    /// the way goes on furthest.
    fn onward(&self, lane: LaneId, next: usize) -> Option<(LaneId, LaneId)> {
        self.map[lane]
            .outgoing
            .iter()
            .flat_map(|&connector| self.map[connector].outgoing.iter().map(move |&after| (connector, after)))
            .filter(|(_, after)| self.way[next].contains(after))
            .max_by_key(|&(connector, after)| (self.reach(next, after), std::cmp::Reverse(connector)))
    }

    /// How many roads of the way can be driven from a lane on it without changing lanes.
    pub(crate) fn reach(&self, place: usize, lane: LaneId) -> usize {
        if place + 1 >= self.way.len() {
            return place;
        }
        let onward = self.map[lane].outgoing.iter().flat_map(|&c| self.map[c].outgoing.iter());
        let further = onward.filter(|after| self.way[place + 1].contains(after));
        further.map(|&after| self.reach(place + 1, after)).max().unwrap_or(place)
    }

    /// The chain of lanes that goes on straight from `lane` until the roads end.
    pub(crate) fn straight_chain(&self, lane: LaneId) -> Vec<LaneId> {
        let mut chain = vec![lane];
        let bend = |&lane: &LaneId| {
            let line = &self.map[lane].centerline;
            crate::geometry::wrap_angle(line.heading_at(line.length()) - line.heading_at(0.0)).abs()
        };
        while let Some(&next) =
            self.map[chain[chain.len() - 1]].outgoing.iter().min_by(|a, b| bend(a).total_cmp(&bend(b)))
        {
            if chain.contains(&next) {
                break;
            }
            chain.push(next);
        }
        chain
    }

    /// All lanes of roads (no connectors).
    pub(crate) fn road_lanes(&self) -> impl Iterator<Item = LaneId> + '_ {
        self.map.lanes().iter().filter(|lane| lane.kind == LaneKind::Lane).map(|lane| lane.id)
    }
}

/// No two roads may share ground, nor a road and a junction that it does not lead to.
fn check_overlaps(
    roads: &[super::network::Road],
    junctions: &[crate::geometry::Polygon],
    touching: &[Vec<RoadIndex>],
) -> Result<(), RoadsError> {
    let index = SpatialIndex::new(roads.iter().map(|road| road.outline.bounds()));
    for (i, road) in roads.iter().enumerate() {
        for j in index.within(&road.outline.bounds()).into_iter().filter(|&j| j > i) {
            if road.outline.overlaps(&roads[j].outline) {
                return Err(RoadsError::Overlap(i, j));
            }
        }
    }
    for (n, junction) in junctions.iter().enumerate() {
        for i in index.within(&junction.bounds()) {
            if !touching[n].contains(&i) && junction.overlaps(&roads[i].outline) {
                return Err(RoadsError::RunsInto(i, n));
            }
        }
        if let Some(other) = junctions[..n].iter().position(|other| other.overlaps(junction)) {
            return Err(RoadsError::JunctionsOverlap(other, n));
        }
    }
    Ok(())
}
