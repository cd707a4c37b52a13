//! The kind of vehicle that a log states.

use std::collections::BTreeMap;
use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A kind of vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VehicleKind {
    /// Fixed rotors with fixed pitch.
    Multirotor,
    /// A helicopter.
    Helicopter,
    /// An aeroplane.
    FixedWing,
    /// An aeroplane that can hover.
    Vtol,
    /// A vehicle on the ground.
    Rover,
    /// A boat.
    Boat,
    /// A submarine.
    Submarine,
    /// An airship or a balloon.
    Airship,
    /// Something else that is not a multirotor.
    Other,
}

impl VehicleKind {
    /// By MAV_TYPE of a HEARTBEAT; `None` for the generic type and for what is no vehicle.
    pub fn of_mav_type(mav_type: u8) -> Option<Self> {
        of_mav_type(f64::from(mav_type))
    }
}

impl fmt::Display for VehicleKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Multirotor => "a multirotor",
            Self::Helicopter => "a helicopter",
            Self::FixedWing => "an aeroplane",
            Self::Vtol => "a VTOL",
            Self::Rover => "a rover",
            Self::Boat => "a boat",
            Self::Submarine => "a submarine",
            Self::Airship => "an airship",
            Self::Other => "not a multirotor",
        })
    }
}

/// A kind of vehicle and its source in the log.
#[derive(Clone, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct StatedKind {
    /// Kind of vehicle.
    pub kind: VehicleKind,
    /// Source of the statement, such as `MAV_TYPE is 2`.
    pub by: String,
}

impl StatedKind {
    pub(super) fn new(kind: Option<VehicleKind>, by: impl FnOnce() -> String) -> Option<Self> {
        kind.map(|kind| Self { kind, by: by() })
    }

    /// The first of PX4's or ArduPilot's parameters that state another kind than a multirotor.
    pub fn otherwise(parameters: &BTreeMap<String, f64>) -> Option<Self> {
        let mut stated = of_parameters(parameters).into_iter();
        stated.find(|stated| stated.kind != VehicleKind::Multirotor)
    }
}

/// Kind from MAV_TYPE; `None` for the generic type and for types that are not vehicles.
pub(super) fn of_mav_type(number: f64) -> Option<VehicleKind> {
    use VehicleKind as K;
    Some(match number as u8 {
        _ if number.fract() != 0.0 || !(0.0..256.0).contains(&number) => return None,
        2 | 13..=15 | 29 | 35 | 43 => K::Multirotor,
        3 | 4 => K::Helicopter,
        1 | 16 | 17 | 28 => K::FixedWing,
        19..=25 => K::Vtol,
        10 => K::Rover,
        11 => K::Boat,
        12 => K::Submarine,
        7 | 8 => K::Airship,
        9 | 46 => K::Other,
        _ => return None,
    })
}

/// Number of motors of a multirotor from MAV_TYPE.
pub(super) fn motors_of_mav_type(number: f64) -> Option<u32> {
    [(2.0, 4), (13.0, 6), (14.0, 8), (15.0, 3), (29.0, 12), (35.0, 10)]
        .into_iter()
        .find_map(|(known, motors)| (known == number).then_some(motors))
}

/// Kind from an ArduPilot firmware's name and version, such as `ArduPlane V4.5.7`.
pub(super) fn of_firmware(text: &str) -> Option<VehicleKind> {
    use VehicleKind as K;
    let kinds = [
        ("copter", K::Multirotor),
        ("heli", K::Helicopter),
        ("plane", K::FixedWing),
        ("rover", K::Rover),
        ("rover2", K::Rover),
        ("sub", K::Submarine),
        ("blimp", K::Airship),
        ("tracker", K::Other),
    ];
    let text = text.to_ascii_lowercase();
    let is_followed = |rest: &str| rest.starts_with(|c: char| c.is_ascii_digit());
    let is = |name: &str| {
        let mut after = text.match_indices(name).map(|(at, name)| &text[at + name.len()..]);
        after.any(|rest| rest.strip_prefix(" v").is_some_and(is_followed))
    };
    kinds.into_iter().find_map(|(name, kind)| is(name).then_some(kind))
}

