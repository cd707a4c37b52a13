//! Autopilot profiles: the differences between autopilots, as values.
//!
//! The meaning of SET_ATTITUDE_TARGET is a property of the autopilot. Three are known. The bundled
//! vehicle takes attitude, rates and thrust together, as a PD law. PX4 must never get attitude and
//! rates together, because the rates then override its attitude loop once per message. ArduCopter
//! may, but rotates the rates by the commanded attitude. Any other autopilot gets attitude and
//! thrust, which all of them fly.

use std::fmt;

use message::MotorSource;
use message::parameter_value::ParameterCast;

use super::loss_reaction::LossLaw;

/// MAV_AUTOPILOT_ARDUPILOTMEGA.
pub(crate) const ARDUPILOT: u8 = 3;
/// MAV_AUTOPILOT_PX4.
pub(crate) const PX4: u8 = 12;
/// AUTOPILOT_VERSION vendor and product of the vehicle that honours attitude, rates and thrust
/// together.
pub const PD_VEHICLE: (u16, u16) = (0x4457, 1);

/// The content of SET_ATTITUDE_TARGET.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AttitudeTargetForm {
    /// Mask 0x00: attitude, rates and thrust.
    AttitudeRatesThrust,
    /// Mask 0x07: attitude and thrust.
    AttitudeThrust,
    /// Mask 0x80: rates and thrust. The attitude loop is closed here:
    /// `omega = omega_des + gain * e`, where e is the rotation vector from the vehicle's attitude
    /// to the desired one, in body axes.
    RatesThrust {
        /// Gain per body axis, 1/s: Kp/Kd of the on-board PD law that it replaces.
        gain: [f64; 3],
    },
}

impl AttitudeTargetForm {
    /// The type mask: set bits are ignored fields.
    pub const fn type_mask(self) -> u8 {
        match self {
            Self::AttitudeRatesThrust => 0x00,
            Self::AttitudeThrust => 0x07,
            Self::RatesThrust { .. } => 0x80,
        }
    }
}

/// How the vehicle interprets the rates that come with an attitude.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RateFrame {
    /// As body rates.
    Body,
    /// Rotated by the commanded attitude first: `q_cmd^-1 w` must be sent for body rate `w`.
    RotatedByCommand,
}

/// A mode: its value in HEARTBEAT and CURRENT_MODE, and the DO_SET_MODE parameters that select it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mode {
    /// The value of HEARTBEAT.custom_mode.
    pub custom_mode: u32,
    /// DO_SET_MODE param 2.
    pub main: u8,
    /// DO_SET_MODE param 3.
    pub sub: u8,
}

impl Mode {
    /// PX4 takes main and sub mode as separate parameters and reports them packed.
    const fn px4(main: u8, sub: u8) -> Self {
        Self { custom_mode: (main as u32) << 16 | (sub as u32) << 24, main, sub }
    }

    const fn copter(number: u8) -> Self {
        Self { custom_mode: number as u32, main: number, sub: 0 }
    }
}

/// The modes that this program requests; `None` where the autopilot has none or is unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Modes {
    /// Obeys SET_ATTITUDE_TARGET.
    pub offboard: Option<Mode>,
    /// Holds position without sticks.
    pub hold: Option<Mode>,
    /// Lands where the vehicle is.
    pub land: Option<Mode>,
}

/// A parameter and the requirement on its value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterRule {
    /// The parameter's name.
    pub name: &'static str,
    /// The requirement on the value.
    pub rule: Rule,
    /// The reason, for the pilot.
    pub why: &'static str,
}

/// A requirement on a parameter's value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rule {
    /// Equal to this.
    Equals(f64),
    /// Has these bits set.
    HasBits(u32),
    /// At most this.
    AtMost(f64),
}

impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Equals(value) => write!(f, "{value}"),
            Self::HasBits(bits) => write!(f, "a value with the bits {bits:#x} set"),
            Self::AtMost(limit) => write!(f, "at most {limit}"),
        }
    }
}

impl ParameterRule {
    /// Whether a value meets the rule.
    pub fn holds(&self, value: f64) -> bool {
        match self.rule {
            Rule::Equals(required) => (value - required).abs() <= 1e-6 * required.abs().max(1.0),
            Rule::HasBits(bits) => value >= 0.0 && value as u32 & bits == bits,
            Rule::AtMost(limit) => value <= limit * (1.0 + 1e-6),
        }
    }
}

/// A message that this program wants, and its rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MessageRate {
    /// MAVLink message id.
    pub id: u32,
    /// Wanted rate, Hz.
    pub hz: f64,
}

