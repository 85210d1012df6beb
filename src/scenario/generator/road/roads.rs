//! Finished roads: the checked map and what drivers need beside it.

use super::layout::Layout;
use super::network::{Passage, RoadIndex};
use super::signal::SignalPlan;
use planagent_world::geometry::SpatialIndex;
use planagent_world::{LaneId, LaneKind, LaneMap, MapError, RoadblockId, TrafficLights};
use std::sync::Arc;

/// Why a layout cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum RoadsError {
    #[error(transparent)]
    Map(#[from] MapError),
    #[error("roads {0} and {1} overlap")]
    Overlap(usize, usize),
    #[error("road {0} runs into junction {1}")]
    RunsInto(usize, usize),
    #[error("junctions {0} and {1} overlap")]
    JunctionsOverlap(usize, usize),
}

/// A lane of a finished road, and the strips beside the road.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RoadFacts {
    /// Meters.
    pub(crate) lane_width: f64,
    /// Paved width right of the lanes along the line and left of the oncoming ones, meters.
    pub(crate) shoulder: [f64; 2],
}

/// A map with right of way, traffic lights and the ego's route.
#[derive(Debug, Clone)]
pub(crate) struct Roads {
    pub(crate) map: Arc<LaneMap>,
    /// By lane; `None` for lanes of roads.
    pub(crate) passages: Vec<Option<Passage>>,
    pub(crate) signals: Vec<SignalPlan>,
    /// Lanes of the ego's route, road after road, leftmost first.
    pub(crate) route_lanes: Vec<Vec<LaneId>>,
    /// Cross-section of the road of each lane; `None` for connectors.
    pub(crate) facts: Vec<Option<RoadFacts>>,
}

impl Roads {
    /// Checks and finishes a layout.
    pub(crate) fn new(layout: Layout, name: String) -> Result<Self, RoadsError> {
        let Layout { mut network, route } = layout;
        network.find_conflicts();
        check_overlaps(
            &network.roads,
            &network.parts.intersections,
            &network.touching,
        )?;
        let mut facts = vec![None; network.parts.lanes.len()];
        for road in &network.roads {
            let shoulder = road.plan.shoulder;
            for &lane in &road.forward {
                facts[lane.index()] = Some(RoadFacts {
                    lane_width: network.width_of(lane),
                    shoulder,
                });
            }
            let shoulder = [shoulder[1], shoulder[0]];
            for &lane in &road.backward {
                facts[lane.index()] = Some(RoadFacts {
                    lane_width: network.width_of(lane),
                    shoulder,
                });
            }
        }
        let route_lanes = route
            .iter()
            .map(|&road| network.roads[road].forward.clone())
            .collect();
        network.parts.name = name;
        // As in nuPlan's maps, an id is unique over all layers: roadblocks count from the number of
        // lanes on.
        let lanes = network.parts.lanes.len() as i64;
        for block in &mut network.parts.roadblocks {
            block.source_id += lanes;
        }
        let map = Arc::new(LaneMap::new(network.parts.with_roadblocks_as_road())?);
        Ok(Self {
            map,
            passages: network.passages,
            signals: network.signals,
            route_lanes,
            facts,
        })
    }

    /// The traffic lights at `time` seconds.
    pub(crate) fn lights(&self, time: f64) -> TrafficLights {
        let mut lights = TrafficLights::default();
        for signal in &self.signals {
            signal.show(time, &mut lights);
        }
        lights
    }

    /// The roadblocks of the route, connectors included.
    pub(crate) fn route(&self) -> Vec<RoadblockId> {
        let block = |lanes: &[LaneId]| self.map[lanes[0]].roadblock;
        let mut route = vec![block(&self.route_lanes[0])];
        for pair in self.route_lanes.windows(2) {
            let (before, after) = (block(&pair[0]), block(&pair[1]));
            let between = self.map[before]
                .outgoing
                .iter()
                .find(|&&b| self.map[b].outgoing.contains(&after));
            route.extend(between);
            route.push(after);
        }
        route
    }

