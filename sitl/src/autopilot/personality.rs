//! What differs between the autopilots that the vehicle can be: one implementation of
//! [`Personality`] for each. Everything else in [`super`] is shared.

mod arducopter;
mod bundled;
mod bundled_cascade;
mod gains;
mod low_pass;
mod px4;
mod px4_rules;
mod rate_loop;

use std::fmt;

use wire::dialect::{
    AUTOPILOT_VERSION_DATA, MavAutopilot, MavBatteryChargeState, MavEstimatorType, MavFrame,
    MavModeFlag, MavResult, MavStandardMode, MavType, ODOMETRY_DATA, SET_ATTITUDE_TARGET_DATA,
};

use super::Mode;
use super::arming::Refusal;
use super::commander::{Commander, Situation};
use super::guidance::Sticks;
use super::offboard::AttitudeSetpoint;
use super::parameters::{Key, Parameters};
use super::streams::{IntervalError, StreamRules};
use crate::config::Autopilot;
use vehicle::effects::PdGain;
use vehicle::frame::{Attitude, Frd};
use vehicle::{ROTORS, VehicleError, VehicleParams};

/// The personality that `autopilot` names.
pub(super) fn of(autopilot: Autopilot) -> &'static dyn Personality {
    match autopilot {
        Autopilot::Bundled => &bundled::Bundled,
        Autopilot::Px4 => &px4::Px4,
        Autopilot::Arducopter => &arducopter::Arducopter,
    }
}

/// The on-board loop with its parameters, as a personality builds them from a vehicle file.
pub(super) struct Onboard {
    pub parameters: Parameters,
    pub attitude_loop: Box<dyn OnboardLoop>,
    /// Rate of the loop, Hz.
    pub rate_hz: f64,
}

/// What the attitude loop has at one tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct LoopInput<'a> {
    pub setpoint: &'a AttitudeSetpoint,
    /// How long the setpoint has been in force, if it was not at the last tick, s.
    pub new_for_s: Option<f64>,
    /// As reported.
    pub attitude: Attitude,
    /// Gyro, rad/s.
    pub body_rate: Frd,
    /// Whether the vehicle stands on the ground: integrals rest then.
    pub landed: bool,
    /// Time since the last tick, s.
    pub dt: f64,
}

/// An attitude loop with its mixer.
pub(super) trait OnboardLoop: fmt::Debug + Send {
    /// The motor outputs, 0..1.
    fn outputs(&mut self, input: &LoopInput<'_>) -> [f64; ROTORS];

    /// The motors stand: forgets what was integrated and shaped.
    fn rest(&mut self) {}

    /// Takes the gains that the parameters now say.
    fn configure(&mut self, _parameters: &Parameters) {}

    /// What ATTITUDE_TARGET tells while `setpoint` is in force.
    fn told(&self, setpoint: AttitudeSetpoint) -> AttitudeSetpoint {
        setpoint
    }
}

/// What a SET_ATTITUDE_TARGET does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Reception {
    /// It is flown.
    Fly(AttitudeSetpoint),
    /// Setpoints end: the vehicle stops and holds its place.
    Stop,
    /// Nothing; it does not keep the stream alive either.
    Ignore,
}

/// What the mode that takes setpoints flies at a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Pursuit {
    /// The setpoint as it is; without one the motors stand.
    Setpoint(Option<AttitudeSetpoint>),
    /// The setpoint's attitude, with a thrust that makes this climb rate in m/s.
    Climb(AttitudeSetpoint, f64),
    /// The place where setpoints ended.
    Hold,
}

/// The state of the setpoint stream at a tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct StreamState {
    /// The setpoint in force.
    pub setpoint: Option<AttitudeSetpoint>,
    /// Whether one was heard within [`Key::ComOfLossT`].
    pub is_live: bool,
    /// Heading, rad.
    pub yaw: f64,
    /// Whether the vehicle stands on the ground.
    pub landed: bool,
}

/// The values that a message has for an output of 0, for 1, and for motors that are disarmed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OutputScale {
    pub zero: f64,
    pub one: f64,
    pub disarmed: f64,
}

/// An autopilot, as far as it differs from the others.
pub(super) trait Personality: fmt::Debug + Sync {
    /// HEARTBEAT's `autopilot`.
    fn autopilot(&self) -> MavAutopilot {
        MavAutopilot::MAV_AUTOPILOT_PX4
    }

    /// AUTOPILOT_VERSION.
    fn version(&self) -> AUTOPILOT_VERSION_DATA;