/// Everything about an autopilot that this program must know to fly it.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Name for people.
    pub name: &'static str,
    /// The content of SET_ATTITUDE_TARGET.
    pub attitude_target: AttitudeTargetForm,
    /// How it interprets rates.
    pub rate_frame: RateFrame,
    /// Whether its attitude loop compares roll, pitch and yaw separately, as the paper's does,
    /// instead of the rotation as a whole.
    pub compares_angles: bool,
    /// The modes that are requested.
    pub modes: Modes,
    /// Its name for each mode, by HEARTBEAT.custom_mode.
    pub mode_names: &'static [(u32, &'static str)],
    /// Whether it reports the intended mode in CURRENT_MODE.
    pub reports_intended_mode: bool,
    /// The parameter that sets how long setpoints may be missing, in s, and the rule for it.
    pub loss_timeout: Option<ParameterRule>,
    /// Its reaction to that, and the parameters that decide.
    pub loss: LossLaw,
    /// Rules without which it must not fly.
    pub required: &'static [ParameterRule],
    /// The message that reports its motor outputs.
    pub motor_outputs: MotorSource,
    /// How it encodes integer parameters.
    pub parameter_cast: ParameterCast,
    /// The parameters that reduce its unrequested traffic on a serial line, for people.
    pub stream_parameters: &'static str,
    /// The messages that serve control best, with their rates.
    pub telemetry: &'static [MessageRate],
}

/// The user's choice of the setpoints' form.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum FormChoice {
    /// As in the autopilot's profile.
    #[default]
    Profile,
    /// Attitude, rates and thrust, for a vehicle with an on-board PD law that it does not declare.
    /// Unsafe on PX4.
    ForceAttitudeRatesThrust,
    /// Rates and thrust, with the attitude loop closed here.
    RatesThrust {
        /// See [`AttitudeTargetForm::RatesThrust`].
        gain: [f64; 3],
    },
    /// Attitude and rates on ArduCopter, with the rates rotated back by the commanded attitude.
    /// Test it in simulation first, because it depends on the version. Elsewhere as in the profile.
    ArduCopterRates,
}

const fn rate(id: u32, hz: f64) -> MessageRate {
    MessageRate { id, hz }
}

/// PX4 quantises to its sources' periods: 100 and 250 Hz are served exactly, 200 Hz is not.
const PX4_TELEMETRY: &[MessageRate] = &[
    rate(331, 100.0), // ODOMETRY
    rate(31, 250.0),  // ATTITUDE_QUATERNION
    rate(32, 100.0),  // LOCAL_POSITION_NED
    rate(105, 250.0), // HIGHRES_IMU
    rate(375, 100.0), // ACTUATOR_OUTPUT_STATUS
    rate(83, 50.0),   // ATTITUDE_TARGET
    rate(147, 5.0),   // BATTERY_STATUS
    rate(436, 2.0),   // CURRENT_MODE: never faster, but at once on a change
    rate(245, 2.0),   // EXTENDED_SYS_STATE
];

/// ArduCopter has no ODOMETRY and honours at most 0.8 of its loop rate, in whole milliseconds.
const COPTER_TELEMETRY: &[MessageRate] = &[
    rate(31, 100.0), // ATTITUDE_QUATERNION
    rate(32, 100.0), // LOCAL_POSITION_NED
    rate(36, 50.0),  // SERVO_OUTPUT_RAW
    rate(83, 50.0),  // ATTITUDE_TARGET
    rate(1, 2.0),    // SYS_STATUS
    rate(147, 5.0),  // BATTERY_STATUS
    rate(245, 2.0),  // EXTENDED_SYS_STATE
];

const SAFE_TELEMETRY: &[MessageRate] = &[rate(31, 100.0), rate(32, 100.0), rate(147, 2.0)];

const fn px4_mode(main: u8, sub: u8, name: &'static str) -> (u32, &'static str) {
    (Mode::px4(main, sub).custom_mode, name)
}

const PX4_MODES: &[(u32, &str)] = &[
    px4_mode(1, 0, "Manual"),
    px4_mode(2, 0, "Altitude"),
    px4_mode(3, 0, "Position"),
    px4_mode(3, 2, "Position Slow"),
    px4_mode(4, 1, "Ready"),
    px4_mode(4, 2, "Takeoff"),
    px4_mode(4, 3, "Hold"),
    px4_mode(4, 4, "Mission"),
    px4_mode(4, 5, "Return"),
    px4_mode(4, 6, "Land"),
    px4_mode(4, 8, "Follow Me"),
    px4_mode(4, 9, "Precision Land"),
    px4_mode(5, 0, "Acro"),
    px4_mode(6, 0, "Offboard"),
    px4_mode(7, 0, "Stabilized"),
    px4_mode(10, 0, "Termination"),
];

