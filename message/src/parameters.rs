//! Vehicle properties from an autopilot's parameters: the outputs that drive the motors and their
//! range, the motors' positions, and the attitude loop.
//!
//! Names and meanings follow the parameter references of PX4 and ArduPilot.

mod attitude;
mod file;
mod mixer;
mod rotors;

use std::collections::BTreeMap;
use std::ops::Deref;

pub use attitude::NormalisedLoop;
pub use file::{NotOneVehicle, NotParameters, OneVehicle, ParameterFile};
pub use mixer::Mixer;
pub use rotors::RotorFact;

/// Autopilots whose parameters are supported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Autopilot {
    /// PX4, multicopter parameters.
    Px4,
    /// ArduCopter, the multicopter firmware of ArduPilot.
    ArduCopter,
}

impl Autopilot {
    /// The autopilot's name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Px4 => "PX4",
            Self::ArduCopter => "ArduCopter",
        }
    }

    /// The relevant parameters without an index in their names.
    fn names(self) -> &'static [&'static str] {
        match self {
            Self::Px4 => PX4,
            Self::ArduCopter => ARDUCOPTER,
        }
    }

    /// Every parameter that describes a quadrotor, to request over a link. A vehicle need not have
    /// all.
    pub fn parameter_names(self) -> Vec<String> {
        let mut parameter_names: Vec<String> =
            self.names().iter().map(|name| (*name).to_owned()).collect();
        parameter_names.extend(self.output_parameter_names());
        parameter_names
    }

    /// The subset that maps outputs to rotors, with the rotors' positions and the outputs' range.
    /// Logs of the vehicle need it.
    pub fn output_parameter_names(self) -> Vec<String> {
        let numbered = |from: u32, to: u32, names: &[[&str; 2]]| -> Vec<String> {
            let each = |[start, end]: &[&str; 2]| {
                (from..to).map(|at| format!("{start}{at}{end}")).collect::<Vec<_>>()
            };
            names.iter().flat_map(each).collect()
        };
        match self {
            Self::Px4 => {
                let mut names = vec!["CA_ROTOR_COUNT".to_owned(), "THR_MDL_FAC".to_owned()];
                let rotor = [["CA_ROTOR", "_PX"], ["CA_ROTOR", "_PY"], ["CA_ROTOR", "_KM"]];
                names.extend(numbered(0, 4, &rotor));
                let output = [["PWM_MAIN_FUNC", ""], ["PWM_MAIN_MIN", ""], ["PWM_MAIN_MAX", ""]];
                names.extend(numbered(1, 9, &output));
                names
            }
            Self::ArduCopter => {
                let exact = [
                    "FRAME_CLASS",
                    "FRAME_TYPE",
                    "MOT_PWM_MIN",
                    "MOT_PWM_MAX",
                    "MOT_SPIN_MIN",
                    "MOT_SPIN_MAX",
                    "MOT_SPIN_ARM",
                ];
                let mut names: Vec<String> = exact.map(str::to_owned).into();
                names.extend(numbered(1, 9, &[["SERVO", "_FUNCTION"]]));
                names
            }
        }
    }
}

const PX4: &[&str] = &[
    "SYS_AUTOSTART",
    "MAV_TYPE",
    "CA_AIRFRAME",
    "CA_METHOD",
    "MC_ROLL_P",
    "MC_PITCH_P",
    "MC_YAW_P",
    "MC_YAW_WEIGHT",
    "MC_ROLLRATE_P",
    "MC_ROLLRATE_I",
    "MC_ROLLRATE_D",
    "MC_ROLLRATE_FF",
    "MC_ROLLRATE_K",
    "MC_ROLLRATE_MAX",
    "MC_RR_INT_LIM",
    "MC_PITCHRATE_P",
    "MC_PITCHRATE_I",
    "MC_PITCHRATE_D",
    "MC_PITCHRATE_FF",
    "MC_PITCHRATE_K",
    "MC_PITCHRATE_MAX",
    "MC_PR_INT_LIM",
    "MC_YAWRATE_P",
    "MC_YAWRATE_I",
    "MC_YAWRATE_D",
    "MC_YAWRATE_FF",
    "MC_YAWRATE_K",
    "MC_YAWRATE_MAX",
    "MC_YR_INT_LIM",
    "MC_BAT_SCALE_EN",
    "IMU_GYRO_CUTOFF",
    "IMU_DGYRO_CUTOFF",
    "IMU_GYRO_RATEMAX",
    "MPC_THR_HOVER",
    "BAT1_N_CELLS",
    "BAT1_V_CHARGED",
    "SIH_MASS",
    "SIH_IXX",
    "SIH_IYY",
    "SIH_IZZ",
    "SIH_T_MAX",
    "SIH_Q_MAX",
    "SIH_L_ROLL",
    "SIH_L_PITCH",
    "SIH_T_TAU",
    "SIH_KDV",
    "SIH_KDW",
    "SIH_VEHICLE_TYPE",
];

