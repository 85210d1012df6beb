//! Random objects beside the traffic: parked cars, cyclists, pedestrians, cones.

use super::builder::{TrafficBuilder, VehicleKind};
use super::setting::LEAD_IN;
use super::wide;
use crate::generator::traffic::{Departure, Walker};
use planagent_world::geometry::{OrientedBox, Point, Polygon, Pose, wrap_angle};
use planagent_world::{LaneId, ObjectKind, TrackToken};
use std::f64::consts::PI;

/// Minimum width of a parking strip, meters.
const PARKING: f64 = 2.4;
/// Minimum width of a strip at the curb that cyclists use, meters.
const BICYCLES: f64 = 1.4;

impl TrafficBuilder<'_, '_> {
    /// The rightmost lanes of all roads, with lane width and width of the strip at the curb.
    pub(super) fn curb_lanes(&self) -> Vec<(LaneId, f64, f64)> {
        let roads = self.roads();
        let at_curb = |lane: &LaneId| roads.map[*lane].right.is_empty();
        roads
            .road_lanes()
            .filter(at_curb)
            .filter_map(|lane| {
                roads.facts[lane.index()].map(|f| (lane, f.lane_width, f.shoulder[0]))
            })
            .collect()
    }

    /// Adds random clutter: parked cars, cyclists, pedestrians, cones.
    pub fn add_clutter(&mut self) {
        if self.rng.is_wide() {
            self.add_wide_clutter();
            return;
        }
        // Drawn once a scene and not once a lane, so that its curbs look alike.
        let (parked, cyclists, strollers) = (
            self.rng.uniform(0.2, 0.8),
            self.rng.bool(0.5),
            self.rng.range(0, 4),
        );
        for (lane, lane_width, strip) in self.curb_lanes() {
            if strip >= PARKING {
                self.park_along(lane, lane_width / 2.0 + strip / 2.0 + 0.1, parked);
            } else if strip >= BICYCLES && cyclists && self.rng.bool(0.6) {
                self.cycle_along(lane, -(lane_width / 2.0 + 0.75));
            }
        }
        for _ in 0..strollers {
            self.stroll();
        }
        let walks = self.roads().map.crosswalks().to_vec();
        for walk in &walks {
            if self.rng.bool(0.3) {
                let departure = if self.rng.bool(0.6) {
                    Departure::WhenClear(self.rng.uniform(-3.0, 12.0))
                } else {
                    Departure::Never
                };
                let from_far_side = self.rng.bool(0.5);
                self.wait_at(walk, departure, from_far_side);
            }
        }
        if self.rng.bool(0.12) {
            self.road_works_beside();
        }
    }

    /// Parks cars in a row beside a lane, `offset` meters to the right of its centerline.
    pub(super) fn park_along(&mut self, lane: LaneId, offset: f64, share: f64) {
        let line = self.roads().map[lane].centerline.clone();
        let max_parked = if self.rng.is_wide() {
            wide::MAX_PARKED
        } else {
            40
        };
        let mut s = 9.0;
        while s < line.length() - 9.0 && self.traffic.fixtures.len() < max_parked {
            if self.rng.bool(share) {
                let pose = line.pose_at(s).translated(0.0, -offset);
                let (length, width) = if self.rng.is_wide() {
                    wide::size(self.rng, VehicleKind::Car, self.habits)
                } else {
                    (self.rng.uniform(4.2, 5.0), self.rng.uniform(1.75, 1.95))
                };
                self.put_fixture(ObjectKind::Vehicle, pose, length, width);
            }
            s += 6.6;
        }
    }

    /// Adds a cyclist along a lane, `lateral` meters to the left of its centerline.
    pub(super) fn cycle_along(&mut self, lane: LaneId, lateral: f64) {
        let length = self.roads().map[lane].centerline.length();
        let (s, pace) = (
            self.rng.uniform(3.0, (length - 6.0).max(4.0)),
            self.rng.uniform(3.0, 6.0),
        );
        let chain = self.roads().straight_chain(lane);
        if let Some(i) = self.put(VehicleKind::Bicycle, chain, s, pace, lateral) {
            self.traffic.movers[i].speed_cap = pace;
        }
    }

