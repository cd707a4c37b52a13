//! The commander: armed or not, which mode is in force and which one is intended, failsafes.
//!
//! It follows PX4: any mode may be chosen while disarmed; the mode chosen while disarmed comes back
//! after a flight; after a failsafe the intended mode stays, and OFFBOARD resumes by itself when
//! its stream does.

use wire::dialect::MavSeverity;

use super::Mode;
use super::arming::{Preflight, Refusal};
use super::parameters::{Key, Parameters};

/// What the commander looks at in every tick.
#[derive(Clone, Copy, Debug)]
pub struct Situation {
    /// Vehicle time, us.
    pub now_us: u64,
    /// Whether an offboard setpoint is younger than COM_OF_LOSS_T.
    pub stream_live: bool,
    /// Whether MANUAL_CONTROL is younger than COM_RC_LOSS_T.
    pub sticks_live: bool,
    /// Whether the sticks are out of their centre.
    pub sticks_moved: bool,
    /// Whether the vehicle stands on the ground.
    pub landed: bool,
    /// Whether a take-off has reached its height.
    pub climbed: bool,
    /// Remaining charge, 0..1.
    pub battery: f64,
}

/// A line of text for whoever listens.
#[derive(Clone, Debug, PartialEq)]
pub struct Notice {
    /// How grave.
    pub severity: MavSeverity,
    /// The text.
    pub text: String,
}

/// Charge at which the pilot is warned, and at which the pack is critical.
const BATTERY_WARNINGS: [(f64, MavSeverity, &str); 2] = [
    (0.15, MavSeverity::MAV_SEVERITY_WARNING, "Low battery level"),
    (0.07, MavSeverity::MAV_SEVERITY_CRITICAL, "Critical battery level"),
];

/// The state of the flight.
#[derive(Clone, Debug)]
pub struct Commander {
    armed: bool,
    mode: Mode,
    intended: Mode,
    mode_after_disarming: Mode,
    failsafe: bool,
    flown: bool,
    armed_us: u64,
    landed_since_us: Option<u64>,
    battery_warnings: usize,
    notices: Vec<Notice>,
}

impl Default for Commander {
    /// A vehicle switched on: disarmed, in Hold.
    fn default() -> Self {
        Self {
            armed: false,
            mode: Mode::Hold,
            intended: Mode::Hold,
            mode_after_disarming: Mode::Hold,
            failsafe: false,
            flown: false,
            armed_us: 0,
            landed_since_us: None,
            battery_warnings: 0,
            notices: Vec::new(),
        }
    }
}

impl Commander {
    /// A vehicle that starts armed, in the air, in Hold.
    pub fn airborne() -> Self {
        Self { armed: true, flown: true, ..Self::default() }
    }

    /// Whether the motors are armed.
    pub fn armed(&self) -> bool {
        self.armed
    }

    /// The mode in force.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The mode that was asked for last.
    pub fn intended(&self) -> Mode {
        self.intended
    }

    /// Whether a failsafe holds the mode in force.
    pub fn failsafe(&self) -> bool {
        self.failsafe
    }

    /// Takes the lines of text that have come up.
    pub fn take_notices(&mut self) -> impl Iterator<Item = Notice> + use<> {
        std::mem::take(&mut self.notices).into_iter()
    }

    /// Whether there are lines of text to take.
    pub fn has_notices(&self) -> bool {
        !self.notices.is_empty()
    }

    /// Says something.
    pub fn notify(&mut self, severity: MavSeverity, text: impl Into<String>) {
        self.notices.push(Notice { severity, text: text.into() });
    }

    /// Changes the mode as someone asked.
    ///
    /// # Errors
    /// [`Refusal::NoOffboardSignal`] for OFFBOARD while armed without a live stream.
    pub fn request_mode(&mut self, mode: Mode, stream_live: bool) -> Result<(), Refusal> {
        if self.armed && mode == Mode::Offboard && !stream_live {
            self.notify(
                MavSeverity::MAV_SEVERITY_CRITICAL,
                format!("Switching to {mode} is currently not available: no offboard signal"),
            );
            return Err(Refusal::NoOffboardSignal);
        }
        if !self.armed {
            self.mode_after_disarming = mode;
        }
        self.failsafe = false;
        self.intended = mode;
        self.mode = mode;
        Ok(())
    }

    /// Arms. Arming an armed vehicle changes nothing and is no error.
    ///
    /// # Errors
    /// The first [`Refusal`] of `preflight`.
    pub fn arm(&mut self, now_us: u64, preflight: &Preflight) -> Result<(), Refusal> {
        if self.armed {
            return Ok(());
        }
        if let Some(refusal) = preflight.refusal(self.mode) {
            self.notify(MavSeverity::MAV_SEVERITY_CRITICAL, format!("Arming denied: {refusal}"));
            return Err(refusal);
        }
        self.armed = true;
        self.armed_us = now_us;
        self.flown = false;
        self.landed_since_us = Some(now_us);
        self.notify(MavSeverity::MAV_SEVERITY_INFO, "Armed by external command");
        Ok(())
    }