    /// The modes that it has, in the order of AVAILABLE_MODES.
    fn modes(&self) -> &'static [Mode];

    /// The word of a mode in HEARTBEAT.
    fn custom_mode(&self, mode: Mode) -> u32 {
        mode.custom_mode()
    }

    /// The mode of parameters 2 and 3 of MAV_CMD_DO_SET_MODE.
    fn mode_of_command(&self, main: u8, sub: u8) -> Option<Mode> {
        Mode::from_main_and_sub(main, sub).filter(|mode| self.modes().contains(mode))
    }

    /// Parameters 2 and 3 of MAV_CMD_DO_SET_MODE that choose a mode.
    fn mode_command(&self, mode: Mode) -> [u8; 2] {
        let [_, _, main, sub] = self.custom_mode(mode).to_le_bytes();
        [main, sub]
    }

    /// The mode of a `custom_mode` word.
    fn mode_of_word(&self, word: u32) -> Option<Mode> {
        self.modes().iter().copied().find(|mode| self.custom_mode(*mode) == word)
    }

    /// What the autopilot calls a mode.
    fn mode_name(&self, mode: Mode) -> &'static str {
        mode.name()
    }

    /// HEARTBEAT's `base_mode`.
    fn base_mode(&self, mode: Mode, armed: bool) -> MavModeFlag {
        mode.base_mode(armed)
    }

    /// CURRENT_MODE's `standard_mode`.
    fn standard_mode(&self, mode: Mode) -> MavStandardMode {
        mode.standard_mode()
    }

    /// The mode after switching on.
    fn first_mode(&self) -> Mode {
        Mode::Hold
    }

    /// Whether a flight can begin in `mode`.
    fn mode_can_arm(&self, mode: Mode) -> bool {
        !matches!(mode, Mode::Land | Mode::Return)
    }

    /// Whether the vehicle sends CURRENT_MODE at once when its mode changes.
    fn announces_mode(&self) -> bool {
        true
    }

    /// What MAV_CMD_DO_SET_MODE is answered with before the mode is checked.
    fn early_answer(&self) -> Option<MavResult> {
        None
    }

    /// Whether a refused parameter is answered by PARAM_ERROR and a text.
    fn explains_refused_parameters(&self) -> bool {
        false
    }

    /// Whether the code that forces arming skips the checks.
    fn forced_arming_skips_checks(&self) -> bool {
        false
    }

    /// Whether NAV_TAKEOFF is flown without leaving the mode that takes setpoints.
    fn takes_off_in_offboard(&self) -> bool {
        false
    }

    /// Whether NAV_TAKEOFF names a height above home, not above sea level.
    fn takes_off_to_height(&self) -> bool {
        false
    }

    /// Which streams there are and how often they come.
    fn streams(&self) -> &'static StreamRules;

    /// Parameters and attitude loop of `vehicle`; `truth` scales the loop's gains.
    ///
    /// # Errors
    /// [`NoLoop`].
    fn onboard(&self, vehicle: &VehicleParams, truth: Option<PdGain>) -> Result<Onboard, NoLoop>;

    /// The scale of motor outputs in the message of this name.
    fn output_scale(&self, message: &str, parameters: &Parameters) -> OutputScale;

    /// Whether the vehicle sends outputs as the vehicle file's `motor_output` says, not as the autopilot's
    /// own parameters do.
    fn heeds_motor_output(&self) -> bool {
        false
    }

    /// ACTUATOR_OUTPUT_STATUS's `active` for outputs of which these are in use, bit by bit.
    fn active_outputs(&self, bits: u32) -> u32 {
        bits
    }

    /// The answer to a request for an interval that is not granted.
    fn refused_interval(&self, _error: IntervalError) -> MavResult {
        MavResult::MAV_RESULT_FAILED
    }

    /// What a SET_ATTITUDE_TARGET does while `mode` is in force.
    fn receive(&self, message: &SET_ATTITUDE_TARGET_DATA, mode: Mode) -> Reception;

    /// What the mode that takes setpoints flies.
    fn pursue(&self, stream: &StreamState, _parameters: &Parameters) -> Pursuit {
        Pursuit::Setpoint(stream.setpoint)
    }

    /// Whether a mode that needs setpoints needs them now, to be entered in flight or armed in.
    fn needs_stream(&self) -> bool {
        true
    }

    /// Share of the thrust that may be used `armed_s` after arming, on the ground.
    fn thrust_limit(&self, _armed_s: f64, _parameters: &Parameters) -> f64 {
        1.0
    }

    /// Whether SYS_STATUS has the position control enabled and healthy in `mode`, while the position
    /// is known.
    fn controls_position(&self, _mode: Mode) -> bool {
        true
    }

    /// How long after the last pose from outside the position is no longer vouched for, s: PX4's simulation
    /// was measured to say so 5.8 s after its last fix.
    fn vision_lost_after_s(&self) -> f64 {
        5.8
    }

    /// Whether an ODOMETRY is taken for a pose from outside: one in front, right, down or north, east, down,
    /// of an estimator that may be believed.
    fn takes_odometry(&self, message: &ODOMETRY_DATA) -> bool {
        let frame = message.frame_id;
        let is_frame =
            [MavFrame::MAV_FRAME_LOCAL_FRD, MavFrame::MAV_FRAME_LOCAL_NED].contains(&frame);
        is_frame
            && !matches!(
                message.estimator_type,
                MavEstimatorType::MAV_ESTIMATOR_TYPE_AUTOPILOT
                    | MavEstimatorType::MAV_ESTIMATOR_TYPE_GPS
                    | MavEstimatorType::MAV_ESTIMATOR_TYPE_LIDAR
                    | MavEstimatorType::MAV_ESTIMATOR_TYPE_MOCAP
            )
    }

    /// Whether a vehicle that has lost its position leaves `mode` to land. PX4's OFFBOARD with attitudes needs
    /// none.
    fn lands_without_position(&self, mode: Mode) -> bool {
        matches!(mode, Mode::Hold | Mode::Position | Mode::Takeoff | Mode::Return)
    }

    /// Largest tilt that the attitude loop may ask for while the detector takes the vehicle for landed,
    /// rad.
    fn landed_lean_max(&self) -> f64 {
        f64::INFINITY
    }

    /// Sticks where none are heard.
    fn sticks_without_radio(&self) -> Option<Sticks> {
        None
    }

    /// Whether a HEARTBEAT is one of the ground station whose loss is watched.
    fn is_ground_station(&self, _system: u8, kind: MavType, _parameters: &Parameters) -> bool {
        kind == MavType::MAV_TYPE_GCS
    }

    /// The mode after disarming, now that `chosen` was asked for; `None`: it stays as it was.
    fn mode_after_disarming(&self, chosen: Mode, armed: bool) -> Option<Mode>;

    /// Runs one tick of an armed vehicle: takes failsafes, follows the pilot's sticks, and disarms
    /// after a landing or a time-out.
    fn watch(&self, commander: &mut Commander, now: &Situation, parameters: &Parameters);

    /// Words for a refused arming, mode or disarming.
    fn refusal_text(&self, refused: Refused, refusal: &Refusal) -> String;

    /// Words for a failsafe that takes `mode`.
    fn failsafe_text(&self, mode: Mode, why: &str) -> String {
        format!("{why}: failsafe activated, switching to {mode}")
    }

    /// How the pack is judged by its charge, 0..1, and the warnings that were given.
    fn charge_state(
        &self,
        _charge: f64,
        _warnings: usize,
        _parameters: &Parameters,
    ) -> MavBatteryChargeState {
        MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_OK
    }

    /// Words for GPS being rejected, or no longer.
    fn gps_text(&self, _is_rejected: bool) -> Option<&'static str> {
        None
    }

    /// Words for a mode that there is not.
    fn unknown_mode_text(&self) -> &'static str {
        "Mode not available: use Hold, Position, Takeoff, Land, Return, Offboard"
    }

    /// Words for the motors being armed or disarmed `by` someone.
    fn motors_text(&self, armed: bool, by: &str) -> String;

    /// A text as STATUSTEXT carries it.
    fn text(&self, text: &str) -> String {
        text.to_owned()
    }
}

/// What was asked for and refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refused {
    Arming,
    Mode(Mode),
    Disarming,
}

/// Why a vehicle file has no loop that a personality can fly.
#[derive(Debug)]
pub(super) enum NoLoop {
    /// It names none.
    Missing,
    /// The mixer cannot be inverted.
    Vehicle(VehicleError),
}

impl From<VehicleError> for NoLoop {
    fn from(error: VehicleError) -> Self {
        Self::Vehicle(error)
    }
}

/// Parameters of the bundled vehicle, for unit tests.
#[cfg(test)]
pub(super) use bundled::parameters as bundled_parameters;

/// The value of an integer parameter, such as an action.
fn choice(parameters: &Parameters, key: Key) -> i32 {
    parameters.get(key) as i32
}
