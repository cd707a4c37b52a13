//! The offboard setpoint: which SET_ATTITUDE_TARGET is accepted, when it takes effect, and whether
//! the stream is live.

use std::collections::VecDeque;

use rand::Rng;
use rand_distr::{Distribution, Exp1};
use wire::dialect::{AttitudeTargetTypemask, SET_ATTITUDE_TARGET_DATA};

use vehicle::frame::{Attitude, Euler, Frd};

/// Mean of the transport jitter, s: the exponential part of the command delay.
pub const JITTER_MEAN_S: f64 = 0.001;

/// Largest number of setpoints in the delay line, which bounds memory during a flood.
const UNDER_WAY_MAX: usize = 256;

/// The setpoint of the attitude loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeSetpoint {
    /// Desired attitude; `None` if only the rate part of the loop acts.
    pub attitude: Option<Euler>,
    /// Desired body rate, rad/s.
    pub body_rate: Frd,
    /// Collective thrust, 0..1 of the rotors' sum.
    pub thrust: f64,
    /// The type mask of the message, for the echo.
    pub type_mask: AttitudeTargetTypemask,
}

impl AttitudeSetpoint {
    /// Decodes a message with mask 0x00 (attitude, rates, thrust), 0x07 (attitude, thrust) or 0x80
    /// (rates, thrust). Clamps the thrust to 0..1 and normalises the quaternion.
    ///
    /// Returns `None` for any other mask, a number that is not finite, or a quaternion whose norm
    /// is at most 0.1. Such a message does not keep the stream alive.
    pub fn from_message(message: &SET_ATTITUDE_TARGET_DATA) -> Option<Self> {
        let SET_ATTITUDE_TARGET_DATA { q, thrust, type_mask, .. } = message;
        let rates = [message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate];
        let (attitude, rates) = match type_mask.bits() {
            0x00 => (Some(unit(*q)?), rates),
            0x07 => (Some(unit(*q)?), [0.0; 3]),
            0x80 => (None, rates),
            _ => return None,
        };
        if !thrust.is_finite() || rates.iter().any(|rate| !rate.is_finite()) {
            return None;
        }
        Some(Self {
            attitude: attitude.map(Attitude::euler),
            body_rate: Frd::from(rates.map(f64::from)),
            thrust: f64::from(*thrust).clamp(0.0, 1.0),
            type_mask: *type_mask,
        })
    }
}

/// PX4 accepts a quaternion of any norm; one near zero has no direction.
pub(super) fn unit([w, x, y, z]: [f32; 4]) -> Option<Attitude> {
    let q: Attitude = Attitude { w: w.into(), x: x.into(), y: y.into(), z: z.into() };
    let norm = (q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z).sqrt();
    (norm.is_finite() && norm > 0.1).then(|| q.normalized())
}

/// The stream of setpoints: a delay line, followed by the active setpoint.
#[derive(Clone, Debug)]
pub struct OffboardStream {
    delay_s: f64,
    under_way: VecDeque<(u64, AttitudeSetpoint)>,
    in_force: Option<AttitudeSetpoint>,
    /// Time at which the active setpoint took effect, if after the previous tick.
    arrived_us: Option<u64>,
    received_us: Option<u64>,
}

impl OffboardStream {
    /// Creates a stream whose setpoints take effect `delay_s` after reception, on average. Up to 1
    /// ms of the delay is exponential jitter; the rest is constant.
    pub fn new(delay_s: f64) -> Self {
        Self {
            delay_s,
            under_way: VecDeque::new(),
            in_force: None,
            arrived_us: None,
            received_us: None,
        }
    }

    /// Adds a setpoint received at `now_us`. Setpoints never overtake one another.
    pub fn receive(&mut self, now_us: u64, setpoint: AttitudeSetpoint, rng: &mut impl Rng) {
        let jitter_mean = self.delay_s.min(JITTER_MEAN_S);
        let jitter: f64 = Exp1.sample(rng);
        let delay_s = (self.delay_s - jitter_mean) + jitter_mean * jitter;
        let earliest = self.under_way.back().map_or(0, |(acts_us, _)| *acts_us);
        let acts_us = (now_us + (delay_s * 1e6).round() as u64).max(earliest);
        if self.under_way.len() == UNDER_WAY_MAX {
            self.under_way.pop_front();
        }
        self.under_way.push_back((acts_us, setpoint));
        self.received_us = Some(now_us);
    }

    /// The active setpoint at the tick at `now_us`.
    pub fn at(&mut self, now_us: u64) -> Option<AttitudeSetpoint> {
        self.arrived_us = None;
        while let Some((acts_us, setpoint)) =
            self.under_way.front().filter(|(acts, _)| *acts <= now_us)
        {
            self.in_force = Some(*setpoint);
            self.arrived_us = Some(*acts_us);
            self.under_way.pop_front();
        }
        self.in_force
    }

