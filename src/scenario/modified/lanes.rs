//! Places relative to the ego's lane.

use super::fault::Fault;
use planagent_world::geometry::{Point, Polyline, Pose, wrap_angle};
use planagent_world::{EgoState, LaneId, LaneMap, LanePath, Route};
use serde::{Deserialize, Deserializer, de};
use std::collections::BTreeSet;
use std::f64::consts::FRAC_PI_2;
use std::fmt;

/// Length of the ego's path, meters.
const PATH_LENGTH: f64 = 400.0;
/// Maximum distance to the lane of an ego that is beside all lanes, meters.
const LANE_REACH: f64 = 3.0;
/// Oncoming lanes are looked for up to this distance to the left of the ego's lane, and in these
/// steps, meters.
const ONCOMING_REACH: f64 = 22.0;
const ONCOMING_STEP: f64 = 0.5;

/// A lane, counted from the ego's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum LanePlace {
    /// The ego's lane.
    #[default]
    Own,
    /// This number of lanes to the left; negative: to the right.
    Beside(i32),
    /// The nearest lane of the other direction.
    Oncoming,
}

impl fmt::Display for LanePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Own => f.write_str("0"),
            Self::Beside(lanes) => write!(f, "{lanes}"),
            Self::Oncoming => f.write_str("\"oncoming\""),
        }
    }
}

impl<'de> Deserialize<'de> for LanePlace {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // A visitor of our own, because serde's untagged enums lose the reason why a value is
        // refused.
        struct Reader;

        impl de::Visitor<'_> for Reader {
            type Value = LanePlace;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(
                    "a whole number of lanes to the left (negative: to the right), or \"oncoming\"",
                )
            }

            fn visit_i64<E: de::Error>(self, lanes: i64) -> Result<LanePlace, E> {
                match i32::try_from(lanes) {
                    Ok(0) => Ok(LanePlace::Own),
                    Ok(lanes) if lanes.abs() <= 8 => Ok(LanePlace::Beside(lanes)),
                    _ => Err(E::invalid_value(de::Unexpected::Signed(lanes), &self)),
                }
            }

            fn visit_str<E: de::Error>(self, word: &str) -> Result<LanePlace, E> {
                match word {
                    "own" => Ok(LanePlace::Own),
                    "oncoming" => Ok(LanePlace::Oncoming),
                    _ => Err(E::invalid_value(de::Unexpected::Str(word), &self)),
                }
            }
        }

        deserializer.deserialize_any(Reader)
    }
}

/// A place on a lane.
#[derive(Debug, Clone, Copy)]
pub(super) struct OnLane {
    pub(super) lane: LaneId,
    /// On its centerline, in its direction.
    pub(super) pose: Pose,
}

/// The ego's lane and the lanes beside it.
#[derive(Debug)]
pub(super) struct EgoLanes {
    /// The ego's lane and what follows on the route.
    pub(super) path: LanePath,
    /// The ego's center on that path, meters.
    pub(super) start_s: f64,
}

impl EgoLanes {
    /// The lanes around the ego; `None` where it is on no lane.
    pub(super) fn from_route(map: &LaneMap, route: &Route, ego: &EgoState) -> Option<Self> {
        let center = ego.center();
        let on_route: Vec<LaneId> = map
            .lanes_at(center.position())
            .into_iter()
            .filter(|&lane| route.contains(map[lane].roadblock))
            .collect();
        let lane = map
            .best_fit(&on_route, center)
            .or_else(|| map.lane_of(center, LANE_REACH))?;
        let path = LanePath::along(map, route, lane, PATH_LENGTH);
        let start_s = path.centerline.project(center.position()).s;
        Some(Self { path, start_s })
    }

    /// The path's pose `ahead_m` ahead of the ego's center.
    pub(super) fn ahead(&self, ahead_m: f64) -> Result<Pose, Fault> {
        let (s, end) = (self.start_s + ahead_m, self.path.centerline.length());
        if (0.0..end).contains(&s) {
            return Ok(self.path.centerline.pose_at(s));
        }
        let (behind, ahead) = (self.start_s, end - self.start_s);
        Err(Fault::new(
            "ahead_m",
            format!(
                "{ahead_m:.1} is not on the ego's path, which is from -{behind:.1} to {ahead:.1}"
            ),
        ))
    }

    /// From the ego's center along its path to the next lane connector, meters; 0 on one. `None`
    /// where the path has none.
    pub(super) fn to_intersection(&self, map: &LaneMap) -> Option<f64> {
        let ends = self
            .path
            .starts
            .iter()
            .skip(1)
            .copied()
            .chain([self.path.centerline.length()]);
        let mut lanes = self.path.lanes.iter().zip(&self.path.starts).zip(ends);
        let ((_, &start), _) =
            lanes.find(|&((&lane, _), end)| map[lane].is_connector() && end > self.start_s)?;
        Some((start - self.start_s).max(0.0))
    }

