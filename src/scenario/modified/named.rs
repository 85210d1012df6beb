//! interPlan's names as modifications: `LOG.db#TOKEN~dhgloa`.

use super::change::Change;
use super::draft::{Draft, GoalPath};
use super::fault::Fault;
use super::lanes::whole_lanes;
use crate::interplan::{Command, Density, InterPlanName, PythonRandom, Row, fill_row};
use planagent_world::dynamics::IDM_AGENT;
use planagent_world::geometry::wrap_angle;
use planagent_world::{LaneId, LaneMap, LanePath, ObjectKind, PACIFICA, RoadblockId, STEP_S};
use std::collections::{BTreeMap, VecDeque};
use std::f64::consts::FRAC_PI_2;

/// A lane gets vehicles up to this distance ahead of and behind the ego, meters, and on to the end
/// of the lane there.
const REACH: f64 = 50.0;
/// Limit of a lane without one, m/s, to compute the time that a way takes.
const UNKNOWN_LIMIT: f64 = 15.0;

impl Change for InterPlanName {
    fn check(&self) -> Result<(), Fault> {
        let known = |fault: &dyn std::fmt::Display| Fault::new("name", fault.to_string());
        self.density().map_err(|fault| known(&fault))?;
        self.goal().map_err(|fault| known(&fault))?;
        self.observation().map_err(|fault| known(&fault))?;
        match self.special() {
            Some(number) => Err(Fault::new(
                "name",
                format!(
                    "special scene s{number}: its places are in interPlan's own files; take a kind or a file"
                ),
            )),
            None => Ok(()),
        }
    }

    fn apply(&self, draft: &mut Draft) -> Result<(), Fault> {
        let fault = |fault: &dyn std::fmt::Display| Fault::new("name", fault.to_string());
        let objects = draft
            .scenario
            .frames
            .iter()
            .flat_map(|frame| frame.objects.iter());
        let everything: Vec<_> = objects.map(|object| object.token).collect();
        draft.removed.extend(everything);
        draft.behavior = self.observation().map_err(|text| fault(&text))?.into();
        if let Some(command) = self.goal().map_err(|text| fault(&text))? {
            draft.goal = Some(goal(draft, command)?);
        }
        if let Some(density) = self.density().map_err(|text| fault(&text))? {
            fill(draft, density);
        }
        Ok(())
    }
}

/// Vehicles on the lanes of the ego's roadblock, as interPlan draws them by the token of the scene.
fn fill(draft: &mut Draft, density: Density) {
    let map = draft.scenario.map.clone();
    let first = &draft.scenario.frames[draft.scenario.start].objects;
    let mut sizes: Vec<(f64, f64)> = first
        .iter()
        .filter(|object| object.kind == ObjectKind::Vehicle)
        .map(|object| (object.shape.length, object.shape.width))
        .collect();
    let mut random = PythonRandom::seeded(&draft.scenario.id);
    // interPlan shuffles the sizes before it fills the rows, and both draw from one stream.
    let order = random.permutation(sizes.len());
    sizes = order
        .into_iter()
        .filter_map(|place| sizes.get(place).copied())
        .collect();
    let mut sizes = sizes.into_iter();
    let own = draft.lanes.path.lane_at(draft.lanes.start_s);
    let block = &map[map[own].roadblock];
    let center = draft.ego().center().position();
    for &lane in &block.lanes {
        let (line, ego_s) = whole_lanes(&map, lane, center, REACH);
        let row = Row {
            length: line.length(),
            ego_s,
            is_ego_lane: lane == own,
            limit: map[lane].speed_limit,
            leads_on: block.outgoing.len() == 1,
            accelerations: (IDM_AGENT.accel_max, IDM_AGENT.decel_max),
        };
        for place in fill_row(&mut random, density, &row) {
            if place.is_ego {
                draft.ego_speed = (place.speed > 0.0)
                    .then_some(place.speed)
                    .or(draft.ego_speed);
            } else {
                let size = sizes.next().unwrap_or((PACIFICA.length(), PACIFICA.width));
                draft.drive(line.pose_at(place.s), size, place.speed, None);
            }
        }
    }
}

