//! Makes a vehicle file from the autopilot's parameters and the user's measurements.
//!
//! Every number has its source. An estimate is marked as such, with a tolerance. An unknown number
//! is named with the way to measure it, and never guessed.

mod body;
mod document;
mod onboard_loop;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::{AttitudeCascade, BatteryParams};

use crate::log::import::StatedKind;
use crate::parameters::{Autopilot, Parameters};

/// Default gravity, m/s^2.
const GRAVITY: f64 = 9.80665;
/// Density of the air near the ground, kg/m^3.
const AIR_DENSITY: f64 = 1.2;

/// The user's measurements of the vehicle. They override parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// The vehicle's name, for the file.
    pub name: Option<String>,
    /// Mass, kg.
    pub mass_kg: Option<f64>,
    /// Moments of inertia about front, right and down, kg m^2.
    pub inertia: Option<[f64; 3]>,
    /// Distance from the centre to a rotor, m.
    pub arm_m: Option<f64>,
    /// Layout, where no parameters give it.
    pub layout: Option<Layout>,
    /// Full thrust of one rotor, N.
    pub thrust_max_n: Option<f64>,
    /// Throttle at hover, 0..1.
    pub hover_throttle: Option<f64>,
    /// Diameter of a propeller, m.
    pub propeller_m: Option<f64>,
    /// Drag torque of a rotor per thrust, m.
    pub torque_ratio_m: Option<f64>,
    /// First-order time constant of the rotors, s.
    pub motor_lag_s: Option<f64>,
    /// Cells of the pack in series.
    pub cells: Option<u8>,
}

/// Layouts of quadrotors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Two rotors in front.
    X,
    /// One rotor in front.
    Plus,
}

/// Accuracy of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tolerance {
    /// As a share of the number.
    Share(f64),
    /// In seconds.
    Seconds(f64),
}

/// A number with its source.
#[derive(Clone, Debug, PartialEq)]
pub struct Given<T> {
    /// The number, or numbers.
    pub value: T,
    /// Its origin, for the file's comments.
    pub from: String,
    /// One standard deviation, where it is known.
    pub tolerance: Option<Tolerance>,
    /// Whether it is an estimate, neither stated nor measured.
    pub is_estimate: bool,
}

impl<T> Given<T> {
    fn stated(value: T, from: impl Into<String>) -> Self {
        Self { value, from: from.into(), tolerance: None, is_estimate: false }
    }

    fn within(self, share: f64) -> Self {
        Self { tolerance: Some(Tolerance::Share(share)), ..self }
    }

    fn estimate(value: T, tolerance: Tolerance, from: impl Into<String>) -> Self {
        Self { value, from: from.into(), tolerance: Some(tolerance), is_estimate: true }
    }
}

/// A number that is unknown or only estimated, and how to measure it.
#[derive(Clone, Debug, PartialEq, Eq, JsonSchema, Serialize)]
pub struct Wanting {
    /// Key of the vehicle file.
    pub key: &'static str,
    /// A description with the unit.
    pub what: &'static str,
    /// How to measure it, and the flag that takes it.
    pub how: &'static str,
}

/// The content of a vehicle file, as far as it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Draft {
    /// Name of the vehicle.
    pub name: String,
    /// The source of the parameters.
    pub source: String,
    /// The autopilot whose parameters they are.
    pub autopilot: Option<Autopilot>,
    /// Mass, kg.
    pub mass: Option<Given<f64>>,
    /// Moments of inertia about front, right and down, kg m^2.
    pub inertia: Option<Given<[f64; 3]>>,
    /// Places of the rotors for people, in the order of the motors.
    pub layout: [String; 4],
    /// Positions front, right, down, m, in the order of the motors.
    pub positions: Option<Given<[[f64; 3]; 4]>>,
    /// Directions of rotation, as in a vehicle file.
    pub spins: Given<[i8; 4]>,
    /// Full thrust of one rotor, N.
    pub thrust_max: Option<Given<f64>>,
    /// Drag torque per thrust, m.
    pub torque_ratio: Option<Given<f64>>,
    /// Radius of a rotor, m.
    pub rotor_radius: Option<Given<f64>>,
    /// First-order time constant of the rotors, s.
    pub motor_lag: Given<f64>,
    /// Delay from a setpoint to its effect, s.
    pub command_delay: Given<f64>,
    /// Hover thrust as a fraction of full thrust.
    pub hover_thrust: Option<Given<f64>>,
    /// The pack.
    pub battery: Given<BatteryParams>,
    /// The autopilot's own attitude loop.
    pub cascade: Option<Given<AttitudeCascade>>,
    /// Parameters missing for the loop, where the autopilot is known.
    pub cascade_lacks: Vec<String>,
    /// Linear drag, N per m/s.
    pub linear_drag: Option<Given<f64>>,
    /// Angular damping, N m s.
    pub angular_damping: Option<Given<f64>>,
    /// Share of the square in the rotors' thrust curve.
    pub thrust_curve: Option<Given<f64>>,
}

