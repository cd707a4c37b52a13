//! The bundled vehicle: PX4's protocol with a PD law on attitude and rates, or with the cascade of
//! a vehicle file that has no PD law.

use wire::dialect::{AUTOPILOT_VERSION_DATA, SET_ATTITUDE_TARGET_DATA};

use super::bundled_cascade::CascadeLoop;
use super::gains::scaled;
use super::px4_rules;
use super::{
    LoopInput, NoLoop, Onboard, OnboardLoop, OutputScale, Personality, Reception, Refused,
};
use crate::autopilot::Mode;
use crate::autopilot::arming::Refusal;
use crate::autopilot::commander::{Commander, Situation};
use crate::autopilot::identity;
use crate::autopilot::offboard::AttitudeSetpoint;
use crate::autopilot::parameters::{Cast, Key, Parameters, Spec, Value, fact, float, int};
use crate::autopilot::pd::AttitudeLoop;
use crate::autopilot::streams::{self, StreamRules};
use vehicle::effects::PdGain;
use vehicle::{AttitudePd, ROTORS, VehicleParams};

#[derive(Debug)]
pub(super) struct Bundled;

impl OnboardLoop for AttitudeLoop {
    fn outputs(&mut self, input: &LoopInput<'_>) -> [f64; ROTORS] {
        AttitudeLoop::outputs(self, input.setpoint, input.attitude.euler(), input.body_rate)
    }
}

/// The defaults are PX4's where PX4 has the parameter. Exceptions are the loss action (Land, which
/// needs only the vehicle) and COM_RC_OVERRIDE (sticks also end OFFBOARD: the pilot wins).
fn table(vehicle: &VehicleParams, pd: &AttitudePd) -> Vec<Spec> {
    let thrust_max = vehicle.thrust_full_n();
    let float_fact = |name, value: f64| fact(name, Value::Float(value as f32));
    vec![
        // Cells in series.
        fact("BAT1_N_CELLS", Value::Int(vehicle.battery.cells.into())),
        // Largest tilt at arming, rad. Not in PX4.
        float(Key::ComArmLevel, "COM_ARM_LEVEL", 0.3, 0.05, 1.5),
        // Disarm this long after landing, s; 0 or less: never.
        float(Key::ComDisarmLand, "COM_DISARM_LAND", 2.0, -1.0, 60.0),
        // Disarm if there is no take-off this long after arming, s; 0 or less: never.
        float(Key::ComDisarmPrflt, "COM_DISARM_PRFLT", 10.0, -1.0, 120.0),
        // Low battery: 0 warning only, 2 land, 3 return when critical, land when lower still.
        int(Key::ComLowBatAct, "COM_LOW_BAT_ACT", 0, 0, 3),
        // Action on loss of the offboard stream: 0 position, 1 altitude, 2 stabilized (these need
        // sticks, else NAV_RCL_ACT), 3 return, 4 land, 5 hold, 6 terminate, 7 disarm.
        int(Key::ComOblRcAct, "COM_OBL_RC_ACT", 4, 0, 7),
        // The offboard stream is lost when the last setpoint is older than this, s.
        float(Key::ComOfLossT, "COM_OF_LOSS_T", 1.0, 0.0, 60.0),
        // 1: sticks over MAVLink; 4: none.
        int(Key::ComRcInMode, "COM_RC_IN_MODE", 1, 0, 4),
        // Sticks are lost when the last MANUAL_CONTROL is older than this, s.
        float(Key::ComRcLossT, "COM_RC_LOSS_T", 0.5, 0.0, 35.0),
        // Moved sticks take over to Position: bit 0 from automatic modes, bit 1 from OFFBOARD.
        int(Key::ComRcOverride, "COM_RC_OVERRIDE", 3, 0, 3),
        // Gains of the attitude loop, N m s/rad and N m/rad, its rate in Hz, and the sum of the
        // rotors' maximum thrust in N, from the vehicle file. Not in PX4.
        float_fact("DW_KD_PITCH", pd.kd[1]),
        float_fact("DW_KD_ROLL", pd.kd[0]),
        float_fact("DW_KD_YAW", pd.kd[2]),
        float_fact("DW_KP_PITCH", pd.kp[1]),
        float_fact("DW_KP_ROLL", pd.kp[0]),
        float_fact("DW_KP_YAW", pd.kp[2]),
        float_fact("DW_PD_RATE", pd.rate_hz),
        float_fact("DW_THRUST_MAX", thrust_max),
        fact("MAV_COMP_ID", Value::Int(1)),
        // 0: MAVLink 1 until the peer sends MAVLink 2.
        fact("MAV_PROTO_VER", Value::Int(0)),
        fact("MAV_SYS_ID", Value::Int(1)),
        fact("MAV_TYPE", Value::Int(2)),
        // Take-off height above the position of arming, m.
        float(Key::MisTakeoffAlt, "MIS_TAKEOFF_ALT", 2.5, 0.2, 80.0),
        // Speed of descent to the ground, m/s.
        float(Key::MpcLandSpeed, "MPC_LAND_SPEED", 0.7, 0.1, 2.0),
        // The firmware's estimate of the collective output at hover. Not applied to offboard
        // setpoints.
        float(Key::MpcThrHover, "MPC_THR_HOVER", vehicle.hover_thrust as f32, 0.05, 0.9),
        // Largest tilt in position control, degrees.
        float(Key::MpcTiltMaxAir, "MPC_TILTMAX_AIR", 35.0, 5.0, 60.0),
        // Climb speed of a take-off, m/s.
        float(Key::MpcTkoSpeed, "MPC_TKO_SPEED", 1.5, 0.2, 5.0),
        // Limits of position control, m/s.
        float(Key::MpcXyVelMax, "MPC_XY_VEL_MAX", 5.0, 0.2, 20.0),
        float(Key::MpcZVelMaxDn, "MPC_Z_VEL_MAX_DN", 1.5, 0.2, 4.0),
        float(Key::MpcZVelMaxUp, "MPC_Z_VEL_MAX_UP", 3.0, 0.2, 8.0),
        // Above 0, arming needs the heartbeat of a ground station.
        int(Key::NavDllAct, "NAV_DLL_ACT", 0, 0, 6),
        // Action if sticks are needed and missing: 1 hold, 2 return, 3 land, 5 terminate, 6 disarm.
        int(Key::NavRclAct, "NAV_RCL_ACT", 2, 1, 6),
        fact("SYS_AUTOSTART", Value::Int(4001)),
    ]
}

