//! Tracks of the ego, the agents and the lights.

use super::deltas::{Deltas, LENGTH};
use planagent_world::geometry::{OrientedBox, Pose, Vector, unwrap_angles};
use planagent_world::{
    EgoState, HistorySample, LaneId, ObjectKind, SignalStatus, TrackToken, TrackedObject,
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Unit of angles, radians.
const ANGLE: f64 = 0.001;
/// Unit of the ego's speed (m/s), acceleration (m/s²) and yaw rate (rad/s).
const RATE: f64 = 0.01;
/// Unit of the agents' velocities, m/s.
const VELOCITY: f64 = 0.1;

/// Poses in order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Poses {
    x: Deltas,
    y: Deltas,
    heading: Deltas,
}

impl Poses {
    fn from_poses(poses: &[Pose]) -> Self {
        let headings: Vec<f64> = poses.iter().map(|pose| pose.heading).collect();
        Self {
            x: Deltas::from_values(poses.iter().map(|pose| pose.x), LENGTH),
            y: Deltas::from_values(poses.iter().map(|pose| pose.y), LENGTH),
            heading: Deltas::from_values(unwrap_angles(&headings), ANGLE),
        }
    }

    fn poses(&self) -> impl Iterator<Item = Pose> + '_ {
        let places = self.x.values(LENGTH).zip(self.y.values(LENGTH));
        places
            .zip(self.heading.values(ANGLE))
            .map(|((x, y), heading)| Pose::new(x, y, heading))
    }
}

/// The ego at all samples: its rear axle, and its motion in its own frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct EgoTrack {
    #[serde(flatten)]
    poses: Poses,
    /// Forward speed.
    speed: Deltas,
    /// Forward acceleration.
    acceleration: Deltas,
    /// Yaw rate.
    yaw_rate: Deltas,
}

impl EgoTrack {
    /// The ego of these samples.
    pub(super) fn from_samples(samples: &[HistorySample]) -> Self {
        let poses: Vec<Pose> = samples.iter().map(|sample| sample.ego.rear_axle).collect();
        let along = |of: fn(&EgoState) -> f64| {
            Deltas::from_values(samples.iter().map(|sample| of(&sample.ego)), RATE)
        };
        Self {
            poses: Poses::from_poses(&poses),
            speed: along(|ego| ego.velocity.x),
            acceleration: along(|ego| ego.acceleration.x),
            yaw_rate: along(|ego| ego.angular_velocity),
        }
    }

    /// The states; steering and lateral motion are not stored.
    pub(super) fn states(&self) -> impl Iterator<Item = EgoState> + '_ {
        let rates = self
            .speed
            .values(RATE)
            .zip(self.acceleration.values(RATE))
            .zip(self.yaw_rate.values(RATE));
        self.poses
            .poses()
            .zip(rates)
            .map(|(rear_axle, ((speed, acceleration), yaw_rate))| EgoState {
                time_us: 0,
                rear_axle,
                velocity: Vector::new(speed, 0.0),
                acceleration: Vector::new(acceleration, 0.0),
                steering_angle: 0.0,
                steering_rate: 0.0,
                angular_velocity: yaw_rate,
                angular_acceleration: 0.0,
            })
    }
}

/// An object during consecutive samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct AgentTrack {
    token: TrackToken,
    kind: ObjectKind,
    /// Whole centimeters, at the first sample.
    length: i64,
    width: i64,
    /// The first sample.
    from: usize,
    /// Center of its box.
    #[serde(flatten)]
    poses: Poses,
    /// Velocity, map frame.
    vx: Deltas,
    vy: Deltas,
}

impl AgentTrack {
    /// The objects of these samples that come within `reach` meters of the ego, by token.
    pub(super) fn all(samples: &[HistorySample], reach: f64) -> Vec<Self> {
        let mut open: BTreeMap<TrackToken, (usize, Vec<TrackedObject>)> = BTreeMap::new();
        let mut ended = Vec::new();
        for (i, sample) in samples.iter().enumerate() {
            for object in sample.objects.iter() {
                let (from, seen) = open.entry(object.token).or_insert_with(|| (i, Vec::new()));
                if *from + seen.len() < i {
                    ended.push((*from, std::mem::take(seen)));
                    *from = i;
                }
                // A token that occurs twice in one sample would shift the later samples.
                if *from + seen.len() == i {
                    seen.push(*object);
                }
            }
        }
        ended.extend(open.into_values());
        let near = |from: usize, seen: &[TrackedObject]| {
            let egos = samples.iter().skip(from).map(|sample| sample.ego.rear_axle);
            seen.iter()
                .zip(egos)
                .any(|(object, ego)| object.shape.center.distance(&ego) <= reach)
        };
        let mut tracks: Vec<Self> = ended
            .into_iter()
            .filter(|(from, seen)| near(*from, seen))
            .filter_map(|(f, s)| Self::from_objects(f, &s))
            .collect();
        tracks.sort_by_key(|track| (track.token, track.from));
        tracks
    }

    fn from_objects(from: usize, seen: &[TrackedObject]) -> Option<Self> {
        let first = seen.first()?;
        let poses: Vec<Pose> = seen.iter().map(|object| object.shape.center).collect();
        let whole = |meters: f64| (meters / LENGTH).round() as i64;
        Some(Self {
            token: first.token,
            kind: first.kind,
            length: whole(first.shape.length),
            width: whole(first.shape.width),
            from,
            poses: Poses::from_poses(&poses),
            vx: Deltas::from_values(seen.iter().map(|object| object.velocity.x), VELOCITY),
            vy: Deltas::from_values(seen.iter().map(|object| object.velocity.y), VELOCITY),
        })
    }