    /// Disarms; `force` also in the air.
    ///
    /// # Errors
    /// [`Refusal::InAir`] without `force`.
    pub fn disarm(&mut self, landed: bool, force: bool) -> Result<(), Refusal> {
        if !self.armed {
            return Ok(());
        }
        if !landed && !force {
            self.notify(MavSeverity::MAV_SEVERITY_CRITICAL, "Disarming denied: not landed");
            return Err(Refusal::InAir);
        }
        self.stop_motors(if force { "force" } else { "external command" });
        Ok(())
    }

    /// Whether a flight can begin in the mode in force.
    pub fn mode_can_arm(&self) -> bool {
        !matches!(self.mode, Mode::Land | Mode::Return)
    }

    fn stop_motors(&mut self, by: &str) {
        self.armed = false;
        self.failsafe = false;
        self.mode = self.mode_after_disarming;
        self.intended = self.mode_after_disarming;
        self.notify(MavSeverity::MAV_SEVERITY_INFO, format!("Disarmed by {by}"));
    }

    /// One tick: failsafes, the end of a take-off, the pilot's sticks, disarming by itself.
    pub fn update(&mut self, now: &Situation, parameters: &Parameters) {
        if !self.armed {
            return;
        }
        self.watch_stream(now, parameters);
        self.watch_sticks(now, parameters);
        self.watch_battery(now, parameters);
        if self.mode == Mode::Takeoff && now.climbed {
            self.mode = Mode::Hold;
            if self.intended == Mode::Takeoff {
                self.intended = Mode::Hold;
            }
        }
        self.watch_ground(now, parameters);
    }

    fn watch_stream(&mut self, now: &Situation, parameters: &Parameters) {
        if self.mode == Mode::Offboard && !now.stream_live {
            match parameters.get(Key::ComOblRcAct) as i32 {
                3 => self.fail_over(Mode::Return, "No offboard signal"),
                4 => self.fail_over(Mode::Land, "No offboard signal"),
                5 => self.fail_over(Mode::Hold, "No offboard signal"),
                6 | 7 => self.stop_motors("failsafe: no offboard signal"),
                // Position, altitude and stabilized flight need sticks.
                _ if now.sticks_live => self.fail_over(Mode::Position, "No offboard signal"),
                _ => self.lose_sticks(parameters),
            }
        } else if self.failsafe
            && self.intended == Mode::Offboard
            && self.mode != Mode::Offboard
            && now.stream_live
        {
            self.failsafe = false;
            self.mode = Mode::Offboard;
            self.notify(MavSeverity::MAV_SEVERITY_NOTICE, "Offboard signal is back");
        }
    }

    fn lose_sticks(&mut self, parameters: &Parameters) {
        let why = "No offboard signal and no manual control";
        match parameters.get(Key::NavRclAct) as i32 {
            1 => self.fail_over(Mode::Hold, why),
            3 => self.fail_over(Mode::Land, why),
            5 | 6 => self.stop_motors("failsafe: no manual control"),
            _ => self.fail_over(Mode::Return, why),
        }
    }

    fn fail_over(&mut self, mode: Mode, why: &str) {
        self.failsafe = true;
        self.mode = mode;
        let text = format!("{why}: failsafe activated, switching to {mode}");
        self.notify(MavSeverity::MAV_SEVERITY_CRITICAL, text);
    }

    fn watch_sticks(&mut self, now: &Situation, parameters: &Parameters) {
        let overrides = parameters.get(Key::ComRcOverride) as i32;
        let allowed = match self.mode {
            Mode::Position => false,
            Mode::Offboard => overrides & 2 != 0,
            _ => overrides & 1 != 0,
        };
        if allowed && now.sticks_live && now.sticks_moved && !now.landed {
            self.failsafe = false;
            self.mode = Mode::Position;
            self.intended = Mode::Position;
            self.notify(MavSeverity::MAV_SEVERITY_NOTICE, "Pilot took over using sticks");
        }
    }

    fn watch_battery(&mut self, now: &Situation, parameters: &Parameters) {
        let Some((level, severity, text)) = BATTERY_WARNINGS.get(self.battery_warnings) else {
            return;
        };
        if now.battery >= *level {
            return;
        }
        self.battery_warnings += 1;
        self.notify(*severity, *text);
        let critical = self.battery_warnings == BATTERY_WARNINGS.len();
        let landing = matches!(self.mode, Mode::Land | Mode::Return);
        if critical && !landing {
            match parameters.get(Key::ComLowBatAct) as i32 {
                2 => self.fail_over(Mode::Land, text),
                3 => self.fail_over(Mode::Return, text),
                _ => {}
            }
        }
    }