/// The way to the last lane of a route that turns as the command says. It has as many roadblocks as
/// the recorded one.
fn goal(draft: &Draft, command: Command) -> Result<GoalPath, Fault> {
    let map = &*draft.scenario.map;
    let own = draft.lanes.path.lane_at(draft.lanes.start_s);
    let blocks = turning(
        map,
        map[own].roadblock,
        command,
        draft.scenario.route.roadblocks.len(),
    );
    let unknown = || Fault::new("name", "no lane of the ego's road leads to the goal");
    let last = blocks.last().copied().ok_or_else(unknown)?;
    let target = map[last].lanes.last().copied().ok_or_else(unknown)?;
    let starts = &map[map[own].roadblock].lanes;
    let mut chains: Vec<Vec<LaneId>> = starts
        .iter()
        .filter_map(|&start| chain(map, start, target, blocks.len()))
        .collect();
    // A way that ends in another lane of the goal's roadblock is second choice.
    chains.sort_by_key(|chain| chain.last() != Some(&target));
    let mut lanes = chains.into_iter().next().ok_or_else(unknown)?;
    let duration = (draft.scenario.iterations() - 1) as f64 * STEP_S;
    let mut needed = 0.0;
    let count = lanes
        .iter()
        .take_while(|&&lane| {
            let before = needed;
            needed +=
                map[lane].centerline.length() / map[lane].speed_limit.unwrap_or(UNKNOWN_LIMIT);
            before <= duration
        })
        .count();
    lanes.truncate(count.max(1));
    let path = LanePath::from_lanes(map, lanes).ok_or_else(unknown)?;
    let from_s = path.centerline.project(draft.ego().center().position()).s;
    let length = path.centerline.length() - from_s;
    let mut roadblocks: Vec<RoadblockId> =
        path.lanes.iter().map(|&lane| map[lane].roadblock).collect();
    roadblocks.dedup();
    Ok(GoalPath {
        path,
        from_s,
        length,
        roadblocks,
    })
}

/// Roadblocks from one on, each the successor whose end turns most as the command says.
fn turning(map: &LaneMap, first: RoadblockId, command: Command, count: usize) -> Vec<RoadblockId> {
    let wanted = match command {
        Command::Left => FRAC_PI_2,
        Command::Straight => 0.0,
        Command::Right => -FRAC_PI_2,
    };
    let end = |block: RoadblockId| {
        let line = map[block].lanes.first().map(|&lane| &map[lane].centerline);
        line.map_or(0.0, |line| line.heading_at(line.length()))
    };
    let mut blocks = vec![first];
    while blocks.len() < count.max(1) {
        let present = blocks[blocks.len() - 1];
        let off =
            |block: &RoadblockId| wrap_angle(wrap_angle(end(*block) - end(present)) - wanted).abs();
        let next = map[present]
            .outgoing
            .iter()
            .copied()
            .min_by(|a, b| off(a).total_cmp(&off(b)));
        match next {
            Some(next) => blocks.push(next),
            None => break,
        }
    }
    blocks
}

/// The shortest chain of successors from a lane to the goal or, where none leads there, to a lane
/// beside it.
fn chain(map: &LaneMap, start: LaneId, goal: LaneId, depth: usize) -> Option<Vec<LaneId>> {
    let mut parents: BTreeMap<LaneId, Option<LaneId>> = BTreeMap::from([(start, None)]);
    let mut queue = VecDeque::from([(start, 1)]);
    let mut beside = None;
    let mut found = None;
    while let Some((lane, length)) = queue.pop_front() {
        if lane == goal {
            found = Some(lane);
            break;
        }
        // Breadth first, so the first lane found beside the goal is the nearest.
        if map[lane].roadblock == map[goal].roadblock {
            beside = beside.or(Some(lane));
        }
        if length < depth {
            for &next in &map[lane].outgoing {
                parents.entry(next).or_insert_with(|| {
                    queue.push_back((next, length + 1));
                    Some(lane)
                });
            }
        }
    }
    let mut lanes = vec![found.or(beside)?];
    while let Some(before) = lanes
        .last()
        .and_then(|lane| parents.get(lane).copied().flatten())
    {
        lanes.push(before);
    }
    lanes.reverse();
    Some(lanes)
}
