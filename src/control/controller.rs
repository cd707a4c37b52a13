//! From state and reference to the setpoint that a vehicle's attitude loop is sent.

use super::attitude_loop::AttitudeError;
use super::disturbance::DisturbanceObserver;
use super::limits::Saturation;
use super::lqr::Lqr;
use crate::clock::VehicleTime;
use crate::setpoint::{Expected, Reference, Setpoint, State};

/// The regulator, and an observer of disturbances beside it.
#[derive(Clone, Debug)]
pub struct Controller {
    lqr: Lqr,
    error: AttitudeError,
    folds_rates: bool,
    observer: Option<DisturbanceObserver>,
    sent: Option<Setpoint>,
    /// Whether a model leads, and what was expected last.
    expected: (bool, Expected),
}

impl Controller {
    /// A regulator around a loop that acts on `error`; without an observer it is the paper's. Rates
    /// that the loop is not sent are folded into the attitude if `folds_rates`, which takes a loop
    /// that is known.
    pub fn new(
        lqr: Lqr,
        error: AttitudeError,
        folds_rates: bool,
        observer: Option<DisturbanceObserver>,
    ) -> Self {
        let expected = (false, Expected::default());
        Self { lqr, error, folds_rates, observer, sent: None, expected }
    }

    /// Nothing that was estimated holds any more.
    pub fn reset(&mut self) {
        self.sent = None;
        self.expected = (false, Expected::default());
        if let Some(observer) = &mut self.observer {
            observer.reset();
        }
    }

    /// The state is not where the last ones lead: the estimate jumped, or the ground holds it.
    pub fn pause(&mut self) {
        if let Some(observer) = &mut self.observer {
            observer.pause();
        }
    }

    /// Takes the state that the last setpoint led to. `expected` is what the reference's model has
    /// beside thrust, weight and loop, or what the thrust at rest says where none `is_led` by.
    /// `thrust_gain` is by how much more than what acts that setpoint's thrust was.
    pub fn observe(
        &mut self,
        at: VehicleTime,
        state: &State,
        expected: &Expected,
        is_led: bool,
        thrust_gain: f64,
    ) {
        let Some(observer) = &mut self.observer else { return };
        let (was_led, before) = std::mem::replace(&mut self.expected, (is_led, *expected));
        if is_led != was_led {
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

    /// The thrust that was sent last, N; `None` where no disturbance is looked for.
    pub fn lifting_n(&self) -> Option<f64> {
        self.observer.as_ref().and(self.sent).map(|sent| sent.thrust_n)
    }

    /// The correction to the reference's input, and whether its position error was cut.
    pub fn feedback(&self, state: &State, reference: &Reference) -> (Setpoint, Saturation) {
        let Some(observer) = &self.observer else { return self.lqr.feedback(state, reference) };
        let shift = observer.shift(reference, state.attitude.yaw());
        let mut held = *reference;
        held.velocity += shift.velocity;
        held.attitude.roll += shift.attitude.roll;
        held.attitude.pitch += shift.attitude.pitch;
        let (feedback, cut) = self.lqr.feedback(state, &held);
        (shift.input.plus(feedback), cut)
    }

    /// `setpoint` as the vehicle's loop must be sent it at the heading `yaw`.
    pub fn addressed(&self, setpoint: Setpoint, yaw: f64) -> Setpoint {
        let attitude_loop = self.lqr.attitude_loop();
        let folded = if self.folds_rates { attitude_loop.folded(setpoint) } else { setpoint };
        self.error.addressed(folded, yaw)
    }

    /// What left after the last state, within limits.
    pub fn sent(&mut self, setpoint: Option<Setpoint>) {
        self.sent = setpoint;
    }
}

impl From<Lqr> for Controller {
    /// The paper's.
    fn from(lqr: Lqr) -> Self {
        Self::new(lqr, AttitudeError::Angles, true, None)
    }
}
