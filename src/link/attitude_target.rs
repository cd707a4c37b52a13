//! From setpoint to SET_ATTITUDE_TARGET, in the form of the autopilot's profile.

use vehicle::frame::{Attitude, Frd};
use wire::dialect::{AttitudeTargetTypemask, SET_ATTITUDE_TARGET_DATA};

use super::profile::{AttitudeTargetForm, Profile, RateFrame};
use crate::guard::Cleared;
use crate::setpoint::Setpoint;

/// Maps collective thrust in newtons to the thrust field, 0..1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThrustMap {
    full_scale_n: f64,
    square_share: f64,
}

/// Why a thrust map is rejected.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ThrustMapError {
    /// The thrust at full output is not a positive number.
    #[error("full-scale thrust must be a positive number of newtons, not {0}")]
    FullScale(f64),
    /// The share of the square is outside 0..1.
    #[error("share of the square in the thrust curve must be within 0..1, not {0}")]
    SquareShare(f64),
}

impl ThrustMap {
    /// Thrust proportional to the field: `T = full_scale_n * u`.
    ///
    /// # Errors
    /// [`ThrustMapError`] unless `full_scale_n`, the sum over the rotors, is finite and positive.
    pub fn linear(full_scale_n: f64) -> Result<Self, ThrustMapError> {
        Self::curve(full_scale_n, 0.0)
    }

    /// Thrust of a vehicle that does not linearise its motors:
    /// `T = full_scale_n * ((1 - s) u + s u^2)`, with s = `square_share` (PX4's THR_MDL_FAC, which
    /// is then 0 on board).
    ///
    /// # Errors
    /// [`ThrustMapError`] unless the full scale is finite and positive, and the share in 0..1.
    pub fn curve(full_scale_n: f64, square_share: f64) -> Result<Self, ThrustMapError> {
        if !(full_scale_n.is_finite() && full_scale_n > 0.0) {
            return Err(ThrustMapError::FullScale(full_scale_n));
        }
        if !(0.0..=1.0).contains(&square_share) {
            return Err(ThrustMapError::SquareShare(square_share));
        }
        Ok(Self { full_scale_n, square_share })
    }

    /// The thrust field for a thrust in N, limited to 0..1.
    pub fn fraction(&self, thrust_n: f64) -> f64 {
        let thrust = (thrust_n / self.full_scale_n).clamp(0.0, 1.0);
        let s = self.square_share;
        // The root of s u^2 + (1 - s) u = thrust, in the form that holds at s = 0.
        let linear = 1.0 - s;
        let denominator = linear + (linear * linear + 4.0 * s * thrust).sqrt();
        if denominator > 0.0 { 2.0 * thrust / denominator } else { 0.0 }
    }

    /// The thrust in N that a field commands.
    pub fn thrust_n(&self, fraction: f64) -> f64 {
        self.full_scale_n * fraction * (1.0 - self.square_share + self.square_share * fraction)
    }
}

/// Why a setpoint has no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EncodeError {
    /// A component is NaN or infinite.
    #[error("setpoint is not finite")]
    NotFinite,
    /// The form sends rates, which needs the vehicle's attitude, and no fresh one is known.
    #[error("no fresh attitude to close the attitude loop with")]
    NoAttitude,
}

/// The message for a setpoint. `attitude` is the vehicle's, for the form that closes the attitude
/// loop here. The sender fills in the header fields (time, target). The quaternion always has unit
/// length.
///
/// # Errors
/// [`EncodeError`]. A message with a non-finite value is never made.
pub fn encode(
    cleared: &Cleared,
    attitude: Option<Attitude>,
    profile: &Profile,
    thrust: &ThrustMap,
) -> Result<SET_ATTITUDE_TARGET_DATA, EncodeError> {
    encode_bounded(cleared.setpoint(), cleared.body_rate_max_rad_s(), attitude, profile, thrust)
}

