//! What differs between the simulated autopilots: one implementation of [`Personality`] for each.
//! Everything else in [`super`] is shared.

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

/// The personality of `autopilot`.
pub(super) fn of(autopilot: Autopilot) -> &'static dyn Personality {
    match autopilot {
        Autopilot::Bundled => &bundled::Bundled,
        Autopilot::Px4 => &px4::Px4,
        Autopilot::Arducopter => &arducopter::Arducopter,
    }
}

/// The on-board loop with its parameters, built from a vehicle file.
pub(super) struct Onboard {
    pub parameters: Parameters,
    pub attitude_loop: Box<dyn OnboardLoop>,
    /// Rate of the loop, Hz.
    pub rate_hz: f64,
}

/// The attitude loop's inputs at one tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct LoopInput<'a> {
    pub setpoint: &'a AttitudeSetpoint,
    /// Time since the setpoint took effect, s, if that was after the previous tick.
    pub new_for_s: Option<f64>,
    /// Reported attitude, with trim and noise.
    pub attitude: Attitude,
    /// Gyro, rad/s.
    pub body_rate: Frd,
    /// Whether the vehicle is on the ground, where integrals do not run.
    pub landed: bool,
    /// Time since the previous tick, s.
    pub dt: f64,
}

/// An attitude loop with its mixer.
pub(super) trait OnboardLoop: fmt::Debug + Send {
    /// The motor outputs, 0..1.
    fn outputs(&mut self, input: &LoopInput<'_>) -> [f64; ROTORS];

    /// Resets integrals and input shaping while the motors are stopped.
    fn rest(&mut self) {}

    /// Updates the gains from the parameters.
    fn configure(&mut self, _parameters: &Parameters) {}

    /// The setpoint that ATTITUDE_TARGET reports while `setpoint` is active.
    fn reported(&self, setpoint: AttitudeSetpoint) -> AttitudeSetpoint {
        setpoint
    }
}

/// The effect of a SET_ATTITUDE_TARGET.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Reception {
    /// The vehicle tracks the setpoint.
    Fly(AttitudeSetpoint),
    /// Setpoints end: the vehicle stops and holds its position.
    Stop,
    /// No effect; it does not keep the stream alive either.
    Ignore,
}

/// What the offboard mode flies at a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Pursuit {
    /// The setpoint unchanged; without one the motors stop.
    Setpoint(Option<AttitudeSetpoint>),
    /// The setpoint's attitude, with the thrust for this climb rate in m/s.
    Climb(AttitudeSetpoint, f64),
    /// Hold the position at which setpoints ended.
    Hold,
}

/// The state of the setpoint stream at a tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct StreamState {
    /// The active setpoint.
    pub setpoint: Option<AttitudeSetpoint>,
    /// Whether a setpoint arrived within [`Key::ComOfLossT`].
    pub is_live: bool,
    /// Heading, rad.
    pub yaw: f64,
    /// Whether the vehicle is on the ground.
    pub landed: bool,
}

/// The message's values for an output of 0, for an output of 1, and for disarmed motors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OutputScale {
    pub zero: f64,
    pub one: f64,
    pub disarmed: f64,
}

/// The behaviour of an autopilot that differs from the others.
pub(super) trait Personality: fmt::Debug + Sync {
    /// HEARTBEAT's `autopilot`.
    fn autopilot(&self) -> MavAutopilot {
        MavAutopilot::MAV_AUTOPILOT_PX4
    }

    /// AUTOPILOT_VERSION.
    fn version(&self) -> AUTOPILOT_VERSION_DATA;

    /// The supported modes, in the order of AVAILABLE_MODES.
    fn modes(&self) -> &'static [Mode];

    /// HEARTBEAT's `custom_mode` for a mode.
    fn custom_mode(&self, mode: Mode) -> u32 {
        mode.custom_mode()
    }

    /// The mode that parameters 2 and 3 of MAV_CMD_DO_SET_MODE select.
    fn mode_of_command(&self, main: u8, sub: u8) -> Option<Mode> {
        Mode::from_main_and_sub(main, sub).filter(|mode| self.modes().contains(mode))
    }

    /// Parameters 2 and 3 of MAV_CMD_DO_SET_MODE that select a mode.
    fn mode_command(&self, mode: Mode) -> [u8; 2] {
        let [_, _, main, sub] = self.custom_mode(mode).to_le_bytes();
        [main, sub]
    }

    /// The mode with this `custom_mode`.
    fn mode_of_custom_mode(&self, custom_mode: u32) -> Option<Mode> {
        self.modes().iter().copied().find(|mode| self.custom_mode(*mode) == custom_mode)
    }

    /// The autopilot's name for a mode.
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

    /// The mode after power-on.
    fn first_mode(&self) -> Mode {
        Mode::Hold
    }

    /// Whether a flight can start in `mode`.
    fn mode_can_arm(&self, mode: Mode) -> bool {
        !matches!(mode, Mode::Land | Mode::Return)
    }

    /// Whether the vehicle sends CURRENT_MODE immediately when its mode changes.
    fn announces_mode(&self) -> bool {
        true
    }

    /// A reply to MAV_CMD_DO_SET_MODE before the mode is checked, if any.
    fn early_answer(&self) -> Option<MavResult> {
        None
    }

    /// Whether a refused parameter triggers PARAM_ERROR and a text.
    fn explains_refused_parameters(&self) -> bool {
        false
    }

