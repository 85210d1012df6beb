//! People on foot: they wait, cross at crosswalks or between them, or walk along the road.

use crate::geometry::{OrientedBox, Point, Pose, Vector};
use crate::world::{STEP_S, TrackToken};

/// What a pedestrian waits for before walking.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Departure {
    /// A moment, seconds.
    At(f64),
    /// That the drivers leave a gap or stop, from a moment on, seconds.
    WhenClear(f64),
    /// Never.
    Never,
}

/// A pedestrian who walks from one point to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Walker {
    /// Its track token.
    pub(crate) token: TrackToken,
    /// From where.
    pub(crate) from: Point,
    /// To where.
    pub(crate) to: Point,
    /// Walking speed, m/s.
    pub(crate) pace: f64,
    /// When it sets off.
    pub(crate) departure: Departure,
    /// Whether the way leads across the carriageway.
    pub(crate) crosses: bool,
    /// Distance walked, metres.
    pub(crate) walked: f64,
    /// Whether it walks now.
    pub(crate) moving: bool,
    /// Side of its square box, metres.
    pub(crate) size: f64,
}

impl Walker {
    fn direction(&self) -> Vector {
        (self.to - self.from).normalize()
    }

    /// Length of the way, metres.
    pub(crate) fn distance(&self) -> f64 {
        (self.to - self.from).norm()
    }

    /// Where it is.
    pub(crate) fn position(&self) -> Point {
        self.from + self.direction() * self.walked
    }

    /// Its velocity, m/s.
    pub(crate) fn velocity(&self) -> Vector {
        if self.moving { self.stride() } else { Vector::zeros() }
    }

    /// Its box.
    pub(crate) fn shape(&self) -> OrientedBox {
        let d = self.direction();
        OrientedBox::new(Pose::at(self.position(), d.y.atan2(d.x)), self.size, self.size)
    }

    /// Velocity while it walks, m/s.
    pub(crate) fn stride(&self) -> Vector {
        self.direction() * self.pace
    }

    /// Seconds until it is on its way across, 0 when it is; `None` when drivers need not mind it. Drivers see shortly before
    /// that somebody is about to set off; who waits for a gap does not count.
    pub(crate) fn crosses_in(&self, time: f64) -> Option<f64> {
        /// How long before somebody sets off it can be seen, seconds.
        const FORESEEN: f64 = 2.5;
        if !self.crosses {
            return None;
        }
        match self.departure {
            _ if self.moving => Some(0.0),
            Departure::At(moment) if self.walked == 0.0 => {
                Some((moment - time).max(0.0)).filter(|&wait| wait < FORESEEN)
            }
            _ => None,
        }
    }

    /// One step; `clear` tells whether the drivers leave room now.
    pub(crate) fn advance(&mut self, time: f64, clear: bool) {
        if self.moving {
            self.walked = (self.walked + self.pace * STEP_S).min(self.distance());
            self.moving = self.walked < self.distance();
        } else if self.walked == 0.0 {
            self.moving = match self.departure {
                Departure::At(moment) => time >= moment,
                Departure::WhenClear(moment) => time >= moment && clear,
                Departure::Never => false,
            };
        }
    }
}