    /// The chain of lanes along the route from `lane`, a lane of its road number `place`, as far as
    /// lanes connect.
    pub(crate) fn chain_on_route(&self, place: usize, lane: LaneId) -> Vec<LaneId> {
        let mut chain = vec![lane];
        for next in place + 1..self.route_lanes.len() {
            let last = chain[chain.len() - 1];
            let Some((connector, after)) = self.onward(last, next) else {
                break;
            };
            chain.extend([connector, after]);
        }
        chain
    }

    /// The connector from a lane to the road number `next` of the route, and the lane behind it:
    /// the one with the largest [reach](Self::reach).
    fn onward(&self, lane: LaneId, next: usize) -> Option<(LaneId, LaneId)> {
        self.map[lane]
            .outgoing
            .iter()
            .flat_map(|&connector| {
                self.map[connector]
                    .outgoing
                    .iter()
                    .map(move |&after| (connector, after))
            })
            .filter(|(_, after)| self.route_lanes[next].contains(after))
            .max_by_key(|&(connector, after)| {
                (self.reach(next, after), std::cmp::Reverse(connector))
            })
    }

    /// Number of the last road of the route that can be reached from a lane without a lane change.
    pub(crate) fn reach(&self, place: usize, lane: LaneId) -> usize {
        if place + 1 >= self.route_lanes.len() {
            return place;
        }
        let onward = self.map[lane]
            .outgoing
            .iter()
            .flat_map(|&c| self.map[c].outgoing.iter());
        let further = onward.filter(|after| self.route_lanes[place + 1].contains(after));
        further
            .map(|&after| self.reach(place + 1, after))
            .max()
            .unwrap_or(place)
    }

    /// The straightest chain of lanes from `lane` to the end of the roads.
    pub(crate) fn straight_chain(&self, lane: LaneId) -> Vec<LaneId> {
        let mut chain = vec![lane];
        let bend = |&lane: &LaneId| {
            let line = &self.map[lane].centerline;
            planagent_world::geometry::wrap_angle(
                line.heading_at(line.length()) - line.heading_at(0.0),
            )
            .abs()
        };
        while let Some(&next) = self.map[chain[chain.len() - 1]]
            .outgoing
            .iter()
            .min_by(|a, b| bend(a).total_cmp(&bend(b)))
        {
            if chain.contains(&next) {
                break;
            }
            chain.push(next);
        }
        chain
    }

    /// All lanes of roads, without connectors.
    pub(crate) fn road_lanes(&self) -> impl Iterator<Item = LaneId> + '_ {
        self.map
            .lanes()
            .iter()
            .filter(|lane| lane.kind == LaneKind::Lane)
            .map(|lane| lane.id)
    }
}

/// Checks that no two roads overlap, and no road and a junction that it does not lead to.
fn check_overlaps(
    roads: &[super::network::Road],
    junctions: &[planagent_world::geometry::Polygon],
    touching: &[Vec<RoadIndex>],
) -> Result<(), RoadsError> {
    let index = SpatialIndex::new(roads.iter().map(|road| road.outline.bounds()));
    for (i, road) in roads.iter().enumerate() {
        for j in index
            .within(&road.outline.bounds())
            .into_iter()
            .filter(|&j| j > i)
        {
            if road.outline.overlaps(&roads[j].outline) {
                return Err(RoadsError::Overlap(i, j));
            }
        }
    }
    for (n, junction) in junctions.iter().enumerate() {
        for i in index.within(&junction.bounds()) {
            // Roads that lead to a junction end in its area, so they overlap it by design.
            if !touching[n].contains(&i) && junction.overlaps(&roads[i].outline) {
                return Err(RoadsError::RunsInto(i, n));
            }
        }
        if let Some(other) = junctions[..n]
            .iter()
            .position(|other| other.overlaps(junction))
        {
            return Err(RoadsError::JunctionsOverlap(other, n));
        }
    }
    Ok(())
}
