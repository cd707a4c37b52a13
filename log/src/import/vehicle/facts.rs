//! Facts about a vehicle from its messages.

use std::collections::BTreeMap;

use message::parameters::Parameters;

use super::{ARDUPILOT, PX4, VehicleLog};
use crate::import::facts::VehicleFacts;
use crate::import::functions;
use crate::import::kind::{self, StatedKind};

impl VehicleLog {
    /// Collects the facts; takes the texts out of the log.
    pub(super) fn facts(&mut self, parameters: &BTreeMap<String, f64>) -> VehicleFacts {
        let most = self.types.iter().max_by_key(|(_, count)| **count).map(|(t, _)| f64::from(*t));
        let of_type = most.and_then(|number| {
            StatedKind::new(kind::of_mav_type(number), || {
                format!("MAV_TYPE of its HEARTBEAT is {number}")
            })
        });
        let firmware = self.texts.iter().find(|text| kind::of_firmware(text).is_some()).cloned();
        let of_text = firmware.as_ref().and_then(|text| {
            StatedKind::new(kind::of_firmware(text), || format!("the firmware is {text}"))
        });
        let of_parameters = kind::of_parameters(parameters);
        let name = match self.autopilot {
            Some(PX4) => Some("PX4".to_owned()),
            Some(ARDUPILOT) => Some("ArduPilot".to_owned()),
            _ => None,
        };
        let stated = Parameters::from(parameters.clone());
        let motors = stated.motor_count().or(most.and_then(kind::motors_of_mav_type));
        let mut facts = VehicleFacts {
            autopilot: firmware.or(name),
            kinds: of_type.into_iter().chain(of_text).chain(of_parameters).collect(),
            rotors: stated.rotors(),
            motors: motors.or_else(|| functions::more_motors(parameters)),
            parameters: parameters.clone(),
            ..VehicleFacts::default()
        };
        std::mem::take(&mut self.texts).give(&mut facts);
        facts
    }
}
