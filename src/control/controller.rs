//! From state and reference to the setpoint for a vehicle's attitude loop: a law, with what every
//! law needs around it.

use super::adaptation::{AdaptationEvent, Parameters};
use super::attitude_loop::{AttitudeError, AttitudeLoop};
use super::disturbance::DisturbanceObserver;
use super::laws::{Command, ControlLaw, ControlProblem, DesignError, Lqr};
use super::way_back::WayBack;
use crate::clock::VehicleTime;
use crate::setpoint::{Expected, Reference, Setpoint, State};

/// A control law, a disturbance observer around it, and the convention in which the vehicle's
/// attitude loop takes its setpoints.
///
/// The observer works with any law: it moves the reference to the equilibrium under the estimated
/// disturbances, and the law tracks that.
#[derive(Clone, Debug)]
pub struct Controller {
    law: Box<dyn ControlLaw>,
    attitude_loop: AttitudeLoop,
    error: AttitudeError,
    folds_rates: bool,
    observer: Option<DisturbanceObserver>,
    /// Time of the last call of the law, s.
    last_call_s: Option<f64>,
    sent: Option<Setpoint>,
    /// The path back to the reference after a change.
    way_back: Option<WayBack>,
    /// Whether a model leads.
    is_led: bool,
    /// The expectation passed last.
    expected: Option<Expected>,
    /// Factor on the law's feedback.
    feedback_scale: f64,
}

impl Controller {
    /// `law` over an attitude loop that acts on the differences of roll, pitch and yaw, as the
    /// paper's does.
    pub fn new(law: Box<dyn ControlLaw>, attitude_loop: AttitudeLoop) -> Self {
        Self {
            law,
            attitude_loop,
            error: AttitudeError::Angles,
            folds_rates: true,
            observer: None,
            last_call_s: None,
            sent: None,
            way_back: None,
            is_led: false,
            expected: None,
            feedback_scale: 1.0,
        }
    }

    /// Designs the law that the problem's settings name, for the problem's vehicle.
    ///
    /// # Errors
    /// [`DesignError`].
    pub fn design(problem: &ControlProblem) -> Result<Self, DesignError> {
        Ok(Self::new(problem.settings.law.design(problem)?, *problem.attitude_loop))
    }

    /// Sets the error that the attitude loop acts on. With `folds_rates`, rates that the loop does
    /// not take are folded into the attitude; this requires a known loop.
    pub fn addressing(self, error: AttitudeError, folds_rates: bool) -> Self {
        Self { error, folds_rates, ..self }
    }

    /// Sets the disturbance observer. Without one, the controller is the law's feedback alone.
    pub fn observing(self, observer: Option<DisturbanceObserver>) -> Self {
        Self { observer, ..self }
    }

    /// Multiplies the law's feedback by `factor` from now on.
    pub fn scale_feedback(&mut self, factor: f64) {
        self.feedback_scale = factor;
    }

    /// The factor on the law's feedback.
    pub fn feedback_scale(&self) -> f64 {
        self.feedback_scale
    }

    /// Discards every estimate.
    pub fn reset(&mut self) {
        self.law.reset();
        (self.sent, self.last_call_s, self.way_back) = (None, None, None);
        (self.is_led, self.expected) = (false, None);
        if let Some(observer) = &mut self.observer {
            observer.reset();
        }
    }

    /// Tells the observer that this state does not continue the last ones: the estimate jumped, or
    /// the ground holds the vehicle.
    pub fn pause(&mut self) {
        if let Some(observer) = &mut self.observer {
            observer.pause();
        }
    }

    /// Counts a jump of the estimate.
    pub fn jumped(&mut self) {
        if let Some(observer) = &mut self.observer {
            observer.jumped();
        }
    }

    /// Records whether the last setpoint met a limit of thrust or tilt.
    pub fn limited(&mut self, is_limited: bool) {
        if let Some(observer) = &mut self.observer {
            observer.limited(is_limited);
        }
    }

    /// The adapted parameters, while adaptation is on.
    pub fn parameters(&self) -> Option<Parameters> {
        self.observer.as_ref()?.parameters()
    }

    /// Takes the pending event of adaptation; returns each event once.
    pub fn take_event(&mut self) -> Option<AdaptationEvent> {
        self.observer.as_mut()?.take_event()
    }

