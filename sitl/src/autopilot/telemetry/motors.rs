//! MAVLink messages with the motor outputs and the rotor speeds.

use wire::dialect::*;

use super::Snapshot;
use crate::autopilot::personality::OutputScale;
use vehicle::{MotorOutput, ROTORS};

impl Snapshot<'_> {
    /// The outputs as encoded in `message`, each with its slot. The vehicle file's `motor_output`
    /// defines the encoding if it describes this message, else the autopilot does.
    fn encoded_outputs(&self, message: &str) -> [(usize, f64); ROTORS] {
        let described = self.motor_output.filter(|described| described.message == message);
        let OutputScale { zero, one, disarmed } = match described {
            Some(MotorOutput { zero, one, disarmed, .. }) => {
                OutputScale { zero: *zero, one: *one, disarmed: *disarmed }
            }
            None => self.personality.output_scale(message, self.parameters),
        };
        std::array::from_fn(|rotor| {
            let field = described.and_then(|described| described.fields.get(rotor));
            let slot = field.and_then(|field| slot_of(field)).unwrap_or(rotor);
            let output = self.outputs[rotor];
            (slot, if self.armed { zero + output * (one - zero) } else { disarmed })
        })
    }

    pub(super) fn actuator_output_status(&self) -> ACTUATOR_OUTPUT_STATUS_DATA {
        let mut actuator = [0.0; 32];
        let mut active = 0;
        for (slot, value) in self.encoded_outputs("ACTUATOR_OUTPUT_STATUS") {
            if let Some(place) = actuator.get_mut(slot) {
                *place = value as f32;
                active |= 1 << slot;
            }
        }
        let active = self.personality.active_outputs(active);
        ACTUATOR_OUTPUT_STATUS_DATA { time_usec: self.now_us, active, actuator }
    }

    pub(super) fn servo_output_raw(&self) -> SERVO_OUTPUT_RAW_DATA {
        let mut pwm = [0; 8];
        for (slot, value) in self.encoded_outputs("SERVO_OUTPUT_RAW") {
            if let Some(place) = pwm.get_mut(slot) {
                *place = value.round() as u16;
            }
        }
        SERVO_OUTPUT_RAW_DATA {
            time_usec: self.now_us as u32,
            servo1_raw: pwm[0],
            servo2_raw: pwm[1],
            servo3_raw: pwm[2],
            servo4_raw: pwm[3],
            servo5_raw: pwm[4],
            servo6_raw: pwm[5],
            servo7_raw: pwm[6],
            servo8_raw: pwm[7],
            ..Default::default()
        }
    }

    pub(super) fn esc_status(&self) -> Option<ESC_STATUS_DATA> {
        let rpm = self.rpm?.map(|rpm| rpm.round() as i32);
        let voltage = [self.battery.voltage as f32; ROTORS];
        let current = [(self.battery.current / ROTORS as f64) as f32; ROTORS];
        Some(ESC_STATUS_DATA { time_usec: self.now_us, rpm, voltage, current, index: 0 })
    }
}

/// Slot of a field, counted from 0: 2 for `actuator[2]` and also for `servo3_raw`.
fn slot_of(field: &str) -> Option<usize> {
    let digits = &field[field.find(|c: char| c.is_ascii_digit())?..];
    let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
    let number: usize = digits[..end].parse().ok()?;
    if field.starts_with("servo") { number.checked_sub(1) } else { Some(number) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motor_field_names_give_their_output_slots() {
        assert_eq!(slot_of("actuator[2]"), Some(2));
        assert_eq!(slot_of("servo3_raw"), Some(2));
        assert_eq!(slot_of("servo0_raw"), None);
        assert_eq!(slot_of("motor"), None);
    }
}
