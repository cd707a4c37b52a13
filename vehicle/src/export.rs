//! Exports vehicles to other simulators: writes a vehicle file and its modelled effects in their
//! formats.
//!
//! Each simulator has its own equations. [`Export::lost`] lists everything in a vehicle that they
//! cannot express. Body axes are front, left, up where the other simulator uses them: y and z
//! change sign, and so does a rotor's drag torque.

mod casadi;
mod drone_models;
mod mujoco;
mod px4_sih;
mod rotorpy;

use std::fmt::Write as _;

use crate::effects::{Effect, EffectId, EffectSet, Place, RotorDrag, ThrustCurve};
use crate::frame::Ned;
use crate::params::{VehicleError, VehicleParams};
use crate::physics::{Constants, Physics};

/// Rotor speed at full output if the vehicle file has none, rad/s. Thrusts and moments do not
/// depend on it.
const ASSUMED_SPEED: f64 = 2000.0;

/// A simulator to which vehicles can be exported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Peer {
    /// RotorPy's parameters: a Python module.
    RotorPy,
    /// `drone-models` (and `crazyflow`): a drone's TOML.
    DroneModels,
    /// PX4's simulation in hardware, SIH: a parameter file.
    Px4Sih,
    /// MuJoCo: an XML model.
    MuJoCo,
    /// CasADi: a Python module that builds the equations of motion.
    CasAdi,
}

impl Peer {
    /// Every supported simulator.
    pub const ALL: [Self; 5] =
        [Self::RotorPy, Self::DroneModels, Self::Px4Sih, Self::MuJoCo, Self::CasAdi];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::RotorPy => "rotorpy",
            Self::DroneModels => "drone-models",
            Self::Px4Sih => "px4-sih",
            Self::MuJoCo => "mujoco",
            Self::CasAdi => "casadi",
        }
    }
}

/// A vehicle in another simulator's format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Export {
    /// Content of the file.
    pub text: String,
    /// The parts of the vehicle that the other simulator cannot express, one phrase each.
    pub lost: Vec<String>,
}

/// Writes `vehicle` for `peer`.
///
/// # Errors
/// The vehicle's mixer cannot be inverted, or the file lacks a number that an effect needs.
pub fn export(vehicle: &VehicleParams, peer: Peer) -> Result<Export, VehicleError> {
    let physics = Physics::new(vehicle, &EffectSet::new())?;
    let mut model = Model {
        vehicle,
        constants: *physics.constants(),
        wind: physics.wind(),
        speed_max: vehicle
            .rotor_max_rpm
            .map_or(ASSUMED_SPEED, |rpm| rpm * std::f64::consts::TAU / 60.0),
        lost: Vec::new(),
    };
    let text = match peer {
        Peer::RotorPy => rotorpy::text(&mut model),
        Peer::DroneModels => drone_models::text(&mut model),
        Peer::Px4Sih => px4_sih::text(&mut model),
        Peer::MuJoCo => mujoco::text(&mut model),
        Peer::CasAdi => casadi::text(&mut model),
    };
    Ok(Export { text, lost: model.lost })
}

/// A vehicle with the effects that change its constants applied.
struct Model<'a> {
    vehicle: &'a VehicleParams,
    constants: Constants,
    wind: Ned,
    /// Rotor speed at full output, rad/s.
    speed_max: f64,
    lost: Vec<String>,
}

