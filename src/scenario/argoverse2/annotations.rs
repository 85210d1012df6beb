//! Annotated boxes of a sensor log: `annotations.feather`, or `annotations_with_ego.feather` of the
//! scenario-mining challenge.
//!
//! * Boxes are in the ego frame of their sweep (10 Hz). The ego's pose at that time moves them to
//!   the map frame.
//! * The dataset has no velocities. An agent's is the slope of its box center over five sweeps
//!   (`recording::motion`), fewer at the ends of its track and at gaps. A track of a single sweep
//!   stands. Static kinds have none, as in nuPlan.
//! * Sweeps without an annotation are not in the table. A gap of a tenth of a second or more is an
//!   error.

use super::category::{Meaning, of_annotation};
use super::error::LogFault;
use super::poses::{heading, isometries};
use super::table::{Table, in_range};
use crate::recording::motion::{MAX_BOX, slopes};
use nalgebra::Isometry3;
use planagent_world::geometry::{OrientedBox, Point, Pose, Vector};
use planagent_world::{ObjectKind, TrackToken, TrackedObject};
use std::collections::{BTreeMap, BTreeSet};

/// A box in the map frame at a sweep.
#[derive(Debug, Clone, Copy)]
struct SweepBox {
    /// Index of the sweep.
    sweep: usize,
    kind: ObjectKind,
    shape: OrientedBox,
}

#[derive(Debug)]
pub(super) struct Annotations {
    /// Boxes of each track in order of time; tracks in order of their uuid.
    tracks: Vec<Vec<SweepBox>>,
}

/// The table, with boxes in the ego frame.
struct Rows {
    times_ns: Vec<i64>,
    tracks: Vec<String>,
    kinds: Vec<Meaning>,
    boxes: Vec<Isometry3<f64>>,
    lengths: Vec<f64>,
    widths: Vec<f64>,
}

impl Rows {
    fn read(table: &Table) -> Result<Self, LogFault> {
        let words = table.words("category")?;
        let kinds = words.into_iter().enumerate().map(|(row, word)| {
            of_annotation(&word).ok_or_else(|| LogFault::Category {
                column: "category",
                row,
                word,
            })
        });
        Ok(Self {
            times_ns: table.integers("timestamp_ns")?,
            tracks: table.words("track_uuid")?,
            kinds: kinds.collect::<Result<_, _>>()?,
            boxes: isometries(table)?,
            lengths: sizes(table, "length_m")?,
            widths: sizes(table, "width_m")?,
        })
    }
}

fn sizes(table: &Table, column: &'static str) -> Result<Vec<f64>, LogFault> {
    in_range(column, table.numbers(column)?, |size| {
        size > 0.0 && size <= MAX_BOX
    })
}

/// Times of the sweeps in order, ns.
pub(super) fn sweeps(table: &Table) -> Result<Vec<i64>, LogFault> {
    let times: BTreeSet<i64> = table.integers("timestamp_ns")?.into_iter().collect();
    Ok(times.into_iter().collect())
}

impl Annotations {
    /// Reads the table and moves every box to the map frame. `sweeps_ns` are the sweeps of the
    /// table in order, `egos` the ego frames in the city frame at them. `origin` becomes the point
    /// (0, 0).
    pub(super) fn read(
        table: &Table,
        sweeps_ns: &[i64],
        egos: &[Isometry3<f64>],
        origin: Vector,
    ) -> Result<Self, LogFault> {
        let rows = Rows::read(table)?;
        let mut tracks: BTreeMap<&str, BTreeMap<usize, SweepBox>> = BTreeMap::new();
        for (row, track) in rows.tracks.iter().enumerate() {
            let Meaning::Object(kind) = rows.kinds[row] else {
                continue;
            };
            // `sweeps_ns` are the table's own times, so the search finds every row's exactly.
            let sweep = sweeps_ns.partition_point(|&time| time < rows.times_ns[row]);
            let place = egos[sweep] * rows.boxes[row];
            let center = Point::new(
                place.translation.x - origin.x,
                place.translation.y - origin.y,
            );
            let shape = OrientedBox::new(
                Pose::at(center, heading(&place)),
                rows.lengths[row],
                rows.widths[row],
            );
            if tracks
                .entry(track)
                .or_default()
                .insert(sweep, SweepBox { sweep, kind, shape })
                .is_some()
            {
                return Err(LogFault::Twice {
                    row,
                    track: track.clone(),
                });
            }
        }
        let tracks = tracks
            .into_values()
            .map(|track| track.into_values().collect())
            .collect();
        Ok(Self { tracks })
    }

    /// Objects of every sweep in order of track. `seconds` are the times of the sweeps.
    pub(super) fn objects(&self, seconds: &[f64]) -> Vec<Vec<TrackedObject>> {
        let mut objects: Vec<Vec<TrackedObject>> = vec![Vec::new(); seconds.len()];
        for (number, track) in self.tracks.iter().enumerate() {
            for run in track.chunk_by(|before, after| after.sweep == before.sweep + 1) {
                let times: Vec<f64> = run.iter().map(|state| seconds[state.sweep]).collect();
                let velocities = slopes(
                    &times,
                    run.iter().map(|state| state.shape.center.position().coords),
                );
                for (&SweepBox { sweep, kind, shape }, moving) in run.iter().zip(velocities) {
                    let velocity = if kind.is_agent() {
                        moving
                    } else {
                        Vector::zeros()
                    };
                    objects[sweep].push(TrackedObject {
                        token: TrackToken(number as u32),
                        kind,
                        shape,
                        velocity,
                    });
                }
            }
        }
        objects
    }
}