    /// The object at each of its samples.
    pub(super) fn objects(&self) -> impl Iterator<Item = (usize, TrackedObject)> + '_ {
        let velocities = self.vx.values(VELOCITY).zip(self.vy.values(VELOCITY));
        let (length, width) = (self.length as f64 * LENGTH, self.width as f64 * LENGTH);
        self.poses
            .poses()
            .zip(velocities)
            .enumerate()
            .map(move |(i, (pose, (vx, vy)))| {
                let shape = OrientedBox::new(pose, length, width);
                let object = TrackedObject {
                    token: self.token,
                    kind: self.kind,
                    shape,
                    velocity: Vector::new(vx, vy),
                };
                // The first sample may be any number: a replay may come from elsewhere.
                (self.from.saturating_add(i), object)
            })
    }
}

/// The light of a connector: the samples of its changes, and its new status; none where no light is
/// recorded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct LightTrack {
    lane: LaneId,
    changes: Vec<(usize, Option<SignalStatus>)>,
}

impl LightTrack {
    /// The lights of `lanes`; `status` gives them by sample.
    pub(super) fn all(
        lanes: impl Iterator<Item = LaneId>,
        samples: usize,
        status: impl Fn(usize, LaneId) -> Option<SignalStatus>,
    ) -> Vec<Self> {
        let track = |lane: LaneId| {
            let mut changes: Vec<(usize, Option<SignalStatus>)> = Vec::new();
            for i in 0..samples {
                let now = status(i, lane);
                if changes
                    .last()
                    .map_or(now.is_some(), |(_, last)| *last != now)
                {
                    changes.push((i, now));
                }
            }
            (!changes.is_empty()).then_some(Self { lane, changes })
        };
        lanes.filter_map(track).collect()
    }

    /// The connector.
    pub(super) fn lane(&self) -> LaneId {
        self.lane
    }

    /// The status at a sample; none where no light is recorded.
    pub(super) fn at(&self, sample: usize) -> Option<SignalStatus> {
        self.changes
            .iter()
            .take_while(|(from, _)| *from <= sample)
            .last()
            .and_then(|(_, status)| *status)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    fn ego(x: f64) -> EgoState {
        EgoState {
            time_us: 0,
            rear_axle: Pose::new(x, 0.0, 0.0),
            velocity: Vector::new(5.0, 0.0),
            acceleration: Vector::zeros(),
            steering_angle: 0.0,
            steering_rate: 0.0,
            angular_velocity: 0.0,
            angular_acceleration: 0.0,
        }
    }

    fn car(token: u32, x: f64) -> TrackedObject {
        let shape = OrientedBox::new(Pose::new(x, 3.5, 3.1), 4.5, 1.9);
        TrackedObject {
            token: TrackToken(token),
            kind: ObjectKind::Vehicle,
            shape,
            velocity: Vector::new(1.0, 0.0),
        }
    }

    #[test]
    fn objects_keep_their_places_and_gaps() {
        let seen: [&[TrackedObject]; 4] = [
            &[car(1, 10.0), car(7, 500.0)],
            &[car(1, 11.0), car(2, 20.0)],
            &[car(2, 21.0)],
            &[car(1, 13.0)],
        ];
        let samples: Vec<HistorySample> = seen
            .iter()
            .enumerate()
            .map(|(i, objects)| HistorySample {
                ego: ego(i as f64),
                objects: Arc::from(*objects),
            })
            .collect();
        let tracks = AgentTrack::all(&samples, 100.0);
        let spans: Vec<(u32, usize, usize)> = tracks
            .iter()
            .map(|t| (t.token.0, t.from, t.objects().count()))
            .collect();
        assert_eq!(spans, [(1, 0, 2), (1, 3, 1), (2, 1, 2)]);
        let (sample, object) = tracks[2].objects().nth(1).unwrap();
        assert_eq!(sample, 2);
        assert!(
            (object.shape.center.x - 21.0).abs() < 1e-9 && (object.shape.length - 4.5).abs() < 1e-9
        );
        let states: Vec<EgoState> = EgoTrack::from_samples(&samples).states().collect();
        assert!(states.len() == 4 && (states[3].rear_axle.x - 3.0).abs() < 1e-9);
    }

    #[test]
    fn a_light_is_stored_when_it_changes() {
        let shown = [
            None,
            Some(SignalStatus::Red),
            Some(SignalStatus::Red),
            Some(SignalStatus::Green),
            None,
        ];
        let lights = LightTrack::all(
            [LaneId(3), LaneId(4)].into_iter(),
            shown.len(),
            |i, lane| {
                if lane == LaneId(3) { shown[i] } else { None }
            },
        );
        let changes = vec![
            (1, Some(SignalStatus::Red)),
            (3, Some(SignalStatus::Green)),
            (4, None),
        ];
        assert_eq!(
            lights,
            [LightTrack {
                lane: LaneId(3),
                changes
            }]
        );
        let [light] = lights.as_slice() else {
            panic!("{lights:?}")
        };
        assert_eq!(
            (0..shown.len()).map(|i| light.at(i)).collect::<Vec<_>>(),
            shown
        );
    }
}
