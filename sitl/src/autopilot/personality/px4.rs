//! PX4, as measured on its SIH quadrotor.

mod attitude_loop;
mod parameters;

use wire::dialect::{
    AUTOPILOT_VERSION_DATA, AttitudeTargetTypemask, MavBatteryChargeState, MavProtocolCapability,
    MavResult, MavSeverity, SET_ATTITUDE_TARGET_DATA,
};

use self::attitude_loop::Px4Loop;
use super::{
    NoLoop, Onboard, OutputScale, Personality, Reception, Refused, choice, gains, px4_rules,
};
use crate::autopilot::Mode;
use crate::autopilot::arming::Refusal;
use crate::autopilot::commander::{Commander, Situation};
use crate::autopilot::identity::PX4_VERSION;
use crate::autopilot::offboard::{self, AttitudeSetpoint};
use crate::autopilot::parameters::{Cast, Key, Parameters};
use crate::autopilot::streams::{self, StreamRules};
use vehicle::VehicleParams;
use vehicle::effects::PdGain;

#[derive(Debug)]
pub(super) struct Px4;

/// Bits of the type mask that ignore a field.
const ROLL_OR_PITCH_RATE: u8 = 0x03;
const YAW_RATE: u8 = 0x04;
const THROTTLE: u8 = 0x40;
const ATTITUDE: u8 = 0x80;

/// Value of `active` in ACTUATOR_OUTPUT_STATUS: the number of outputs, not a bit mask.
const OUTPUTS: u32 = 16;

impl Personality for Px4 {
    fn version(&self) -> AUTOPILOT_VERSION_DATA {
        AUTOPILOT_VERSION_DATA {
            capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT
                | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_INT
                | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
                | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
                | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2,
            flight_sw_version: PX4_VERSION,
            ..Default::default()
        }
    }

    fn modes(&self) -> &'static [Mode] {
        &Mode::ALL
    }

    fn early_answer(&self) -> Option<MavResult> {
        Some(MavResult::MAV_RESULT_ACCEPTED)
    }

    fn streams(&self) -> &'static StreamRules {
        &streams::PX4
    }

    fn onboard(&self, vehicle: &VehicleParams, truth: Option<PdGain>) -> Result<Onboard, NoLoop> {
        let allocation = vehicle.allocation()?;
        let moments = parameters::unit_moments(vehicle, &allocation);
        let nominal = parameters::TUNING.cascade(vehicle, moments)?;
        let mut specs = parameters::table(vehicle);
        specs.extend(gains::specs(parameters::GAINS, nominal, moments));
        let parameters = Parameters::new(specs, &[(Key::ComArmLevel, 0.3)], Cast::Bytes);
        let attitude_loop = Px4Loop::new(nominal, moments, truth, allocation, &parameters);
        Ok(Onboard { attitude_loop: Box::new(attitude_loop), rate_hz: nominal.rate_hz, parameters })
    }

    fn output_scale(&self, _message: &str, _parameters: &Parameters) -> OutputScale {
        let [zero, one, disarmed] = parameters::PULSES_US;
        OutputScale { zero, one, disarmed }
    }

    fn active_outputs(&self, _bits: u32) -> u32 {
        OUTPUTS
    }

    fn receive(&self, message: &SET_ATTITUDE_TARGET_DATA, _mode: Mode) -> Reception {
        setpoint(message).map_or(Reception::Ignore, Reception::Fly)
    }

    /// The last selected mode in which a flight can start.
    fn mode_after_disarming(&self, chosen: Mode, _armed: bool) -> Option<Mode> {
        self.mode_can_arm(chosen).then_some(chosen)
    }

    fn watch(&self, commander: &mut Commander, now: &Situation, parameters: &Parameters) {
        px4_rules::watch_stream(commander, now, parameters);
        watch_radio(commander, now, parameters);
        watch_ground_station(commander, now, parameters);
        px4_rules::watch_sticks(commander, now, parameters);
        px4_rules::watch_battery(commander, now, parameters);
        px4_rules::end_take_off(commander, now);
        px4_rules::watch_ground(commander, now, parameters);
    }

    fn refusal_text(&self, refused: Refused, _refusal: &Refusal) -> String {
        match refused {
            Refused::Arming => "Arming denied: Resolve system health failures first".to_owned(),
            Refused::Mode(mode) => format!("Switching to {mode} is currently not available"),
            Refused::Disarming => "Disarming denied: not landed".to_owned(),
        }
    }

    fn motors_text(&self, armed: bool, by: &str) -> String {
        px4_rules::motors_text(armed, by)
    }

    fn failsafe_text(&self, _mode: Mode, _why: &str) -> String {
        "Failsafe activated".to_owned()
    }

    fn charge_state(
        &self,
        charge: f64,
        _warnings: usize,
        parameters: &Parameters,
    ) -> MavBatteryChargeState {
        if charge < parameters.get(Key::BatCrtThr) {
            MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_CRITICAL
        } else if charge < parameters.get(Key::BatLowThr) {
            MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_LOW
        } else {
            MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_OK
        }
    }

    fn gps_text(&self, is_rejected: bool) -> Option<&'static str> {
        is_rejected.then_some("GNSS data fusion stopped")
    }

    fn text(&self, text: &str) -> String {
        // PX4 appends a tab to texts that also exist as events.
        format!("{text}\t")
    }
}

