//! The rows of a log: nuPlan's 20 Hz from a scenario's 10 Hz.
//!
//! Every frame is a row. Between two frames lies one more row: the interpolated ego, the
//! interpolated objects of both frames, and the lights of the earlier frame. The frames after the
//! end (`continuation`) follow in the same way. The devkit takes every second row, that is exactly
//! the frames. The tagged row is chosen by the devkit's own rule: its window is the scenario. Where
//! the window would reach beyond the end, the log ends with the scenario: the end of the log is
//! what cuts the window there.

use super::continuation::frames_after;
use crate::nuplan::extraction::{Extraction, ROWS_PER_STEP};
use crate::{Frame, Scenario};
use planagent_world::geometry::{Point, Pose, wrap_angle};
use planagent_world::{EgoState, TrackedObject, TrafficLights};
use std::collections::BTreeMap;
use std::sync::Arc;

/// One row of `lidar_pc` with its ego, boxes and lights.
#[derive(Debug, Clone)]
pub(super) struct Row {
    /// Its time is that of the row.
    pub(super) ego: EgoState,
    pub(super) objects: Arc<[TrackedObject]>,
    pub(super) lights: Arc<TrafficLights>,
}

/// The rows of a scenario, and its tagged row.
#[derive(Debug, Clone)]
pub(super) struct Timeline {
    /// In order of time.
    pub(super) rows: Vec<Row>,
    /// Index of the tagged row.
    pub(super) anchor: usize,
    /// Number of rows up to the last frame of the scenario; those after it are the continuation.
    pub(super) scenario_rows: usize,
    /// Number of recorded ego states after the last frame that nuPlan's window would include.
    pub(super) dropped_future_states: usize,
}

/// Why a scenario cannot be part of a nuPlan log.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum TimelineError {
    #[error("frame {frame} is {step_us} µs after the one before it; at least 2 µs are needed")]
    Step { frame: usize, step_us: i64 },
    /// No row has the scenario as its window.
    #[error(
        "no row has the scenario's {iterations} iterations in nuPlan's window of `{scenario_type}` ({duration_s} s from \
         {offset_s} s after the tagged row); give it another scenario type or cut it to that length"
    )]
    Window {
        scenario_type: String,
        iterations: usize,
        duration_s: i64,
        offset_s: i64,
    },
}

impl Timeline {
    pub(super) fn from_scenario(scenario: &Scenario) -> Result<Self, TimelineError> {
        let after = frames_after(scenario);
        let mut rows = rows(scenario.frames.iter().chain(&after))?;
        if let Some(anchor) = anchor(&rows, scenario) {
            let scenario_rows = rows.len() - after.len() * ROWS_PER_STEP;
            return Ok(Self {
                rows,
                anchor,
                scenario_rows,
                dropped_future_states: 0,
            });
        }
        rows.truncate(rows.len() - after.len() * ROWS_PER_STEP);
        let extraction = Extraction::for_type(&scenario.scenario_type);
        let anchor = anchor(&rows, scenario).ok_or_else(|| TimelineError::Window {
            scenario_type: scenario.scenario_type.clone(),
            iterations: scenario.iterations(),
            duration_s: extraction.duration_us / 1_000_000,
            offset_s: extraction.offset_us / 1_000_000,
        })?;
        Ok(Self {
            scenario_rows: rows.len(),
            rows,
            anchor,
            dropped_future_states: scenario.future.len(),
        })
    }
}

/// Index of the row whose window is the scenario.
fn anchor(rows: &[Row], scenario: &Scenario) -> Option<usize> {
    let extraction = Extraction::for_type(&scenario.scenario_type);
    let times: Vec<i64> = rows.iter().map(|row| row.ego.time_us).collect();
    let start = scenario.start * ROWS_PER_STEP;
    let wanted = (start, scenario.iterations());
    // Recorded times jitter: try the row nearest to the nominal time first, then those around it.
    let nominal = times.get(start)?.saturating_sub(extraction.offset_us);
    let mut candidates: Vec<usize> = (0..rows.len()).collect();
    candidates.sort_by_key(|&row| (times[row].abs_diff(nominal), row));
    candidates
        .into_iter()
        .find(|&row| selected(&times, row, extraction) == Some(wanted))
}