impl Model<'_> {
    /// An effect that the vehicle models, if present.
    fn effect<E: Effect>(&self) -> Option<E> {
        self.vehicle.modelled_effects.get()
    }

    /// Linear drag on the air-relative velocity, N per m/s along front, right and down, at the
    /// hover rotor speed; and whether it is proportional to the rotor speed.
    fn linear_drag(&self) -> Option<([f64; 3], bool)> {
        if let Some(drag) = self.vehicle.linear_drag_n_per_m_s {
            return Some(([drag; 3], false));
        }
        self.effect().map(|RotorDrag { d_xy, d_z }| ([d_xy, d_xy, d_z], true))
    }

    /// The a of the thrust curve: a rotor at output u gives the share (1 - a) u + a u^2 of its
    /// largest thrust.
    fn thrust_curve(&self) -> f64 {
        self.effect().map_or(0.0, |ThrustCurve { a }| a)
    }

    /// Rotor speed at hover as a fraction of full speed.
    fn hover_speed(&self) -> f64 {
        self.vehicle.hover_thrust.sqrt()
    }

    /// The rotors' mean thrust at full output, N, and mean drag torque per thrust, m.
    fn mean_rotor(&self) -> (f64, f64) {
        let rotors = &self.constants.rotors;
        let mean = |of: &dyn Fn(usize) -> f64| {
            (0..rotors.len()).map(of).sum::<f64>() / rotors.len() as f64
        };
        (mean(&|i| rotors[i].thrust_max), mean(&|i| rotors[i].torque_per_thrust.abs()))
    }

    fn lose(&mut self, what: impl Into<String>) {
        self.lost.push(what.into());
    }

    /// Lists as lost the effects that are not in `expressed`, and all laws, which no peer supports.
    fn lose_but(&mut self, expressed: &[EffectId]) {
        let given = |id: &EffectId| id.place() == Place::Constant || expressed.contains(id);
        let effects = self.vehicle.modelled_effects.iter().map(|(id, _)| id);
        let lost: Vec<EffectId> = effects.filter(|id| !given(id)).collect();
        for id in lost {
            self.lose(format!("the effect {}", id.name()));
        }
        for law in self.vehicle.modelled_effects.laws() {
            self.lose(format!("the law {}", law.name()));
        }
    }

    /// Notes the loss where one thrust and one torque represent all rotors.
    fn lose_unlike_rotors(&mut self) {
        let (thrust, torque) = self.mean_rotor();
        let is_off = |value: f64, mean: f64| (value - mean).abs() > 1e-9 * mean;
        let rotors = &self.constants.rotors;
        if rotors.iter().any(|r| is_off(r.thrust_max, thrust)) {
            let each = self.constants.rotors.map(|rotor| rotor.thrust_max);
            self.lose(format!(
                "rotors of different thrust, {each:?} N: each has the mean, {thrust} N"
            ));
        }
        let rotors = &self.constants.rotors;
        if rotors.iter().any(|r| is_off(r.torque_per_thrust.abs(), torque)) {
            self.lose(format!("rotors of different drag torque: each has the mean, {torque} m"));
        }
    }

    fn lose_assumed_speed(&mut self) {
        if self.vehicle.rotor_max_rpm.is_none() {
            self.lose(format!(
                "the rotors' speed, which the vehicle file does not state (rotor_max_rpm): \
                 {ASSUMED_SPEED} rad/s is assumed at full output"
            ));
        }
    }

    fn lose_gravity(&mut self, theirs: f64) {
        let gravity = self.vehicle.gravity;
        if (gravity - theirs).abs() > 1e-9 {
            self.lose(format!("gravity of {gravity} m/s^2: theirs is {theirs}"));
        }
    }

    /// The header of a file: the vehicle's name and the losses, as comments that start with `mark`.
    fn head(&self, mark: &str) -> String {
        let mut head =
            format!("{mark} {}, by `downwash vehicle export`.\n", one_line(self.vehicle));
        for lost in &self.lost {
            let _ = writeln!(head, "{mark} Not expressed: {lost}.");
        }
        head
    }
}

/// The vehicle's name with unsafe characters replaced, for a comment or a quoted string.
fn one_line(vehicle: &VehicleParams) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || " _-.".contains(c);
    vehicle.name.chars().map(|c| if plain(c) { c } else { '_' }).collect()
}

/// Formats a number so that every reader parses it as a float.
fn real(value: f64) -> String {
    format!("{value:e}")
}

/// Formats numbers separated by commas.
fn reals(values: &[f64]) -> String {
    values.iter().map(|value| real(*value)).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::tests::quad;

    fn with(effects: &[&str]) -> VehicleParams {
        let mut vehicle = quad();
        for effect in effects {
            vehicle.modelled_effects.insert_argument(effect).unwrap();
        }
        vehicle
    }

    #[test]
    fn inexpressible_effects_are_named_in_the_export() {
        let vehicle = with(&["battery_sag:exponent=1", "rotor_drag:d_xy=0.2,d_z=0.1"]);
        for peer in Peer::ALL {
            let Export { text, lost } = export(&vehicle, peer).unwrap();
            let says_sag = lost.iter().any(|lost| lost.contains("battery_sag"));
            assert_eq!(says_sag, peer != Peer::CasAdi, "{peer:?}: {lost:?}");
            assert_eq!(text.matches("Not expressed").count(), lost.len(), "{peer:?}");
        }
    }

    #[test]
    fn effects_on_constants_change_the_exported_numbers() {
        let vehicle = with(&["mass:mass_kg=2.5", "inertia:scale=[2,1,1]"]);
        for peer in Peer::ALL {
            let Export { text, .. } = export(&vehicle, peer).unwrap();
            assert!(text.contains("2.5"), "{peer:?}: {text}");
            assert!(text.contains(&real(2.0 * quad().inertia[0])), "{peer:?}: {text}");
        }
    }

    #[test]
    fn exported_names_cannot_escape_comments() {
        let mut vehicle = quad();
        vehicle.name = "a---b\"]\nimport os --> <x/>".to_owned();
        for peer in Peer::ALL {
            let Export { text, .. } = export(&vehicle, peer).unwrap();
            let breaks = ["\nimport os", "a\"]", "<x/>"].iter().any(|part| text.contains(part));
            assert!(!breaks, "{peer:?}: {text}");
        }
        let Export { text, .. } = export(&vehicle, Peer::MuJoCo).unwrap();
        let comment = text.trim_start_matches("<!--").split("-->").next().unwrap();
        assert!(!comment.contains("--"), "{comment}");
    }

    #[test]
    fn exports_state_the_thrust_curve() {
        let vehicle = with(&["thrust_curve:a=0.375"]);
        for peer in [Peer::RotorPy, Peer::DroneModels, Peer::MuJoCo] {
            let Export { text, .. } = export(&vehicle, peer).unwrap();
            assert!(text.contains(&format!("with a = {}", real(0.375))), "{peer:?}: {text}");
        }
    }
}