    /// Adds a pedestrian who walks along the sidewalk.
    pub(super) fn stroll(&mut self) {
        let curbs = self.curb_lanes();
        let (lane, lane_width, strip) = self.rng.choose(&curbs);
        let line = &self.roads().map[lane].centerline;
        if line.length() < 50.0 {
            return;
        }
        let offset = lane_width / 2.0 + strip + self.rng.uniform(1.0, 2.2);
        let s = self.rng.uniform(5.0, line.length() - 40.0);
        let (a, b) = (
            line.frenet_to_map(s, -offset),
            line.frenet_to_map(s + 32.0, -offset),
        );
        let (from, to) = if self.rng.bool(0.5) { (a, b) } else { (b, a) };
        let pace = self.rng.uniform(0.9, 1.6);
        self.put_walker(Walker {
            pace,
            departure: Departure::At(-10.0),
            crosses: false,
            ..walker(from, to)
        });
    }

    /// Adds a pedestrian who waits at a crosswalk.
    pub(crate) fn wait_at(&mut self, walk: &Polygon, departure: Departure, from_far_side: bool) {
        let (a, b) = ends(walk);
        let (from, to) = if from_far_side { (b, a) } else { (a, b) };
        let aside = Pose::at(from, 0.0)
            .translated(self.rng.uniform(-0.6, 0.6), self.rng.uniform(-0.6, 0.6));
        let pace = self.rng.uniform(1.0, 1.7);
        self.put_walker(Walker {
            pace,
            departure,
            crosses: true,
            ..walker(aside.position(), to)
        });
    }

    /// Adds a pedestrian who crosses the road away from any crosswalk, where no object blocks the
    /// path.
    pub(crate) fn add_jaywalker(&mut self) {
        /// Distance of both ends of the crossing from the ego's path, meters.
        const REACH: f64 = 14.0;
        /// Places that are tried before the scene stays without a jaywalker.
        const TRIES: usize = 5;
        // A place may be blocked; a scene without a jaywalker is better than a search without an
        // end.
        for _ in 0..TRIES {
            let (s, side) = (
                self.ego().s + self.rng.uniform(50.0, 110.0),
                self.rng.sign(),
            );
            let early = self.rng.uniform(8.0, 12.0);
            let pose = self.ego().track.pose_at(s);
            let (from, to) = (
                pose.to_map(Point::new(0.0, side * REACH)),
                pose.to_map(Point::new(1.0, -side * REACH)),
            );
            let blocked = self.traffic.fixtures.iter().any(|fixture| {
                let shape = fixture.shape;
                OrientedBox::new(shape.center, shape.length + 1.2, shape.width + 1.2)
                    .meets_segment(from, to)
            });
            if blocked || self.ego().track.span_at(s).connector {
                continue;
            }
            let arrives = (s - self.ego().s) / self.ego().speed.max(3.0) - LEAD_IN;
            let pace = self.rng.uniform(1.2, 1.9);
            self.put_walker(Walker {
                pace,
                departure: Departure::At(arrives - early),
                ..walker(from, to)
            });
            return;
        }
    }