    /// Whether the force code for arming skips the checks.
    fn forced_arming_skips_checks(&self) -> bool {
        false
    }

    /// Whether NAV_TAKEOFF runs without leaving the offboard mode.
    fn takes_off_in_offboard(&self) -> bool {
        false
    }

    /// Whether NAV_TAKEOFF's altitude is above home instead of above sea level.
    fn takes_off_to_height(&self) -> bool {
        false
    }

    /// The available streams and their rates.
    fn streams(&self) -> &'static StreamRules;

    /// Parameters and attitude loop of `vehicle`; `truth` scales the loop's gains.
    ///
    /// # Errors
    /// [`NoLoop`] if the vehicle file has no usable loop.
    fn onboard(&self, vehicle: &VehicleParams, truth: Option<PdGain>) -> Result<Onboard, NoLoop>;

    /// The scale of motor outputs in the message with this name.
    fn output_scale(&self, message: &str, parameters: &Parameters) -> OutputScale;

    /// Whether outputs are sent with the scale of the vehicle file's `motor_output` instead of the
    /// autopilot's parameters.
    fn uses_motor_output(&self) -> bool {
        false
    }

    /// ACTUATOR_OUTPUT_STATUS's `active` for a bit mask of the outputs in use.
    fn active_outputs(&self, bits: u32) -> u32 {
        bits
    }

    /// The reply to a refused request for an interval.
    fn refused_interval(&self, _error: IntervalError) -> MavResult {
        MavResult::MAV_RESULT_FAILED
    }

    /// The effect of a SET_ATTITUDE_TARGET in `mode`.
    fn receive(&self, message: &SET_ATTITUDE_TARGET_DATA, mode: Mode) -> Reception;

    /// What the offboard mode flies.
    fn pursue(&self, stream: &StreamState, _parameters: &Parameters) -> Pursuit {
        Pursuit::Setpoint(stream.setpoint)
    }

    /// Whether OFFBOARD requires live setpoints to be entered in flight or to arm.
    fn needs_stream(&self) -> bool {
        true
    }

    /// Thrust limit on the ground `armed_s` after arming, as a share of full thrust.
    fn thrust_limit(&self, _armed_s: f64, _parameters: &Parameters) -> f64 {
        1.0
    }

    /// Whether SYS_STATUS reports position control as enabled and healthy in `mode` while the
    /// position is known.
    fn controls_position(&self, _mode: Mode) -> bool {
        true
    }

    /// Time after the last external pose at which the position becomes invalid, s. PX4's simulation
    /// was measured to report it 5.8 s after its last fix.
    fn vision_lost_after_s(&self) -> f64 {
        5.8
    }

    /// Whether an ODOMETRY is accepted as an external pose: it must be in LOCAL_FRD or LOCAL_NED
    /// and from a trusted kind of estimator.
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

    /// Whether a vehicle that loses its position leaves `mode` to land. PX4's OFFBOARD with
    /// attitude setpoints needs no position.
    fn lands_without_position(&self, mode: Mode) -> bool {
        matches!(mode, Mode::Hold | Mode::Position | Mode::Takeoff | Mode::Return)
    }

    /// Largest commanded tilt at which the land detector may report a landing, rad.
    fn landed_lean_max(&self) -> f64 {
        f64::INFINITY
    }

    /// Sticks to assume without a radio.
    fn sticks_without_radio(&self) -> Option<Sticks> {
        None
    }

    /// Whether a HEARTBEAT comes from the monitored ground station.
    fn is_ground_station(&self, _system: u8, kind: MavType, _parameters: &Parameters) -> bool {
        kind == MavType::MAV_TYPE_GCS
    }

    /// The mode after disarming, now that `chosen` was requested; `None` keeps the previous one.
    fn mode_after_disarming(&self, chosen: Mode, armed: bool) -> Option<Mode>;

    /// Runs one tick of an armed vehicle: triggers failsafes, obeys the pilot's sticks, and disarms
    /// after a landing or a time-out.
    fn watch(&self, commander: &mut Commander, now: &Situation, parameters: &Parameters);

    /// Text for a refused arming, mode or disarming.
    fn refusal_text(&self, refused: Refused, refusal: &Refusal) -> String;

    /// Text for a failsafe that enters `mode`.
    fn failsafe_text(&self, mode: Mode, why: &str) -> String {
        format!("{why}: failsafe activated, switching to {mode}")
    }

    /// The assessment of the pack from its charge, 0..1, and the number of warnings issued.
    fn charge_state(
        &self,
        _charge: f64,
        _warnings: usize,
        _parameters: &Parameters,
    ) -> MavBatteryChargeState {
        MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_OK
    }

    /// Text for GPS being rejected, or accepted again.
    fn gps_text(&self, _is_rejected: bool) -> Option<&'static str> {
        None
    }

    /// Text for an unknown mode.
    fn unknown_mode_text(&self) -> &'static str {
        "Mode not available: use Hold, Position, Takeoff, Land, Return, Offboard"
    }

    /// Text for arming or disarming; `by` names the cause.
    fn motors_text(&self, armed: bool, by: &str) -> String;

    /// Formats a text for STATUSTEXT.
    fn text(&self, text: &str) -> String {
        text.to_owned()
    }
}

/// A refused request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refused {
    Arming,
    Mode(Mode),
    Disarming,
}

/// Why a vehicle file has no loop that a personality can use.
#[derive(Debug)]
pub(super) enum NoLoop {
    /// The file has no loop.
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
