//! Refusal of values that no vehicle has: each number alone, and what a physical body rules out.
//!
//! `check.rs` doubts numbers that are possible alone and do not fit each other.

use super::{AttitudeCascade, BatteryParams, MotorOutput, ROTORS, VehicleError, VehicleParams};
use crate::effects::{Effect, EffectSet, RotorGyroscopic};

/// Largest accepted mass, moment of inertia or thrust, each in its unit. A larger value would swamp
/// the others in floating-point arithmetic.
const MOST: f64 = 1e6;
/// Largest rate of an on-board loop, Hz.
pub(super) const LOOP_RATE_MAX_HZ: f64 = 8000.0;

/// Smallest accepted mass, kg. Below it, thrust over weight exceeds what a controller can handle.
const LEAST_MASS_KG: f64 = 1e-6;

impl VehicleParams {
    /// Returns this vehicle if every value is physically possible.
    ///
    /// # Errors
    /// Names the first impossible value and its field.
    pub fn checked(self) -> Result<Self, VehicleError> {
        self.check_body()?;
        self.check_rotors()?;
        self.check_motor_output()?;
        self.check_loop()?;
        self.check_battery()?;
        self.check_effects(&self.modelled_effects)?;
        Ok(self)
    }

    /// Checks that this vehicle has every number that `effects` need.
    ///
    /// # Errors
    /// Names the first number that is missing.
    pub fn check_effects(&self, effects: &EffectSet) -> Result<(), VehicleError> {
        if effects.contains(RotorGyroscopic::ID) && self.rotor_max_rpm.is_none() {
            let expected = "a speed in 1/min, which the effect rotor_gyroscopic needs";
            return Err(self.error("rotor_max_rpm", expected, "none".to_owned()));
        }
        Ok(())
    }

    fn check_body(&self) -> Result<(), VehicleError> {
        let is_possible = |value: f64| value > 0.0 && value <= MOST;
        let is_mass = (LEAST_MASS_KG..=MOST).contains(&self.mass);
        self.require("mass", self.mass, is_mass, "a mass of at least 1e-6 kg, at most 1e6")?;
        for (axis, moment) in ["inertia[0]", "inertia[1]", "inertia[2]"].iter().zip(self.inertia) {
            let expected = "a moment of inertia above 0 kg m^2, at most 1e6";
            self.require(axis, moment, is_possible(moment), expected)?;
        }
        let sum: f64 = self.inertia.iter().sum();
        let largest = self.inertia.into_iter().fold(0.0, f64::max);
        // Published inertias violate the triangle inequality by a percent or two.
        if largest > 1.05 * (sum - largest) {
            let expected = "no moment above the sum of the other two, by more than 5 %";
            return Err(self.error("inertia", expected, format!("{:?} kg m^2", self.inertia)));
        }
        let g = self.gravity;
        self.require("gravity", g, g > 0.0 && g < 100.0, "gravity in 0..100 m/s^2")?;
        let rho = self.air_density;
        self.require("air_density", rho, rho > 0.0 && rho < 100.0, "a density in 0..100 kg/m^3")?;
        if let Some(k) = self.linear_drag_n_per_m_s {
            let expected = "0 or more N per m/s, at most 1e6";
            self.require("linear_drag_N_per_m_s", k, (0.0..=MOST).contains(&k), expected)?;
        }
        for k in self.angular_damping_nms.into_iter().flatten() {
            let expected = "0 or more N m s, at most 1e6";
            self.require("angular_damping_Nms", k, (0.0..=MOST).contains(&k), expected)?;
        }
        Ok(())
    }