/// Why this vehicle cannot have a vehicle file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoQuadrotor {
    /// It does not have four motors.
    #[error("its parameters describe a vehicle with {0} motors; only quadrotors are supported")]
    Motors(u32),
    /// It is not a multirotor.
    #[error("its parameters describe {} ({}); only quadrotors are supported", .0.kind, .0.by)]
    Kind(StatedKind),
}

impl Draft {
    /// Gathers what parameters and measurements say about a vehicle.
    ///
    /// # Errors
    /// [`NoQuadrotor`].
    pub fn new(
        source: &str,
        parameters: &Parameters,
        measured: &Measured,
    ) -> Result<Self, NoQuadrotor> {
        if let Some(stated) = StatedKind::otherwise(parameters) {
            return Err(NoQuadrotor::Kind(stated));
        }
        if let Some(count) = parameters.motor_count().filter(|count| *count != 4) {
            return Err(NoQuadrotor::Motors(count));
        }
        let mut draft = body::draft(source, parameters, measured);
        onboard_loop::fill(&mut draft, parameters);
        Ok(draft)
    }

    /// The numbers that the file needs and no source gives.
    pub fn missing(&self) -> Vec<Wanting> {
        let has = [
            ("mass", self.mass.is_some()),
            ("rotors.position_m", self.positions.is_some()),
            ("rotors.thrust_max_N", self.thrust_max.is_some()),
            ("inertia", self.inertia.is_some()),
        ];
        let missing = has.into_iter().filter(|(_, has)| !has);
        missing.filter_map(|(key, _)| wanting(key)).collect()
    }

    /// The assumed value of an important estimate, and its source. Only `inertia` has one.
    pub fn assumption(&self, key: &str) -> Option<String> {
        let inertia =
            self.inertia.as_ref().filter(|given| given.is_estimate && key == "inertia")?;
        let [roll, pitch, yaw] = inertia.value.map(body::tidy);
        Some(format!("assumed to be {roll}, {pitch}, {yaw}, {}", inertia.from))
    }

    /// The numbers in the file that are only estimates.
    pub fn estimated(&self) -> Vec<Wanting> {
        let is_estimate =
            |given: &Option<Given<f64>>| given.as_ref().is_some_and(|g| g.is_estimate);
        let estimates = [
            ("inertia", self.inertia.as_ref().is_some_and(|given| given.is_estimate)),
            ("rotors.thrust_max_N", is_estimate(&self.thrust_max)),
            ("rotors.drag_torque_per_thrust_m", is_estimate(&self.torque_ratio)),
            ("motor_time_constant_s", self.motor_lag.is_estimate),
            ("command_delay_s", self.command_delay.is_estimate),
            ("rotor_radius_m", is_estimate(&self.rotor_radius)),
            ("battery", self.battery.is_estimate),
        ];
        let estimates = estimates.into_iter().filter(|(_, is_estimate)| *is_estimate);
        estimates.filter_map(|(key, _)| wanting(key)).collect()
    }
}

const WANTING: [Wanting; 9] = [
    Wanting {
        key: "mass",
        what: "the mass in kg",
        how: "weigh the vehicle as it flies, battery included: --mass",
    },
    Wanting {
        key: "rotors.position_m",
        what: "the rotors' positions from the centre of mass in m",
        how: "measure from the centre to a motor's axis: --arm, or across between opposite motors: \
              --wheelbase",
    },
    Wanting {
        key: "rotors.thrust_max_N",
        what: "a rotor's thrust at full output in N",
        how: "take it from the motor's data sheet or a scale: --thrust; or give the throttle at \
              which the vehicle hovers, 0 to 1: --hover-throttle",
    },
    Wanting {
        key: "inertia",
        what: "the moments of inertia about front, right and down in kg m^2",
        how: "hang the vehicle from two lines of length l, 2 r apart, and time its swing about \
              them: I = m g r^2 T^2 / (4 pi^2 l): --inertia; or let `downwash diagnose` find it \
              from flights with outputs logged at 100 Hz or more",
    },
    Wanting {
        key: "rotors.drag_torque_per_thrust_m",
        what: "a rotor's drag torque over its thrust in m",
        how: "take it from the propeller's data (diameter times C_P / (2 pi C_T)): --torque-ratio; \
              it sets how strongly the vehicle can yaw",
    },
    Wanting {
        key: "motor_time_constant_s",
        what: "the rotors' lag in s",
        how: "time a step of the throttle on a bench: --motor-lag; `downwash train` finds it from \
              flights",
    },
    Wanting {
        key: "command_delay_s",
        what: "the delay of setpoints in s",
        how: "`downwash train` finds it from flights",
    },
    Wanting {
        key: "rotor_radius_m",
        what: "the radius of a rotor in m",
        how: "half of the propeller's diameter, in inches: --propeller",
    },
    Wanting { key: "battery", what: "the pack", how: "the number of cells in series: --cells" },
];

