//! The loop of a vehicle file's `attitude_cascade` without an autopilot's peculiarities: the
//! equations of [`AttitudeCascade`], without input shaping.

use super::rate_loop::{RateInput, RateLoop, clip};
use super::{LoopInput, OnboardLoop};
use crate::autopilot::offboard::AttitudeSetpoint;
use vehicle::frame::Frd;
use vehicle::rotor::Allocation;
use vehicle::{AttitudeCascade, ROTORS};

#[derive(Debug)]
pub(super) struct CascadeLoop(RateLoop);

impl CascadeLoop {
    pub fn new(cascade: AttitudeCascade, allocation: Allocation) -> Self {
        Self(RateLoop::new(cascade, allocation))
    }
}

impl OnboardLoop for CascadeLoop {
    fn outputs(&mut self, input: &LoopInput<'_>) -> [f64; ROTORS] {
        let AttitudeSetpoint { attitude, body_rate, thrust, .. } = *input.setpoint;
        let AttitudeCascade { angle_p_per_s, rate_max_rad_s, .. } = self.0.cascade;
        let towards = attitude.map_or(Frd::zero(), |desired| {
            let error = input.attitude.inverse().compose(desired.attitude()).canonical();
            let error = Frd::new(error.x, error.y, error.z) * 2.0;
            clip(error.scale_by(angle_p_per_s), rate_max_rad_s)
        });
        self.0.outputs(&RateInput {
            setpoint: towards + body_rate,
            body_rate: input.body_rate,
            thrust,
            thrust_curve: 0.0,
            landed: input.landed,
            dt: input.dt,
        })
    }

    fn rest(&mut self) {
        self.0.rest();
    }
}
