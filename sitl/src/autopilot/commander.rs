//! The commander: arming state, active and intended mode, and the transitions between modes. The
//! `Personality` decides on transitions that nobody requested.

use wire::dialect::MavSeverity;

use super::Mode;
use super::arming::{Preflight, Refusal};
use super::parameters::Parameters;
use super::personality::{Personality, Refused};

/// The commander's inputs in each tick.
#[derive(Clone, Copy, Debug)]
pub struct Situation {
    /// Vehicle time, us.
    pub now_us: u64,
    /// Whether an offboard setpoint is younger than COM_OF_LOSS_T.
    pub stream_live: bool,
    /// Whether MANUAL_CONTROL is younger than COM_RC_LOSS_T.
    pub sticks_live: bool,
    /// Whether a stick is off centre.
    pub sticks_moved: bool,
    /// Whether sticks were ever received.
    pub sticks_known: bool,
    /// Age of the monitored ground station's last heartbeat, us; `None` before the first.
    pub ground_station_age_us: Option<u64>,
    /// Whether the vehicle is on the ground.
    pub landed: bool,
    /// Whether a take-off has reached its height.
    pub climbed: bool,
    /// Remaining charge, 0..1.
    pub battery: f64,
    /// Terminal voltage, V.
    pub voltage: f64,
}

/// A text message for all peers.
#[derive(Clone, Debug, PartialEq)]
pub struct StatusText {
    /// Severity of the message.
    pub severity: MavSeverity,
    /// Text of the message.
    pub text: String,
}

/// Arming and mode state of the flight.
#[derive(Clone, Debug)]
pub struct Commander {
    personality: &'static dyn Personality,
    armed: bool,
    mode: Mode,
    intended: Mode,
    mode_after_disarming: Option<Mode>,
    failsafe: bool,
    /// Whether the failsafe ends when setpoints resume.
    pub(super) ends_with_stream: bool,
    /// Whether the vehicle has left the ground since arming.
    pub(super) flown: bool,
    /// Time of arming, us.
    pub(super) armed_us: u64,
    pub(super) landed_since_us: Option<u64>,
    /// Number of battery warnings issued.
    pub(super) battery_warnings: usize,
    /// Start of a loss whose action is delayed, us.
    pub(super) loss_us: Option<u64>,
    /// Whether the loss of the monitored ground station has been handled.
    pub(super) ground_station_lost: bool,
    /// Whether the loss of the sticks has been handled.
    pub(super) sticks_lost: bool,
    status_texts: Vec<StatusText>,
}

impl Commander {
    /// The state after power-on: disarmed on the ground, or armed in the air in Hold.
    pub(super) fn new(personality: &'static dyn Personality, airborne: bool) -> Self {
        let mode = if airborne { Mode::Hold } else { personality.first_mode() };
        Self {
            personality,
            armed: airborne,
            mode,
            intended: mode,
            mode_after_disarming: personality.mode_after_disarming(mode, false),
            failsafe: false,
            ends_with_stream: false,
            flown: airborne,
            armed_us: 0,
            landed_since_us: None,
            battery_warnings: 0,
            loss_us: None,
            ground_station_lost: false,
            sticks_lost: false,
            status_texts: Vec::new(),
        }
    }