fn wanting(key: &str) -> Option<Wanting> {
    WANTING.iter().find(|wanting| wanting.key == key).cloned()
}

#[cfg(test)]
mod tests {
    use vehicle::VehicleParams;

    use super::*;
    use crate::log::import::VehicleKind;
    use crate::parameters::ParameterFile;

    const SIH: &str = include_str!("../message/tests/parameters/px4_sih.params");
    const COPTER: &str = include_str!("../message/tests/parameters/arducopter.parm");

    fn parameters(text: &str) -> Parameters {
        let file = ParameterFile::parse(text.as_bytes()).expect("parameters");
        file.vehicle(None).expect("one vehicle").parameters
    }

    fn draft(text: &str, measured: Measured) -> Draft {
        Draft::new("a test", &parameters(text), &measured).expect("a quadrotor")
    }

    fn keys(wanting: Vec<Wanting>) -> Vec<&'static str> {
        wanting.into_iter().map(|wanting| wanting.key).collect()
    }

    fn close(found: f64, expected: f64) {
        assert!((found - expected).abs() <= 1e-4 * expected.abs(), "{found} is not {expected}");
    }

    #[test]
    fn px4_simulated_vehicle_gives_a_complete_file() {
        let draft = draft(SIH, Measured::default());
        assert_eq!(draft.missing(), []);
        let text = draft.to_toml();
        let vehicle = VehicleParams::from_toml_str(&text).unwrap_or_else(|e| panic!("{e}\n{text}"));
        assert_eq!((vehicle.mass, vehicle.inertia), (1.0, [0.025, 0.025, 0.03]));
        assert_eq!(vehicle.rotors[3].position_m, [-0.2, 0.2, 0.0]);
        assert_eq!(vehicle.rotors.map(|rotor| rotor.spin), [1, 1, -1, -1]);
        close(vehicle.rotors[0].drag_torque_per_thrust_m, 0.02);
        close(vehicle.hover_thrust, 9.80665 / 20.0);
        assert_eq!(vehicle.linear_drag_n_per_m_s, Some(1.0));
        assert_eq!(vehicle.battery.cells, 4);
        close(vehicle.battery.full_v, 16.2);
        assert_eq!(vehicle.remarks(), []);
        // MC_ROLLRATE_P 0.15 times the mixer's 2 sqrt(2) N m; MC_YAWRATE_P 0.2 times 0.4 N m.
        let pd = vehicle.attitude_loop_pd().expect("a loop");
        close(pd.kd[0], 0.15 * 8f64.sqrt());
        close(pd.kp[0], 4.0 * 0.15 * 8f64.sqrt());
        close(pd.kd[2], 0.2 * 0.4);
        close(pd.kp[2], 2.8 * 0.2 * 0.4);
        let cascade = vehicle.attitude_cascade.expect("a cascade");
        close(cascade.integral_max_nm[2], 0.3 * 0.4);
        close(cascade.rate_i_nm[1], 0.2 * 8f64.sqrt());
    }

    #[test]
    fn values_missing_from_arducopter_are_named_and_omitted() {
        let draft = draft(COPTER, Measured::default());
        let missing = ["mass", "rotors.position_m", "rotors.thrust_max_N", "inertia"];
        assert_eq!(keys(draft.missing()), missing);
        let text = draft.to_toml();
        assert!(text.contains("# mass = ?") && text.contains("--mass"), "{text}");
        let error = VehicleParams::from_toml_str(&text).unwrap_err().to_string();
        assert!(error.contains("no key mass"), "{error}");
    }

    #[test]
    fn arducopter_with_measured_mass_and_arm_is_complete() {
        let measured = Measured {
            mass_kg: Some(3.0),
            arm_m: Some(0.35),
            inertia: Some([0.023, 0.023, 0.046]),
            ..Measured::default()
        };
        let draft = draft(COPTER, measured);
        assert_eq!(draft.missing(), []);
        let vehicle = VehicleParams::from_toml_str(&draft.to_toml()).expect("a vehicle");
        // The throttle at hover is the share of the thrust.
        let thrust = 3.0 * GRAVITY / 4.0 / 0.39;
        close(vehicle.rotors[0].thrust_max_n, thrust);
        close(vehicle.rotors[0].position_m[1], 0.35);
        let curve =
            vehicle.modelled_effects.get::<vehicle::effects::ThrustCurve>().expect("a curve");
        close(curve.a, 0.65);
        // Two motors at half thrust each act about roll.
        let cascade = vehicle.attitude_cascade.expect("a cascade");
        close(cascade.rate_p_nms[0], 0.135 * thrust * 0.35);
        assert_eq!(cascade.input_time_constant_s, Some(0.15));
        // The setpoint is followed with 0.15 s, and its rate is fed forward.
        close(vehicle.attitude_loop_pd().expect("a loop").kp[0], cascade.rate_p_nms[0] / 0.15);
    }

    #[test]
    fn assumed_inertia_is_stated() {
        let weighed = Measured { mass_kg: Some(3.0), arm_m: Some(0.35), ..Measured::default() };
        let taken = draft(COPTER, weighed.clone()).assumption("inertia").expect("an assumption");
        assert!(taken.contains("0.091875") && taken.contains("mass times arm squared"), "{taken}");
        let stated = Measured { inertia: Some([0.023, 0.023, 0.046]), ..weighed };
        assert_eq!(draft(COPTER, stated).assumption("inertia"), None);
    }

    #[test]
    fn few_measurements_make_a_file_without_a_loop() {
        let measured = Measured {
            mass_kg: Some(1.4),
            arm_m: Some(0.22),
            hover_throttle: Some(0.4),
            propeller_m: Some(0.254),
            cells: Some(4),
            ..Measured::default()
        };
        let draft = Draft::new("flags", &Parameters::default(), &measured).expect("a quadrotor");
        let vehicle = VehicleParams::from_toml_str(&draft.to_toml()).expect("a vehicle");
        assert_eq!(vehicle.attitude_loop_pd(), None);
        close(vehicle.rotor_radius_m, 0.127);
        assert_eq!(vehicle.remarks(), []);
        let estimated = keys(draft.estimated());
        assert!(estimated.contains(&"inertia"), "{estimated:?}");
        // The file contains it too, with its tolerance.
        let share = vehicle.provenance["inertia"]["sigma_share"].as_f64().expect("a share");
        assert!(share >= 0.3, "{share}");
    }

    #[test]
    fn measurements_override_parameters() {
        let measured =
            Measured { mass_kg: Some(1.3), thrust_max_n: Some(7.0), ..Measured::default() };
        let draft = draft(SIH, measured);
        let vehicle = VehicleParams::from_toml_str(&draft.to_toml()).expect("a vehicle");
        assert_eq!((vehicle.mass, vehicle.rotors[1].thrust_max_n), (1.3, 7.0));
        close(vehicle.hover_thrust, 1.3 * GRAVITY / 28.0);
        assert_eq!(vehicle.provenance["mass"]["from"], "measured (--mass)");
    }

    #[test]
    fn wrong_motor_count_or_airframe_is_no_quadrotor() {
        let six = COPTER.replace("FRAME_CLASS,1", "FRAME_CLASS,2");
        let refused = Draft::new("a test", &parameters(&six), &Measured::default());
        assert_eq!(refused, Err(NoQuadrotor::Motors(6)));
        let wing = SIH.replace("CA_AIRFRAME 0", "CA_AIRFRAME 1");
        let helicopter = COPTER.replace("FRAME_CLASS,1", "FRAME_CLASS,6");
        let hovering = format!("{COPTER}\nQ_ENABLE,1");
        for (text, kind) in [
            (wing, VehicleKind::FixedWing),
            (helicopter, VehicleKind::Helicopter),
            (hovering, VehicleKind::Vtol),
        ] {
            let refused = Draft::new("a test", &parameters(&text), &Measured::default());
            assert!(
                matches!(&refused, Err(NoQuadrotor::Kind(stated)) if stated.kind == kind),
                "{refused:?}"
            );
        }
    }
}