/// Decodes a SET_ATTITUDE_TARGET. It counts towards the stream if it has an attitude, or rates
/// about both roll and pitch. Without throttle, the thrust is zero.
fn setpoint(message: &SET_ATTITUDE_TARGET_DATA) -> Option<AttitudeSetpoint> {
    let mask = message.type_mask.bits();
    let has_rates = mask & ROLL_OR_PITCH_RATE == 0;
    if mask & ATTITUDE != 0 && !has_rates {
        return None;
    }
    let attitude = match mask & ATTITUDE {
        0 => Some(offboard::unit(message.q)?.euler()),
        _ => None,
    };
    let thrust = if mask & THROTTLE == 0 { f64::from(message.thrust) } else { 0.0 };
    let kept = |bit: u8, rate: f32| if mask & bit == 0 { f64::from(rate) } else { f64::NAN };
    Some(AttitudeSetpoint {
        attitude,
        body_rate: [
            kept(ROLL_OR_PITCH_RATE, message.body_roll_rate),
            kept(ROLL_OR_PITCH_RATE, message.body_pitch_rate),
            kept(YAW_RATE, message.body_yaw_rate),
        ]
        .into(),
        thrust: Some(thrust).filter(|thrust| thrust.is_finite())?.clamp(0.0, 1.0),
        type_mask: AttitudeTargetTypemask::from_bits_retain(mask),
    })
}

/// After a loss of the sticks: Hold for COM_FAIL_ACT_T, then NAV_RCL_ACT, unless COM_RCL_EXCEPT
/// exempts the mode.
fn watch_radio(commander: &mut Commander, now: &Situation, parameters: &Parameters) {
    if now.sticks_live || !now.sticks_known {
        commander.sticks_lost = false;
        return;
    }
    let excepted = match commander.mode() {
        Mode::Hold => choice(parameters, Key::ComRclExcept) & 2 != 0,
        Mode::Offboard => choice(parameters, Key::ComRclExcept) & 4 != 0,
        Mode::Return | Mode::Land => true,
        _ => false,
    };
    if commander.sticks_lost {
        let since = commander.loss_us;
        let delay = parameters.timeout_us(Key::ComFailActT).unwrap_or(0);
        if since.is_some_and(|since| now.now_us.saturating_sub(since) >= delay) {
            commander.loss_us = None;
            px4_rules::lose_sticks(commander, parameters, "Manual control lost");
        }
    } else if !excepted {
        commander.sticks_lost = true;
        commander.loss_us = Some(now.now_us);
        commander.fail_over(Mode::Hold);
        let delay = parameters.get(Key::ComFailActT);
        let text = format!("Failsafe activated, entering Hold for {delay:.0} seconds");
        commander.notify(MavSeverity::MAV_SEVERITY_CRITICAL, text);
    }
}

/// Applies NAV_DLL_ACT once no ground station has sent a heartbeat for COM_DL_LOSS_T.
fn watch_ground_station(commander: &mut Commander, now: &Situation, parameters: &Parameters) {
    let timeout = parameters.timeout_us(Key::ComDlLossT).unwrap_or(u64::MAX);
    let lost = now.ground_station_age_us.is_some_and(|age| age >= timeout);
    let newly = lost && !commander.ground_station_lost;
    commander.ground_station_lost = lost;
    if !newly || matches!(commander.mode(), Mode::Return | Mode::Land) {
        return;
    }
    let why = "Connection to ground control station lost";
    match choice(parameters, Key::NavDllAct) {
        1 => px4_rules::fail_over(commander, Mode::Hold, why),
        2 => px4_rules::fail_over(commander, Mode::Return, why),
        3 => px4_rules::fail_over(commander, Mode::Land, why),
        5 | 6 => commander.stop_motors("failsafe: no ground control station"),
        _ => {}
    }
}
