//! What ArduPilot's log states about the vehicle.

use message::parameters::{Parameters, is_of_vehicle};

use crate::import::dataflash::Contents;
use crate::import::facts::{Texts, VehicleFacts};
use crate::import::functions;
use crate::import::kind::{self, StatedKind};
use crate::import::statements::Statements;

/// The first text with `start`, from there on.
fn text_from(texts: &Texts, start: &str) -> Option<String> {
    texts.iter().find_map(|text| Some(text.get(text.find(start)?..)?.to_owned()))
}

/// The frame, as the autopilot names it.
fn frame(stated: &Statements) -> Option<String> {
    const START: &str = "Frame: ";
    text_from(&stated.texts, START)?.strip_prefix(START).map(str::to_owned)
}

/// Every kind of vehicle that a boot states.
pub(in crate::import) fn kinds(stated: &Statements) -> Vec<StatedKind> {
    let of_text = stated.texts.iter().find_map(|text| {
        let name = text.split_once(" s: ").map_or(text.as_str(), |(_, text)| text);
        StatedKind::new(kind::of_firmware(text), || format!("the firmware is {name}"))
    });
    let of_frame = frame(stated).and_then(|name| {
        let kind = kind::of_frame(&name).map(|(kind, _)| kind);
        StatedKind::new(kind, || format!("the frame is {name}"))
    });
    let of_build = stated.most_frequent_type().and_then(|build| {
        StatedKind::new(kind::of_build(build), || format!("BU of VER is {build}"))
    });
    let of_parameters = kind::of_parameters(&stated.parameters);
    of_text.into_iter().chain(of_frame).chain(of_build).chain(of_parameters).collect()
}

impl Contents {
    /// The facts that the chosen boot states.
    pub(super) fn facts(&self) -> VehicleFacts {
        let Statements { parameters, texts, .. } = &self.stated;
        let firmwares = [
            "ArduCopter",
            "APM:Copter",
            "ArduPlane",
            "APM:Plane",
            "ArduRover",
            "APM:Rover",
            "APMrover2",
            "ArduSub",
            "Blimp",
        ];
        let frame = frame(&self.stated);
        let of_frame = frame.as_deref().and_then(kind::of_frame);
        let stated = Parameters::from(parameters.clone());
        let motors = stated.motor_count().or(of_frame.and_then(|(_, motors)| motors));
        let of_vehicle = parameters.iter().filter(|(name, _)| is_of_vehicle(name));
        VehicleFacts {
            autopilot: firmwares.iter().find_map(|name| text_from(texts, name)),
            frame,
            kinds: kinds(&self.stated),
            motors: motors.or_else(|| functions::more_motors(parameters)),
            rotors: stated.rotors(),
            parameters: of_vehicle.map(|(name, value)| (name.clone(), *value)).collect(),
            ..VehicleFacts::default()
        }
    }
}