/// The parameters of `vehicle` with its loop `pd`.
pub(in crate::autopilot) fn parameters(vehicle: &VehicleParams, pd: &AttitudePd) -> Parameters {
    Parameters::new(table(vehicle, pd), &[], Cast::Bytes)
}

impl Personality for Bundled {
    fn version(&self) -> AUTOPILOT_VERSION_DATA {
        identity::bundled_version()
    }

    fn modes(&self) -> &'static [Mode] {
        &Mode::BUNDLED
    }

    fn explains_refused_parameters(&self) -> bool {
        true
    }

    fn streams(&self) -> &'static StreamRules {
        &streams::BUNDLED
    }

    fn onboard(&self, vehicle: &VehicleParams, truth: Option<PdGain>) -> Result<Onboard, NoLoop> {
        let nominal = vehicle.attitude_loop_pd().ok_or(NoLoop::Missing)?;
        let allocation = vehicle.allocation()?;
        let attitude_loop: Box<dyn OnboardLoop> =
            match vehicle.attitude_cascade.filter(|_| vehicle.attitude_pd.is_none()) {
                Some(cascade) => Box::new(CascadeLoop::new(scaled(cascade, truth), allocation)),
                None => {
                    let gains = truth.map_or(nominal, |gain| gain.apply(&nominal));
                    Box::new(AttitudeLoop::new(gains, allocation))
                }
            };
        Ok(Onboard {
            parameters: parameters(vehicle, &nominal),
            attitude_loop,
            rate_hz: nominal.rate_hz,
        })
    }

    fn uses_motor_output(&self) -> bool {
        true
    }

    fn output_scale(&self, message: &str, _parameters: &Parameters) -> OutputScale {
        match message {
            "SERVO_OUTPUT_RAW" => OutputScale { zero: 1000.0, one: 2000.0, disarmed: 900.0 },
            _ => OutputScale { zero: 0.0, one: 1.0, disarmed: 0.0 },
        }
    }

    fn receive(&self, message: &SET_ATTITUDE_TARGET_DATA, _mode: Mode) -> Reception {
        AttitudeSetpoint::from_message(message).map_or(Reception::Ignore, Reception::Fly)
    }

    fn mode_after_disarming(&self, chosen: Mode, armed: bool) -> Option<Mode> {
        (!armed).then_some(chosen)
    }

    fn watch(&self, commander: &mut Commander, now: &Situation, parameters: &Parameters) {
        px4_rules::watch_stream(commander, now, parameters);
        px4_rules::watch_sticks(commander, now, parameters);
        px4_rules::watch_battery(commander, now, parameters);
        px4_rules::end_take_off(commander, now);
        px4_rules::watch_ground(commander, now, parameters);
    }

    fn refusal_text(&self, refused: Refused, refusal: &Refusal) -> String {
        px4_rules::refusal_text(refused, refusal)
    }

    fn motors_text(&self, armed: bool, by: &str) -> String {
        px4_rules::motors_text(armed, by)
    }

    fn text(&self, text: &str) -> String {
        // PX4 appends a tab to texts that also exist as events.
        format!("{text}\t")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::testing;

    #[test]
    fn parameter_names_fit_the_protocol_and_are_sorted() {
        let vehicle = testing::vehicle();
        let parameters = parameters(&vehicle, &vehicle.attitude_pd.unwrap());
        let names: Vec<_> =
            (0..parameters.count()).map(|at| parameters.at(at).unwrap().0.to_owned()).collect();
        assert!(names.is_sorted());
        assert!(names.iter().all(|name| name.len() <= 16));
    }
}