    fn check_rotors(&self) -> Result<(), VehicleError> {
        for (i, rotor) in self.rotors.iter().enumerate() {
            let field = |name: &str| format!("rotors[{i}].{name}");
            for coordinate in rotor.position_m {
                let expected = "lengths in m, at most 1000";
                let is_possible = coordinate.abs() <= 1e3;
                self.require(&field("position_m"), coordinate, is_possible, expected)?;
            }
            let spin = rotor.spin;
            if spin != 1 && spin != -1 {
                return Err(self.error(&field("spin"), "1 or -1", spin.to_string()));
            }
            let thrust = rotor.thrust_max_n;
            let expected = "a thrust above 0 N, at most 1e6";
            self.require(&field("thrust_max_N"), thrust, thrust > 0.0 && thrust <= MOST, expected)?;
            let torque = rotor.drag_torque_per_thrust_m;
            let name = field("drag_torque_per_thrust_m");
            self.require(&name, torque, torque > 0.0, "a ratio above 0 m (spin has the sign)")?;
        }
        self.allocation()?;
        let radius = self.rotor_radius_m;
        self.require("rotor_radius_m", radius, radius > 0.0, "a radius above 0 m")?;
        if let Some(rpm) = self.rotor_max_rpm {
            self.require("rotor_max_rpm", rpm, rpm > 0.0, "a speed above 0 in 1/min")?;
        }
        let tau = self.motor_time_constant_s;
        let expected = "a time in 0..=2 s";
        self.require("motor_time_constant_s", tau, (0.0..=2.0).contains(&tau), expected)?;
        let hover = self.hover_thrust;
        let expected = "a fraction of the full thrust between 0 and 1";
        self.require("hover_thrust", hover, hover > 0.0 && hover < 1.0, expected)
    }

    fn check_motor_output(&self) -> Result<(), VehicleError> {
        let Some(MotorOutput { fields, zero, one, disarmed, .. }) = &self.motor_output else {
            return Ok(());
        };
        self.require("motor_output.zero", *zero, true, "a number")?;
        self.require("motor_output.one", *one, one != zero, "a number other than zero's")?;
        self.require("motor_output.disarmed", *disarmed, true, "a number")?;
        if fields.len() != ROTORS {
            let found = format!("{} fields", fields.len());
            return Err(self.error("motor_output.fields", "one field for each rotor", found));
        }
        Ok(())
    }

    fn check_loop(&self) -> Result<(), VehicleError> {
        let delay = self.command_delay_s;
        let expected = "a time in 0..=1 s";
        self.require("command_delay_s", delay, (0.0..=1.0).contains(&delay), expected)?;
        if let Some(cascade) = &self.attitude_cascade {
            self.check_cascade(cascade)?;
        }
        let Some(pd) = &self.attitude_pd else { return Ok(()) };
        for gain in pd.kp {
            self.require("attitude_pd.kp", gain, gain >= 0.0, "gains of 0 or more N m/rad")?;
        }
        for gain in pd.kd {
            self.require("attitude_pd.kd", gain, gain >= 0.0, "gains of 0 or more N m s/rad")?;
        }
        let rate = pd.rate_hz;
        let expected = "a rate in 1..=1000 Hz";
        self.require("attitude_pd.rate_hz", rate, (1.0..=1000.0).contains(&rate), expected)
    }

    fn check_cascade(&self, cascade: &AttitudeCascade) -> Result<(), VehicleError> {
        if self.attitude_pd.is_some() {
            let expected = "one on-board loop, attitude_pd or attitude_cascade";
            return Err(self.error("attitude_cascade", expected, "both".to_owned()));
        }
        for (name, triple) in [
            ("angle_p_per_s", cascade.angle_p_per_s),
            ("rate_max_rad_s", cascade.rate_max_rad_s),
            ("rate_p_Nms", cascade.rate_p_nms),
        ] {
            for value in triple {
                let field = format!("attitude_cascade.{name}");
                self.require(&field, value, value > 0.0, "numbers above 0")?;
            }
        }
        for (name, triple) in [
            ("rate_i_Nm", cascade.rate_i_nm),
            ("rate_d_Nms2", cascade.rate_d_nms2),
            ("rate_ff_Nms", cascade.rate_ff_nms),
            ("integral_max_Nm", cascade.integral_max_nm),
        ] {
            for value in triple {
                let field = format!("attitude_cascade.{name}");
                self.require(&field, value, value >= 0.0, "numbers of 0 or more")?;
            }
        }
        for (name, hz) in [
            ("gyro_cutoff_hz", cascade.gyro_cutoff_hz),
            ("derivative_cutoff_hz", cascade.derivative_cutoff_hz),
        ] {
            let field = format!("attitude_cascade.{name}");
            self.require(&field, hz, hz > 0.0, "a frequency above 0 Hz")?;
        }
        if let Some(tc) = cascade.input_time_constant_s {
            let field = "attitude_cascade.input_time_constant_s";
            self.require(field, tc, (0.0..=2.0).contains(&tc), "a time in 0..=2 s")?;
        }
        let rate = cascade.rate_hz;
        let expected = "a rate in 1..=8000 Hz";
        self.require(
            "attitude_cascade.rate_hz",
            rate,
            (1.0..=LOOP_RATE_MAX_HZ).contains(&rate),
            expected,
        )
    }

