//! The body, its rotors and its pack.

use vehicle::BatteryParams;

use super::{Draft, GRAVITY, Given, Layout, Measured, Tolerance};
use crate::parameters::{Autopilot, Parameters, RotorFact};

/// Distances of a rotor from the centre that are plausible in metres, m.
const ARMS: std::ops::RangeInclusive<f64> = 0.02..=0.8;
/// PX4's defaults.
const PX4_HOVER: f64 = 0.5;
const PX4_TORQUE_RATIO: f64 = 0.05;
/// ArduCopter's default.
const ARDUCOPTER_HOVER: f64 = 0.35;
/// Moment of inertia over mass times arm squared, about front and right, and about down. Published
/// quadrotors have 0.16 to 0.31, and about twice that.
const INERTIA_SHARES: [f64; 3] = [0.25, 0.25, 0.45];
/// Spread of these shares.
const INERTIA_SPREAD: f64 = 0.4;
/// Drag torque over thrust and diameter of small propellers, and its spread.
const TORQUE_RATIO: f64 = 0.07;
const TORQUE_SPREAD: f64 = 0.4;
/// Radius of a rotor over the arm, and its spread.
const RADIUS_SHARE: f64 = 0.6;
const RADIUS_SPREAD: f64 = 0.3;
/// Lag of small rotors, s, and its spread.
const MOTOR_LAG_S: f64 = 0.04;
const MOTOR_LAG_SPREAD_S: f64 = 0.02;
/// Delay of a setpoint on a good link, s, and its spread.
const DELAY_S: f64 = 0.01;
const DELAY_SPREAD_S: f64 = 0.007;
/// Volts of a cell, nominal and full.
const CELL_V: [f64; 2] = [3.7, 4.2];

pub(super) fn draft(source: &str, parameters: &Parameters, measured: &Measured) -> Draft {
    let read = Read {
        parameters,
        measured,
        autopilot: parameters.autopilot(),
        is_simulated: parameters.is_simulated_in_hardware(),
    };
    let mass = read.one(measured.mass_kg, "--mass", "SIH_MASS");
    let Placed { positions, spins, order: layout } = read.rotors();
    let arm = positions.as_ref().map(|given| {
        given.value.iter().map(|[x, y, _]| x.hypot(*y)).sum::<f64>() / given.value.len() as f64
    });
    let rotor_radius = read.rotor_radius(arm);
    let torque_ratio = read.torque_ratio(rotor_radius.as_ref());
    let thrust_max = read.thrust_max(mass.as_ref());
    let hover_thrust = mass.as_ref().zip(thrust_max.as_ref()).map(|(mass, thrust)| {
        let share = mass.value * GRAVITY / (4.0 * thrust.value);
        Given::stated(share, "mass times gravity over the full thrust of all rotors")
    });
    Draft {
        name: read.name(),
        source: source.to_owned(),
        autopilot: read.autopilot,
        inertia: read.inertia(mass.as_ref(), arm),
        mass,
        layout,
        positions,
        spins,
        thrust_max,
        torque_ratio,
        rotor_radius,
        motor_lag: read.one(measured.motor_lag_s, "--motor-lag", "SIH_T_TAU").unwrap_or_else(
            || {
                let from = "not measured: small rotors lag by 0.02 to 0.08 s";
                Given::estimate(MOTOR_LAG_S, Tolerance::Seconds(MOTOR_LAG_SPREAD_S), from)
            },
        ),
        command_delay: Given::estimate(
            DELAY_S,
            Tolerance::Seconds(DELAY_SPREAD_S),
            "not measured: a network on one machine takes less, a radio more",
        ),
        hover_thrust,
        battery: read.battery(),
        cascade: None,
        cascade_lacks: Vec::new(),
        linear_drag: read.one(None, "", "SIH_KDV"),
        angular_damping: read.one(None, "", "SIH_KDW"),
        thrust_curve: read.thrust_curve(),
    }
}

/// The rotors' places.
struct Placed {
    /// Front, right and down of each, m; `None` where no source gives it.
    positions: Option<Given<[[f64; 3]; 4]>>,
    spins: Given<[i8; 4]>,
    /// The place of each, for people.
    order: [String; 4],
}

struct Read<'a> {
    parameters: &'a Parameters,
    measured: &'a Measured,
    autopilot: Option<Autopilot>,
    /// Whether the SIH_* parameters describe this vehicle.
    is_simulated: bool,
}

