//! What was promised of a setpoint, and of how it changes.

use wire::dialect::SET_ATTITUDE_TARGET_DATA;

/// Bounds that were promised to the operator.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Least and largest thrust field.
    pub thrust: [f64; 2],
    /// rad
    pub tilt_rad: f64,
    /// rad/s
    pub body_rate_rad_s: f64,
    /// Thrust field in a second.
    pub thrust_change_per_s: f64,
    /// rad/s^2
    pub body_rate_change_rad_s2: f64,
    /// The word of the mode in which setpoints are obeyed, and of the one that lands.
    pub obeys: u32,
    /// That of landing.
    pub lands: u32,
}

/// A setpoint that left.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sent {
    /// When, us.
    pub at_us: u64,
    thrust: f64,
    body_rate: [f64; 3],
}

impl Sent {
    /// What of a message is compared with the next.
    pub fn new(at_us: u64, target: &SET_ATTITUDE_TARGET_DATA) -> Self {
        let body_rate = [target.body_roll_rate, target.body_pitch_rate, target.body_yaw_rate];
        Self { at_us, thrust: target.thrust.into(), body_rate: body_rate.map(f64::from) }
    }
}

impl Bounds {
    /// Whether a setpoint is within them.
    pub(super) fn admit(&self, sent: &Sent, target: &SET_ATTITUDE_TARGET_DATA) -> bool {
        let q = target.q.map(f64::from);
        let norm: f64 = q.iter().map(|c| c * c).sum();
        // The third column's last entry of the rotation that q is.
        let tilt_rad =
            (q[0] * q[0] - q[1] * q[1] - q[2] * q[2] + q[3] * q[3]).clamp(-1.0, 1.0).acos();
        (norm - 1.0).abs() < 1e-4
            && tilt_rad <= self.tilt_rad + 1e-3
            && sent.body_rate.iter().all(|rate| rate.abs() <= self.body_rate_rad_s + 1e-4)
            && (self.thrust[0] - 1e-4..=self.thrust[1] + 1e-4).contains(&sent.thrust)
            && target.target_system == sitl::autopilot::SYSTEM_ID
    }

    /// Whether one may follow the other `dt_s` later.
    pub(super) fn admit_change(&self, last: &Sent, sent: &Sent, dt_s: f64) -> bool {
        let mut rates = sent.body_rate.iter().zip(last.body_rate);
        (sent.thrust - last.thrust).abs() <= self.thrust_change_per_s * dt_s + 1e-4
            && rates
                .all(|(rate, was)| (rate - was).abs() <= self.body_rate_change_rad_s2 * dt_s + 1e-3)
    }
}