    fn watch_ground(&mut self, now: &Situation, parameters: &Parameters) {
        if !now.landed {
            self.flown = true;
            self.landed_since_us = None;
            return;
        }
        let since = *self.landed_since_us.get_or_insert(now.now_us);
        let (key, by) = if self.flown {
            (Key::ComDisarmLand, "landing")
        } else {
            (Key::ComDisarmPrflt, "auto preflight disarming")
        };
        let since = if self.flown { since } else { self.armed_us };
        let expired = parameters
            .timeout_us(key)
            .is_some_and(|timeout| now.now_us.saturating_sub(since) >= timeout);
        if expired {
            self.stop_motors(by);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::parameters::Value;
    use crate::autopilot::testing;

    const CALM: Situation = Situation {
        now_us: 0,
        stream_live: false,
        sticks_live: false,
        sticks_moved: false,
        landed: false,
        climbed: false,
        battery: 1.0,
    };

    fn parameters() -> Parameters {
        let vehicle = testing::vehicle();
        Parameters::new(&vehicle, &vehicle.attitude_pd.unwrap())
    }

    fn in_offboard() -> Commander {
        let mut commander = Commander::airborne();
        commander.request_mode(Mode::Offboard, true).unwrap();
        commander
    }

    #[test]
    fn offboard_in_the_air_needs_a_stream_and_a_refusal_changes_nothing() {
        let mut commander = Commander::airborne();
        assert_eq!(commander.request_mode(Mode::Offboard, false), Err(Refusal::NoOffboardSignal));
        assert_eq!((commander.mode(), commander.intended()), (Mode::Hold, Mode::Hold));
        assert!(commander.take_notices().next().is_some());
    }

    #[test]
    fn each_loss_action_leads_to_its_mode() {
        let modes = [
            (0, Some(Mode::Return)),
            (1, Some(Mode::Return)),
            (3, Some(Mode::Return)),
            (4, Some(Mode::Land)),
            (5, Some(Mode::Hold)),
            (7, None),
        ];
        for (action, expected) in modes {
            let mut parameters = parameters();
            parameters.set("COM_OBL_RC_ACT", Value::Int(action)).unwrap();
            let mut commander = in_offboard();
            commander.update(&CALM, &parameters);
            match expected {
                Some(mode) => {
                    assert_eq!(commander.mode(), mode, "action {action}");
                    assert_eq!(commander.intended(), Mode::Offboard);
                    assert!(commander.failsafe());
                }
                None => assert!(!commander.armed()),
            }
        }
    }

    #[test]
    fn a_resumed_stream_resumes_offboard_unless_someone_chose_another_mode() {
        let parameters = parameters();
        let live = Situation { stream_live: true, ..CALM };
        let mut commander = in_offboard();
        commander.update(&CALM, &parameters);
        assert_eq!(commander.mode(), Mode::Land);
        commander.update(&live, &parameters);
        assert_eq!(commander.mode(), Mode::Offboard);

        commander.update(&CALM, &parameters);
        commander.request_mode(Mode::Position, true).unwrap();
        commander.update(&live, &parameters);
        assert_eq!(commander.mode(), Mode::Position);
    }

    #[test]
    fn moved_sticks_take_over_for_good() {
        let parameters = parameters();
        let mut commander = in_offboard();
        let sticks = Situation { stream_live: true, sticks_live: true, sticks_moved: true, ..CALM };
        commander.update(&sticks, &parameters);
        assert_eq!((commander.mode(), commander.intended()), (Mode::Position, Mode::Position));
        commander.update(&Situation { stream_live: true, ..CALM }, &parameters);
        assert_eq!(commander.mode(), Mode::Position);
    }

    #[test]
    fn the_mode_chosen_while_disarmed_comes_back_after_the_flight() {
        let parameters = parameters();
        let mut commander = in_offboard();
        commander.mode_after_disarming = Mode::Offboard;
        commander.update(&CALM, &parameters);
        assert_eq!(commander.mode(), Mode::Land);
        for now_us in [1_000_000, 3_000_000] {
            commander.update(&Situation { landed: true, now_us, ..CALM }, &parameters);
        }
        assert!(!commander.armed());
        assert_eq!(commander.mode(), Mode::Offboard);
    }

    #[test]
    fn no_disarming_in_the_air_without_force() {
        let mut commander = Commander::airborne();
        assert_eq!(commander.disarm(false, false), Err(Refusal::InAir));
        assert!(commander.armed());
        assert!(commander.disarm(false, true).is_ok());
        assert!(!commander.armed());
    }

    #[test]
    fn critical_battery_acts_only_if_told_to() {
        let mut parameters = parameters();
        let empty = Situation { battery: 0.05, ..CALM };
        let mut commander = Commander::airborne();
        commander.update(&empty, &parameters);
        commander.update(&empty, &parameters);
        assert_eq!(commander.mode(), Mode::Hold);
        assert_eq!(commander.take_notices().count(), 2);

        parameters.set("COM_LOW_BAT_ACT", Value::Int(2)).unwrap();
        let mut commander = Commander::airborne();
        commander.update(&empty, &parameters);
        commander.update(&empty, &parameters);
        assert_eq!(commander.mode(), Mode::Land);
    }
}
