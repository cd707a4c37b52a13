//! ArduCopter, as measured on its SITL quadrotor.

mod attitude_loop;
mod parameters;

use wire::dialect::{
    AUTOPILOT_VERSION_DATA, AttitudeTargetTypemask, MavAutopilot, MavBatteryChargeState, MavFrame,
    MavModeFlag, MavProtocolCapability, MavResult, MavSeverity, MavType, ODOMETRY_DATA,
    SET_ATTITUDE_TARGET_DATA,
};

use self::attitude_loop::ArducopterLoop;
use super::{
    NoLoop, Onboard, OutputScale, Personality, Pursuit, Reception, Refused, StreamState, choice,
    gains,
};
use crate::autopilot::Mode;
use crate::autopilot::arming::Refusal;
use crate::autopilot::commander::{Commander, Situation};
use crate::autopilot::guidance::Sticks;
use crate::autopilot::offboard::AttitudeSetpoint;
use crate::autopilot::parameters::{Cast, Key, Parameters};
use crate::autopilot::streams::{self, IntervalError, StreamRules};
use vehicle::VehicleParams;
use vehicle::effects::PdGain;
use vehicle::frame::{Attitude, Euler, Frd};

#[derive(Debug)]
pub(super) struct Arducopter;

/// The modes with their numbers and names.
const MODES: [(Mode, u32, &str); 7] = [
    (Mode::Stabilized, 0, "STABILIZE"),
    (Mode::Altitude, 2, "ALT_HOLD"),
    (Mode::Offboard, 4, "GUIDED"),
    (Mode::Position, 5, "LOITER"),
    (Mode::Return, 6, "RTL"),
    (Mode::Land, 9, "LAND"),
    (Mode::Hold, 17, "BRAKE"),
];

/// Bits of the type mask that ignore a field.
const RATES: u8 = 0x07;
const THROTTLE: u8 = 0x40;
const ATTITUDE: u8 = 0x80;

/// Largest deviation of a quaternion's squared norm from 1.
const NORM_TOLERANCE: f64 = 1e-3;
/// Bit of GUID_OPTIONS that makes the thrust field a thrust instead of a climb rate.
const THRUST_AS_THRUST: i32 = 8;
/// Time after arming before the motors spin, s.
const ARMING_DELAY_S: f64 = 2.0;
/// `LAND_CHECK_LARGE_ANGLE_CD`, 15 degrees in rad.
const LANDED_LEAN_MAX: f64 = 0.262;
/// Reported version: 4.7.0, a development build.
const VERSION: u32 = u32::from_be_bytes([4, 7, 0, 0]);

fn entry(mode: Mode) -> Option<&'static (Mode, u32, &'static str)> {
    MODES.iter().find(|(known, _, _)| *known == mode)
}

impl Personality for Arducopter {
    fn autopilot(&self) -> MavAutopilot {
        MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA
    }

    fn version(&self) -> AUTOPILOT_VERSION_DATA {
        AUTOPILOT_VERSION_DATA {
            capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT
                | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_INT
                | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
                | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
                | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2,
            flight_sw_version: VERSION,
            ..Default::default()
        }
    }

