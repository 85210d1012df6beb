//! Conflicts between the connectors of a junction, and which one yields.

use super::network::{Conflict, Network};
use planagent_world::LaneId;
use planagent_world::geometry::Point;

/// Two paths nearer than this conflict, meters: the width of a vehicle and a margin.
const TOO_NEAR: f64 = 2.9;
/// Distance between samples, meters.
const SAMPLE: f64 = 1.0;

impl Network {
    /// Finds the conflicts between all connectors of each junction. Connectors that leave the same
    /// lane do not conflict: their drivers follow one another.
    pub(crate) fn find_conflicts(&mut self) {
        let samples: Vec<(LaneId, usize, u8, Vec<Point>)> = self
            .passages
            .iter()
            .enumerate()
            // Lines are sampled once for all pairs, since each is compared with every other of its
            // junction.
            .filter_map(|(i, passage)| {
                let passage = passage.as_ref()?;
                let id = LaneId(i as u32);
                let line = &self.parts.lanes[i].centerline;
                let count = (line.length() / SAMPLE) as usize;
                let points = (0..=count)
                    .map(|k| line.point_at(k as f64 * SAMPLE))
                    .collect();
                Some((id, passage.junction, passage.rank, points))
            })
            .collect();
        for (place, (a, junction, rank_a, line_a)) in samples.iter().enumerate() {
            for (b, _, rank_b, line_b) in samples[place + 1..]
                .iter()
                .filter(|other| other.1 == *junction)
            {
                if self.parts.lanes[a.index()].incoming == self.parts.lanes[b.index()].incoming {
                    continue;
                }
                let Some((own, others)) = near_parts(line_a, line_b) else {
                    continue;
                };
                let conflict = |other, own, others, yields| Conflict {
                    other,
                    own,
                    others,
                    yields,
                };
                if let Some(passage) = &mut self.passages[a.index()] {
                    passage
                        .conflicts
                        .push(conflict(*b, own, others, rank_a < rank_b));
                }
                if let Some(passage) = &mut self.passages[b.index()] {
                    passage
                        .conflicts
                        .push(conflict(*a, others, own, rank_b < rank_a));
                }
            }
        }
    }
}

/// The parts of two sampled lines that are too near to each other, as arc lengths on each.
fn near_parts(a: &[Point], b: &[Point]) -> Option<([f64; 2], [f64; 2])> {
    let (mut on_a, mut on_b) = (
        [f64::INFINITY, f64::NEG_INFINITY],
        [f64::INFINITY, f64::NEG_INFINITY],
    );
    let mut i = 0;
    while i < a.len() {
        let mut nearest = f64::INFINITY;
        for (j, q) in b.iter().enumerate() {
            let distance = (a[i] - q).norm();
            nearest = nearest.min(distance);
            if distance < TOO_NEAR {
                let (s, t) = (i as f64 * SAMPLE, j as f64 * SAMPLE);
                on_a = [on_a[0].min(s), on_a[1].max(s)];
                on_b = [on_b[0].min(t), on_b[1].max(t)];
            }
        }
        // The distance shrinks by at most one sample per sample, so strides skip the parts that are
        // far apart.
        i += ((nearest - TOO_NEAR) / SAMPLE).floor().max(1.0) as usize;
    }
    (on_a[0] <= on_a[1]).then_some((on_a, on_b))
}
