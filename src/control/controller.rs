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
    observer: Option<DisturbanceObserver>,
    sent: Option<Setpoint>,
}

impl Controller {
    /// A regulator around a loop that acts on `error`; without an observer it is the paper's.
    pub fn new(lqr: Lqr, error: AttitudeError, observer: Option<DisturbanceObserver>) -> Self {
        Self { lqr, error, observer, sent: None }
    }

    /// Nothing that was estimated holds any more.
    pub fn reset(&mut self) {
        self.sent = None;
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

    /// Takes the state that the last setpoint led to. `thrust_gain` is by how much more than what
    /// acts that setpoint's thrust was.
    pub fn observe(
        &mut self,
        at: VehicleTime,
        state: &State,
        expected: &Expected,
        thrust_gain: f64,
    ) {
        let Some(observer) = &mut self.observer else { return };
        match &self.sent {
            Some(sent) => {
                let sent = Setpoint { thrust_n: sent.thrust_n / thrust_gain, ..*sent };
                observer.observe(at, state, &sent, expected);
            }
            None => observer.pause(),
        }
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
        self.lqr.attitude_loop().addressed(self.error, setpoint, yaw)
    }

    /// What left after the last state, within limits.
    pub fn sent(&mut self, setpoint: Option<Setpoint>) {
        self.sent = setpoint;
    }
}

impl From<Lqr> for Controller {
    /// The paper's.
    fn from(lqr: Lqr) -> Self {
        Self::new(lqr, AttitudeError::Angles, None)
    }
}