const ARDUCOPTER: &[&str] = &[
    "MOT_THST_EXPO",
    "MOT_THST_HOVER",
    "MOT_BAT_VOLT_MAX",
    "MOT_BAT_VOLT_MIN",
    "ATC_ANG_RLL_P",
    "ATC_ANG_PIT_P",
    "ATC_ANG_YAW_P",
    "ATC_RAT_RLL_P",
    "ATC_RAT_RLL_I",
    "ATC_RAT_RLL_D",
    "ATC_RAT_RLL_FF",
    "ATC_RAT_RLL_IMAX",
    "ATC_RAT_RLL_FLTT",
    "ATC_RAT_RLL_FLTE",
    "ATC_RAT_RLL_FLTD",
    "ATC_RAT_PIT_P",
    "ATC_RAT_PIT_I",
    "ATC_RAT_PIT_D",
    "ATC_RAT_PIT_FF",
    "ATC_RAT_PIT_IMAX",
    "ATC_RAT_PIT_FLTT",
    "ATC_RAT_PIT_FLTE",
    "ATC_RAT_PIT_FLTD",
    "ATC_RAT_YAW_P",
    "ATC_RAT_YAW_I",
    "ATC_RAT_YAW_D",
    "ATC_RAT_YAW_FF",
    "ATC_RAT_YAW_IMAX",
    "ATC_RAT_YAW_FLTT",
    "ATC_RAT_YAW_FLTE",
    "ATC_RAT_YAW_FLTD",
    "ATC_RATE_R_MAX",
    "ATC_RATE_P_MAX",
    "ATC_RATE_Y_MAX",
    "ATC_INPUT_TC",
    "ATC_ANGLE_BOOST",
    "INS_GYRO_FILTER",
    "SCHED_LOOP_RATE",
];

/// Parameter values by name; integers are converted to floats.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters(BTreeMap<String, f64>);

impl Deref for Parameters {
    type Target = BTreeMap<String, f64>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl From<BTreeMap<String, f64>> for Parameters {
    fn from(values: BTreeMap<String, f64>) -> Self {
        Self(values)
    }
}

impl FromIterator<(String, f64)> for Parameters {
    fn from_iter<I: IntoIterator<Item = (String, f64)>>(values: I) -> Self {
        Self(values.into_iter().collect())
    }
}

impl Parameters {
    /// A parameter's value, if it is present and finite.
    pub fn number(&self, name: &str) -> Option<f64> {
        self.0.get(name).copied().filter(|value| value.is_finite())
    }

    /// Adds or replaces a parameter.
    pub fn set(&mut self, name: String, value: f64) {
        self.0.insert(name, value);
    }

    /// The autopilot, inferred from the names; a set never has names of both.
    pub fn autopilot(&self) -> Option<Autopilot> {
        let has = |starts: &[&str]| {
            self.0.keys().any(|name| starts.iter().any(|start| name.starts_with(start)))
        };
        if has(&["MOT_", "ATC_", "FRAME_CLASS"]) {
            Some(Autopilot::ArduCopter)
        } else if has(&["MC_", "CA_", "PWM_", "SYS_AUTOSTART", "THR_MDL_FAC"]) {
            Some(Autopilot::Px4)
        } else {
            None
        }
    }

