//! The position of an object relative to a centerline.

use super::{Centerline, Heading};
use planagent_world::geometry::{Corridor, OrientedBox, Polyline, Pose, Vector, wrap_angle};
use planagent_world::{ObjectKind, PACIFICA, TrackedObject};

/// Half a typical lane width: a center nearer to the centerline is on the lane, meters.
pub(crate) const HALF_LANE: f64 = 1.75;
/// Pedestrians count this much farther out, since they may step on the road, meters.
pub(crate) const KERB_MARGIN: f64 = 2.0;
/// Free space beside the ego, meters.
pub(crate) const SWEEP_MARGIN: f64 = 0.3;
/// Pedestrians and cyclists count at their positions within this time, seconds.
pub const CROSSING_SECONDS: f64 = 2.0;
/// Slower objects stand still, m/s.
pub(in crate::environment) const STANDING_SPEED: f64 = 0.5;

/// The position of an object relative to a centerline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::environment) struct LaneRelation {
    /// From the ego's center to its center along the line, meters.
    pub offset: f64,
    /// Of its center, meters, positive to the left.
    pub lateral: f64,
    /// From bumper to bumper along the line, meters; 0 when side by side.
    pub gap: f64,
    /// Whether its center is on the lane.
    pub on_lane: bool,
    /// Whether it is on the strip that the ego would sweep, or on foot or bicycle soon will be.
    pub blocks_path: bool,
    /// Velocity along the line, m/s.
    pub along_speed: f64,
    pub heading: Heading,
}

/// The part of a centerline around the ego on which objects count.
pub(in crate::environment) struct Window {
    line: Polyline,
    /// Arc length on `line` of the point at (or beside) the ego's center.
    ego_s: f64,
    sweep: Corridor,
}

impl Window {
    /// From `behind` meters behind to `ahead` meters ahead of the ego's center, within the path;
    /// `None` without a path there.
    pub(in crate::environment) fn new(
        centerline: &Centerline,
        behind: f64,
        ahead: f64,
    ) -> Option<Self> {
        let from = (centerline.ego_s - behind).max(0.0);
        let line = centerline
            .path
            .centerline
            .slice(from, centerline.ego_s + ahead)?;
        let sweep = Corridor::new(line.clone(), PACIFICA.width / 2.0 + SWEEP_MARGIN);
        Some(Self {
            line,
            ego_s: centerline.ego_s - from,
            sweep,
        })
    }

    /// The relation of an object; `None` when its box is completely before or after this part.
    pub(in crate::environment) fn project(&self, object: &TrackedObject) -> Option<LaneRelation> {
        let foot = self.line.project(object.shape.center.position());
        let along = Pose::at(foot.point, foot.heading);
        let extent = half_extent(&object.shape, foot.heading);
        let beyond = along.to_local(object.shape.center.position()).x.abs();
        let at_end = foot.s <= 0.0 || foot.s >= self.line.length();
        if at_end && beyond > extent {
            return None;
        }
        let offset = foot.s - self.ego_s;
        let kerb = if object.kind == ObjectKind::Pedestrian {
            KERB_MARGIN
        } else {
            0.0
        };
        let velocity = along_frame(&along, object.velocity);
        Some(LaneRelation {
            offset,
            lateral: foot.lateral,
            gap: (offset.abs() - extent - PACIFICA.length() / 2.0).max(0.0),
            on_lane: foot.lateral.abs() <= HALF_LANE + kerb,
            blocks_path: self.blocks(object),
            along_speed: velocity.x,
            heading: heading_of(velocity),
        })
    }

    fn blocks(&self, object: &TrackedObject) -> bool {
        /// Time between the tested positions, seconds: a pedestrian moves less than its own size.
        const STEP: f64 = 0.25;
        let steps = if object.kind.is_vulnerable() {
            (CROSSING_SECONDS / STEP) as u32
        } else {
            0
        };
        (0..=steps).any(|i| {
            let moved = object.velocity * (f64::from(i) * STEP);
            let center = Pose::at(
                object.shape.center.position() + moved,
                object.shape.center.heading,
            );
            self.sweep.meets_box(&object.shape.moved_to(center))
        })
    }
}

/// Half the extent of a box along a direction, meters.
pub(in crate::environment) fn half_extent(shape: &OrientedBox, heading: f64) -> f64 {
    let turn = wrap_angle(shape.center.heading - heading);
    f64::midpoint(
        shape.length * turn.cos().abs(),
        shape.width * turn.sin().abs(),
    )
}

fn along_frame(along: &Pose, velocity: Vector) -> Vector {
    let (sin, cos) = along.heading.sin_cos();
    Vector::new(
        cos * velocity.x + sin * velocity.y,
        cos * velocity.y - sin * velocity.x,
    )
}

fn heading_of(velocity: Vector) -> Heading {
    let angle = velocity.y.atan2(velocity.x).abs();
    if velocity.norm() < STANDING_SPEED || angle <= Heading::CROSSING {
        Heading::Along
    } else if angle <= Heading::ONCOMING {
        Heading::Crossing
    } else {
        Heading::Oncoming
    }
}