    pub(super) fn personality(&self) -> &'static dyn Personality {
        self.personality
    }

    /// Whether the motors are armed.
    pub fn armed(&self) -> bool {
        self.armed
    }

    /// The active mode.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The mode requested last.
    pub fn intended(&self) -> Mode {
        self.intended
    }

    /// Whether a failsafe has set the active mode.
    pub fn failsafe(&self) -> bool {
        self.failsafe
    }

    /// Takes the pending text messages.
    pub fn take_status_texts(&mut self) -> impl Iterator<Item = StatusText> + use<> {
        std::mem::take(&mut self.status_texts).into_iter()
    }

    /// Whether there are pending text messages.
    pub fn has_status_texts(&self) -> bool {
        !self.status_texts.is_empty()
    }

    /// Queues a text message.
    pub fn notify(&mut self, severity: MavSeverity, text: impl Into<String>) {
        self.status_texts.push(StatusText { severity, text: text.into() });
    }

    /// Changes the mode on request.
    ///
    /// # Errors
    /// [`Refusal::NoOffboardSignal`] for OFFBOARD while armed, without the required stream.
    pub fn request_mode(&mut self, mode: Mode, stream_live: bool) -> Result<(), Refusal> {
        let needs_stream = mode == Mode::Offboard && self.personality.needs_stream();
        if self.armed && needs_stream && !stream_live {
            let refusal = Refusal::NoOffboardSignal;
            self.refuse(Refused::Mode(mode), &refusal);
            return Err(refusal);
        }
        self.mode_after_disarming =
            self.personality.mode_after_disarming(mode, self.armed).or(self.mode_after_disarming);
        self.failsafe = false;
        self.loss_us = None;
        self.enter(mode);
        Ok(())
    }

    /// Arms; `force` skips the checks. Arming an armed vehicle changes nothing and is not an error.
    ///
    /// # Errors
    /// The first [`Refusal`] of `preflight`.
    pub fn arm(&mut self, now_us: u64, preflight: &Preflight, force: bool) -> Result<(), Refusal> {
        if self.armed {
            return Ok(());
        }
        if let Some(refusal) = preflight.refusal(self.mode).filter(|_| !force) {
            self.refuse(Refused::Arming, &refusal);
            return Err(refusal);
        }
        self.armed = true;
        self.armed_us = now_us;
        self.flown = false;
        self.landed_since_us = Some(now_us);
        let text = self.personality.motors_text(true, "external command");
        self.notify(MavSeverity::MAV_SEVERITY_INFO, text);
        Ok(())
    }

    /// Disarms; in the air only with `force`.
    ///
    /// # Errors
    /// [`Refusal::InAir`] in the air without `force`.
    pub fn disarm(&mut self, landed: bool, force: bool) -> Result<(), Refusal> {
        if !self.armed {
            return Ok(());
        }
        if !landed && !force {
            self.refuse(Refused::Disarming, &Refusal::InAir);
            return Err(Refusal::InAir);
        }
        self.stop_motors(if force { "force" } else { "external command" });
        Ok(())
    }

    fn refuse(&mut self, refused: Refused, refusal: &Refusal) {
        let text = self.personality.refusal_text(refused, refusal);
        self.notify(MavSeverity::MAV_SEVERITY_CRITICAL, text);
    }

    /// Whether a flight can start in the active mode.
    pub fn mode_can_arm(&self) -> bool {
        self.personality.mode_can_arm(self.mode)
    }

    /// Runs one tick.
    pub fn update(&mut self, now: &Situation, parameters: &Parameters) {
        if self.armed {
            self.personality.watch(self, now, parameters);
        }
    }

    /// Stops the motors; `by` names the cause in the vehicle's text.
    pub(super) fn stop_motors(&mut self, by: &str) {
        self.armed = false;
        self.failsafe = false;
        self.loss_us = None;
        if let Some(mode) = self.mode_after_disarming {
            self.enter(mode);
        }
        let text = self.personality.motors_text(false, by);
        self.notify(MavSeverity::MAV_SEVERITY_INFO, text);
    }

    /// Enters a mode that also becomes the intended one.
    pub(super) fn enter(&mut self, mode: Mode) {
        self.mode = mode;
        self.intended = mode;
    }

    /// Enters a failsafe's mode; the intended mode stays.
    pub(super) fn fail_over(&mut self, mode: Mode) {
        self.failsafe = true;
        self.ends_with_stream = false;
        self.mode = mode;
    }

    /// Returns to the intended mode after a failsafe or another interruption.
    pub(super) fn resume(&mut self) {
        self.failsafe = false;
        self.mode = self.intended;
    }

    /// Time since the vehicle landed, us. In the air, returns `None` and records that it has flown.
    pub(super) fn landed_for_us(&mut self, now: &Situation) -> Option<u64> {
        if !now.landed {
            self.flown = true;
            self.landed_since_us = None;
            return None;
        }
        let since = *self.landed_since_us.get_or_insert(now.now_us);
        Some(now.now_us.saturating_sub(since))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::parameters::Value;
    use crate::autopilot::{personality, testing};
    use crate::config::Autopilot;

    const CALM: Situation = Situation {
        now_us: 0,
        stream_live: false,
        sticks_live: false,
        sticks_moved: false,
        landed: false,
        climbed: false,
        battery: 1.0,
        sticks_known: false,
        ground_station_age_us: None,
        voltage: 12.0,
    };

    fn airborne() -> Commander {
        Commander::new(personality::of(Autopilot::Bundled), true)
    }

    fn parameters() -> Parameters {
        testing::parameters()
    }

    fn in_offboard() -> Commander {
        let mut commander = airborne();
        commander.request_mode(Mode::Offboard, true).unwrap();
        commander
    }

    #[test]
    fn offboard_in_flight_requires_a_stream_and_refusal_keeps_mode() {
        let mut commander = airborne();
        assert_eq!(commander.request_mode(Mode::Offboard, false), Err(Refusal::NoOffboardSignal));
        assert_eq!((commander.mode(), commander.intended()), (Mode::Hold, Mode::Hold));
        assert!(commander.take_status_texts().next().is_some());
    }

    #[test]
    fn each_loss_action_enters_its_mode() {
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
    fn resumed_stream_restores_offboard_unless_another_mode_was_chosen() {
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
    fn moved_sticks_take_over_permanently() {
        let parameters = parameters();
        let mut commander = in_offboard();
        let sticks = Situation { stream_live: true, sticks_live: true, sticks_moved: true, ..CALM };
        commander.update(&sticks, &parameters);
        assert_eq!((commander.mode(), commander.intended()), (Mode::Position, Mode::Position));
        commander.update(&Situation { stream_live: true, ..CALM }, &parameters);
        assert_eq!(commander.mode(), Mode::Position);
    }

    #[test]
    fn mode_chosen_while_disarmed_is_restored_after_disarming() {
        let parameters = parameters();
        let mut commander = in_offboard();
        commander.mode_after_disarming = Some(Mode::Offboard);
        commander.update(&CALM, &parameters);
        assert_eq!(commander.mode(), Mode::Land);
        for now_us in [1_000_000, 3_000_000] {
            commander.update(&Situation { landed: true, now_us, ..CALM }, &parameters);
        }
        assert!(!commander.armed());
        assert_eq!(commander.mode(), Mode::Offboard);
    }

    #[test]
    fn disarming_in_the_air_requires_force() {
        let mut commander = airborne();
        assert_eq!(commander.disarm(false, false), Err(Refusal::InAir));
        assert!(commander.armed());
        assert!(commander.disarm(false, true).is_ok());
        assert!(!commander.armed());
    }

    #[test]
    fn critical_battery_acts_only_if_configured() {
        let mut parameters = parameters();
        let empty = Situation { battery: 0.05, ..CALM };
        let mut commander = airborne();
        commander.update(&empty, &parameters);
        commander.update(&empty, &parameters);
        assert_eq!(commander.mode(), Mode::Hold);
        assert_eq!(commander.take_status_texts().count(), 2);

        parameters.set("COM_LOW_BAT_ACT", Value::Int(2)).unwrap();
        let mut commander = airborne();
        commander.update(&empty, &parameters);
        commander.update(&empty, &parameters);
        assert_eq!(commander.mode(), Mode::Land);
    }
}