    fn check_battery(&self) -> Result<(), VehicleError> {
        let BatteryParams { cells, full_v, nominal_v } = self.battery;
        if cells == 0 {
            return Err(self.error("battery.cells", "1 or more cells", cells.to_string()));
        }
        let expected = "a voltage above 0 V";
        self.require("battery.nominal_V", nominal_v, nominal_v > 0.0, expected)?;
        let expected = "a voltage of at least nominal_V";
        self.require("battery.full_V", full_v, full_v >= nominal_v, expected)
    }

    fn require(
        &self,
        field: &str,
        value: f64,
        holds: bool,
        expected: &'static str,
    ) -> Result<(), VehicleError> {
        if value.is_finite() && holds {
            return Ok(());
        }
        // Debug writes very large and very small numbers with an exponent.
        Err(self.error(field, expected, format!("{value:?}")))
    }

    pub(super) fn error(&self, field: &str, expected: &'static str, found: String) -> VehicleError {
        let (vehicle, field) = (self.name.clone(), field.to_owned());
        VehicleError::Value { vehicle, field, expected, found }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::tests::quad;

    fn refused(change: impl FnOnce(&mut VehicleParams)) -> String {
        let mut vehicle = quad();
        change(&mut vehicle);
        vehicle.checked().unwrap_err().to_string()
    }

    #[test]
    fn impossible_values_are_refused_with_field_and_unit() {
        assert!(
            refused(|v| v.mass = -1.0)
                .contains("mass: expected a mass of at least 1e-6 kg, at most 1e6, found -1")
        );
        assert!(refused(|v| v.mass = 1e300).ends_with("found 1e300"));
        assert!(refused(|v| v.mass = 1e-300).ends_with("found 1e-300"));
        assert!(refused(|v| v.mass = f64::NAN).contains("found NaN"));
        assert!(refused(|v| v.inertia[1] = 0.0).contains("inertia[1]"));
        assert!(refused(|v| v.inertia = [0.01, 0.01, 0.03]).contains("sum of the other two"));
        assert!(refused(|v| v.rotors[2].spin = 0).contains("rotors[2].spin: expected 1 or -1"));
        assert!(refused(|v| v.rotors[3].thrust_max_n = 0.0).contains("rotors[3].thrust_max_N"));
        assert!(refused(|v| v.rotors[0].position_m[0] = f64::INFINITY).contains("position_m"));
        assert!(refused(|v| v.rotors.iter_mut().for_each(|r| r.spin = 1)).contains("rotors:"));
        assert!(refused(|v| v.hover_thrust = 1.0).contains("hover_thrust"));
        assert!(refused(|v| v.gravity = 0.0).contains("m/s^2"));
        assert!(refused(|v| v.air_density = -1.2).contains("kg/m^3"));
        assert!(refused(|v| v.battery.cells = 0).contains("battery.cells"));
        assert!(refused(|v| v.battery.full_v = 1.0).contains("at least nominal_V"));
        assert!(refused(|v| v.motor_time_constant_s = -0.1).contains("0..=2 s"));
        assert!(
            refused(|v| {
                v.rotor_max_rpm = None;
                v.modelled_effects
                    .insert_argument("rotor_gyroscopic:rotor_inertia_kgm2=1e-5")
                    .unwrap();
            })
            .contains("rotor_max_rpm")
        );
    }

    #[test]
    fn inertia_may_violate_the_triangle_inequality_slightly() {
        let mut vehicle = quad();
        vehicle.inertia = [1.0e-5, 1.0e-5, 2.03e-5];
        assert!(vehicle.checked().is_ok());
    }
}
