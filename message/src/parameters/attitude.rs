//! An autopilot's attitude loop with normalised torques, in the units of its gains.

use super::{Autopilot, Parameters};

/// The attitude cascade of PX4 or ArduCopter; triples are roll, pitch, yaw. The
/// [`Mixer`](super::Mixer) defines the thrusts of a normalised torque of 1.
#[derive(Clone, Debug, PartialEq)]
pub struct NormalisedLoop {
    /// Gain from attitude error to body rate, 1/s.
    pub angle_p_per_s: [f64; 3],
    /// Largest commanded body rate, rad/s.
    pub rate_max_rad_s: [f64; 3],
    /// Gain from rate error to torque, s.
    pub rate_p: [f64; 3],
    /// Gain from the integral of the rate error to torque, dimensionless.
    pub rate_i: [f64; 3],
    /// Gain from angular acceleration to torque, s^2.
    pub rate_d: [f64; 3],
    /// Gain from rate setpoint to torque, s.
    pub rate_ff: [f64; 3],
    /// Bound on the integral's normalised torque.
    pub integral_max: [f64; 3],
    /// Cutoff of the gyro's low-pass, Hz.
    pub gyro_cutoff_hz: f64,
    /// Cutoff of the derivative's low-pass, Hz.
    pub derivative_cutoff_hz: f64,
    /// Time constant of the input shaping on the setpoint, s; `None` on PX4.
    pub input_time_constant_s: Option<f64>,
    /// Rate of the loop, Hz.
    pub rate_hz: f64,
}

/// Effectively no bound, rad/s. A parameter of 0 means that ArduCopter does not bound the body
/// rate.
const NO_BOUND: f64 = 100.0;
/// Cutoff that stands for a disabled low-pass, Hz.
const NO_FILTER: f64 = 1000.0;
/// Rate of PX4's simulated IMU, Hz.
const SIMULATED_IMU_HZ: f64 = 250.0;

impl NormalisedLoop {
    /// Reads the loop from parameters.
    ///
    /// # Errors
    /// The names of the required parameters that are missing.
    pub fn of(parameters: &Parameters) -> Result<Self, Vec<String>> {
        let mut read = Read { parameters, missing: Vec::new() };
        let found = match parameters.autopilot() {
            Some(Autopilot::Px4) => read.px4(),
            Some(Autopilot::ArduCopter) => read.arducopter(),
            None => return Err(vec!["MC_ROLL_P or ATC_ANG_RLL_P".to_owned()]),
        };
        if read.missing.is_empty() { Ok(found) } else { Err(read.missing) }
    }
}

struct Read<'a> {
    parameters: &'a Parameters,
    missing: Vec<String>,
}