fn encode_bounded(
    setpoint: &Setpoint,
    body_rate_max_rad_s: f64,
    attitude: Option<Attitude>,
    profile: &Profile,
    thrust: &ThrustMap,
) -> Result<SET_ATTITUDE_TARGET_DATA, EncodeError> {
    if !setpoint.is_finite() {
        return Err(EncodeError::NotFinite);
    }
    let desired = setpoint.attitude.attitude().normalized();
    let rate = match (profile.attitude_target, profile.rate_frame) {
        (AttitudeTargetForm::AttitudeThrust, _) => Frd::zero(),
        (AttitudeTargetForm::AttitudeRatesThrust, RateFrame::Body) => setpoint.body_rate,
        (AttitudeTargetForm::AttitudeRatesThrust, RateFrame::RotatedByCommand) => {
            // The vehicle rotates these by the command again, which gives the body rates.
            let [x, y, z] = setpoint.body_rate.to_array();
            Frd::from(desired.to_body([x, y, z].into()).to_array())
        }
        (AttitudeTargetForm::RatesThrust { gain }, _) => {
            let attitude = attitude.ok_or(EncodeError::NoAttitude)?;
            let closed = setpoint.body_rate + attitude.rotation_to(desired).scale_by(gain);
            closed.map(|rate| rate.clamp(-body_rate_max_rad_s, body_rate_max_rad_s))
        }
    };
    let q = desired.to_wire();
    let [roll_rate, pitch_rate, yaw_rate] = rate.to_array().map(|rate| rate as f32);
    if ![roll_rate, pitch_rate, yaw_rate, q[0], q[1], q[2], q[3]].iter().all(|v| v.is_finite()) {
        return Err(EncodeError::NotFinite);
    }
    Ok(SET_ATTITUDE_TARGET_DATA {
        q,
        body_roll_rate: roll_rate,
        body_pitch_rate: pitch_rate,
        body_yaw_rate: yaw_rate,
        thrust: thrust.fraction(setpoint.thrust_n) as f32,
        type_mask: AttitudeTargetTypemask::from_bits_retain(profile.attitude_target.type_mask()),
        ..Default::default()
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use vehicle::frame::Euler;
    use wire::dialect::MavMessage;

    use super::*;
    use crate::link::profile::FormChoice;

    fn setpoint() -> Setpoint {
        Setpoint {
            thrust_n: 9.81,
            attitude: Euler::new(0.1, -0.2, 1.5),
            body_rate: Frd::new(0.3, -0.4, 0.5),
        }
    }

    const RATE_MAX: f64 = 6.0;

    fn encode(
        setpoint: &Setpoint,
        attitude: Option<Attitude>,
        profile: &Profile,
        thrust: &ThrustMap,
    ) -> Result<SET_ATTITUDE_TARGET_DATA, EncodeError> {
        encode_bounded(setpoint, RATE_MAX, attitude, profile, thrust)
    }

    fn map() -> ThrustMap {
        ThrustMap::linear(20.0).unwrap()
    }

    #[test]
    fn bundled_vehicle_gets_attitude_rates_and_thrust() {
        let data = encode(&setpoint(), None, &Profile::BUNDLED, &map()).unwrap();
        assert_eq!(data.type_mask.bits(), 0);
        assert_eq!(
            [data.body_roll_rate, data.body_pitch_rate, data.body_yaw_rate],
            [0.3, -0.4, 0.5]
        );
        assert!((data.thrust - 0.4905).abs() < 1e-6);
        let sent = Attitude::from_wire(data.q).unwrap();
        assert!(sent.angle_to(setpoint().attitude.attitude()) < 1e-6);
    }

    #[test]
    fn sent_setpoint_round_trips_within_its_mask() {
        let sent = |profile: &Profile| {
            let data = encode(&setpoint(), None, profile, &map()).unwrap();
            let mut bytes = Vec::new();
            let message = MavMessage::SET_ATTITUDE_TARGET(data);
            wire::Encoder::new(255, 190).encode(&message, &mut bytes);
            message::attitude_target::decode(&wire::Frame::parse(&bytes).unwrap()).unwrap().unwrap()
        };
        let target = sent(&Profile::BUNDLED);
        assert!(target.attitude.unwrap().angle_to(setpoint().attitude.attitude()) < 1e-6);
        assert!((target.body_rate.unwrap() - setpoint().body_rate).norm() < 1e-6);
        assert!((target.thrust.unwrap() - 0.4905).abs() < 1e-6);
        let target = sent(&Profile::PX4);
        assert!(target.attitude.is_some() && target.body_rate.is_none());
    }

    #[test]
    fn px4_never_gets_rates_with_an_attitude() {
        let data = encode(&setpoint(), None, &Profile::PX4, &map()).unwrap();
        assert_eq!(data.type_mask.bits(), 0x07);
        assert_eq!([data.body_roll_rate, data.body_pitch_rate, data.body_yaw_rate], [0.0; 3]);
    }

    #[test]
    fn rate_setpoints_close_the_attitude_loop() {
        let gain = [6.0, 6.0, 3.0];
        let profile = Profile::identify(12, 2, None, false, FormChoice::RatesThrust { gain });
        let at_rest = Setpoint { body_rate: Frd::zero(), ..setpoint() };
        assert_eq!(encode(&at_rest, None, &profile, &map()), Err(EncodeError::NoAttitude));
        let level = Euler::new(0.0, 0.0, 1.5).attitude();
        let rolled = Setpoint { attitude: Euler::new(0.1, 0.0, 1.5), ..at_rest };
        let data = encode(&rolled, Some(level), &profile, &map()).unwrap();
        assert_eq!(data.type_mask.bits(), 0x80);
        assert!((data.body_roll_rate - 0.6).abs() < 1e-6, "{}", data.body_roll_rate);
        assert!(data.body_pitch_rate.abs() < 1e-6 && data.body_yaw_rate.abs() < 1e-6);
        let far = Setpoint { attitude: Euler::new(0.0, 0.0, -1.0), ..at_rest };
        let data = encode(&far, Some(level), &profile, &map()).unwrap();
        assert_eq!(
            f64::from(data.body_yaw_rate),
            -RATE_MAX,
            "the rate that closes the loop is bounded too"
        );
    }

    #[test]
    fn sent_rates_become_body_rates_on_arducopter() {
        let profile = Profile::identify(3, 2, None, false, FormChoice::ArduCopterRates);
        let data = encode(&setpoint(), None, &profile, &map()).unwrap();
        let command = Attitude::from_wire(data.q).unwrap();
        let sent = [data.body_roll_rate, data.body_pitch_rate, data.body_yaw_rate].map(f64::from);
        let flown = command.to_world(sent.into());
        for (flown, requested) in flown.to_array().iter().zip(setpoint().body_rate.to_array()) {
            assert!((flown - requested).abs() < 1e-6);
        }
    }

    #[test]
    fn non_finite_setpoint_is_never_sent() {
        for broken in [
            Setpoint { thrust_n: f64::NAN, ..setpoint() },
            Setpoint { attitude: Euler::new(f64::INFINITY, 0.0, 0.0), ..setpoint() },
            Setpoint { body_rate: Frd::new(0.0, f64::NAN, 0.0), ..setpoint() },
            Setpoint { body_rate: Frd::new(1e300, 0.0, 0.0), ..setpoint() },
        ] {
            assert_eq!(
                encode(&broken, None, &Profile::BUNDLED, &map()),
                Err(EncodeError::NotFinite)
            );
        }
        assert!(ThrustMap::linear(0.0).is_err() && ThrustMap::linear(f64::NAN).is_err());
        assert!(ThrustMap::curve(20.0, 1.1).is_err());
    }

    proptest! {
        #[test]
        fn thrust_map_round_trips(full in 1f64..100.0, share in 0f64..=1.0, part in 0f64..=1.0) {
            let map = ThrustMap::curve(full, share).unwrap();
            let fraction = map.fraction(part * full);
            prop_assert!((0.0..=1.0).contains(&fraction));
            prop_assert!((map.thrust_n(fraction) - part * full).abs() < 1e-9 * full);
        }

        #[test]
        fn sent_quaternion_is_always_unit(
            roll in -1e3f64..1e3, pitch in -1e3f64..1e3, yaw in -1e3f64..1e3, thrust in -1e9f64..1e9,
        ) {
            let wild = Setpoint {
                thrust_n: thrust,
                attitude: Euler::new(roll, pitch, yaw),
                body_rate: Frd::zero(),
            };
            let data = encode(&wild, None, &Profile::PX4, &map()).unwrap();
            let norm: f32 = data.q.iter().map(|c| c * c).sum();
            prop_assert!((norm - 1.0).abs() < 1e-5);
            prop_assert!((0.0..=1.0).contains(&data.thrust));
        }
    }
}