const COPTER_MODES: &[(u32, &str)] = &[
    (0, "Stabilize"),
    (1, "Acro"),
    (2, "AltHold"),
    (3, "Auto"),
    (4, "Guided"),
    (5, "Loiter"),
    (6, "RTL"),
    (7, "Circle"),
    (9, "Land"),
    (11, "Drift"),
    (13, "Sport"),
    (15, "AutoTune"),
    (16, "PosHold"),
    (17, "Brake"),
    (18, "Throw"),
    (20, "Guided without GPS"),
    (21, "SmartRTL"),
    (22, "FlowHold"),
    (23, "Follow"),
    (24, "ZigZag"),
    (27, "AutoRTL"),
    (28, "Turtle"),
];

impl Profile {
    /// PX4: attitude and thrust.
    pub const PX4: Self = Self {
        name: "PX4",
        attitude_target: AttitudeTargetForm::AttitudeThrust,
        rate_frame: RateFrame::Body,
        compares_angles: false,
        modes: Modes {
            offboard: Some(Mode::px4(6, 0)),
            hold: Some(Mode::px4(4, 3)),
            land: Some(Mode::px4(4, 6)),
        },
        mode_names: PX4_MODES,
        reports_intended_mode: true,
        loss_timeout: Some(ParameterRule {
            name: "COM_OF_LOSS_T",
            rule: Rule::AtMost(0.2),
            why: "the vehicle flies the last setpoint for this long when the stream ends",
        }),
        loss: LossLaw::Px4,
        required: &[],
        motor_outputs: MotorSource::ActuatorOutputStatus,
        parameter_cast: ParameterCast::Bytes,
        stream_parameters: "MAV_n_MODE and MAV_n_RATE",
        telemetry: PX4_TELEMETRY,
    };

    /// A vehicle that presents itself as PX4, with an on-board PD law on attitude and rates
    /// together.
    pub const BUNDLED: Self = Self {
        name: "bundled",
        attitude_target: AttitudeTargetForm::AttitudeRatesThrust,
        compares_angles: true,
        ..Self::PX4
    };

    /// ArduCopter in GUIDED.
    pub const ARDUCOPTER: Self = Self {
        name: "ArduCopter",
        attitude_target: AttitudeTargetForm::AttitudeThrust,
        rate_frame: RateFrame::RotatedByCommand,
        compares_angles: false,
        modes: Modes {
            offboard: Some(Mode::copter(4)),
            hold: Some(Mode::copter(17)), // BRAKE: needs no sticks, LOITER would descend.
            land: Some(Mode::copter(9)),
        },
        mode_names: COPTER_MODES,
        reports_intended_mode: false,
        loss_timeout: Some(ParameterRule {
            name: "GUID_TIMEOUT",
            rule: Rule::AtMost(0.2),
            why: "the vehicle stays tilted for this long when the stream ends",
        }),
        loss: LossLaw::ArduCopter,
        required: &[
            ParameterRule {
                name: "GUID_OPTIONS",
                rule: Rule::HasBits(8),
                // With it, thrust also takes off: setpoints need no NAV_TAKEOFF before them.
                why: "without bit 3 the thrust field is a climb rate",
            },
            ParameterRule {
                name: "ATC_ANGLE_BOOST",
                rule: Rule::Equals(0.0),
                why: "the vehicle would add tilt compensation to a thrust that already has it",
            },
        ],
        motor_outputs: MotorSource::ServoOutputRaw,
        parameter_cast: ParameterCast::Value,
        stream_parameters: "SRn_* (from 4.7 on MAVn_*)",
        telemetry: COPTER_TELEMETRY,
    };

    /// An unknown autopilot: the form that all of them fly, and no modes.
    pub const UNKNOWN: Self = Self {
        name: "unknown",
        attitude_target: AttitudeTargetForm::AttitudeThrust,
        rate_frame: RateFrame::Body,
        compares_angles: false,
        modes: Modes { offboard: None, hold: None, land: None },
        mode_names: &[],
        reports_intended_mode: false,
        loss_timeout: None,
        loss: LossLaw::Unknown,
        required: &[],
        motor_outputs: MotorSource::ServoOutputRaw,
        parameter_cast: ParameterCast::Value,
        stream_parameters: "its stream rates",
        telemetry: SAFE_TELEMETRY,
    };

