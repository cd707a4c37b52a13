//! PX4's rules for modes and motors, which the bundled vehicle shares. Any mode may be selected
//! while disarmed. A failsafe keeps the intended mode, and OFFBOARD resumes when its stream does.

use wire::dialect::MavSeverity;

use super::{Refused, choice};
use crate::autopilot::Mode;
use crate::autopilot::arming::Refusal;
use crate::autopilot::commander::{Commander, Situation};
use crate::autopilot::parameters::{Key, Parameters};

/// Charge for the warning to the pilot, and charge at which the pack is critical.
const BATTERY_WARNINGS: [(f64, MavSeverity, &str); 2] = [
    (0.15, MavSeverity::MAV_SEVERITY_WARNING, "Low battery level"),
    (0.07, MavSeverity::MAV_SEVERITY_CRITICAL, "Critical battery level"),
];

pub(super) fn fail_over(commander: &mut Commander, mode: Mode, why: &str) {
    commander.fail_over(mode);
    let text = commander.personality().failsafe_text(mode, why);
    commander.notify(MavSeverity::MAV_SEVERITY_CRITICAL, text);
}

/// OFFBOARD ends with its stream and resumes with it.
pub(super) fn watch_stream(commander: &mut Commander, now: &Situation, parameters: &Parameters) {
    if commander.mode() == Mode::Offboard && !now.stream_live {
        match choice(parameters, Key::ComOblRcAct) {
            3 => fail_over(commander, Mode::Return, "No offboard signal"),
            4 => fail_over(commander, Mode::Land, "No offboard signal"),
            5 => fail_over(commander, Mode::Hold, "No offboard signal"),
            6 | 7 => commander.stop_motors("failsafe: no offboard signal"),
            // Position, altitude and stabilized flight need sticks.
            _ if now.sticks_live => fail_over(commander, Mode::Position, "No offboard signal"),
            _ => lose_sticks(commander, parameters, "No offboard signal and no manual control"),
        }
        commander.ends_with_stream = true;
    } else if commander.failsafe()
        && commander.ends_with_stream
        && commander.intended() == Mode::Offboard
        && commander.mode() != Mode::Offboard
        && now.stream_live
    {
        commander.resume();
        commander.notify(MavSeverity::MAV_SEVERITY_NOTICE, "Offboard signal is back");
    }
}

/// Applies NAV_RCL_ACT.
pub(super) fn lose_sticks(commander: &mut Commander, parameters: &Parameters, why: &str) {
    match choice(parameters, Key::NavRclAct) {
        1 => fail_over(commander, Mode::Hold, why),
        3 => fail_over(commander, Mode::Land, why),
        5 | 6 => commander.stop_motors("failsafe: no manual control"),
        _ => fail_over(commander, Mode::Return, why),
    }
}

/// Moved sticks switch to Position, if COM_RC_OVERRIDE allows it.
pub(super) fn watch_sticks(commander: &mut Commander, now: &Situation, parameters: &Parameters) {
    let overrides = choice(parameters, Key::ComRcOverride);
    let allowed = match commander.mode() {
        Mode::Position | Mode::Altitude | Mode::Stabilized => false,
        Mode::Offboard => overrides & 2 != 0,
        _ => overrides & 1 != 0,
    };
    if allowed && now.sticks_live && now.sticks_moved && !now.landed {
        commander.resume();
        commander.enter(Mode::Position);
        commander.notify(MavSeverity::MAV_SEVERITY_NOTICE, "Pilot took over using sticks");
    }
}

/// Issues battery warnings and applies COM_LOW_BAT_ACT.
pub(super) fn watch_battery(commander: &mut Commander, now: &Situation, parameters: &Parameters) {
    let Some((level, severity, text)) = BATTERY_WARNINGS.get(commander.battery_warnings) else {
        return;
    };
    if now.battery >= *level {
        return;
    }
    commander.battery_warnings += 1;
    commander.notify(*severity, *text);
    let critical = commander.battery_warnings == BATTERY_WARNINGS.len();
    let landing = matches!(commander.mode(), Mode::Land | Mode::Return);
    if critical && !landing {
        match choice(parameters, Key::ComLowBatAct) {
            2 => fail_over(commander, Mode::Land, text),
            3 => fail_over(commander, Mode::Return, text),
            _ => {}
        }
    }
}

/// Switches to Hold once a take-off has reached its height.
pub(super) fn end_take_off(commander: &mut Commander, now: &Situation) {
    if commander.mode() == Mode::Takeoff && now.climbed {
        if commander.intended() == Mode::Takeoff {
            commander.enter(Mode::Hold);
        } else {
            commander.fail_over(Mode::Hold);
        }
    }
}

/// Disarms after a landing, and if no take-off follows arming.
pub(super) fn watch_ground(commander: &mut Commander, now: &Situation, parameters: &Parameters) {
    let Some(landed_us) = commander.landed_for_us(now) else { return };
    let (key, by, since_us) = if commander.flown {
        (Key::ComDisarmLand, "landing", landed_us)
    } else {
        let armed_for_us = now.now_us.saturating_sub(commander.armed_us);
        (Key::ComDisarmPrflt, "auto preflight disarming", armed_for_us)
    };
    if parameters.timeout_us(key).is_some_and(|timeout| since_us >= timeout) {
        commander.stop_motors(by);
    }
}

pub(super) fn refusal_text(refused: Refused, refusal: &Refusal) -> String {
    match refused {
        Refused::Arming => format!("Arming denied: {refusal}"),
        Refused::Mode(mode) => {
            format!("Switching to {mode} is currently not available: no offboard signal")
        }
        Refused::Disarming => "Disarming denied: not landed".to_owned(),
    }
}

pub(super) fn motors_text(armed: bool, by: &str) -> String {
    format!("{} by {by}", if armed { "Armed" } else { "Disarmed" })
}