    /// Updates the observer with the state that the last setpoint led to. `expected` is what the
    /// reference's model has beyond thrust, weight and loop, or the expectation from the thrust at
    /// rest where no model leads (`is_led`). `thrust_gain` is that setpoint's thrust over the
    /// thrust that acts.
    pub fn observe(
        &mut self,
        at: VehicleTime,
        state: &State,
        expected: &Expected,
        is_led: bool,
        thrust_gain: f64,
    ) {
        let Some(observer) = &mut self.observer else { return };
        let was_led = std::mem::replace(&mut self.is_led, is_led);
        let before = self.expected.replace(*expected);
        // While no model leads, it is the expectation that changes, not the vehicle.
        if let Some(before) = before.filter(|_| !(is_led && was_led)) {
            observer.expect_anew(&expected.beyond(&before));
        }
        match &self.sent {
            Some(sent) => {
                let sent = Setpoint { thrust_n: sent.thrust_n / thrust_gain, ..*sent };
                observer.observe(at, state, &sent, expected);
            }
            None => observer.pause(),
        }
    }

    /// `state` as a planner should start from it: its velocity is the slope of the position, as far
    /// as that is known. A plan that starts from the estimator's velocity would lead away from the
    /// position.
    pub fn moving(&self, state: &State) -> State {
        self.observer.as_ref().map_or(*state, |observer| observer.moving(state))
    }

    /// The thrust sent last, N; `None` without an observer.
    pub fn lifting_n(&self) -> Option<f64> {
        self.observer.as_ref().and(self.sent).map(|sent| sent.thrust_n)
    }

    /// The setpoint for the vehicle's loop at `time_s` of the vehicle's clock, before any limit.
    pub fn command(&mut self, time_s: f64, state: &State, reference: &Reference) -> Command {
        let dt_s =
            self.last_call_s.replace(time_s).map_or(0.0, |before| (time_s - before).max(0.0));
        let yaw = state.attitude.yaw();
        let led = self.led_back(time_s, state, reference, yaw);
        let scale = self.feedback_scale;
        let command = match self.observer.as_ref().filter(|observer| !observer.is_idle()) {
            None => match self.law.command(state, reference, dt_s) {
                command if scale == 1.0 => command,
                Command { feedback, is_cut, .. } => {
                    Command::correcting(reference, feedback.scaled(scale), is_cut)
                }
            },
            Some(observer) => {
                let shift = observer.shift(&led, yaw);
                let mut held = led;
                held.velocity += shift.velocity;
                held.attitude.roll += shift.attitude.roll;
                held.attitude.pitch += shift.attitude.pitch;
                held.feedforward = led.feedforward.plus(shift.input);
                let Command { feedback, is_cut, .. } = self.law.command(state, &held, dt_s);
                let more = Command::absolute(reference, led.feedforward, false).feedback;
                let mut correction = more.plus(shift.input).plus(feedback.scaled(scale));
                if observer.parameters().is_some() {
                    let fed_n = reference.feedforward.thrust_n;
                    correction.thrust_n = observer.thrust_n(fed_n + correction.thrust_n) - fed_n;
                }
                Command::correcting(reference, correction, is_cut)
            }
        };
        Command { setpoint: self.addressed(command.setpoint, yaw), ..command }
    }

    /// `reference`, or the path back to it: once a change is found and its size known, the path
    /// leads the vehicle back from where the change left it.
    fn led_back(
        &mut self,
        time_s: f64,
        state: &State,
        reference: &Reference,
        yaw: f64,
    ) -> Reference {
        let Some(observer) = &mut self.observer else { return *reference };
        // A way back under way is kept. Where change follows change, a new one each time would
        // lead from wherever the vehicle has drifted.
        if observer.take_change() && self.way_back.is_none() {
            let filtered = observer.filtered(state);
            self.way_back = WayBack::from(time_s, &filtered, reference);
        }
        match self.way_back.filter(|way| !way.is_over(time_s) && observer.parameters().is_some()) {
            Some(way) => way.along(time_s, observer.lead_s(), reference, observer.vehicle(), yaw),
            None => {
                self.way_back = None;
                *reference
            }
        }
    }

    /// The reference's input alone, in the loop's convention at the heading `yaw`: on the ground,
    /// feedback would only tip the vehicle over.
    pub fn open_loop(&self, reference: &Reference, yaw: f64) -> Command {
        let command = Command::correcting(reference, Setpoint::default(), false);
        Command { setpoint: self.addressed(command.setpoint, yaw), ..command }
    }

    fn addressed(&self, setpoint: Setpoint, yaw: f64) -> Setpoint {
        let folded = if self.folds_rates { self.attitude_loop.folded(setpoint) } else { setpoint };
        self.error.addressed(folded, yaw)
    }

    /// Records the setpoint sent after the last state, within limits.
    pub fn sent(&mut self, setpoint: Option<Setpoint>) {
        self.sent = setpoint;
    }
}

impl From<Lqr> for Controller {
    /// The paper's controller: the LQR without an observer.
    fn from(lqr: Lqr) -> Self {
        let attitude_loop = *lqr.attitude_loop();
        Self::new(Box::new(lqr), attitude_loop)
    }
}
