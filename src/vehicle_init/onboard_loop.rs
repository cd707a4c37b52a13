//! The autopilot's attitude loop in physical units.

use vehicle::AttitudeCascade;

use super::body::tidy;
use super::{Draft, Given};
use crate::parameters::{Autopilot, Mixer, NormalisedLoop, Parameters};

/// Fills in the loop. The autopilot's gains act on normalised torques. The mixer, the rotors' full
/// thrust and their levers give the moment of a torque of 1; times that moment, the gains give
/// moments in N m.
pub(super) fn fill(draft: &mut Draft, parameters: &Parameters) {
    let Some(autopilot) = draft.autopilot else { return };
    let normalised = match NormalisedLoop::of(parameters) {
        Ok(normalised) => normalised,
        Err(missing) => return draft.cascade_lacks = missing,
    };
    let Some(mixer) = Mixer::of(parameters) else {
        return draft.cascade_lacks = vec!["the motors' geometry".to_owned()];
    };
    let (Some(positions), Some(thrust), Some(ratio)) =
        (&draft.positions, &draft.thrust_max, &draft.torque_ratio)
    else {
        return draft.cascade_lacks = vec!["the rotors' thrust and places".to_owned()];
    };
    let levers = [
        positions.value.map(|[_, right, _]| -right),
        positions.value.map(|[front, _, _]| front),
        draft.spins.value.map(|spin| f64::from(spin) * ratio.value),
    ];
    let moments = mixer.moments(&levers, [thrust.value; 4]);
    let scaled = |gains: [f64; 3]| std::array::from_fn(|axis| tidy(gains[axis] * moments[axis]));
    let cascade = AttitudeCascade {
        angle_p_per_s: normalised.angle_p_per_s.map(tidy),
        rate_max_rad_s: normalised.rate_max_rad_s.map(tidy),
        rate_p_nms: scaled(normalised.rate_p),
        rate_i_nm: scaled(normalised.rate_i),
        rate_d_nms2: scaled(normalised.rate_d),
        rate_ff_nms: scaled(normalised.rate_ff),
        integral_max_nm: scaled(normalised.integral_max),
        gyro_cutoff_hz: tidy(normalised.gyro_cutoff_hz),
        derivative_cutoff_hz: tidy(normalised.derivative_cutoff_hz),
        input_time_constant_s: normalised.input_time_constant_s.map(tidy),
        rate_hz: tidy(normalised.rate_hz),
    };
    let names = match autopilot {
        Autopilot::Px4 => "MC_*_P, MC_*RATE_*, IMU_GYRO_CUTOFF and IMU_DGYRO_CUTOFF",
        Autopilot::ArduCopter => "ATC_ANG_*, ATC_RAT_*, ATC_INPUT_TC and INS_GYRO_FILTER",
    };
    let [roll, pitch, yaw] = moments.map(tidy);
    let from = format!(
        "{names}, times {roll}, {pitch} and {yaw} N m that a normalised torque of 1 is at the rotors"
    );
    draft.cascade = Some(Given::stated(cascade, from));
}
