//! The ego vehicle and its state.

use crate::geometry::{OrientedBox, Point, Pose, Vector};

/// Dimensions of the ego vehicle, meters (devkit `vehicle_parameters.py`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VehicleParameters {
    /// Width over all.
    pub width: f64,
    /// Rear axle to front bumper.
    pub front_length: f64,
    /// Rear axle to rear bumper.
    pub rear_length: f64,
    /// Distance between the axles.
    pub wheel_base: f64,
}

/// nuPlan's ego vehicle, a Chrysler Pacifica.
pub const PACIFICA: VehicleParameters = VehicleParameters {
    width: 2.297,
    front_length: 4.049,
    rear_length: 1.127,
    wheel_base: 3.089,
};

impl VehicleParameters {
    /// Length over all, meters.
    #[inline]
    pub fn length(&self) -> f64 {
        self.front_length + self.rear_length
    }

    /// From the rear axle forward to the center of the box, meters.
    #[inline]
    pub fn rear_axle_to_center(&self) -> f64 {
        self.length() / 2.0 - self.rear_length
    }

    /// Footprint of a vehicle whose rear axle is at `rear_axle`.
    #[inline]
    pub fn footprint(&self, rear_axle: Pose) -> OrientedBox {
        OrientedBox::new(
            rear_axle.translated(self.rear_axle_to_center(), 0.0),
            self.length(),
            self.width,
        )
    }

    /// The middle of the front bumper of a vehicle whose rear axle is at `rear_axle`.
    #[inline]
    #[doc(hidden)]
    pub fn front_of(&self, rear_axle: Pose) -> Point {
        rear_axle.translated(self.front_length, 0.0).position()
    }

    /// Rear-axle pose of a vehicle whose box is centered at `center`.
    #[inline]
    pub fn rear_axle_of(&self, center: Pose) -> Pose {
        center.translated(-self.rear_axle_to_center(), 0.0)
    }
}

/// State of the ego, referred to its rear axle; the vehicle is [`PACIFICA`].
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct EgoState {
    /// Time, µs.
    pub time_us: i64,
    /// Pose of the rear axle, map frame.
    pub rear_axle: Pose,
    /// Rear-axle velocity in the body frame (forward, left), m/s.
    pub velocity: Vector,
    /// Rear-axle acceleration in the body frame (forward, left), m/s².
    pub acceleration: Vector,
    /// Steering angle of the front wheels, radians.
    pub steering_angle: f64,
    /// Its rate, rad/s.
    pub steering_rate: f64,
    /// Yaw rate, rad/s.
    pub angular_velocity: f64,
    /// Yaw acceleration, rad/s².
    pub angular_acceleration: f64,
}

impl EgoState {
    /// A state from what a log holds; steering and angular quantities are 0, as nuPlan reads them.
    pub fn from_log(time_us: i64, rear_axle: Pose, velocity: Vector, acceleration: Vector) -> Self {
        Self {
            time_us,
            rear_axle,
            velocity,
            acceleration,
            steering_angle: 0.0,
            steering_rate: 0.0,
            angular_velocity: 0.0,
            angular_acceleration: 0.0,
        }
    }

    /// Norm of the rear-axle velocity, m/s.
    #[inline]
    pub fn speed(&self) -> f64 {
        self.velocity.norm()
    }

    /// Pose of the box center, map frame.
    #[inline]
    pub fn center(&self) -> Pose {
        self.rear_axle
            .translated(PACIFICA.rear_axle_to_center(), 0.0)
    }

    /// The box, map frame.
    #[inline]
    pub fn footprint(&self) -> OrientedBox {
        PACIFICA.footprint(self.rear_axle)
    }

    /// Velocity of the box center in the body frame, m/s (devkit `dynamic_car_state.py`).
    #[inline]
    pub fn center_velocity(&self) -> Vector {
        self.velocity + Vector::new(0.0, PACIFICA.rear_axle_to_center() * self.angular_velocity)
    }

    /// Acceleration of the box center in the body frame, m/s². nuPlan adds d·(ω² + α) to the
    /// forward component and nothing to the lateral one, which is not rigid-body kinematics. Its
    /// metrics use this value, so it is kept.
    #[inline]
    pub fn center_acceleration(&self) -> Vector {
        let d = PACIFICA.rear_axle_to_center();
        self.acceleration
            + Vector::new(
                d * (self.angular_velocity.powi(2) + self.angular_acceleration),
                0.0,
            )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pacifica_measures_what_nuplan_says() {
        assert!((PACIFICA.length() - 5.176).abs() < 1e-12);
        assert!((PACIFICA.rear_axle_to_center() - 1.461).abs() < 1e-12);
        let back = PACIFICA.rear_axle_of(PACIFICA.footprint(Pose::new(3.0, 4.0, 1.0)).center);
        assert!(back.distance(&Pose::new(3.0, 4.0, 1.0)) < 1e-12);
    }
}
