//! The promised bounds of a setpoint and of its changes.

use wire::dialect::SET_ATTITUDE_TARGET_DATA;

/// The bounds that the operator was promised.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Least and largest thrust field.
    pub thrust: [f64; 2],
    /// Largest tilt, rad.
    pub tilt_rad: f64,
    /// Largest body rate about each axis, rad/s.
    pub body_rate_rad_s: f64,
    /// Largest change of the thrust field, 1/s.
    pub thrust_change_per_s: f64,
    /// Largest change of a body rate, rad/s^2.
    pub body_rate_change_rad_s2: f64,
    /// The custom mode that obeys setpoints.
    pub obeys: u32,
    /// The custom mode that lands.
    pub lands: u32,
}

/// A setpoint that left the station.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sent {
    /// Time at which it left, us.
    pub at_us: u64,
    thrust: f64,
    body_rate: [f64; 3],
}

impl Sent {
    /// The part of a message that is compared with the next one.
    pub fn new(at_us: u64, target: &SET_ATTITUDE_TARGET_DATA) -> Self {
        let body_rate = [target.body_roll_rate, target.body_pitch_rate, target.body_yaw_rate];
        Self { at_us, thrust: target.thrust.into(), body_rate: body_rate.map(f64::from) }
    }
}

impl Bounds {
    /// Whether a setpoint is within the bounds.
    pub(super) fn admit(&self, sent: &Sent, target: &SET_ATTITUDE_TARGET_DATA) -> bool {
        let q = target.q.map(f64::from);
        let norm: f64 = q.iter().map(|c| c * c).sum();
        // The last entry of the third column of q's rotation matrix.
        let tilt_rad =
            (q[0] * q[0] - q[1] * q[1] - q[2] * q[2] + q[3] * q[3]).clamp(-1.0, 1.0).acos();
        (norm - 1.0).abs() < 1e-4
            && tilt_rad <= self.tilt_rad + 1e-3
            && sent.body_rate.iter().all(|rate| rate.abs() <= self.body_rate_rad_s + 1e-4)
            && (self.thrust[0] - 1e-4..=self.thrust[1] + 1e-4).contains(&sent.thrust)
            && target.target_system == sitl::autopilot::SYSTEM_ID
    }

    /// Whether `sent` may follow `last` after `dt_s`.
    pub(super) fn admit_change(&self, last: &Sent, sent: &Sent, dt_s: f64) -> bool {
        let mut rates = sent.body_rate.iter().zip(last.body_rate);
        (sent.thrust - last.thrust).abs() <= self.thrust_change_per_s * dt_s + 1e-4
            && rates
                .all(|(rate, was)| (rate - was).abs() <= self.body_rate_change_rad_s2 * dt_s + 1e-3)
    }
}
