//! ArduCopter's attitude loop: input shaping turns the setpoint into a feasible target, the
//! target's rate is fed forward, and a proportional law on the error to the target drives the rate
//! loop.

use super::super::rate_loop::{RateInput, RateLoop, clip};
use super::super::{LoopInput, OnboardLoop, gains};
use super::parameters::{ACCELERATION_MAX_RAD_S2, GAINS};
use crate::autopilot::offboard::AttitudeSetpoint;
use crate::autopilot::parameters::{Key, Parameters};
use vehicle::effects::PdGain;
use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::rotor::Allocation;
use vehicle::{AttitudeCascade, ROTORS};
use wire::dialect::AttitudeTargetTypemask;

#[derive(Debug)]
pub(super) struct ArducopterLoop {
    nominal: AttitudeCascade,
    /// Moments of a normalised torque of 1, N m.
    moments: [f64; 3],
    truth: Option<PdGain>,
    rate_loop: RateLoop,
    thrust_curve: f64,
    /// The commanded attitude, propagated with the commanded rates between messages.
    desired: Option<Attitude>,
    /// The shaped target; `None` while the motors are stopped.
    target: Option<Attitude>,
    /// Rate of the target in the target's axes, rad/s.
    target_rate: Frd,
}

impl ArducopterLoop {
    pub fn new(
        nominal: AttitudeCascade,
        moments: [f64; 3],
        truth: Option<PdGain>,
        allocation: Allocation,
        parameters: &Parameters,
    ) -> Self {
        let mut made = Self {
            nominal,
            moments,
            truth,
            rate_loop: RateLoop::new(nominal, allocation),
            thrust_curve: 0.0,
            desired: None,
            target: None,
            target_rate: Frd::zero(),
        };
        made.configure(parameters);
        made
    }

    /// The desired rate of the target, rad/s.
    fn desired_rate(&mut self, input: &LoopInput<'_>, target: Attitude) -> Frd {
        let AttitudeSetpoint { attitude, body_rate, .. } = *input.setpoint;
        let Some(commanded) = attitude.map(|euler| euler.attitude()) else {
            self.desired = None;
            return body_rate;
        };
        let [x, y, z] = body_rate.to_array();
        // ArduCopter rotates the rates by the commanded attitude before use, as measured.
        let rate = Frd::from(commanded.to_world(Frd::new(x, y, z)).to_array());
        let desired = match self.desired {
            Some(desired) if input.new_for_s.is_none() && rate != Frd::zero() => {
                turned(desired, rate * input.dt)
            }
            _ => commanded,
        };
        self.desired = Some(desired);
        let error = rotation_vector(target, desired);
        match self.rate_loop.cascade.input_time_constant_s {
            Some(time_s) if time_s > 0.0 => rate + approach(error, time_s),
            _ => rate + error * (1.0 / input.dt),
        }
    }
}

/// The rate that reduces an angle to zero with a time constant, limited such that the acceleration
/// limit allows it to stop.
fn approach(error: Frd, time_s: f64) -> Frd {
    let error = error.to_array();
    let [x, y, z] = std::array::from_fn(|axis| {
        let limit = ACCELERATION_MAX_RAD_S2[axis];
        let linear = limit * time_s * time_s;
        let size = error[axis].abs();
        let rate = if size <= linear {
            size / time_s
        } else {
            (2.0 * limit * (size - 0.5 * linear)).sqrt()
        };
        rate.copysign(error[axis])
    });
    Frd::new(x, y, z)
}

/// Rotates `attitude` by a rotation vector in its body axes.
fn turned(attitude: Attitude, by: Frd) -> Attitude {
    let half = by * 0.5;
    let angle = half.norm();
    let share = if angle < 1e-9 { 1.0 } else { angle.sin() / angle };
    let [x, y, z] = (half * share).to_array();
    attitude.compose(Attitude { w: angle.cos(), x, y, z }).normalized()
}

/// The rotation from one attitude to another as angle times axis, in body axes of the first.
fn rotation_vector(from: Attitude, to: Attitude) -> Frd {
    let d = from.inverse().compose(to).canonical();
    let sine = (d.x * d.x + d.y * d.y + d.z * d.z).sqrt();
    let scale = if sine < 1e-9 { 2.0 } else { 2.0 * sine.atan2(d.w) / sine };
    Frd::new(d.x, d.y, d.z) * scale
}

impl OnboardLoop for ArducopterLoop {
    fn outputs(&mut self, input: &LoopInput<'_>) -> [f64; ROTORS] {
        let target = self.target.unwrap_or(input.attitude);
        let desired_rate = self.desired_rate(input, target);
        let step = ACCELERATION_MAX_RAD_S2.map(|limit| limit * input.dt);
        self.target_rate += clip(desired_rate - self.target_rate, step);
        let target = turned(target, self.target_rate * input.dt);
        self.target = Some(target);
        let AttitudeCascade { angle_p_per_s, rate_max_rad_s, .. } = self.rate_loop.cascade;
        let error = rotation_vector(input.attitude, target).scale_by(angle_p_per_s);
        let [north, east, down] = target.to_world(self.target_rate).to_array();
        let forward = input.attitude.to_body(Ned::new(north, east, down));
        self.rate_loop.outputs(&RateInput {
            setpoint: clip(error, rate_max_rad_s) + forward,
            body_rate: input.body_rate,
            thrust: input.setpoint.thrust.max(0.0),
            thrust_curve: self.thrust_curve,
            landed: input.landed,
            dt: input.dt,
        })
    }

    fn rest(&mut self) {
        self.rate_loop.rest();
        (self.desired, self.target, self.target_rate) = (None, None, Frd::zero());
    }

    fn configure(&mut self, parameters: &Parameters) {
        let cascade = gains::cascade(GAINS, parameters, &self.nominal, self.moments);
        self.rate_loop.configure(gains::scaled(cascade, self.truth));
        self.thrust_curve = parameters.get(Key::ThrustCurve);
    }

    /// Reports the shaped target.
    fn reported(&self, setpoint: AttitudeSetpoint) -> AttitudeSetpoint {
        AttitudeSetpoint {
            attitude: self.target.map(Attitude::euler),
            body_rate: self.target_rate,
            type_mask: AttitudeTargetTypemask::empty(),
            ..setpoint
        }
    }
}