/// By the frame that ArduCopter names, as `HEXA/X`: its kind, and the motors of a multirotor.
pub(super) fn of_frame(name: &str) -> Option<(VehicleKind, Option<u32>)> {
    use VehicleKind as K;
    let class = name.split(['/', ' ']).next().unwrap_or_default().to_ascii_uppercase();
    Some(match class.as_str() {
        "TRI" => (K::Multirotor, Some(3)),
        "QUAD" => (K::Multirotor, Some(4)),
        "HEXA" | "Y6" => (K::Multirotor, Some(6)),
        "OCTA" | "OCTAQUAD" | "OCTA_QUAD" => (K::Multirotor, Some(8)),
        "DECA" => (K::Multirotor, Some(10)),
        "DODECAHEXA" => (K::Multirotor, Some(12)),
        "HELI" | "HELI_DUAL" | "HELI_QUAD" => (K::Helicopter, None),
        "SINGLE" | "COAX" | "TAILSITTER" => (K::Other, None),
        _ => return None,
    })
}

/// Kind from the build number in ArduPilot's message VER.
pub(super) fn of_build(number: f64) -> Option<VehicleKind> {
    use VehicleKind as K;
    let kinds = [
        (1.0, K::Rover),
        (2.0, K::Multirotor),
        (3.0, K::FixedWing),
        (4.0, K::Other),
        (7.0, K::Submarine),
        (12.0, K::Airship),
        (13.0, K::Helicopter),
    ];
    kinds.into_iter().find_map(|(known, kind)| (known == number).then_some(kind))
}

/// Kind from PX4's airframe number (SYS_AUTOSTART), in ranges that belong to one kind.
fn of_airframe(number: f64) -> Option<VehicleKind> {
    use VehicleKind as K;
    Some(match number as u32 {
        2100..=3999 => K::FixedWing,
        4000..=9999 | 11000..=12999 => K::Multirotor,
        13000..=13999 => K::Vtol,
        15000..=16999 => K::Helicopter,
        17000..=17999 => K::FixedWing,
        18000..=18999 => K::Airship,
        50000..=59999 => K::Rover,
        60000..=69999 => K::Submarine,
        _ => return None,
    })
}

/// Kind from PX4's airframe class (CA_AIRFRAME).
fn of_airframe_class(class: f64) -> Option<VehicleKind> {
    use VehicleKind as K;
    Some(match class as u32 {
        0 => K::Multirotor,
        1 => K::FixedWing,
        2..=4 => K::Vtol,
        5 | 6 | 13 => K::Rover,
        10..=12 => K::Helicopter,
        9 => return None,
        _ => K::Other,
    })
}

/// Kind from ArduCopter's frame class (FRAME_CLASS); other builds use a different parameter.
fn of_frame_class(class: f64) -> Option<VehicleKind> {
    use VehicleKind as K;
    Some(match class as u32 {
        1..=5 | 7 | 12 | 14 => K::Multirotor,
        6 | 11 | 13 => K::Helicopter,
        8..=10 | 16 => K::Other,
        _ => return None,
    })
}

/// Kind from ArduPilot's output functions (SERVOn_FUNCTION).
fn of_functions(parameters: &BTreeMap<String, f64>) -> Option<StatedKind> {
    use VehicleKind as K;
    let functions: Vec<(&str, u32)> = parameters
        .iter()
        .filter(|(name, _)| name.starts_with("SERVO") && name.ends_with("_FUNCTION"))
        .map(|(name, value)| (name.as_str(), *value as u32))
        .collect();
    let first = |codes: &[u32]| functions.iter().find(|(_, f)| codes.contains(f)).copied();
    // Ailerons, elevators, flaperons, elevons, V-tails.
    let wing = first(&[4, 19, 24, 25, 77, 78, 79, 80]);
    let motor = first(&[33, 34, 35, 36]);
    let by = |(name, function): (&str, u32)| format!("{name} is {function}");
    let stated = |kind: VehicleKind, by: String| Some(StatedKind { kind, by });
    match (wing, motor) {
        (Some(wing), Some(motor)) => stated(K::Vtol, format!("{} and {}", by(wing), by(motor))),
        (Some(wing), None) => stated(K::FixedWing, by(wing)),
        (None, Some(motor)) => stated(K::Multirotor, by(motor)),
        // Steering on the ground, throttles left and right, the collective of a helicopter.
        (None, None) => match (first(&[26, 73, 74]), first(&[31, 32]), first(&[70])) {
            (Some(wheels), ..) => stated(K::Rover, by(wheels)),
            (None, Some(rotor), _) => stated(K::Helicopter, by(rotor)),
            (None, None, Some(throttle)) => stated(K::Other, by(throttle)),
            (None, None, None) => None,
        },
    }
}