    /// Time at which the setpoint of the last [`OffboardStream::at`] took effect, us; `None` if it
    /// was active before.
    pub fn arrived_us(&self) -> Option<u64> {
        self.arrived_us
    }

    /// Drops all setpoints.
    pub fn clear(&mut self) {
        *self = Self::new(self.delay_s);
    }

    /// Whether the last setpoint is younger than `timeout_us`.
    pub fn is_live(&self, now_us: u64, timeout_us: u64) -> bool {
        self.received_us.is_some_and(|at| now_us.saturating_sub(at) < timeout_us)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    fn message(mask: u8) -> SET_ATTITUDE_TARGET_DATA {
        SET_ATTITUDE_TARGET_DATA {
            q: [1.0, 0.0, 0.0, 0.0],
            body_roll_rate: 0.1,
            thrust: 0.5,
            type_mask: AttitudeTargetTypemask::from_bits_retain(mask),
            ..Default::default()
        }
    }

    #[test]
    fn only_three_type_masks_are_accepted() {
        for mask in 0..=255 {
            let counts = AttitudeSetpoint::from_message(&message(mask)).is_some();
            assert_eq!(counts, matches!(mask, 0x00 | 0x07 | 0x80), "mask {mask:#x}");
        }
    }

    #[test]
    fn masked_fields_are_ignored() {
        let setpoint = AttitudeSetpoint::from_message(&message(0x07)).unwrap();
        assert_eq!(setpoint.body_rate, Frd::zero());
        let mut rates_only = message(0x80);
        rates_only.q = [f32::NAN; 4];
        let setpoint = AttitudeSetpoint::from_message(&rates_only).unwrap();
        assert!(setpoint.attitude.is_none());
    }

    #[test]
    fn non_finite_setpoints_are_refused() {
        for spoil in [
            |m: &mut SET_ATTITUDE_TARGET_DATA| m.q[2] = f32::NAN,
            |m: &mut SET_ATTITUDE_TARGET_DATA| m.q = [0.0; 4],
            |m: &mut SET_ATTITUDE_TARGET_DATA| m.q = [f32::MAX, f32::INFINITY, 0.0, 0.0],
            |m: &mut SET_ATTITUDE_TARGET_DATA| m.thrust = f32::NAN,
            |m: &mut SET_ATTITUDE_TARGET_DATA| m.body_yaw_rate = f32::INFINITY,
        ] {
            let mut spoiled = message(0x00);
            spoil(&mut spoiled);
            assert_eq!(AttitudeSetpoint::from_message(&spoiled), None);
        }
    }

    #[test]
    fn thrust_is_clamped_and_quaternion_scale_is_ignored() {
        let mut large = message(0x00);
        large.thrust = 3.0;
        large.q = [1.2, 0.0, 0.0, 0.0];
        let setpoint = AttitudeSetpoint::from_message(&large).unwrap();
        assert_eq!(setpoint.thrust, 1.0);
        assert_eq!(setpoint.attitude, Some(Euler::default()));
    }

    #[test]
    fn mean_delay_matches_the_configured_delay() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let setpoint = AttitudeSetpoint::from_message(&message(0x00)).unwrap();
        let mut total = 0.0;
        let count = 4000;
        for _ in 0..count {
            let mut stream = OffboardStream::new(0.005);
            stream.receive(0, setpoint, &mut rng);
            total += stream.under_way[0].0 as f64 * 1e-6;
        }
        assert!((total / f64::from(count) - 0.005).abs() < 1e-4);
    }

    proptest! {
        #[test]
        fn setpoints_act_in_the_order_sent(seed: u64, gaps in prop::collection::vec(0u64..3000, 1..100)) {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            let mut stream = OffboardStream::new(0.003);
            let mut now = 0;
            for gap in gaps {
                now += gap;
                stream.receive(now, AttitudeSetpoint::from_message(&message(0)).unwrap(), &mut rng);
            }
            prop_assert!(stream.under_way.iter().is_sorted_by_key(|(acts, _)| *acts));
        }
    }

    #[test]
    fn stream_is_live_until_its_timeout() {
        let mut stream = OffboardStream::new(0.0);
        assert!(!stream.is_live(0, 1000));
        let setpoint = AttitudeSetpoint::from_message(&message(0x00)).unwrap();
        stream.receive(10, setpoint, &mut Pcg64Mcg::seed_from_u64(0));
        assert!(stream.is_live(1009, 1000));
        assert!(!stream.is_live(1010, 1000));
    }
}