/// First row and number of rows that nuPlan takes around an anchor: every second row of the window,
/// both ends included.
fn selected(times: &[i64], anchor: usize, extraction: Extraction) -> Option<(usize, usize)> {
    let (from, to) = extraction.window(*times.get(anchor)?);
    let first = times.partition_point(|&time| time < from);
    let end = times.partition_point(|&time| time <= to);
    (first < end).then(|| (first, (end - first).div_ceil(ROWS_PER_STEP)))
}

fn rows<'a>(frames: impl Iterator<Item = &'a Frame>) -> Result<Vec<Row>, TimelineError> {
    let mut rows = Vec::new();
    let mut before: Option<&Frame> = None;
    for (index, frame) in frames.enumerate() {
        if let Some(before) = before.replace(frame) {
            let ego = ego_between(&before.ego, &frame.ego, index)?;
            rows.push(Row {
                ego,
                objects: objects_between(before, frame).into(),
                lights: before.lights.clone(),
            });
        }
        rows.push(Row {
            ego: frame.ego,
            objects: frame.objects.clone(),
            lights: frame.lights.clone(),
        });
    }
    Ok(rows)
}

/// The ego midway between two frames; `frame` is the index of the later one.
fn ego_between(a: &EgoState, b: &EgoState, frame: usize) -> Result<EgoState, TimelineError> {
    let step_us = b.time_us.saturating_sub(a.time_us);
    if step_us < 2 {
        return Err(TimelineError::Step { frame, step_us });
    }
    Ok(EgoState {
        time_us: a.time_us + step_us / 2,
        rear_axle: midway(a.rear_axle, b.rear_axle),
        velocity: a.velocity.lerp(&b.velocity, 0.5),
        acceleration: a.acceleration.lerp(&b.acceleration, 0.5),
        steering_angle: f64::midpoint(a.steering_angle, b.steering_angle),
        steering_rate: f64::midpoint(a.steering_rate, b.steering_rate),
        angular_velocity: f64::midpoint(a.angular_velocity, b.angular_velocity),
        angular_acceleration: f64::midpoint(a.angular_acceleration, b.angular_acceleration),
    })
}

/// The objects of both frames, midway between them.
fn objects_between(before: &Frame, after: &Frame) -> Vec<TrackedObject> {
    let later: BTreeMap<_, _> = after
        .objects
        .iter()
        .map(|object| (object.token, object))
        .collect();
    let between = before.objects.iter().filter_map(|object| {
        let next = later.get(&object.token)?;
        let center = midway(object.shape.center, next.shape.center);
        let shape = object.shape.moved_to(center);
        Some(TrackedObject {
            shape,
            velocity: object.velocity.lerp(&next.velocity, 0.5),
            ..*object
        })
    });
    between.collect()
}

fn midway(from: Pose, to: Pose) -> Pose {
    let turn = wrap_angle(to.heading - from.heading);
    let middle = Point::from(from.position().coords.lerp(&to.position().coords, 0.5));
    Pose::at(middle, wrap_angle(from.heading + turn / 2.0))
}

#[cfg(test)]
mod tests {
    use super::super::continuation::FRAMES_AFTER;
    use super::*;
    use crate::generator::{Spec, generate, types};
    use planagent_world::geometry::{OrientedBox, Vector};
    use planagent_world::{ObjectKind, TrackToken};
    use std::f64::consts::PI;

    fn frame(time_us: i64, heading: f64, tracks: &[u32]) -> Frame {
        let pose = Pose::new(time_us as f64 * 1e-5, 2.0, heading);
        let object = |&track: &u32| TrackedObject {
            token: TrackToken(track),
            kind: ObjectKind::Vehicle,
            shape: OrientedBox::new(pose.translated(10.0, 0.0), 4.0, 2.0),
            velocity: Vector::new(10.0, 0.0),
        };
        Frame {
            ego: EgoState::from_log(time_us, pose, Vector::new(10.0, 0.0), Vector::zeros()),
            objects: tracks.iter().map(object).collect(),
            lights: Arc::new(TrafficLights::default()),
        }
    }