    /// The place on a lane `ahead_m` ahead of the ego's center.
    pub(super) fn place(
        &self,
        map: &LaneMap,
        ahead_m: f64,
        lane: LanePlace,
    ) -> Result<OnLane, Fault> {
        let pose = self.ahead(ahead_m)?;
        let own = self.path.lane_at(self.start_s + ahead_m);
        let found = match lane {
            LanePlace::Own => Some(OnLane { lane: own, pose }),
            LanePlace::Beside(lanes) => beside(map, own, pose.position(), lanes),
            LanePlace::Oncoming => self.oncoming(map, ahead_m)?.first().copied(),
        };
        found.ok_or_else(|| {
            Fault::new(
                "lane",
                format!("there is no lane {lane} at {ahead_m:.1} m ahead of the ego"),
            )
        })
    }

    /// The lanes of the ego's direction at a place: from the right to the left.
    pub(super) fn own_direction(&self, map: &LaneMap, ahead_m: f64) -> Result<Vec<OnLane>, Fault> {
        let point = self.ahead(ahead_m)?.position();
        let own = self.path.lane_at(self.start_s + ahead_m);
        let (mut rightmost, mut steps) = (own, 0);
        while let Some(next) = beside(map, own, point, steps - 1) {
            if steps < -8 || next.lane == rightmost {
                break;
            }
            (rightmost, steps) = (next.lane, steps - 1);
        }
        Ok((steps..steps + 9)
            .map_while(|lanes| beside(map, own, point, lanes))
            .collect())
    }

    /// The lanes of the other direction at a place, the nearest first.
    pub(super) fn oncoming(&self, map: &LaneMap, ahead_m: f64) -> Result<Vec<OnLane>, Fault> {
        let pose = self.ahead(ahead_m)?;
        let steps = (ONCOMING_REACH / ONCOMING_STEP) as u32;
        let (mut seen, mut found) = (BTreeSet::new(), Vec::new());
        for step in 1..=steps {
            let point = pose.to_map(Point::new(0.0, f64::from(step) * ONCOMING_STEP));
            for lane in map.lanes_at(point) {
                let there = map[lane].centerline.nearest_pose(point);
                let is_against = wrap_angle(there.heading - pose.heading).abs() > FRAC_PI_2 * 1.6;
                if is_against && !map[lane].is_connector() && seen.insert(lane) {
                    found.push(OnLane { lane, pose: there });
                }
            }
        }
        Ok(found)
    }
}

/// The lane that is `lanes` lanes to the left of one at a point.
fn beside(map: &LaneMap, lane: LaneId, point: Point, lanes: i32) -> Option<OnLane> {
    map.beside(lane, point, lanes)
        .map(|(lane, pose)| OnLane { lane, pose })
}

/// A line of whole lanes, and the progress of a point on it. It reaches `reach` meters behind and
/// ahead of the point, or to the end of the road. It has no lane with a traffic light, and nothing
/// beyond one.
pub(super) fn whole_lanes(
    map: &LaneMap,
    lane: LaneId,
    point: Point,
    reach: f64,
) -> (Polyline, f64) {
    let bend = |lane: &LaneId| map[*lane].centerline.curvature_at(0.0).abs();
    let open = |lanes: &[LaneId]| -> Option<LaneId> {
        let before_lights = lanes
            .iter()
            .copied()
            .take_while(|&lane| !map[lane].has_traffic_lights);
        before_lights.min_by(|a, b| bend(a).total_cmp(&bend(b)))
    };
    // `seen` ends the walk where lanes form a ring.
    let (mut line, mut seen) = (map[lane].centerline.clone(), BTreeSet::from([lane]));
    let mut last = lane;
    while line.length() - line.project(point).s < reach {
        let Some(next) = open(&map[last].outgoing).filter(|lane| seen.insert(*lane)) else {
            break;
        };
        line = line.joined(&map[next].centerline);
        last = next;
    }
    let mut first = lane;
    while line.project(point).s < reach {
        let Some(before) = open(&map[first].incoming).filter(|lane| seen.insert(*lane)) else {
            break;
        };
        line = map[before].centerline.joined(&line);
        first = before;
    }
    let s = line.project(point).s;
    (line, s)
}

/// A line along a lane, `behind` and `ahead` meters from a point as far as lanes go, with the
/// progress of the point. Of several lanes before and after, the one that bends least at its start.
pub(super) fn through(
    map: &LaneMap,
    lane: LaneId,
    point: Point,
    behind: f64,
    ahead: f64,
) -> (Polyline, f64) {
    let bend = |lane: &LaneId| map[*lane].centerline.curvature_at(0.0).abs();
    let straightest = |lanes: &[LaneId]| {
        lanes
            .iter()
            .copied()
            .min_by(|a, b| bend(a).total_cmp(&bend(b)))
    };
    let mut line = map[lane].centerline.clone();
    // A ring of lanes would never end the walks below.
    let mut seen = BTreeSet::from([lane]);
    let mut first = lane;
    while line.project(point).s < behind {
        let Some(before) = straightest(&map[first].incoming).filter(|lane| seen.insert(*lane))
        else {
            break;
        };
        line = map[before].centerline.joined(&line);
        first = before;
    }
    let mut last = lane;
    while line.length() - line.project(point).s < ahead {
        let Some(next) = straightest(&map[last].outgoing).filter(|lane| seen.insert(*lane)) else {
            break;
        };
        line = line.joined(&map[next].centerline);
        last = next;
    }
    let s = line.project(point).s;
    let (from, to) = ((s - behind).max(0.0), (s + ahead).min(line.length()));
    match line.slice(from, to) {
        Some(part) => (part, s - from),
        None => (line, s),
    }
}
