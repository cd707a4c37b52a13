//! The part that the cascades share: the PID loop on the body rate, and the mixer.

use super::low_pass::{Butterworth, Derivative};
use vehicle::frame::Frd;
use vehicle::rotor::Allocation;
use vehicle::{AttitudeCascade, ROTORS};

/// The rate loop with its filters, integral and mixer.
#[derive(Clone, Debug)]
pub(super) struct RateLoop {
    pub cascade: AttitudeCascade,
    allocation: Allocation,
    gyro: Butterworth,
    derivative: Derivative,
    integral: Frd,
    is_saturated: bool,
}

/// The rate loop's inputs at one tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct RateInput {
    /// Desired body rate, rad/s.
    pub setpoint: Frd,
    /// Gyro, rad/s.
    pub body_rate: Frd,
    /// Collective thrust as a share of the rotors' full thrust.
    pub thrust: f64,
    /// Quadratic share of the thrust curve that the firmware compensates.
    pub thrust_curve: f64,
    /// Whether the vehicle has landed; the integral then does not run.
    pub landed: bool,
    /// Time since the previous tick, s.
    pub dt: f64,
}

impl RateLoop {
    pub fn new(cascade: AttitudeCascade, allocation: Allocation) -> Self {
        Self {
            gyro: Butterworth::new(cascade.gyro_cutoff_hz, cascade.rate_hz),
            derivative: Derivative::new(cascade.derivative_cutoff_hz),
            integral: Frd::zero(),
            is_saturated: false,
            cascade,
            allocation,
        }
    }

    /// Replaces the gains; resets the filters if a cutoff changes.
    pub fn configure(&mut self, cascade: AttitudeCascade) {
        if cascade.gyro_cutoff_hz != self.cascade.gyro_cutoff_hz
            || cascade.derivative_cutoff_hz != self.cascade.derivative_cutoff_hz
        {
            self.gyro = Butterworth::new(cascade.gyro_cutoff_hz, cascade.rate_hz);
            self.derivative = Derivative::new(cascade.derivative_cutoff_hz);
        }
        self.cascade = cascade;
    }

    pub fn rest(&mut self) {
        self.gyro.reset();
        self.derivative.reset();
        self.integral = Frd::zero();
        self.is_saturated = false;
    }

    /// The motor outputs, 0..1.
    pub fn outputs(&mut self, input: &RateInput) -> [f64; ROTORS] {
        let AttitudeCascade { rate_p_nms, rate_i_nm, rate_d_nms2, rate_ff_nms, .. } = self.cascade;
        let rate = self.gyro.update(input.body_rate);
        let acceleration = self.derivative.update(rate, input.dt);
        let error = input.setpoint - rate;
        let moment = error.scale_by(rate_p_nms) + self.integral
            - acceleration.scale_by(rate_d_nms2)
            + input.setpoint.scale_by(rate_ff_nms);
        if !input.landed && !self.is_saturated {
            let grown = self.integral + error.scale_by(rate_i_nm) * input.dt;
            self.integral = clip(grown, self.cascade.integral_max_nm);
        }
        self.mix(input.thrust, moment).map(|share| output_of(share, input.thrust_curve))
    }

    /// Each rotor's share of its full thrust, 0..=1. If one would exceed 1, the mixer lowers the
    /// collective and preserves the moments.
    fn mix(&mut self, thrust: f64, moment: Frd) -> [f64; ROTORS] {
        let [roll, pitch, yaw] = moment.to_array();
        let collective = thrust * self.allocation.collective_max();
        let unclipped = self.allocation.unclipped_outputs([collective, roll, pitch, yaw]);
        let most = unclipped.into_iter().fold(1.0, f64::max);
        let clipped = unclipped.map(|share| (share - (most - 1.0)).clamp(0.0, 1.0));
        self.is_saturated = clipped != unclipped;
        clipped
    }
}

/// Clamps each axis to its bound.
pub(super) fn clip(vector: Frd, bounds: [f64; 3]) -> Frd {
    let [x, y, z] = vector.to_array();
    let [a, b, c] = bounds;
    Frd::new(x.clamp(-a, a), y.clamp(-b, b), z.clamp(-c, c))
}

/// The output u at which a rotor has `share` of its thrust, from share = (1 - a) u + a u^2.
fn output_of(share: f64, a: f64) -> f64 {
    if a <= 0.0 {
        return share;
    }
    let linear = 1.0 - a;
    2.0 * share / (linear + (linear * linear + 4.0 * a * share).sqrt()).max(1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_invert_the_thrust_curve() {
        for a in [0.0, 0.3, 0.65, 1.0] {
            for share in [0.0, 0.2, 0.7, 1.0] {
                let u = output_of(share, a);
                assert!(((1.0 - a) * u + a * u * u - share).abs() < 1e-9, "{a} {share}");
            }
        }
    }
}
