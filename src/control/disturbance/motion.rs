//! How delay, attitude loop and rotors turn setpoints into motion, step by step.

use vehicle::frame::{Euler, Frd, Ned, wrap_angle};

use crate::clock::VehicleTime;
use crate::control::actuation::Actuation;
use crate::control::attitude_loop::{AttitudeError, AttitudeLoop, angle_error};
use crate::control::hover_model::HoverVehicle;
use crate::setpoint::{Setpoint, State};

/// Longest step of the attitude loop's model, s.
const STEP_MAX_S: f64 = 2.5e-3;

/// The model's response to the setpoints so far.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub at: VehicleTime,
    pub position: Ned,
    pub velocity: Ned,
    /// The measured state.
    pub seen: State,
    /// The setpoint after the delay.
    pub delayed: Setpoint,
    pub thrust_n: f64,
    pub attitude: Euler,
    pub body_rate: Frd,
    pub turn: Frd,
}

impl Motion {
    pub fn starting(at: VehicleTime, state: &State, sent: &Setpoint, velocity: Ned) -> Self {
        Self {
            at,
            position: state.position,
            velocity,
            seen: *state,
            delayed: *sent,
            thrust_n: sent.thrust_n,
            attitude: state.attitude.euler(),
            body_rate: state.body_rate,
            turn: Frd::zero(),
        }
    }

    pub fn is_finite(&self) -> bool {
        let Euler { roll, pitch, yaw } = self.attitude;
        self.position.is_finite()
            && self.velocity.is_finite()
            && self.body_rate.is_finite()
            && [roll, pitch, yaw, self.thrust_n].iter().all(|number| number.is_finite())
    }
}

/// The model between a setpoint and the motion.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chain {
    pub vehicle: HoverVehicle,
    pub attitude_loop: AttitudeLoop,
    pub error: AttitudeError,
    pub actuation: Actuation,
}

impl Chain {
    /// The model's motion `dt` later; delay and lag are first-order, as in the regulator's model.
    pub fn moved(&self, before: Motion, sent: &Setpoint, dt: f64) -> Motion {
        let mut now = before;
        let steps = (dt / STEP_MAX_S).ceil().max(1.0);
        let h = dt / steps;
        let share = |time_s: f64| 1.0 - (-h / time_s.max(1e-4)).exp();
        let delay = share(self.actuation.command_delay_s);
        let lag = share(self.actuation.motor_time_constant_s);
        let turn_lag = if self.attitude_loop.is_before_the_rotors() { lag } else { 1.0 };
        for _ in 0..steps as usize {
            let [roll, pitch, yaw] = angle_error(sent.attitude, now.delayed.attitude);
            let Euler { roll: r, pitch: p, yaw: y } = now.delayed.attitude;
            now.delayed = Setpoint {
                thrust_n: now.delayed.thrust_n + delay * (sent.thrust_n - now.delayed.thrust_n),
                attitude: Euler::new(r + delay * roll, p + delay * pitch, y + delay * yaw),
                body_rate: now.delayed.body_rate + (sent.body_rate - now.delayed.body_rate) * delay,
            };
            now.thrust_n += lag * (now.delayed.thrust_n - now.thrust_n);
            let turn = self.attitude_loop.angular_acceleration(
                self.vehicle.inertia,
                self.error.between(now.delayed.attitude, now.attitude),
                now.delayed.body_rate.to_array(),
                now.body_rate.to_array(),
            );
            now.turn += (Frd::from(turn) - now.turn) * turn_lag;
            now.body_rate += now.turn * h;
            let [droll, dpitch, dyaw] = now.attitude.rates(now.body_rate);
            let Euler { roll, pitch, yaw } = now.attitude;
            now.attitude =
                Euler::new(roll + h * droll, pitch + h * dpitch, wrap_angle(yaw + h * dyaw));
        }
        now
    }
}