impl Read<'_> {
    /// The measurement, or else the parameter of a simulated vehicle.
    fn one(&self, measured: Option<f64>, flag: &str, simulated: &str) -> Option<Given<f64>> {
        let measured = measured.map(|value| Given::stated(value, format!("measured ({flag})")));
        measured.or_else(|| {
            let value = self.simulated(simulated)?;
            Some(Given::stated(value, simulated))
        })
    }

    fn simulated(&self, name: &str) -> Option<f64> {
        self.parameters.number(name).filter(|_| self.is_simulated)
    }

    fn name(&self) -> String {
        self.measured.name.clone().unwrap_or_else(|| {
            match (self.autopilot, self.is_simulated) {
                (Some(Autopilot::Px4), true) => "px4_sih_quadrotor",
                (Some(Autopilot::Px4), false) => "px4_quadrotor",
                (Some(Autopilot::ArduCopter), _) => "arducopter_quadrotor",
                (None, _) => "quadrotor",
            }
            .to_owned()
        })
    }

    fn rotors(&self) -> Placed {
        let (rotors, from) = match <[RotorFact; 4]>::try_from(self.parameters.rotors()) {
            Ok(rotors) => (rotors, self.rotor_source()),
            Err(_) => self.usual_rotors(),
        };
        let spins = Given::stated(rotors.map(|rotor| rotor.spin), from);
        let arm = |rotor: &RotorFact| rotor.front.hypot(rotor.right);
        let mean = rotors.iter().map(arm).sum::<f64>() / 4.0;
        let scaled = |front: f64, right: f64| {
            rotors.map(|rotor| [rotor.front * front, rotor.right * right, 0.0].map(tidy))
        };
        let simulated = || Some([self.simulated("SIH_L_PITCH")?, self.simulated("SIH_L_ROLL")?]);
        let positions = if let Some(length) = self.measured.arm_m {
            let scale = length / mean;
            Some(Given::stated(
                scaled(scale, scale),
                format!("measured (--arm or --wheelbase), {from}"),
            ))
        } else if let Some([pitch, roll]) = simulated() {
            let side = |place: f64, length: f64| if place < 0.0 { -length } else { length };
            let places =
                rotors.map(|rotor| [side(rotor.front, pitch), side(rotor.right, roll), 0.0]);
            Some(Given::stated(places, "SIH_L_PITCH and SIH_L_ROLL, signs of CA_ROTORn_PX and _PY"))
        } else if self.autopilot == Some(Autopilot::Px4) && ARMS.contains(&mean) {
            let from = format!(
                "{from}, as m: as accurate as whoever set them measured; --arm scales them"
            );
            Some(Given::stated(scaled(1.0, 1.0), from).within(0.1))
        } else {
            None
        };
        Placed { positions, spins, order: RotorFact::descriptions(&rotors) }
    }

    fn rotor_source(&self) -> &'static str {
        match self.autopilot {
            Some(Autopilot::ArduCopter) => "FRAME_CLASS and FRAME_TYPE",
            _ => "CA_ROTORn_PX, _PY and _KM",
        }
    }

    /// The order that PX4 and ArduPilot share, where no parameters give it.
    fn usual_rotors(&self) -> ([RotorFact; 4], &'static str) {
        let rotor = |front: f64, right: f64, spin: i8| RotorFact { front, right, spin };
        match self.measured.layout {
            Some(Layout::Plus) => (
                [
                    rotor(0.0, 1.0, 1),
                    rotor(0.0, -1.0, 1),
                    rotor(1.0, 0.0, -1),
                    rotor(-1.0, 0.0, -1),
                ],
                "ArduPilot's order of a plus: right, left, front, rear",
            ),
            _ => (
                [
                    rotor(1.0, 1.0, 1),
                    rotor(-1.0, -1.0, 1),
                    rotor(1.0, -1.0, -1),
                    rotor(-1.0, 1.0, -1),
                ],
                "PX4's and ArduPilot's order of an X: front right, rear left, front left, rear right",
            ),
        }
    }

    fn inertia(&self, mass: Option<&Given<f64>>, arm: Option<f64>) -> Option<Given<[f64; 3]>> {
        if let Some(inertia) = self.measured.inertia {
            return Some(Given::stated(inertia, "measured (--inertia)"));
        }
        let simulated = ["SIH_IXX", "SIH_IYY", "SIH_IZZ"].map(|name| self.simulated(name));
        if let [Some(x), Some(y), Some(z)] = simulated {
            return Some(Given::stated([x, y, z], "SIH_IXX, SIH_IYY and SIH_IZZ"));
        }
        let square = mass?.value * arm?.powi(2);
        Some(Given::estimate(
            INERTIA_SHARES.map(|share| share * square),
            Tolerance::Share(INERTIA_SPREAD),
            "not measured: 0.25, 0.25 and 0.45 of mass times arm squared, typical of quadrotors",
        ))
    }

    fn rotor_radius(&self, arm: Option<f64>) -> Option<Given<f64>> {
        if let Some(diameter) = self.measured.propeller_m {
            return Some(Given::stated(0.5 * diameter, "measured (--propeller)"));
        }
        let from = "not measured: 0.6 of the arm";
        Some(Given::estimate(RADIUS_SHARE * arm?, Tolerance::Share(RADIUS_SPREAD), from))
    }

    fn torque_ratio(&self, radius: Option<&Given<f64>>) -> Option<Given<f64>> {
        if let Some(ratio) = self.measured.torque_ratio_m {
            return Some(Given::stated(ratio, "measured (--torque-ratio)"));
        }
        if let (Some(torque), Some(thrust)) =
            (self.simulated("SIH_Q_MAX"), self.simulated("SIH_T_MAX"))
        {
            return Some(Given::stated(torque / thrust, "SIH_Q_MAX over SIH_T_MAX"));
        }
        // PX4's default magnitude says nothing about this vehicle.
        let stated = self.parameters.number("CA_ROTOR0_KM").map(f64::abs);
        if let Some(ratio) = stated.filter(|ratio| (ratio - PX4_TORQUE_RATIO).abs() > 1e-6) {
            return Some(Given::stated(ratio, "CA_ROTOR0_KM").within(0.2));
        }
        let from = "not measured: 0.07 of the propeller's diameter, typical of small ones";
        let ratio = TORQUE_RATIO * 2.0 * radius?.value;
        Some(Given::estimate(ratio, Tolerance::Share(TORQUE_SPREAD), from))
    }

    fn thrust_max(&self, mass: Option<&Given<f64>>) -> Option<Given<f64>> {
        let stated = self.one(self.measured.thrust_max_n, "--thrust", "SIH_T_MAX");
        if stated.is_some() {
            return stated;
        }
        let weight = mass?.value * GRAVITY;
        let (hover, from, usual) = match (self.measured.hover_throttle, self.autopilot) {
            (Some(hover), _) => (hover, "--hover-throttle", None),
            (None, Some(Autopilot::Px4)) => {
                (self.parameters.number("MPC_THR_HOVER")?, "MPC_THR_HOVER", Some(PX4_HOVER))
            }
            (None, Some(Autopilot::ArduCopter)) => {
                let hover = self.parameters.number("MOT_THST_HOVER")?;
                (hover, "MOT_THST_HOVER", Some(ARDUCOPTER_HOVER))
            }
            (None, None) => return None,
        };
        if !(0.02..=0.98).contains(&hover) {
            return None;
        }
        let thrust = weight / (4.0 * hover);
        let from = format!("the vehicle hovers at {} of full thrust ({from})", tidy(hover));
        // The autopilot's default says nothing about this vehicle.
        if usual.is_some_and(|usual| (usual - hover).abs() < 1e-6) {
            let from = format!("{from}: the autopilot's default, which may not be this vehicle's");
            return Some(Given::estimate(thrust, Tolerance::Share(0.3), from));
        }
        Some(Given::stated(thrust, from).within(0.1))
    }

    fn battery(&self) -> Given<BatteryParams> {
        let pack = |cells: u8, full_v: f64, from: String| {
            let nominal_v = (CELL_V[0] * f64::from(cells)).min(full_v);
            Given::stated(BatteryParams { cells, full_v: tidy(full_v), nominal_v }, from)
        };
        let full = |cells: u8| CELL_V[1] * f64::from(cells);
        if let Some(cells) = self.measured.cells {
            return pack(cells, full(cells), "measured (--cells)".to_owned());
        }
        let cell_count = |value: f64| (1.0..=50.0).contains(&value).then(|| value.round() as u8);
        if let Some(cells) = self.parameters.number("BAT1_N_CELLS").and_then(cell_count) {
            let charged = self.parameters.number("BAT1_V_CHARGED").filter(|v| *v > CELL_V[0]);
            let full_v = charged.map_or(full(cells), |volt| volt * f64::from(cells));
            return pack(cells, full_v, "BAT1_N_CELLS and BAT1_V_CHARGED".to_owned());
        }
        let most = self.parameters.number("MOT_BAT_VOLT_MAX").filter(|volt| *volt > 0.0);
        if let Some((volt, cells)) =
            most.and_then(|volt| Some((volt, cell_count((volt / CELL_V[1]).round())?)))
        {
            return pack(cells, volt, format!("MOT_BAT_VOLT_MAX of {} V", tidy(volt)));
        }
        let cells = 4;
        Given {
            is_estimate: true,
            ..pack(cells, full(cells), "unknown: assumed to be 4 cells".to_owned())
        }
    }

    fn thrust_curve(&self) -> Option<Given<f64>> {
        let name = match self.autopilot? {
            Autopilot::Px4 => "THR_MDL_FAC",
            Autopilot::ArduCopter => "MOT_THST_EXPO",
        };
        let share = self.parameters.number(name)?;
        let given = Given::stated(share, format!("{name}: the autopilot's compensation"));
        (share > 0.0 && share <= 1.0).then(|| given.within(0.2))
    }
}

/// Removes the digits that come from a 32-bit float and its arithmetic.
pub(super) fn tidy(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let digits = (5 - value.abs().log10().floor() as i32).clamp(0, 18);
    let scale = 10f64.powi(digits);
    let rounded = (value * scale).round() / scale;
    if rounded.abs() < 1e-12 { 0.0 } else { rounded }
}
