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

/// The lead agent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lead {
    /// Free distance from the front of the follower, meters.
    pub gap: f64,
    /// Speed along the follower's direction, m/s.
    pub speed: f64,
}

impl IdmParameters {
    /// Acceleration of a vehicle of `speed` behind `lead` (`None`: free road), m/s², within [−b,
    /// a]; paper equation 1, with s* = s0 + v·T + v·Δv/(2·√(a·b)) and the gap at least s0.
    #[inline]
    pub fn acceleration(&self, speed: f64, lead: Option<Lead>) -> f64 {
        let free = (speed / self.target_velocity).powi(self.exponent);
        let interaction = lead.map_or(0.0, |lead| {
            let approach =
                speed * (speed - lead.speed) / (2.0 * (self.accel_max * self.decel_max).sqrt());
            let desired = self.min_gap + speed * self.headway + approach;
            (desired / lead.gap.max(self.min_gap)).powi(2)
        });
        (self.accel_max * (1.0 - free - interaction)).clamp(-self.decel_max, self.accel_max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    /// Progress and speed after one forward Euler step, the speed not clamped.
    fn euler(idm: &IdmParameters, speed: f64, lead: Lead, dt: f64) -> (f64, f64) {
        (speed * dt, speed + dt * idm.acceleration(speed, Some(lead)))
    }

    #[test]
    fn follows_the_recorded_policy() {
        let path = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../tests/fixtures/vectors/idm_policy.json"
        );
        let vectors: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
        let cases = vectors["cases"].as_array().unwrap();
        assert_eq!(cases.len(), 60);
        for case in cases {
            let [target_velocity, min_gap, headway, accel_max, decel_max]: [f64; 5] =
                serde_json::from_value(case["params"].clone()).unwrap();
            let idm = IdmParameters {
                target_velocity,
                min_gap,
                headway,
                accel_max,
                decel_max,
                exponent: 4,
            };
            let number = |key: &str| case[key].as_f64().unwrap();
            let lead = Lead {
                gap: number("lead_progress") - number("lead_length_rear"),
                speed: number("lead_velocity"),
            };
            let (progress, speed) = euler(&idm, number("v"), lead, number("dt"));
            assert!((progress - number("out_progress")).abs() < 1e-9, "{case}");
            assert!((speed - number("out_velocity")).abs() < 1e-9, "{case}");
        }
    }

    #[test]
    fn agrees_with_the_devkit_test_of_the_policy() {
        let idm = IdmParameters {
            target_velocity: 30.0,
            min_gap: 2.0,
            headway: 1.5,
            accel_max: 0.73,
            decel_max: 1.67,
            exponent: 4,
        };
        let lead = Lead {
            gap: 15.0 - 5.0 - 5.0,
            speed: 2.0,
        };
        assert!((idm.acceleration(3.0, Some(lead)) - -1.073_366).abs() < 1e-6);
        let (progress, speed) = euler(&idm, 3.0, lead, 0.5);
        assert!((5.0 + progress - 6.5).abs() < 1e-12 && (speed - 2.463_316_996_93).abs() < 1e-9);
    }

    #[test]
    fn a_free_road_is_driven_at_the_target_velocity() {
        let idm = IdmParameters {
            target_velocity: 10.0,
            min_gap: 1.0,
            headway: 1.5,
            accel_max: 1.0,
            decel_max: 2.0,
            exponent: 4,
        };
        assert!(idm.acceleration(10.0, None).abs() < 1e-12);
        assert!((idm.acceleration(0.0, None) - 1.0).abs() < 1e-12);
        assert!(
            (idm.acceleration(100.0, None) - -2.0).abs() < 1e-12,
            "braking is bounded"
        );
    }
}
