//! Pedestrians: they wait, cross at crosswalks or between them, or walk along the road.

use planagent_world::geometry::{OrientedBox, Point, Pose, Vector};
use planagent_world::{STEP_S, TrackToken};

/// When a pedestrian starts to walk. Times are seconds from iteration 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Departure {
    At(f64),
    /// From this time on, when the drivers leave a gap or stop.
    WhenClear(f64),
    Never,
}

/// A pedestrian on a straight path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Walker {
    pub(crate) token: TrackToken,
    pub(crate) from: Point,
    pub(crate) to: Point,
    /// Walking speed, m/s.
    pub(crate) pace: f64,
    pub(crate) departure: Departure,
    /// True if the path crosses the road.
    pub(crate) crosses: bool,
    /// Distance walked, meters.
    pub(crate) walked: f64,
    pub(crate) moving: bool,
    /// Side of the square box, meters.
    pub(crate) size: f64,
}

impl Walker {
    fn direction(&self) -> Vector {
        (self.to - self.from).normalize()
    }

    /// Length of the path, meters.
    pub(crate) fn distance(&self) -> f64 {
        (self.to - self.from).norm()
    }

    pub(crate) fn position(&self) -> Point {
        self.from + self.direction() * self.walked
    }

    /// m/s.
    pub(crate) fn velocity(&self) -> Vector {
        if self.moving {
            self.stride()
        } else {
            Vector::zeros()
        }
    }

    pub(crate) fn shape(&self) -> OrientedBox {
        let d = self.direction();
        OrientedBox::new(
            Pose::at(self.position(), d.y.atan2(d.x)),
            self.size,
            self.size,
        )
    }

    /// Velocity while it walks, m/s.
    pub(crate) fn stride(&self) -> Vector {
        self.direction() * self.pace
    }

    /// Seconds until the pedestrian starts to cross, 0 while crossing, `None` if drivers need not
    /// react. Drivers foresee the start shortly before; pedestrians who wait for a gap do not
    /// count.
    pub(crate) fn crosses_in(&self, time: f64) -> Option<f64> {
        /// Time before the start at which drivers foresee it, seconds.
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

    /// One step; `clear` is true if the drivers leave room now.
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
