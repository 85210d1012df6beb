//! Roundabouts: a ring of short one-way roads, and at each arm a junction with entries, exits and
//! the ring.

use super::junction::{Arm, curb};
use super::line::{arc, connection};
use super::network::{Network, Passage, RoadIndex, RoadPlan};
use planagent_world::LaneId;
use planagent_world::geometry::{GeometryError, Point, Polygon, Pose, wrap_angle};
use std::f64::consts::{FRAC_PI_2, PI};

/// Parameters of a ring.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ring {
    pub(crate) center: Point,
    /// Radius of the island, meters.
    pub(crate) island: f64,
    /// Circulating lanes.
    pub(crate) lanes: usize,
    /// Meters.
    pub(crate) lane_width: f64,
    /// m/s.
    pub(crate) speed_limit: f64,
    /// Half the angle of the ring that an arm's junction takes, radians.
    pub(crate) half_opening: f64,
}

/// Paved apron of the ring, outside and inside, meters.
const APRON: [f64; 2] = [0.4, 1.2];
/// Right of way on the ring and at its entries.
const RANK_ON_RING: u8 = 2;
const RANK_ENTRY: u8 = 1;

impl Ring {
    /// Pose on the inner line at an angle from the center, in the counter-clockwise driving
    /// direction.
    fn inner(&self, angle: f64) -> Pose {
        let radial = Pose::at(self.center, angle);
        Pose::at(
            radial.to_map(Point::new(self.island, 0.0)),
            wrap_angle(angle + FRAC_PI_2),
        )
    }

    /// Radius of the outer edge of the circulating lanes, meters.
    pub(crate) fn outer(&self) -> f64 {
        self.island + self.lanes as f64 * self.lane_width
    }
}

impl Network {
    /// Adds a roundabout between arms in counter-clockwise order. Gives the roads of the ring, the
    /// n-th from the n-th arm to the next.
    pub(crate) fn circle(
        &mut self,
        ring: &Ring,
        arms: &[Arm],
    ) -> Result<Vec<RoadIndex>, GeometryError> {
        let angles: Vec<f64> = arms
            .iter()
            .map(|&arm| {
                let out = self.mouth(arm).position() - ring.center;
                out.y.atan2(out.x)
            })
            .collect();
        let mut around = Vec::with_capacity(arms.len());
        for (i, &angle) in angles.iter().enumerate() {
            let next = angles[(i + 1) % angles.len()];
            let sweep = (next - angle).rem_euclid(2.0 * PI) - 2.0 * ring.half_opening;
            let line = arc(ring.inner(angle + ring.half_opening), ring.island, sweep);
            around.push(self.add_road(RoadPlan {
                line,
                forward: ring.lanes,
                backward: 0,
                lane_width: ring.lane_width,
                extra: None,
                speed_limit: ring.speed_limit,
                shoulder: APRON,
            })?);
        }
        for (i, (&arm, &angle)) in arms.iter().zip(&angles).enumerate() {
            let (before, after) = (around[(i + arms.len() - 1) % arms.len()], around[i]);
            let area = self.ring_arm_area(ring, arm, angle)?;
            let junction = self.add_junction(area, vec![arm.road, before, after]);
            let passage = |rank| Passage {
                junction,
                rank,
                stop_sign: false,
                conflicts: Vec::new(),
            };
            let (from, to) = (
                self.roads[before].forward.clone(),
                self.roads[after].forward.clone(),
            );
            let (arriving, leaving) = (self.arriving(arm).to_vec(), self.leaving(arm).to_vec());
            for (&a, &b) in from.iter().zip(&to) {
                let start = self.end_of(a);
                let radius = (start.position() - ring.center).norm();
                self.connect(
                    a,
                    b,
                    &arc(start, radius, 2.0 * ring.half_opening),
                    passage(RANK_ON_RING),
                )?;
            }
            // Vehicles on the ring go first: an exit ranks as the ring, an entry below it.
            let exits = side_by_side(&from, &leaving)
                .into_iter()
                .map(|pair| (pair, RANK_ON_RING));
            let entries = side_by_side(&arriving, &to)
                .into_iter()
                .map(|pair| (pair, RANK_ENTRY));
            for ((a, b), rank) in exits.chain(entries) {
                let line = connection(self.end_of(a), self.start_of(b));
                self.connect(a, b, &line, passage(rank))?;
            }
        }
        Ok(around)
    }

    /// Pavement where an arm meets the ring: the strip of the ring and the funnel to the arm's
    /// mouth.
    fn ring_arm_area(&self, ring: &Ring, arm: Arm, angle: f64) -> Result<Polygon, GeometryError> {
        /// Overlap with the ring's roads and the arm against gaps at the seam, meters.
        const SEAM: f64 = 0.05;
        let reach = ring.half_opening + SEAM / ring.outer();
        let outer = ring.outer() + APRON[0];
        let (first, last) = (ring.inner(angle - reach), ring.inner(angle + reach));
        let offset = ring.island - outer;
        // Both edges face away from the junction: back along the ring before the arm, forward along
        // it after the arm.
        let before = first.translated(0.0, offset);
        let before = Pose::new(before.x, before.y, wrap_angle(before.heading + PI));
        let after = last.translated(0.0, offset);
        let ([right, left], mouth) = (self.edges(arm), self.mouth(arm));
        let (right, left) = (mouth.translated(SEAM, -right), mouth.translated(SEAM, left));
        let mut outline = vec![before.position()];
        outline.extend(curb(before, right));
        outline.push(right.position());
        outline.push(left.position());
        outline.extend(curb(left, after));
        outline.push(after.position());
        let start = first.translated(0.0, APRON[1]);
        let strip = arc(start, ring.island - APRON[1], 2.0 * reach);
        outline.extend(strip.iter().rev().map(Pose::position));
        Polygon::new(outline)
    }
}

/// Pairs of lanes of two roads, outermost with outermost. The wider road's inner lanes share the
/// last partner.
fn side_by_side(from: &[LaneId], to: &[LaneId]) -> Vec<(LaneId, LaneId)> {
    if from.is_empty() || to.is_empty() {
        return Vec::new();
    }
    let count = from.len().max(to.len());
    let right_aligned = |list: &[LaneId], k: usize| {
        list[(list.len() + k).saturating_sub(count).min(list.len() - 1)]
    };
    (0..count)
        .map(|k| (right_aligned(from, k), right_aligned(to, k)))
        .collect()
}