    /// Fills the bays at the curb with parked vehicles and with pedestrians beside them.
    pub(crate) fn fill_bay(&mut self) {
        let bays = self.roads().map.carparks().to_vec();
        for bay in &bays {
            // The outline runs along the right edge of the road first, then back along the left
            // one.
            let ring = bay.ring();
            let (left, right) = ((ring[3], ring[2]), (ring[0], ring[1]));
            let heading = (left.1 - left.0).y.atan2((left.1 - left.0).x);
            let start = Pose::at(nalgebra::center(&left.0, &right.0), heading);
            let (length, depth) = ((left.1 - left.0).norm(), (right.0 - left.0).norm());
            let share = self.rng.uniform(0.3, 0.8);
            let mut s = 4.5;
            while s < length - 4.0 {
                if self.rng.bool(share) {
                    let (long, wide) = (self.rng.uniform(4.3, 5.1), self.rng.uniform(1.8, 2.0));
                    self.put_fixture(ObjectKind::Vehicle, start.translated(s, 0.0), long, wide);
                }
                if self.rng.bool(0.35) {
                    let at = start
                        .translated(s + 2.0, -depth / 2.0 - self.rng.uniform(0.6, 1.6))
                        .position();
                    let ahead = start.translated(s + 9.0, -depth / 2.0 - 1.2).position();
                    let walks = self.rng.bool(0.3);
                    let departure = if walks {
                        Departure::At(self.rng.uniform(-3.0, 8.0))
                    } else {
                        Departure::Never
                    };
                    self.put_walker(Walker {
                        departure,
                        crosses: false,
                        ..walker(at, ahead)
                    });
                }
                s += 7.0;
            }
        }
    }

    /// Adds cones and a sign on the strip beside a road.
    pub(super) fn road_works_beside(&mut self) {
        let curbs = self.curb_lanes();
        let (lane, lane_width, strip) = self.rng.choose(&curbs);
        let line = self.roads().map[lane].centerline.clone();
        if line.length() < 60.0 {
            return;
        }
        let start = self.rng.uniform(10.0, line.length() - 40.0);
        let offset = -(lane_width / 2.0 + strip.min(1.0) * 0.6);
        for k in 0..5 {
            let s = start + 5.0 * f64::from(k);
            let kind = if k == 0 {
                ObjectKind::CzoneSign
            } else {
                ObjectKind::TrafficCone
            };
            self.put_fixture(
                kind,
                Pose::at(line.frenet_to_map(s, offset), line.heading_at(s)),
                0.4,
                0.4,
            );
        }
    }

    /// Closes a lane from arc length `s` on with barriers and cones over `length` meters.
    pub(crate) fn close_lane(&mut self, lane: LaneId, s: f64, length: f64, width: f64) {
        let line = self.roads().map[lane].centerline.clone();
        let at = |s: f64, d: f64| Pose::at(line.frenet_to_map(s, d), line.heading_at(s));
        // A taper of cones, then a barrier across the lane and cones along it.
        for k in 0..4 {
            let share = f64::from(k) / 3.0;
            let pose = at(s - 12.0 + 12.0 * share, (-0.5 + share * 0.8) * width);
            self.put_fixture(ObjectKind::TrafficCone, pose, 0.35, 0.35);
        }
        let barrier = at(s + 1.0, 0.0);
        let across = Pose::new(barrier.x, barrier.y, wrap_angle(barrier.heading + PI / 2.0));
        self.put_fixture(ObjectKind::Barrier, across, 0.7 * width, 0.5);
        let mut along = 6.0;
        while along < length {
            self.put_fixture(
                ObjectKind::TrafficCone,
                at(s + along, 0.32 * width),
                0.35,
                0.35,
            );
            along += 6.0;
        }
        self.put_fixture(ObjectKind::CzoneSign, at(s - 14.0, -0.42 * width), 0.5, 0.5);
    }
}

/// A pedestrian who stands still.
fn walker(from: Point, to: Point) -> Walker {
    Walker {
        token: TrackToken(0),
        from,
        to,
        pace: 1.3,
        departure: Departure::Never,
        crosses: true,
        walked: 0.0,
        moving: false,
        size: 0.6,
    }
}

/// The two places on the sidewalk that a crosswalk joins.
fn ends(walk: &Polygon) -> (Point, Point) {
    /// Distance from the curb, meters.
    const BACK: f64 = 1.1;
    let ring = walk.ring();
    let (a, b) = (
        nalgebra::center(&ring[0], &ring[1]),
        nalgebra::center(&ring[2], &ring[3]),
    );
    let along = (b - a).normalize() * BACK;
    (a - along, b + along)
}
