//! The rotors as configured in an autopilot's parameters.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Autopilot, Parameters};

/// A rotor's position and spin, as configured in the autopilot.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct RotorFact {
    /// Position towards the front, in the autopilot's unit: only its sign and its ratio to the
    /// others matter.
    pub front: f64,
    /// Position towards the right, in the same unit.
    pub right: f64,
    /// +1 if the rotor's drag torque on the body is about +z body (down), else -1.
    pub spin: i8,
}

impl RotorFact {
    /// Each rotor in words, such as `front right (spin +1)`.
    pub fn descriptions(rotors: &[Self; 4]) -> [String; 4] {
        // A position nearer to an axis than this share of the arm counts as on it.
        const ON_AXIS: f64 = 0.2;
        let arm = rotors.iter().map(|rotor| rotor.front.hypot(rotor.right)).fold(0.0, f64::max);
        rotors.map(|rotor| {
            let side = |place: f64, names: [&'static str; 2]| match place {
                place if place.abs() < ON_AXIS * arm => None,
                place => Some(names[usize::from(place < 0.0)]),
            };
            let place =
                [side(rotor.front, ["front", "rear"]), side(rotor.right, ["right", "left"])];
            let place: Vec<&str> = place.into_iter().flatten().collect();
            let turns = if rotor.spin > 0 { "+1" } else { "-1" };
            format!("{} (spin {turns})", place.join(" "))
        })
    }
}

/// Largest accepted CA_ROTOR_COUNT.
const ROTORS_MAX: f64 = 64.0;
/// Motors 1 to 4 of a quadrotor: angle clockwise from the front in degrees, and the direction in
/// which the rotor's drag turns the body.
type Quadrotor = [(f64, i8); 4];

pub(super) fn count(parameters: &Parameters) -> Option<u32> {
    match parameters.autopilot()? {
        Autopilot::Px4 => {
            let count = parameters.number("CA_ROTOR_COUNT")?;
            (1.0..=ROTORS_MAX).contains(&count).then_some(count as u32)
        }
        Autopilot::ArduCopter => match parameters.number("FRAME_CLASS")? as u32 {
            1 => Some(4),
            2 | 5 => Some(6),
            3 | 4 => Some(8),
            7 => Some(3),
            _ => None,
        },
    }
}

pub(super) fn of(parameters: &Parameters) -> Vec<RotorFact> {
    match parameters.autopilot() {
        Some(Autopilot::Px4) => px4(parameters),
        Some(Autopilot::ArduCopter) => arducopter(parameters),
        None => Vec::new(),
    }
}

/// Rotors from PX4's CA_ROTORn_*.
fn px4(parameters: &Parameters) -> Vec<RotorFact> {
    let rotor = |at: u32| {
        let number = |axis: &str| parameters.number(&format!("CA_ROTOR{at}_{axis}"));
        // A rotor with a positive coefficient spins anticlockwise, seen from above, and turns the
        // body clockwise, about +z.
        let spin = if number("KM")? >= 0.0 { 1 } else { -1 };
        Some(RotorFact { front: number("PX")?, right: number("PY")?, spin })
    };
    let rotors: Option<Vec<RotorFact>> = (0..count(parameters).unwrap_or(0)).map(rotor).collect();
    rotors.unwrap_or_default()
}

/// Rotors from FRAME_CLASS and FRAME_TYPE, according to ArduPilot's motor order diagrams. Only
/// quadrotors whose rotors all push up are supported.
fn arducopter(parameters: &Parameters) -> Vec<RotorFact> {
    const QUADROTOR: f64 = 1.0;
    if parameters.number("FRAME_CLASS") != Some(QUADROTOR) {
        return Vec::new();
    }
    // A rotor that spins anticlockwise turns the body clockwise.
    let motors: Quadrotor = match parameters.number("FRAME_TYPE").map(|kind| kind as u32) {
        // Plus.
        Some(0) => [(90.0, 1), (-90.0, 1), (0.0, -1), (180.0, -1)],
        // X, and V, whose arms differ in yaw only.
        Some(1 | 2) => [(45.0, 1), (-135.0, 1), (-45.0, -1), (135.0, -1)],
        // H: as X, with every spin reversed.
        Some(3) => [(45.0, -1), (-135.0, -1), (-45.0, 1), (135.0, 1)],
        // Plus, with every spin reversed.
        Some(6) => [(90.0, -1), (-90.0, -1), (0.0, 1), (180.0, 1)],
        // X in Betaflight's order.
        Some(12) => [(135.0, -1), (45.0, 1), (-135.0, 1), (-45.0, -1)],
        // X in DJI's order.
        Some(13) => [(45.0, 1), (-45.0, -1), (-135.0, 1), (135.0, -1)],
        // X, clockwise.
        Some(14) => [(45.0, 1), (135.0, -1), (-135.0, 1), (-45.0, -1)],
        // X in Betaflight's order, with every spin reversed.
        Some(18) => [(135.0, 1), (45.0, -1), (-135.0, -1), (-45.0, 1)],
        _ => return Vec::new(),
    };
    let place = |(degrees, spin): (f64, i8)| {
        let (right, front) = degrees.to_radians().sin_cos();
        RotorFact { front, right, spin }
    };
    motors.into_iter().map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{COPTER, SIH, parameters};

    fn places(text: &str) -> Vec<(i8, i8, i8)> {
        let side = |place: f64| (place * 10.0).round().clamp(-1.0, 1.0) as i8;
        let rotors = parameters(text).rotors();
        rotors.iter().map(|r| (side(r.front), side(r.right), r.spin)).collect()
    }

    #[test]
    fn px4_parameters_give_rotor_positions() {
        assert_eq!(places(SIH), [(1, 1, 1), (-1, -1, 1), (1, -1, -1), (-1, 1, -1)]);
        assert_eq!(parameters(SIH).motor_count(), Some(4));
    }

    #[test]
    fn arducopter_frame_gives_rotor_positions() {
        assert_eq!(places(COPTER), [(0, 1, 1), (0, -1, 1), (1, 0, -1), (-1, 0, -1)]);
        let x = COPTER.replace("FRAME_TYPE,0", "FRAME_TYPE,1");
        assert_eq!(places(&x), [(1, 1, 1), (-1, -1, 1), (1, -1, -1), (-1, 1, -1)]);
        let betaflight = COPTER.replace("FRAME_TYPE,0", "FRAME_TYPE,12");
        assert_eq!(places(&betaflight), [(-1, 1, -1), (1, 1, 1), (-1, -1, 1), (1, -1, -1)]);
        assert_eq!(places(&COPTER.replace("FRAME_CLASS,1", "FRAME_CLASS,2")), []);
    }
}
