//! The route beyond the end of the recording, so that no plan ends where the recorded drive ends.

use planagent_world::geometry::{Pose, wrap_angle};
use planagent_world::{LaneId, LaneMap, RoadblockId};

/// Minimum length of the route beyond the last recorded pose, meters: a trajectory of 8 s, from
/// wherever a simulation of 15 s can have taken the ego.
/// Why: docs/decisions/110-routes-of-recordings.md.
const MIN_LENGTH: f64 = 200.0;
/// Time at the speed limit that the route covers beyond that pose, seconds.
const SECONDS: f64 = 20.0;
/// Length over which the turns of two successors are compared, meters: across an intersection.
/// Why: docs/decisions/110-routes-of-recordings.md.
const COMPARED: f64 = 30.0;
/// Maximum number of lanes over which they are compared.
const MAX_COMPARED: usize = 6;
/// Maximum number of lanes that are looked at for one successor. Those of a road are some tens; a
/// damaged map, in which all lanes follow each other, has a sixth power of their number.
const MAX_LOOKS: usize = 4096;

/// The roadblocks after `route`, which ends in the lane `last` with the recorded `pose`: through
/// the successors that need least turning, over the neighbor where the lane ends. They end with the
/// map, or where they would come back to the route.
pub(super) fn onward(
    map: &LaneMap,
    route: &[RoadblockId],
    last: LaneId,
    pose: Pose,
) -> Vec<RoadblockId> {
    let limit = map[last].speed_limit.unwrap_or(0.0);
    let mut left = MIN_LENGTH.max(SECONDS * limit);
    left -= map[last].centerline.length() - map[last].centerline.project(pose.position()).s;
    let mut blocks: Vec<RoadblockId> = Vec::new();
    let mut lane = last;
    while left > 0.0 {
        let Some(next) =
            successor(map, lane).or_else(|| successor(map, neighbor_that_goes_on(map, lane)?))
        else {
            break;
        };
        let block = map[next].roadblock;
        if route.contains(&block) || blocks.contains(&block) {
            break;
        }
        blocks.push(block);
        left -= map[next].centerline.length();
        lane = next;
    }
    blocks
}

/// The successor that needs least turning, the first of equals.
fn successor(map: &LaneMap, lane: LaneId) -> Option<LaneId> {
    let turn = |next: LaneId| {
        let mut looks = MAX_LOOKS;
        turning(map, next, COMPARED, MAX_COMPARED, &mut looks)
    };
    let turns = map[lane].outgoing.iter().map(|&next| (next, turn(next)));
    turns
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(next, _)| next)
}

/// A lane of the same roadblock beside the end of this one that leads on.
fn neighbor_that_goes_on(map: &LaneMap, lane: LaneId) -> Option<LaneId> {
    let (end, block) = (map[lane].centerline.length(), map[lane].roadblock);
    let beside = [map[lane].left_at(end), map[lane].right_at(end)]
        .into_iter()
        .flatten();
    beside
        .into_iter()
        .find(|&beside| map[beside].roadblock == block && !map[beside].outgoing.is_empty())
}

/// The least turning over the next `length` meters from the start of a lane on, radians. It looks at
/// `looks` lanes at most.
fn turning(map: &LaneMap, lane: LaneId, length: f64, lanes: usize, looks: &mut usize) -> f64 {
    *looks = looks.saturating_sub(1);
    let line = &map[lane].centerline;
    let here = wrap_angle(line.heading_at(length.min(line.length())) - line.heading_at(0.0)).abs();
    let rest = length - line.length();
    if rest <= 0.0 || lanes == 0 || *looks == 0 {
        return here;
    }
    let onward = map[lane]
        .outgoing
        .iter()
        .map(|&next| turning(map, next, rest, lanes - 1, looks));
    here + onward.min_by(f64::total_cmp).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_world::MapBuilder;
    use planagent_world::geometry::Point;

    fn line(points: &[(f64, f64)]) -> Vec<Point> {
        points.iter().map(|&(x, y)| Point::new(x, y)).collect()
    }

    /// A lane to the east (0), 100 m; behind it a lane that bends to the right (1) and one straight
    /// on (2), then two more of 100 m each (3, 4). Beside the last a lane (5) that leads to a sixth
    /// (6).
    fn road() -> LaneMap {
        let mut road = MapBuilder::default();
        for points in [
            &[(0.0, 0.0), (100.0, 0.0)][..],
            &[(100.0, 0.0), (115.0, -5.0), (120.0, -20.0)],
            &[(100.0, 0.0), (120.0, 0.0)],
            &[(120.0, 0.0), (220.0, 0.0)],
            &[(220.0, 0.0), (250.0, 0.0)],
            &[(220.0, 4.0), (250.0, 4.0)],
            &[(250.0, 4.0), (600.0, 4.0)],
        ] {
            road.lane(line(points), 3.5, Some(10.0)).unwrap();
        }
        road.connect_touching();
        road.abreast(&[LaneId(5), LaneId(4)]);
        road.finish().unwrap()
    }

    fn lanes(map: &LaneMap, blocks: &[RoadblockId]) -> Vec<u32> {
        blocks
            .iter()
            .flat_map(|&block| map[block].lanes.iter().map(|lane| lane.0))
            .collect()
    }

    #[test]
    fn the_route_goes_straight_on_for_200_m_and_over_a_neighbor_where_the_lane_ends() {
        let map = road();
        let from = |lane: u32, x: f64| {
            let route = [map[LaneId(lane)].roadblock];
            lanes(
                &map,
                &onward(&map, &route, LaneId(lane), Pose::new(x, 0.0, 0.0)),
            )
        };
        // 90 m are left of the first lane, and 110 m follow it.
        assert_eq!(from(0, 10.0), vec![2, 3]);
        // 200 m beyond this pose end within lane 6, which lane 4 reaches over its neighbor.
        assert_eq!(from(0, 90.0), vec![2, 3, 5, 4, 6]);
        assert_eq!(from(1, 118.0), Vec::<u32>::new());
    }

    #[test]
    fn a_circle_ends_where_it_comes_back_to_the_route() {
        let mut road = MapBuilder::default();
        let corners = [
            (0.0, 0.0),
            (30.0, 0.0),
            (30.0, 30.0),
            (0.0, 30.0),
            (0.0, 0.0),
        ];
        for side in corners.windows(2) {
            road.lane(line(side), 3.5, None).unwrap();
        }
        road.connect_touching();
        let map = road.finish().unwrap();
        let route = [map[LaneId(0)].roadblock, map[LaneId(1)].roadblock];
        assert_eq!(
            lanes(
                &map,
                &onward(&map, &route, LaneId(1), Pose::new(30.0, 10.0, 1.57))
            ),
            vec![2, 3]
        );
    }

    #[test]
    fn lanes_that_all_follow_each_other_are_compared_in_bounded_time() {
        let mut road = MapBuilder::default();
        let count: u32 = 100;
        for lane in 0..count {
            let y = f64::from(lane);
            road.lane(line(&[(0.0, y), (1.0, y)]), 3.5, Some(10.0))
                .unwrap();
        }
        for from in 0..count {
            for to in (0..count).filter(|&to| to != from) {
                road.connect(LaneId(from), LaneId(to));
            }
        }
        let map = road.finish().unwrap();
        assert_eq!(successor(&map, LaneId(0)), Some(LaneId(1)));
    }
}