/// Every kind that parameters of PX4 or ArduPilot state.
pub(super) fn of_parameters(parameters: &BTreeMap<String, f64>) -> Vec<StatedKind> {
    type Rule = (&'static str, fn(f64) -> Option<VehicleKind>);
    let rules: [Rule; 9] = [
        ("CA_AIRFRAME", of_airframe_class),
        ("MAV_TYPE", of_mav_type),
        ("SYS_AUTOSTART", of_airframe),
        ("FRAME_CLASS", of_frame_class),
        ("Q_ENABLE", |on| (on >= 1.0).then_some(VehicleKind::Vtol)),
        // Only these builds of ArduPilot have them.
        ("TECS_CLMB_MAX", |_| Some(VehicleKind::FixedWing)),
        ("ARSPD_FBW_MIN", |_| Some(VehicleKind::FixedWing)),
        ("CRUISE_SPEED", |_| Some(VehicleKind::Rover)),
        ("SURFACE_DEPTH", |_| Some(VehicleKind::Submarine)),
    ];
    let stated = rules.into_iter().filter_map(|(name, rule)| {
        let value = *parameters.get(name)?;
        StatedKind::new(rule(value), || format!("{name} is {value}"))
    });
    stated.chain(of_functions(parameters)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kinds(parameters: &[(&str, f64)]) -> Vec<VehicleKind> {
        let parameters = parameters.iter().map(|(name, value)| ((*name).to_owned(), *value));
        of_parameters(&parameters.collect()).into_iter().map(|stated| stated.kind).collect()
    }

    #[test]
    fn firmware_text_gives_the_vehicle_kind() {
        use VehicleKind as K;
        for (text, kind) in [
            ("ArduCopter V4.5.7 (2a3dc4b7)", Some(K::Multirotor)),
            ("APM:Copter V3.3.3 (acf1b2a6)", Some(K::Multirotor)),
            ("APM:Plane V3.5.2", Some(K::FixedWing)),
            ("ArduRover V4.2.0", Some(K::Rover)),
            ("ArduSub V4.1.0", Some(K::Submarine)),
            ("ArduRover v2.50", Some(K::Rover)),
            ("APMrover2 V3.0.0", Some(K::Rover)),
            ("Subsystem Version", None),
            ("EKF3 IMU0 Plane Vector", None),
        ] {
            assert_eq!(of_firmware(text), kind, "{text}");
        }
    }

    #[test]
    fn frame_name_gives_vehicle_kind_and_motor_count() {
        use VehicleKind as K;
        for (name, found) in [
            ("QUAD/X", Some((K::Multirotor, Some(4)))),
            ("HEXA", Some((K::Multirotor, Some(6)))),
            ("OCTA_QUAD", Some((K::Multirotor, Some(8)))),
            ("HELI", Some((K::Helicopter, None))),
            ("UNSUPPORTED", None),
        ] {
            assert_eq!(of_frame(name), found, "{name}");
        }
    }

    #[test]
    fn parameters_give_the_vehicle_kind() {
        use VehicleKind as K;
        let surfaces = [("SERVO1_FUNCTION", 4.0), ("SERVO3_FUNCTION", 70.0)];
        assert_eq!(kinds(&surfaces), [K::FixedWing]);
        let tilting = [("SERVO1_FUNCTION", 77.0), ("SERVO5_FUNCTION", 33.0), ("Q_ENABLE", 1.0)];
        assert_eq!(kinds(&tilting), [K::Vtol, K::Vtol]);
        assert_eq!(kinds(&[("SERVO1_FUNCTION", 26.0), ("SERVO3_FUNCTION", 70.0)]), [K::Rover]);
        assert_eq!(kinds(&[("FRAME_CLASS", 6.0)]), [K::Helicopter]);
        assert_eq!(kinds(&[("CA_AIRFRAME", 0.0), ("MAV_TYPE", 2.0)]), [K::Multirotor; 2]);
        assert_eq!(kinds(&[("CA_AIRFRAME", 2.0), ("MAV_TYPE", 22.0)]), [K::Vtol; 2]);
        assert_eq!(kinds(&[("SYS_AUTOSTART", 50000.0), ("MAV_TYPE", 0.0)]), [K::Rover]);
        assert_eq!(kinds(&[("SURFACE_DEPTH", -10.0)]), [K::Submarine]);
        assert_eq!(kinds(&[("THR_MDL_FAC", 0.3)]), []);
    }

    #[test]
    fn mav_type_gives_vehicle_kind_and_motor_count() {
        assert_eq!(of_mav_type(1.0), Some(VehicleKind::FixedWing));
        assert_eq!(of_mav_type(13.0), Some(VehicleKind::Multirotor));
        assert_eq!((of_mav_type(0.0), of_mav_type(6.0), of_mav_type(2.5)), (None, None, None));
        assert_eq!(motors_of_mav_type(13.0), Some(6));
    }
}