    fn modes(&self) -> &'static [Mode] {
        const ALL: [Mode; 7] = [
            Mode::Stabilized,
            Mode::Altitude,
            Mode::Offboard,
            Mode::Position,
            Mode::Return,
            Mode::Land,
            Mode::Hold,
        ];
        &ALL
    }

    fn custom_mode(&self, mode: Mode) -> u32 {
        entry(mode).map_or(0, |(_, number, _)| *number)
    }

    fn mode_command(&self, mode: Mode) -> [u8; 2] {
        [self.custom_mode(mode) as u8, 0]
    }

    fn mode_of_command(&self, main: u8, _sub: u8) -> Option<Mode> {
        self.mode_of_custom_mode(main.into())
    }

    fn mode_name(&self, mode: Mode) -> &'static str {
        entry(mode).map_or("UNKNOWN", |(_, _, name)| name)
    }

    fn base_mode(&self, mode: Mode, armed: bool) -> MavModeFlag {
        let mut flags = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | MavModeFlag::MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
            | MavModeFlag::MAV_MODE_FLAG_STABILIZE_ENABLED;
        let guided = !matches!(mode, Mode::Stabilized | Mode::Altitude);
        flags.set(MavModeFlag::MAV_MODE_FLAG_GUIDED_ENABLED, guided);
        flags.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, armed);
        flags
    }

    fn first_mode(&self) -> Mode {
        Mode::Stabilized
    }

    fn mode_can_arm(&self, mode: Mode) -> bool {
        !matches!(mode, Mode::Land | Mode::Return | Mode::Hold)
    }

    fn announces_mode(&self) -> bool {
        false
    }

    fn forced_arming_skips_checks(&self) -> bool {
        true
    }

    fn takes_off_in_offboard(&self) -> bool {
        true
    }

    fn takes_off_to_height(&self) -> bool {
        true
    }

    fn streams(&self) -> &'static StreamRules {
        &streams::ARDUCOPTER
    }

    fn onboard(&self, vehicle: &VehicleParams, truth: Option<PdGain>) -> Result<Onboard, NoLoop> {
        let allocation = vehicle.allocation()?;
        let moments = parameters::unit_moments(vehicle);
        let nominal = parameters::TUNING.cascade(vehicle, moments)?;
        let mut specs = parameters::table(vehicle, nominal.rate_hz);
        specs.extend(gains::specs(parameters::GAINS, nominal, moments));
        let parameters = Parameters::new(specs, parameters::BUILT_IN, Cast::Number);
        let attitude_loop = ArducopterLoop::new(nominal, moments, truth, allocation, &parameters);
        Ok(Onboard { attitude_loop: Box::new(attitude_loop), rate_hz: nominal.rate_hz, parameters })
    }

    /// The range from the pulse of MOT_SPIN_MIN to that of MOT_SPIN_MAX.
    fn output_scale(&self, _message: &str, parameters: &Parameters) -> OutputScale {
        let (low, high) = (parameters.get(Key::MotPwmMin), parameters.get(Key::MotPwmMax));
        let pulse = |key: Key| low + parameters.get(key) * (high - low);
        let (zero, one) = (pulse(Key::MotSpinMin), pulse(Key::MotSpinMax));
        OutputScale { zero, one, disarmed: low }
    }

    fn refused_interval(&self, _error: IntervalError) -> MavResult {
        MavResult::MAV_RESULT_DENIED
    }

    fn receive(&self, message: &SET_ATTITUDE_TARGET_DATA, mode: Mode) -> Reception {
        if mode != Mode::Offboard {
            return Reception::Ignore;
        }
        setpoint(message).map_or(Reception::Stop, Reception::Fly)
    }

    fn pursue(&self, stream: &StreamState, parameters: &Parameters) -> Pursuit {
        let Some(setpoint) = stream.setpoint else { return Pursuit::Hold };
        if !stream.is_live {
            let level = AttitudeSetpoint {
                attitude: Some(Euler::new(0.0, 0.0, stream.yaw)),
                body_rate: Frd::zero(),
                ..setpoint
            };
            return if stream.landed { Pursuit::Hold } else { Pursuit::Climb(level, 0.0) };
        }
        let thrust = setpoint.thrust;
        if choice(parameters, Key::GuidOptions) & THRUST_AS_THRUST != 0 {
            let boosts = parameters.get(Key::AngleBoost) != 0.0;
            let cosine = if boosts { setpoint.attitude.map_or(1.0, cos_tilt) } else { 1.0 };
            let thrust = (thrust.max(0.0) / cosine.clamp(0.1, 1.0)).min(1.0);
            return Pursuit::Setpoint(Some(AttitudeSetpoint { thrust, ..setpoint }));
        }
        let limit = if thrust > 0.5 { Key::MpcZVelMaxUp } else { Key::MpcZVelMaxDn };
        let rate_m_s = (2.0 * thrust - 1.0).clamp(-1.0, 1.0) * parameters.get(limit);
        if stream.landed && rate_m_s <= 0.0 {
            return Pursuit::Hold;
        }
        Pursuit::Climb(setpoint, rate_m_s)
    }

    fn needs_stream(&self) -> bool {
        false
    }

    fn thrust_limit(&self, armed_s: f64, parameters: &Parameters) -> f64 {
        let spool_s = parameters.get(Key::MotSpoolTime).max(1e-3);
        ((armed_s - ARMING_DELAY_S) / spool_s).clamp(0.0, 1.0)
    }

    /// The position controller does not run while Guided tracks attitudes.
    fn controls_position(&self, mode: Mode) -> bool {
        !matches!(mode, Mode::Offboard | Mode::Altitude | Mode::Stabilized)
    }

    fn vision_lost_after_s(&self) -> f64 {
        // Measured: ArduCopter's EKF failsafe acts 8 s after the last fix, in Guided too.
        8.0
    }

    fn takes_odometry(&self, message: &ODOMETRY_DATA) -> bool {
        (message.frame_id, message.child_frame_id)
            == (MavFrame::MAV_FRAME_LOCAL_FRD, MavFrame::MAV_FRAME_BODY_FRD)
    }

    fn lands_without_position(&self, mode: Mode) -> bool {
        matches!(mode, Mode::Offboard | Mode::Hold | Mode::Position | Mode::Return)
    }

    fn landed_lean_max(&self) -> f64 {
        LANDED_LEAN_MAX
    }

    /// Without a radio, the throttle stick counts as at its low end.
    fn sticks_without_radio(&self) -> Option<Sticks> {
        Some(Sticks { up: -1.0, ..Sticks::default() })
    }

    fn is_ground_station(&self, system: u8, _kind: MavType, parameters: &Parameters) -> bool {
        parameters.get(Key::GroundStationSystem) == f64::from(system)
    }

    fn mode_after_disarming(&self, _chosen: Mode, _armed: bool) -> Option<Mode> {
        None
    }

    fn watch(&self, commander: &mut Commander, now: &Situation, parameters: &Parameters) {
        watch_ground_station(commander, now, parameters);
        watch_radio(commander, now, parameters);
        watch_battery(commander, now, parameters);
        watch_ground(commander, now, parameters);
    }

    fn refusal_text(&self, refused: Refused, refusal: &Refusal) -> String {
        match refused {
            Refused::Arming => format!("Arm: {refusal}"),
            Refused::Mode(mode) => format!("Mode change to {} failed", self.mode_name(mode)),
            Refused::Disarming => "Disarm: not landed".to_owned(),
        }
    }

    fn motors_text(&self, armed: bool, _by: &str) -> String {
        format!("{} motors", if armed { "Arming" } else { "Disarming" })
    }

    fn failsafe_text(&self, _mode: Mode, why: &str) -> String {
        why.to_owned()
    }

    fn charge_state(
        &self,
        _charge: f64,
        warnings: usize,
        _parameters: &Parameters,
    ) -> MavBatteryChargeState {
        match warnings {
            0 => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_OK,
            1 => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_LOW,
            _ => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_CRITICAL,
        }
    }

    fn gps_text(&self, is_rejected: bool) -> Option<&'static str> {
        Some(if is_rejected { "GPS Glitch or Compass error" } else { "Glitch cleared" })
    }

    fn unknown_mode_text(&self) -> &'static str {
        "No such mode"
    }
}

