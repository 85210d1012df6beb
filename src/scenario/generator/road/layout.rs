//! Lays roads one after another along the ego's route.

use super::junction::{Arm, Control, End, Turn};
use super::line::{bend, straight, trace};
use super::network::{ExtraWidths, Network, RoadIndex, RoadPlan, band};
use super::roundabout::Ring;
use crate::generator::rng::SeededRng;
use planagent_world::geometry::{GeometryError, Point, Polygon, Pose, wrap_angle};
use std::f64::consts::{FRAC_PI_2, PI};

/// Maximum turn of a road's bend, radians.
const MAX_TURN: f64 = 0.9;

/// Cross-section and speed limit of a road.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoadStyle {
    /// Lanes in the ego's direction.
    pub(crate) own: usize,
    /// Oncoming lanes.
    pub(crate) oncoming: usize,
    /// Meters.
    pub(crate) lane_width: f64,
    /// How much wider single lanes are.
    pub(crate) extra: Option<ExtraWidths>,
    /// m/s.
    pub(crate) speed_limit: f64,
    /// Paved width beside the outermost lanes, right and left, meters.
    pub(crate) shoulder: [f64; 2],
}

impl RoadStyle {
    /// Distance from the line to the farther edge of the pavement, meters.
    fn reach(&self) -> f64 {
        let right = self.own as f64 * self.lane_width
            + ExtraWidths::before(self.extra, true, self.own)
            + self.shoulder[0];
        let left = self.oncoming as f64 * self.lane_width
            + ExtraWidths::before(self.extra, false, self.oncoming);
        right.max(left + self.shoulder[1])
    }
}

/// Length and bend of a road.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Course {
    /// Meters.
    pub(crate) length: f64,
    /// Curvature of the bend, 1/m; 0 for a straight road.
    pub(crate) curvature: f64,
    /// Length before the bend, meters.
    pub(crate) lead: f64,
}

impl Course {
    pub(crate) fn straight(length: f64) -> Self {
        Self {
            length,
            curvature: 0.0,
            lead: 0.0,
        }
    }

    fn line(&self, start: Pose) -> Vec<Pose> {
        if self.curvature == 0.0 {
            return trace(start, &straight(self.length));
        }
        let room = (self.length - self.lead - 5.0).max(0.0);
        let bent = room.min(MAX_TURN / self.curvature.abs() + 18.0);
        trace(
            start,
            &bend(
                self.lead,
                bent,
                self.curvature,
                self.length - self.lead - bent,
            ),
        )
    }
}

/// Parameters of a crossing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CrossingPlan {
    pub(crate) control: Control,
    /// Turn of the route.
    pub(crate) turn: Turn,
    /// True for each arm to the left, ahead, to the right.
    pub(crate) arms: [bool; 3],
    /// True for a crosswalk at each of these arms and, last, at the approach.
    pub(crate) crosswalks: [bool; 4],
    /// Cross-section of the crossing road.
    pub(crate) side: RoadStyle,
    /// True if the ego comes from the minor road.
    pub(crate) from_minor: bool,
    /// Deviation of the crossing road from the right angle, radians.
    pub(crate) skew: f64,
    /// Radius of the curbs at the corners, meters.
    pub(crate) corner: f64,
    /// Length of the arms off the route, meters.
    pub(crate) arm_length: f64,
}

/// Parameters of a roundabout.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CirclePlan {
    /// Radius of the island, meters.
    pub(crate) island: f64,
    /// Circulating lanes.
    pub(crate) lanes: usize,
    /// Arms, the approach included: 3 or 4.
    pub(crate) arms: usize,
    /// Exit of the route, counted from the first one after the approach (0).
    pub(crate) exit: usize,
    /// Cross-section of the other arms.
    pub(crate) side: RoadStyle,
    /// Length of the arms off the route, meters.
    pub(crate) arm_length: f64,
}

/// Roads along a route, which grows at its end.
#[derive(Debug, Default)]
pub struct Layout {
    pub(crate) network: Network,
    /// Roads of the route in driving order, all driven along their line.
    pub(crate) route: Vec<RoadIndex>,
}

impl Layout {
    /// A route with its first road.
    pub(crate) fn begin(
        start: Pose,
        style: &RoadStyle,
        course: Course,
    ) -> Result<Self, GeometryError> {
        let mut layout = Self::default();
        layout.extend(start, style, course)?;
        Ok(layout)
    }

    /// End of the route.
    pub(crate) fn end(&self) -> Pose {
        self.network.roads[self.last()].end()
    }

    fn last(&self) -> RoadIndex {
        self.route[self.route.len() - 1]
    }

    fn extend(
        &mut self,
        start: Pose,
        style: &RoadStyle,
        course: Course,
    ) -> Result<RoadIndex, GeometryError> {
        let road = self.add(start, style, course)?;
        self.route.push(road);
        Ok(road)
    }

    fn add(
        &mut self,
        start: Pose,
        style: &RoadStyle,
        course: Course,
    ) -> Result<RoadIndex, GeometryError> {
        self.network.add_road(RoadPlan {
            line: course.line(start),
            forward: style.own,
            backward: style.oncoming,
            lane_width: style.lane_width,
            extra: style.extra,
            speed_limit: style.speed_limit,
            shoulder: style.shoulder,
        })
    }

