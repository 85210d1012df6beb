//! The intelligent driver model (Treiber et al. 2000), as nuPlan and the paper use it.

/// Parameters of the law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdmParameters {
    /// Desired speed v0, m/s.
    pub target_velocity: f64,
    /// Gap kept at standstill s0, m.
    pub min_gap: f64,
    /// Time headway T, s.
    pub headway: f64,
    /// Maximum acceleration a, m/s².
    pub accel_max: f64,
    /// Comfortable deceleration b as a positive magnitude, m/s²; also the bound on braking.
    pub decel_max: f64,
    /// Exponent δ of the free-road term.
    pub exponent: i32,
}

/// What drives ahead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lead {
    /// Free distance from the front of the follower, metres.
    pub gap: f64,
    /// Speed along the follower's direction, m/s.
    pub speed: f64,
}

impl IdmParameters {
    /// Acceleration of a vehicle of `speed` behind `lead` (`None`: free road), m/s², within [−b, a]; paper equation 1, with
    /// s* = s0 + v·T + v·Δv/(2·√(a·b)) and the gap held at s0 or above.
    pub fn acceleration(&self, speed: f64, lead: Option<Lead>) -> f64 {
        let free = (speed / self.target_velocity).powi(self.exponent);
        let interaction = lead.map_or(0.0, |lead| {
            let approach = speed * (speed - lead.speed) / (2.0 * (self.accel_max * self.decel_max).sqrt());
            let desired = self.min_gap + speed * self.headway + approach;
            (desired / lead.gap.max(self.min_gap)).powi(2)
        });
        (self.accel_max * (1.0 - free - interaction)).clamp(-self.decel_max, self.accel_max)
    }
}
