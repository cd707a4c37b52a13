//! Facts about a vehicle from its messages.

use message::parameters::Parameters;

use super::{ARDUPILOT, PX4, VehicleLog};
use crate::import::facts::VehicleFacts;
use crate::import::functions;
use crate::import::kind::{self, StatedKind};
use crate::import::statements::{Statement, Statements};

/// The first text with a firmware's name.
fn firmware(stated: &Statements) -> Option<&String> {
    stated.texts.iter().find(|text| kind::of_firmware(text).is_some())
}

/// Every kind of vehicle that a boot states.
fn kinds(stated: &Statements) -> Vec<StatedKind> {
    let of_type = stated.most_frequent_type().and_then(|number| {
        StatedKind::new(kind::of_mav_type(number), || {
            format!("MAV_TYPE of its HEARTBEAT is {number}")
        })
    });
    let of_text = firmware(stated).and_then(|text| {
        StatedKind::new(kind::of_firmware(text), || format!("the firmware is {text}"))
    });
    let of_parameters = kind::of_parameters(&stated.parameters);
    of_type.into_iter().chain(of_text).chain(of_parameters).collect()
}

impl VehicleLog {
    /// What the boot of an epoch states, completed from the others.
    pub(super) fn stated(&self, chosen: usize) -> Statements {
        let mut boots = vec![Statements::default(); self.epochs.len().max(1)];
        let parameter = |(index, name, value): (u32, &str, f64)| {
            (index, Statement::Parameter(name.to_owned(), value))
        };
        let parameters = self.heard_parameters().map(parameter);
        for (index, statement) in self.statements.iter().cloned().chain(parameters) {
            if let Some(boot) = boots.get_mut(self.epoch_at(index).unwrap_or(0)) {
                boot.add(statement);
            }
        }
        Statements::of_boot(&boots, chosen, kinds)
    }

    /// The facts that a boot states.
    pub(super) fn facts(&self, stated: Statements) -> VehicleFacts {
        let name = match self.autopilot {
            Some(PX4) => Some("PX4".to_owned()),
            Some(ARDUPILOT) => Some("ArduPilot".to_owned()),
            _ => None,
        };
        let kinds = kinds(&stated);
        let autopilot = firmware(&stated).cloned().or(name);
        let of_type = stated.most_frequent_type().and_then(kind::motors_of_mav_type);
        let Statements { parameters, texts, .. } = stated;
        let stated = Parameters::from(parameters.clone());
        let motors = stated.motor_count().or(of_type);
        let mut facts = VehicleFacts {
            autopilot,
            kinds,
            rotors: stated.rotors(),
            motors: motors.or_else(|| functions::more_motors(&parameters)),
            parameters,
            ..VehicleFacts::default()
        };
        texts.give(&mut facts);
        facts
    }
}

#[cfg(test)]
mod tests {
    use wire::dialect::*;
    use wire::{Encoder, Frame};

    use super::*;
    use crate::import::clocks::FrameTime;
    use crate::import::flight::Flight;
    use crate::import::kind::VehicleKind;

    /// A log with two boots: the MAV_TYPE of each, how long it flies, s, and whether it sends its
    /// parameter. Each boot first sends what it states, and its first stamp 5 s later.
    fn flight(boots: [(MavType, u32, bool); 2]) -> Flight {
        let (mut log, mut encoder) = (VehicleLog::default(), Encoder::new(1, 1));
        let (mut index, mut ground) = (0, 0.0);
        let mut send = |ground: f64, message: MavMessage| {
            let mut bytes = Vec::new();
            encoder.encode(&message, &mut bytes);
            index += 1;
            log.add(FrameTime { index, ground }, &Frame::parse(&bytes).expect("a frame"));
        };
        for (mavtype, seconds, has_parameter) in boots {
            let heartbeat = |armed: bool| {
                let autopilot = MavAutopilot::MAV_AUTOPILOT_PX4;
                let base_mode = if armed {
                    MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED
                } else {
                    MavModeFlag::empty()
                };
                let data = HEARTBEAT_DATA { mavtype, autopilot, base_mode, ..Default::default() };
                MavMessage::HEARTBEAT(data)
            };
            ground += 20.0;
            for _ in 0..8 {
                send(ground, heartbeat(false));
            }
            if has_parameter {
                let mut param_id = [0; 16];
                param_id[..11].copy_from_slice(b"CA_AIRFRAME");
                let is_plane = mavtype == MavType::MAV_TYPE_FIXED_WING;
                send(
                    ground,
                    MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
                        param_value: f32::from_bits(u32::from(is_plane)),
                        param_type: MavParamType::MAV_PARAM_TYPE_INT32,
                        param_id: param_id.into(),
                        ..Default::default()
                    }),
                );
            }
            ground += 5.0;
            for step in 0..50 * seconds {
                let data = ATTITUDE_DATA { time_boot_ms: 3000 + 20 * step, ..Default::default() };
                send(ground, MavMessage::ATTITUDE(data));
                if step % 50 == 0 && step < 250 {
                    send(ground, heartbeat(true));
                }
                ground += 0.02;
            }
        }
        let mut flight = Flight::in_memory("memory", "tlog");
        assert!(log.finish(Vec::new(), None, &mut flight).is_ok());
        flight
    }

    #[test]
    fn facts_are_those_of_the_boot_that_is_read() {
        const QUAD: MavType = MavType::MAV_TYPE_QUADROTOR;
        const PLANE: MavType = MavType::MAV_TYPE_FIXED_WING;
        use VehicleKind as K;
        for (boots, expected) in [
            ([(QUAD, 10, true), (PLANE, 4, true)], vec![K::Multirotor; 2]),
            ([(PLANE, 4, true), (QUAD, 10, true)], vec![K::Multirotor; 2]),
            ([(QUAD, 4, true), (PLANE, 10, true)], vec![K::FixedWing; 2]),
            // Parameters of another kind of vehicle are not taken, those of the same are.
            ([(PLANE, 4, true), (QUAD, 10, false)], vec![K::Multirotor]),
            ([(QUAD, 4, true), (QUAD, 10, false)], vec![K::Multirotor; 2]),
        ] {
            let flight = flight(boots);
            let kinds: Vec<_> = flight.facts.kinds.iter().map(|stated| stated.kind).collect();
            assert_eq!(kinds, expected, "{boots:?}");
        }
    }
}