impl Read<'_> {
    fn one(&mut self, name: &str) -> f64 {
        self.parameters.number(name).unwrap_or_else(|| {
            self.missing.push(name.to_owned());
            0.0
        })
    }

    fn three(&mut self, names: [&str; 3]) -> [f64; 3] {
        names.map(|name| self.one(name))
    }

    /// A parameter that older versions lack, with its default.
    fn or(&self, name: &str, default: f64) -> f64 {
        self.parameters.number(name).unwrap_or(default)
    }

    fn cutoff(&self, name: &str, default: f64) -> f64 {
        let hz = self.or(name, default);
        if hz > 0.0 { hz } else { NO_FILTER }
    }

    fn px4(&mut self) -> NormalisedLoop {
        const RATES: [&str; 3] = ["ROLLRATE", "PITCHRATE", "YAWRATE"];
        let gain = RATES.map(|axis| self.or(&format!("MC_{axis}_K"), 1.0));
        let mut scaled = |end: &str| {
            let names = RATES.map(|axis| format!("MC_{axis}_{end}"));
            let values = self.three([&names[0], &names[1], &names[2]]);
            std::array::from_fn(|i| gain[i] * values[i])
        };
        let (rate_p, rate_i, rate_d) = (scaled("P"), scaled("I"), scaled("D"));
        let most = self.three(["MC_ROLLRATE_MAX", "MC_PITCHRATE_MAX", "MC_YAWRATE_MAX"]);
        let is_simulated = self.parameters.is_simulated_in_hardware();
        let rate_hz =
            if is_simulated { SIMULATED_IMU_HZ } else { self.or("IMU_GYRO_RATEMAX", 400.0) };
        NormalisedLoop {
            angle_p_per_s: self.three(["MC_ROLL_P", "MC_PITCH_P", "MC_YAW_P"]),
            rate_max_rad_s: most.map(f64::to_radians),
            rate_p,
            rate_i,
            rate_d,
            // The feed-forward is not scaled by K.
            rate_ff: RATES.map(|axis| self.or(&format!("MC_{axis}_FF"), 0.0)),
            integral_max: ["MC_RR_INT_LIM", "MC_PR_INT_LIM", "MC_YR_INT_LIM"]
                .map(|name| self.or(name, 0.3)),
            gyro_cutoff_hz: self.cutoff("IMU_GYRO_CUTOFF", 40.0),
            derivative_cutoff_hz: self.cutoff("IMU_DGYRO_CUTOFF", 30.0),
            input_time_constant_s: None,
            rate_hz,
        }
    }

    fn arducopter(&mut self) -> NormalisedLoop {
        let mut rate = |end: &str| {
            let names = ["RLL", "PIT", "YAW"].map(|axis| format!("ATC_RAT_{axis}_{end}"));
            self.three([&names[0], &names[1], &names[2]])
        };
        let (rate_p, rate_i, rate_d) = (rate("P"), rate("I"), rate("D"));
        let (rate_ff, integral_max) = (rate("FF"), rate("IMAX"));
        let bound = |degrees: f64| if degrees > 0.0 { degrees.to_radians() } else { NO_BOUND };
        let most = ["ATC_RATE_R_MAX", "ATC_RATE_P_MAX", "ATC_RATE_Y_MAX"];
        NormalisedLoop {
            angle_p_per_s: self.three(["ATC_ANG_RLL_P", "ATC_ANG_PIT_P", "ATC_ANG_YAW_P"]),
            rate_max_rad_s: most.map(|name| bound(self.or(name, 0.0))),
            rate_p,
            rate_i,
            rate_d,
            rate_ff,
            integral_max,
            gyro_cutoff_hz: self.cutoff("INS_GYRO_FILTER", 20.0),
            derivative_cutoff_hz: self.cutoff("ATC_RAT_RLL_FLTD", 20.0),
            input_time_constant_s: Some(self.one("ATC_INPUT_TC")),
            rate_hz: self.or("SCHED_LOOP_RATE", 400.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{COPTER, SIH, parameters};
    use super::*;

    #[test]
    fn px4_rate_gains_scale_with_k_and_limits_are_degrees() {
        let doubled = SIH.replace("MC_ROLLRATE_K 1", "MC_ROLLRATE_K 2");
        let found = NormalisedLoop::of(&parameters(&doubled)).expect("a loop");
        assert_eq!((found.rate_p[0], found.rate_d[0], found.rate_p[1]), (0.3, 0.006, 0.15));
        assert_eq!(found.rate_max_rad_s[0], 220f64.to_radians());
        assert_eq!(found.rate_hz, 250.0);
        assert_eq!(found.input_time_constant_s, None);
    }

    #[test]
    fn arducopter_shapes_setpoints_and_zero_rate_limit_means_unbounded() {
        let found = NormalisedLoop::of(&parameters(COPTER)).expect("a loop");
        assert_eq!(found.input_time_constant_s, Some(0.15));
        assert_eq!(found.rate_max_rad_s, [NO_BOUND; 3]);
        assert_eq!(found.rate_p, [0.135, 0.135, 0.18]);
        assert_eq!(found.rate_hz, 400.0);
    }

    #[test]
    fn missing_parameters_are_named() {
        let without = SIH.replace("MC_YAW_P 2.8", "").replace("MC_PITCHRATE_P 0.15", "");
        let missing = NormalisedLoop::of(&parameters(&without)).unwrap_err();
        assert_eq!(missing, ["MC_PITCHRATE_P", "MC_YAW_P"]);
    }
}