fn cos_tilt(attitude: Euler) -> f64 {
    attitude.roll.cos() * attitude.pitch.cos()
}

/// Decodes a SET_ATTITUDE_TARGET in GUIDED: attitude or rates or both, with the rates about all
/// three axes or none, and thrust. Anything else stops the vehicle.
fn setpoint(message: &SET_ATTITUDE_TARGET_DATA) -> Option<AttitudeSetpoint> {
    let mask = message.type_mask.bits();
    let rates = [message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate];
    if mask & THROTTLE != 0 || !message.thrust.is_finite() {
        return None;
    }
    let rates = match mask & RATES {
        0 => Some(rates.map(f64::from)).filter(|rates| rates.iter().all(|r| r.is_finite()))?,
        RATES => [0.0; 3],
        _ => return None,
    };
    let attitude = if mask & ATTITUDE == 0 { Some(unit(message.q)?.euler()) } else { None };
    Some(AttitudeSetpoint {
        attitude,
        body_rate: rates.into(),
        thrust: f64::from(message.thrust).clamp(-1.0, 1.0),
        type_mask: AttitudeTargetTypemask::from_bits_retain(mask),
    })
}

fn unit([w, x, y, z]: [f32; 4]) -> Option<Attitude> {
    let q: Attitude = Attitude { w: w.into(), x: x.into(), y: y.into(), z: z.into() };
    let square = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z;
    // Also false for NaN.
    ((square - 1.0).abs() <= NORM_TOLERANCE).then(|| q.normalized())
}