    /// The profile of a vehicle, from MAV_AUTOPILOT and MAV_TYPE of its HEARTBEAT, and vendor and
    /// product of its AUTOPILOT_VERSION (if it answered).
    ///
    /// Attitude, rates and thrust go together only to a vehicle that declares that it takes them
    /// and whose file has `attitude_pd`, or where the user forces it.
    pub fn identify(
        autopilot: u8,
        vehicle_type: u8,
        version: Option<(u16, u16)>,
        vehicle_has_attitude_pd: bool,
        choice: FormChoice,
    ) -> Self {
        let is_copter = matches!(vehicle_type, 2 | 3 | 4 | 13 | 14 | 15 | 29 | 35);
        let mut profile = match autopilot {
            PX4 if version == Some(PD_VEHICLE) && vehicle_has_attitude_pd => Self::BUNDLED,
            PX4 => Self::PX4,
            ARDUPILOT if is_copter => Self::ARDUCOPTER,
            _ => Self::UNKNOWN,
        };
        profile.compares_angles = autopilot == PX4 && version == Some(PD_VEHICLE);
        let is_arducopter = profile.name == Self::ARDUCOPTER.name;
        profile.attitude_target = match choice {
            FormChoice::ForceAttitudeRatesThrust => AttitudeTargetForm::AttitudeRatesThrust,
            FormChoice::RatesThrust { gain } => AttitudeTargetForm::RatesThrust { gain },
            FormChoice::ArduCopterRates if is_arducopter => AttitudeTargetForm::AttitudeRatesThrust,
            FormChoice::ArduCopterRates | FormChoice::Profile => profile.attitude_target,
        };
        profile
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const QUADROTOR: u8 = 2;
    const PLANE: u8 = 1;

    #[test]
    fn type_mask_follows_vehicle_and_form_choice() {
        use FormChoice as C;
        let rates = C::RatesThrust { gain: [6.0; 3] };
        let cases = [
            // autopilot, type, version, attitude_pd, choice, mask
            (PX4, QUADROTOR, Some(PD_VEHICLE), true, C::Profile, 0x00),
            (PX4, QUADROTOR, Some(PD_VEHICLE), false, C::Profile, 0x07),
            (PX4, QUADROTOR, Some(PD_VEHICLE), true, rates, 0x80),
            (PX4, QUADROTOR, Some((0x26AC, 50)), true, C::Profile, 0x07),
            (PX4, QUADROTOR, None, true, C::Profile, 0x07),
            (PX4, QUADROTOR, None, true, C::ForceAttitudeRatesThrust, 0x00),
            (PX4, QUADROTOR, None, true, C::ArduCopterRates, 0x07),
            (PX4, QUADROTOR, None, false, rates, 0x80),
            (ARDUPILOT, QUADROTOR, None, false, C::Profile, 0x07),
            (ARDUPILOT, QUADROTOR, None, false, C::ArduCopterRates, 0x00),
            // The vendor id means nothing on an autopilot that does not present itself as PX4.
            (ARDUPILOT, QUADROTOR, Some(PD_VEHICLE), true, C::Profile, 0x07),
            (ARDUPILOT, PLANE, None, false, C::ArduCopterRates, 0x07),
            (0, QUADROTOR, None, true, C::Profile, 0x07),
            (200, 250, None, true, C::Profile, 0x07),
        ];
        for (autopilot, kind, version, pd, choice, mask) in cases {
            let profile = Profile::identify(autopilot, kind, version, pd, choice);
            assert_eq!(
                profile.attitude_target.type_mask(),
                mask,
                "{autopilot} {kind} {version:?} {pd} {choice:?}"
            );
        }
    }

    #[test]
    fn px4_modes_match_the_documentation() {
        let modes = Profile::PX4.modes;
        assert_eq!(modes.offboard.map(|mode| mode.custom_mode), Some(0x0006_0000));
        assert_eq!(modes.hold.map(|mode| mode.custom_mode), Some(0x0304_0000));
        assert_eq!(modes.land.map(|mode| mode.custom_mode), Some(0x0604_0000));
    }

    #[test]
    fn required_parameter_rules_hold() {
        let bits = Profile::ARDUCOPTER.required[0];
        assert!(bits.holds(8.0) && bits.holds(9.0) && !bits.holds(1.0) && !bits.holds(-8.0));
        let timeout = Profile::PX4.loss_timeout.unwrap();
        assert!(timeout.holds(0.2f32.into()) && !timeout.holds(1.0));
    }
}
