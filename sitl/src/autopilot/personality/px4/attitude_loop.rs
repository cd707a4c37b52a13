//! PX4's attitude loop: a proportional law on the quaternion error that gives tilt priority over
//! heading, around the rate loop.

use super::super::rate_loop::{RateInput, RateLoop, clip};
use super::super::{LoopInput, OnboardLoop, gains};
use super::parameters::GAINS;
use crate::autopilot::offboard::AttitudeSetpoint;
use crate::autopilot::parameters::{Key, Parameters};
use vehicle::effects::PdGain;
use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::rotor::Allocation;
use vehicle::{AttitudeCascade, ROTORS};

#[derive(Debug)]
pub(super) struct Px4Loop {
    nominal: AttitudeCascade,
    /// Moments of a normalised torque of 1, N m.
    moments: [f64; 3],
    truth: Option<PdGain>,
    rate_loop: RateLoop,
    yaw_weight: f64,
    thrust_curve: f64,
}

impl Px4Loop {
    pub fn new(
        nominal: AttitudeCascade,
        moments: [f64; 3],
        truth: Option<PdGain>,
        allocation: Allocation,
        parameters: &Parameters,
    ) -> Self {
        let rate_loop = RateLoop::new(nominal, allocation);
        let mut made =
            Self { nominal, moments, truth, rate_loop, yaw_weight: 1.0, thrust_curve: 0.0 };
        made.configure(parameters);
        made
    }

    /// The body rates that rotate `attitude` towards `desired`.
    fn rates_to(&self, attitude: Attitude, desired: Attitude, yaw_rate: f64) -> Frd {
        let cascade = &self.rate_loop.cascade;
        let weighted = weigh_yaw(attitude, desired, self.yaw_weight);
        let error = attitude.inverse().compose(weighted).canonical();
        // The heading's gain compensates its weight.
        let [roll, pitch, yaw] = cascade.angle_p_per_s;
        let gain = [roll, pitch, yaw / self.yaw_weight];
        let rates = (Frd::new(error.x, error.y, error.z) * 2.0).scale_by(gain);
        let turn = attitude.to_body(Ned::new(0.0, 0.0, yaw_rate));
        clip(rates + turn, cascade.rate_max_rad_s)
    }
}

/// Share of a cycle between the attitude loop and the rate loop. Rates that arrive in between are
/// overwritten before use. The value follows from the measured effect of such rates.
const OVERWRITTEN: f64 = 0.13;

/// Whether the rates of a new setpoint reach the rate loop.
fn overrides(input: &LoopInput<'_>) -> bool {
    input.new_for_s.is_some_and(|age| age >= OVERWRITTEN * input.dt)
}

/// `desired` with only the share `weight` of its rotation about the thrust axis: the shortest
/// rotation of the thrust comes first, then the heading.
fn weigh_yaw(attitude: Attitude, desired: Attitude, weight: f64) -> Attitude {
    let down = Frd::new(0.0, 0.0, 1.0);
    let (from, to) = (attitude.to_world(down), desired.to_world(down));
    let axis = from.cross(to);
    let w = 1.0 + from.dot(to);
    if w < 1e-5 {
        return desired;
    }
    let turn = Attitude { w, x: axis.north(), y: axis.east(), z: axis.down() }.normalized();
    let tilted = turn.compose(attitude);
    let heading = tilted.inverse().compose(desired).canonical();
    let half = heading.z.atan2(heading.w) * weight;
    tilted.compose(Attitude { w: half.cos(), x: 0.0, y: 0.0, z: half.sin() })
}

impl OnboardLoop for Px4Loop {
    fn outputs(&mut self, input: &LoopInput<'_>) -> [f64; ROTORS] {
        let AttitudeSetpoint { attitude, body_rate, thrust, .. } = *input.setpoint;
        let sent = body_rate.to_array();
        // An ignored rate is replaced by the measured one.
        let measured = input.body_rate.to_array();
        let of_message =
            std::array::from_fn(
                |axis| {
                    if sent[axis].is_nan() { measured[axis] } else { sent[axis] }
                },
            );
        let has_rates = !sent[0].is_nan();
        let setpoint = match attitude {
            // Rates in a message with an attitude replace those of the attitude loop until its next
            // cycle.
            Some(_) if has_rates && overrides(input) => Frd::from(of_message),
            Some(desired) => {
                let yaw_rate = if sent[2].is_nan() { 0.0 } else { sent[2] };
                self.rates_to(input.attitude, desired.attitude(), yaw_rate)
            }
            None => Frd::from(of_message),
        };
        self.rate_loop.outputs(&RateInput {
            setpoint,
            body_rate: input.body_rate,
            thrust,
            thrust_curve: self.thrust_curve,
            landed: input.landed,
            dt: input.dt,
        })
    }

    fn rest(&mut self) {
        self.rate_loop.rest();
    }

    fn configure(&mut self, parameters: &Parameters) {
        let cascade = gains::cascade(GAINS, parameters, &self.nominal, self.moments);
        self.rate_loop.configure(gains::scaled(cascade, self.truth));
        self.yaw_weight = parameters.get(Key::YawWeight).clamp(0.01, 1.0);
        self.thrust_curve = parameters.get(Key::ThrustCurve);
    }

    fn reported(&self, setpoint: AttitudeSetpoint) -> AttitudeSetpoint {
        let known = |rate: f64| if rate.is_nan() { 0.0 } else { rate };
        AttitudeSetpoint { body_rate: setpoint.body_rate.map(known), ..setpoint }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle::frame::Euler;

    #[test]
    fn yaw_weight_reduces_heading_but_not_tilt() {
        let level = Attitude::default();
        let tilted = Euler::new(0.3, -0.2, 0.0).attitude();
        assert!(weigh_yaw(level, tilted, 0.4).tilt() - tilted.tilt() < 1e-12);
        let both = Euler::new(0.3, -0.2, 1.0).attitude();
        let weighted = weigh_yaw(level, both, 0.4);
        assert!((weighted.tilt() - both.tilt()).abs() < 1e-12, "tilt is not weighted");
        let turned = Euler::new(0.0, 0.0, 1.0).attitude();
        assert!((weigh_yaw(level, turned, 0.4).yaw() - 0.4).abs() < 1e-12);
    }
}