    /// Whether PX4 simulates the vehicle itself (SIH). The parameters then describe its body.
    pub fn is_simulated_in_hardware(&self) -> bool {
        // Every build with the module has SIH_*; outputs with functions but no range are simulated.
        const QUADROTOR: f64 = 0.0;
        // One of them may be unreadable.
        const BODY: [&str; 3] = ["SIH_MASS", "SIH_IXX", "SIH_T_MAX"];
        let has_ranges = self.0.keys().any(|name| name.starts_with("PWM_MAIN_MIN"));
        BODY.iter().any(|name| self.number(name).is_some())
            && self.number("SIH_VEHICLE_TYPE").is_none_or(|kind| kind == QUADROTOR)
            && !has_ranges
    }

    /// The rotors as configured in the autopilot, motor 1 first; empty if the parameters do not
    /// tell.
    pub fn rotors(&self) -> Vec<RotorFact> {
        rotors::of(self)
    }

    /// Number of motors that the autopilot drives.
    pub fn motor_count(&self) -> Option<u32> {
        rotors::count(self)
    }
}

/// Whether a parameter describes the vehicle, its outputs or its attitude loop. A log's facts keep
/// these.
pub fn is_of_vehicle(name: &str) -> bool {
    const STARTS: &[&str] = &[
        "ATC_",
        "AHRS_TRIM",
        "BAT1_N_CELLS",
        "BAT1_V_",
        "CA_",
        "FRAME_",
        "IMU_DGYRO_CUTOFF",
        "IMU_GYRO_CUTOFF",
        "IMU_GYRO_RATEMAX",
        "MC_",
        "MOT_",
        "PWM_",
        "SIH_",
    ];
    const EXACT: &[&str] = &[
        "INS_ACCEL_FILTER",
        "INS_GYRO_FILTER",
        "LOG_BITMASK",
        "MAV_TYPE",
        "MPC_THR_HOVER",
        "SCHED_LOOP_RATE",
        "SYS_AUTOSTART",
        "THR_MDL_FAC",
    ];
    let is_function = name.starts_with("SERVO") && name.ends_with("_FUNCTION");
    is_function || EXACT.contains(&name) || STARTS.iter().any(|start| name.starts_with(start))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Parameters from `NAME value` lines.
    pub(crate) fn parameters(text: &str) -> Parameters {
        let file = ParameterFile::parse(text.as_bytes()).expect("parameters");
        file.vehicle(None).expect("one vehicle").parameters
    }

    /// PX4's SIH quadrotor with PX4's defaults of March 2026.
    pub(crate) const SIH: &str = include_str!("../tests/parameters/px4_sih.params");

    /// ArduCopter's simulated "+" quadrotor.
    pub(crate) const COPTER: &str = include_str!("../tests/parameters/arducopter.parm");

    #[test]
    fn autopilot_is_recognised_by_parameter_names() {
        assert_eq!(parameters(SIH).autopilot(), Some(Autopilot::Px4));
        assert_eq!(parameters(COPTER).autopilot(), Some(Autopilot::ArduCopter));
        assert_eq!(Parameters::default().autopilot(), None);
    }

    #[test]
    fn wanted_parameters_are_kept_from_logs() {
        for autopilot in [Autopilot::Px4, Autopilot::ArduCopter] {
            let parameter_names = autopilot.parameter_names();
            let lost: Vec<_> = parameter_names.iter().filter(|name| !is_of_vehicle(name)).collect();
            assert_eq!(lost, Vec::<&String>::new());
        }
    }

    #[test]
    fn only_px4_simulated_vehicles_have_their_body_in_parameters() {
        assert!(parameters(SIH).is_simulated_in_hardware());
        // A real vehicle may have the module.
        let real = format!("{SIH}\nPWM_MAIN_MIN1 1100\nPWM_MAIN_MAX1 1900");
        assert!(!parameters(&real).is_simulated_in_hardware());
        assert!(!parameters(COPTER).is_simulated_in_hardware());
    }
}
