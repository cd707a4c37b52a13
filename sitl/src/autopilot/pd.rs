//! The PD attitude loop of the bundled autopilot.
//!
//! M = kp (zeta_des - zeta) + kd (omega_des - omega), with the yaw difference wrapped. With rates
//! only, M = kd (omega_des - omega). Mixer and collective always use the firmware's nominal numbers
//! from the vehicle file. Only the gains may be the true ones.

use vehicle::frame::{Euler, Frd, wrap_angle};
use vehicle::rotor::Allocation;
use vehicle::{AttitudePd, ROTORS};

use super::offboard::AttitudeSetpoint;

/// The attitude loop with its gains and mixer.
#[derive(Clone, Debug)]
pub struct AttitudeLoop {
    gains: AttitudePd,
    allocation: Allocation,
}

impl AttitudeLoop {
    /// Creates the loop with the true gains and the firmware's mixer.
    pub fn new(gains: AttitudePd, allocation: Allocation) -> Self {
        Self { gains, allocation }
    }

    /// The motor outputs, 0..1, for `setpoint` at the reported attitude and the measured rate.
    pub fn outputs(
        &self,
        setpoint: &AttitudeSetpoint,
        reported: Euler,
        body_rate: Frd,
    ) -> [f64; ROTORS] {
        let mut moment = (setpoint.body_rate - body_rate).scale_by(self.gains.kd);
        if let Some(desired) = setpoint.attitude {
            let error = Frd::new(
                desired.roll - reported.roll,
                desired.pitch - reported.pitch,
                wrap_angle(desired.yaw - reported.yaw),
            );
            moment += error.scale_by(self.gains.kp);
        }
        let [roll, pitch, yaw] = moment.to_array();
        let collective = setpoint.thrust * self.allocation.collective_max();
        self.allocation.outputs([collective, roll, pitch, yaw])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::testing;
    use proptest::prelude::*;
    use vehicle::VehicleParams;
    use wire::dialect::AttitudeTargetTypemask;

    fn attitude_loop() -> (VehicleParams, AttitudePd, AttitudeLoop) {
        let vehicle = testing::vehicle();
        let gains = vehicle.attitude_pd.unwrap();
        let attitude_loop = AttitudeLoop::new(gains, vehicle.allocation().unwrap());
        (vehicle, gains, attitude_loop)
    }

    fn setpoint(attitude: Option<Euler>, body_rate: Frd, thrust: f64) -> AttitudeSetpoint {
        let type_mask = AttitudeTargetTypemask::empty();
        AttitudeSetpoint { attitude, body_rate, thrust, type_mask }
    }

    proptest! {
        #[test]
        fn unclipped_outputs_produce_the_pd_moments(
            roll in -0.05..0.05f64, pitch in -0.05..0.05f64, yaw in -0.05..0.05f64, rate in -0.1..0.1f64,
        ) {
            let (vehicle, pd, attitude_loop) = attitude_loop();
            let desired = setpoint(Some(Euler::default()), Frd::zero(), 0.5);
            let outputs =
                attitude_loop.outputs(&desired, Euler::new(roll, pitch, yaw), Frd::new(rate, 0.0, 0.0));
            prop_assume!(outputs.iter().all(|u| (0.001..0.999).contains(u)));
            let made = vehicle.allocation().unwrap().wrench(outputs);
            let expected = [
                0.5 * vehicle.thrust_full_n(),
                -pd.kp[0] * roll - pd.kd[0] * rate,
                -pd.kp[1] * pitch,
                -pd.kp[2] * yaw,
            ];
            for (made, expected) in made.into_iter().zip(expected) {
                prop_assert!((made - expected).abs() < 1e-9, "{made} {expected}");
            }
        }
    }

    #[test]
    fn yaw_error_wraps_the_short_way() {
        let (_, _, attitude_loop) = attitude_loop();
        let desired = setpoint(Some(Euler::new(0.0, 0.0, 3.1)), Frd::zero(), 0.5);
        let across = attitude_loop.outputs(&desired, Euler::new(0.0, 0.0, -3.1), Frd::zero());
        let short = 3.1 - std::f64::consts::PI;
        let same = setpoint(Some(Euler::new(0.0, 0.0, 2.0 * short)), Frd::zero(), 0.5);
        let near = attitude_loop.outputs(&same, Euler::default(), Frd::zero());
        for (a, b) in across.into_iter().zip(near) {
            assert!((a - b).abs() < 1e-9);
        }
    }

    #[test]
    fn rate_only_setpoints_ignore_the_attitude() {
        let (_, _, attitude_loop) = attitude_loop();
        let rates = setpoint(None, Frd::zero(), 0.5);
        let tilted = attitude_loop.outputs(&rates, Euler::new(0.5, -0.5, 1.0), Frd::zero());
        assert!(tilted.iter().all(|u| (u - 0.5).abs() < 1e-9));
    }
}