    #[test]
    fn frames_stay_and_midpoints_lie_between() {
        let frames = [
            frame(0, PI - 0.1, &[1, 2]),
            frame(100_000, -PI + 0.1, &[2, 3]),
            frame(200_100, 0.0, &[]),
        ];
        let rows = rows(frames.iter()).unwrap();
        assert_eq!(
            rows.iter().map(|row| row.ego.time_us).collect::<Vec<_>>(),
            [0, 50_000, 100_000, 150_050, 200_100]
        );
        assert_eq!(rows[2].ego, frames[1].ego);
        assert!(
            (rows[1].ego.rear_axle.heading.abs() - PI).abs() < 1e-12,
            "{}",
            rows[1].ego.rear_axle.heading
        );
        assert!((rows[1].ego.rear_axle.x - 0.5).abs() < 1e-12);
        assert_eq!(
            rows[1]
                .objects
                .iter()
                .map(|o| o.token.0)
                .collect::<Vec<_>>(),
            [2]
        );
        assert!(rows[3].objects.is_empty());
        let back = [frame(0, 0.0, &[]), frame(1, 0.0, &[])];
        assert!(matches!(
            super::rows(back.iter()),
            Err(TimelineError::Step {
                frame: 1,
                step_us: 1
            })
        ));
    }

    #[test]
    fn the_window_around_the_anchor_is_the_scenario() {
        for (kind, apart, after) in [
            (types::changing_lane::TYPE, 60, FRAMES_AFTER * 2),
            (types::traversing_roundabout::TYPE, 0, 0),
        ] {
            let scenario = generate(&Spec::new(kind, 1)).unwrap();
            let timeline = Timeline::from_scenario(&scenario).unwrap();
            assert_eq!(timeline.anchor, scenario.start * 2 + apart);
            assert_eq!(timeline.scenario_rows, scenario.frames.len() * 2 - 1);
            assert_eq!(timeline.rows.len(), timeline.scenario_rows + after);
        }
    }

    #[test]
    fn a_window_that_nuplan_cannot_cut_is_an_error() {
        let mut scenario = generate(&Spec::new(types::changing_lane::TYPE, 1)).unwrap();
        scenario.future.clear();
        let cut =
            |scenario: &Scenario| Timeline::from_scenario(scenario).map(|timeline| timeline.anchor);
        scenario.frames.truncate(scenario.start + 31);
        assert_eq!(cut(&scenario), Ok((scenario.start + 30) * 2));
        scenario.frames.truncate(scenario.start + 20);
        assert!(matches!(
            cut(&scenario),
            Err(TimelineError::Window {
                iterations: 20,
                offset_s: -3,
                ..
            })
        ));
        scenario.scenario_type = "unknown".to_owned();
        assert_eq!(cut(&scenario), Ok(scenario.start * 2));
    }

    #[test]
    fn the_log_goes_on_where_the_window_does_not_reach_beyond_the_end() {
        let mut scenario = generate(&Spec::new(types::changing_lane::TYPE, 1)).unwrap();
        let last = scenario.frames.last().unwrap().ego;
        let later = |step: i64| EgoState {
            time_us: last.time_us + step * 100_000,
            ..last
        };
        scenario.future = vec![later(1), later(2)];
        let rows = scenario.frames.len() * 2 - 1;
        let timeline = Timeline::from_scenario(&scenario).unwrap();
        assert_eq!(
            (timeline.scenario_rows, timeline.dropped_future_states),
            (rows, 0)
        );
        assert_eq!(timeline.rows.len(), rows + FRAMES_AFTER * 2);
        assert_eq!(timeline.rows[rows].ego.time_us, last.time_us + 50_000);
        assert_eq!(timeline.rows[rows + 3].ego, later(2));
        assert_eq!(
            timeline.rows[rows + FRAMES_AFTER * 2 - 1].ego.time_us,
            last.time_us + 9_000_000
        );
        scenario.scenario_type = "unknown".to_owned();
        let timeline = Timeline::from_scenario(&scenario).unwrap();
        assert_eq!(
            (timeline.rows.len(), timeline.dropped_future_states),
            (rows, 2)
        );
    }
}