    /// Adds a joint of `gap` meters, with a crosswalk if wanted, and a road behind it.
    pub(crate) fn joint(
        &mut self,
        gap: f64,
        crosswalk: bool,
        style: &RoadStyle,
        course: Course,
    ) -> Result<(), GeometryError> {
        let (before, end) = (self.last(), self.end());
        let after = self.extend(end.translated(gap, 0.0), style, course)?;
        self.network.join(before, after)?;
        if crosswalk {
            let road = &self.network.roads[before];
            let corner =
                |along: f64, lateral: f64| end.to_map(Point::new(gap / 2.0 + along, lateral));
            let (left, right) = (road.left_edge(), -road.right_edge());
            let area = [
                corner(1.5, left),
                corner(-1.5, left),
                corner(-1.5, right),
                corner(1.5, right),
            ];
            self.network.parts.crosswalks.push(Polygon::new(area)?);
        }
        Ok(())
    }

    /// Adds a crossing and a road behind it.
    pub(crate) fn crossing(
        &mut self,
        plan: &CrossingPlan,
        style: &RoadStyle,
        course: Course,
        rng: &mut SeededRng,
    ) -> Result<(), GeometryError> {
        let (before, end) = (self.last(), self.end());
        let walks = if plan.crosswalks.iter().any(|&c| c) {
            5.0
        } else {
            0.0
        };
        let slack = plan.skew.abs() * 12.0;
        let radius = style.reach().max(plan.side.reach()) + walks + plan.corner + slack;
        let center = end.translated(radius, 0.0);
        // Counter-clockwise from the approach: right, ahead, left.
        let exits = [
            (
                Turn::Right,
                plan.arms[2],
                end.heading - FRAC_PI_2 + plan.skew,
                plan.crosswalks[2],
            ),
            (
                Turn::Straight,
                plan.arms[1],
                end.heading,
                plan.crosswalks[1],
            ),
            (
                Turn::Left,
                plan.arms[0],
                end.heading + FRAC_PI_2 + plan.skew,
                plan.crosswalks[0],
            ),
        ];
        let mut arms = vec![Arm {
            road: before,
            end: End::Finish,
            minor: plan.from_minor,
        }];
        let mut crosswalks = vec![plan.crosswalks[3]];
        for (turn, wanted, heading, crosswalk) in exits {
            if !wanted {
                continue;
            }
            let start = Pose::at(center.position(), wrap_angle(heading)).translated(radius, 0.0);
            let ahead = turn == Turn::Straight;
            let style = if ahead { style } else { &plan.side };
            let road = if turn == plan.turn {
                self.extend(start, style, course)?
            } else {
                let curvature = if rng.bool(0.4) {
                    rng.sign() * rng.uniform(0.002, 0.008)
                } else {
                    0.0
                };
                let length = plan.arm_length * rng.uniform(0.85, 1.15);
                self.add(
                    start,
                    style,
                    Course {
                        length,
                        curvature,
                        lead: 30.0,
                    },
                )?
            };
            arms.push(Arm {
                road,
                end: End::Start,
                minor: plan.from_minor == ahead,
            });
            crosswalks.push(crosswalk);
        }
        self.network.cross(&arms, plan.control, &crosswalks)
    }

    /// Adds a roundabout and a road behind it.
    pub(crate) fn roundabout(
        &mut self,
        plan: &CirclePlan,
        style: &RoadStyle,
        course: Course,
    ) -> Result<(), GeometryError> {
        /// Width of a lane on the ring, meters: turning vehicles need more than on a road.
        const LANE_WIDTH: f64 = 4.6;
        /// Limit on the ring, m/s (20 mph).
        const SPEED_LIMIT: f64 = 8.9;
        let (before, end) = (self.last(), self.end());
        let half_opening = if plan.arms == 4 { 0.6 } else { 0.7 };
        // The arms begin outside the ring, so that connectors have room to bend into it.
        let outer = plan.island + plan.lanes as f64 * LANE_WIDTH;
        let radius = outer + 9.0;
        let center: Point = end.translated(radius, 0.0).position();
        let ring = Ring {
            center,
            island: plan.island,
            lanes: plan.lanes,
            lane_width: LANE_WIDTH,
            speed_limit: SPEED_LIMIT,
            half_opening,
        };
        let mut arms = vec![Arm {
            road: before,
            end: End::Finish,
            minor: true,
        }];
        let mut exit_road = None;
        for i in 0..plan.arms - 1 {
            let heading = end.heading + PI + 2.0 * PI * (i + 1) as f64 / plan.arms as f64;
            let start = Pose::at(center, wrap_angle(heading)).translated(radius, 0.0);
            let road = if i == plan.exit {
                let road = self.add(start, style, course)?;
                exit_road = Some(road);
                road
            } else {
                self.add(start, &plan.side, Course::straight(plan.arm_length))?
            };
            arms.push(Arm {
                road,
                end: End::Start,
                minor: true,
            });
        }
        let around = self.network.circle(&ring, &arms)?;
        self.route.extend(around.iter().take(plan.exit + 1));
        if let Some(road) = exit_road {
            self.route.push(road);
        }
        Ok(())
    }

    /// Adds a bay of `depth` meters at the right curb of the last road, `length` meters long from
    /// arc length `from` on. The road must be straight there.
    pub(crate) fn bay(&mut self, depth: f64, from: f64, length: f64) -> Result<(), GeometryError> {
        let road = &self.network.roads[self.last()];
        let edge = road.right_edge();
        let start = road.plan.line[0].translated(from, 0.0);
        let area = band(
            &[start, start.translated(length, 0.0)],
            -edge,
            -edge - depth,
        )?;
        self.network.parts.carparks.push(area);
        Ok(())
    }
}