fn fail_over(commander: &mut Commander, mode: Mode, text: &str) {
    if !matches!((commander.mode(), mode), (Mode::Land, _)) {
        commander.fail_over(mode);
    }
    commander.notify(MavSeverity::MAV_SEVERITY_CRITICAL, text);
}

/// Applies FS_GCS_ENABLE once MAV_GCS_SYSID has sent no heartbeat for FS_GCS_TIMEOUT.
fn watch_ground_station(commander: &mut Commander, now: &Situation, parameters: &Parameters) {
    let timeout = parameters.timeout_us(Key::ComDlLossT).unwrap_or(u64::MAX);
    let action = choice(parameters, Key::FsGcsEnable);
    let lost = action != 0 && now.ground_station_age_us.is_some_and(|age| age >= timeout);
    let newly = lost && !commander.ground_station_lost;
    if commander.ground_station_lost && !lost {
        commander.notify(MavSeverity::MAV_SEVERITY_WARNING, "GCS Failsafe Cleared");
    }
    commander.ground_station_lost = lost;
    if !newly {
        return;
    }
    match action {
        _ if now.landed => commander.stop_motors("GCS failsafe"),
        5 => fail_over(commander, Mode::Land, "GCS Failsafe"),
        6 | 7 => fail_over(commander, Mode::Hold, "GCS Failsafe"),
        _ => fail_over(commander, Mode::Return, "GCS Failsafe"),
    }
}

/// Applies FS_THR_ENABLE after a loss of the sticks, if they were received before.
fn watch_radio(commander: &mut Commander, now: &Situation, parameters: &Parameters) {
    let action = choice(parameters, Key::NavRclAct);
    let lost = action != 0 && now.sticks_known && !now.sticks_live;
    let newly = lost && !commander.sticks_lost;
    commander.sticks_lost = lost;
    match action {
        _ if !newly => {}
        _ if now.landed => commander.stop_motors("radio failsafe"),
        3 => fail_over(commander, Mode::Land, "Radio Failsafe"),
        _ => fail_over(commander, Mode::Return, "Radio Failsafe"),
    }
}

/// Applies BATT_LOW_VOLT and BATT_CRT_VOLT once the voltage is below them for ten seconds.
fn watch_battery(commander: &mut Commander, now: &Situation, parameters: &Parameters) {
    const LOW_FOR_US: u64 = 10_000_000;
    let levels = [(Key::BatLowVolt, Key::BatFsLowAct), (Key::BatCriticalVolt, Key::BatFsCrtAct)];
    let Some((level, action)) = levels.get(commander.battery_warnings) else { return };
    if now.voltage >= parameters.get(*level) {
        commander.loss_us = None;
        return;
    }
    let since = *commander.loss_us.get_or_insert(now.now_us);
    if now.now_us.saturating_sub(since) < LOW_FOR_US {
        return;
    }
    commander.loss_us = None;
    commander.battery_warnings += 1;
    let grade = if commander.battery_warnings == 1 { "low" } else { "critical" };
    let text = format!("Battery 1 is {grade} {:.2}V", now.voltage);
    commander.notify(MavSeverity::MAV_SEVERITY_WARNING, text);
    match choice(parameters, *action) {
        1 => fail_over(commander, Mode::Land, "Battery Failsafe"),
        2..=4 => fail_over(commander, Mode::Return, "Battery Failsafe"),
        5 => commander.stop_motors("battery failsafe"),
        _ => commander.notify(MavSeverity::MAV_SEVERITY_CRITICAL, "Battery Failsafe"),
    }
}

/// Disarms after a landing in LAND or RTL; in other modes DISARM_DELAY after arming or landing.
fn watch_ground(commander: &mut Commander, now: &Situation, parameters: &Parameters) {
    let Some(landed_us) = commander.landed_for_us(now) else { return };
    let since_us =
        if commander.flown { landed_us } else { now.now_us.saturating_sub(commander.armed_us) };
    let ends = commander.flown && matches!(commander.mode(), Mode::Land | Mode::Return);
    let expired =
        parameters.timeout_us(Key::ComDisarmPrflt).is_some_and(|timeout| since_us >= timeout);
    if ends || expired {
        commander.stop_motors("landing");
    }
}
