//! Ranges of motor outputs, from the autopilot's parameters.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::functions::{Drive, MOTORS, OUTPUTS, px4_drive};

/// Range of pulse widths, us.
const PULSES: std::ops::RangeInclusive<f64> = 500.0..=2500.0;
/// Outputs above this are not pulse widths, us.
const PULSE_MAX: f64 = 2500.0;
/// DShot commands at zero and full thrust.
const DSHOT: OutputRange = OutputRange { zero: 0.0, one: 1999.0 };
/// CAN commands at zero and full thrust.
const CAN: OutputRange = OutputRange { zero: 0.0, one: 8191.0 };
/// PX4's simulated outputs, whose range is in no parameter.
const SIMULATED: OutputRange = OutputRange { zero: 1000.0, one: 2000.0 };

/// A motor's output at zero and full thrust.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct OutputRange {
    /// Output at zero thrust.
    pub zero: f64,
    /// Output at full thrust.
    pub one: f64,
}

impl OutputRange {
    /// An output as a fraction of the range, clamped to 0..1.
    pub fn fraction(self, output: f64) -> f64 {
        ((output - self.zero) / (self.one - self.zero)).clamp(0.0, 1.0)
    }
}

/// The ranges of motors 1 to 4, with their source.
pub(super) type Stated = ([OutputRange; MOTORS], String);

/// The ranges of motors 1 to 4 from an autopilot's parameters, if these state them; `most` is the
/// largest output received.
pub fn output_ranges(
    parameters: &BTreeMap<String, f64>,
    most: f64,
) -> Option<[OutputRange; MOTORS]> {
    let of_px4 = || px4(parameters, &px4_drive(parameters, &[]).ok()?, most);
    ardupilot(parameters).or_else(of_px4).map(|(ranges, _)| ranges)
}

/// The ranges of PX4's outputs in `drive`; `most` is the largest output logged.
pub(super) fn px4(parameters: &BTreeMap<String, f64>, drive: &Drive, most: f64) -> Option<Stated> {
    let parameter = |name: &str| parameters.get(name).copied();
    let range = |low: &str, high: &str| {
        let [zero, one] = [parameter(low)?, parameter(high)?];
        (one > zero).then_some(OutputRange { zero, one })
    };
    let is_can = most > PULSE_MAX;
    let name = drive.device.as_deref();
    if let Some(name) = name.filter(|name| !is_can || !name.starts_with("PWM")) {
        // Timer settings for DShot150 to DShot1200.
        let is_dshot = (0..OUTPUTS).any(|timer| {
            parameter(&format!("{name}_TIM{timer}")).is_some_and(|t| (-5.0..=-2.0).contains(&t))
        });
        if is_dshot {
            return Some(([DSHOT; MOTORS], format!("of DShot, by {name}_TIMn")));
        }
        let own = drive.channels.map(|channel| {
            let name = |end: &str| format!("{name}_{end}{}", channel + 1);
            range(&name("MIN"), &name("MAX"))
        });
        if let [Some(a), Some(b), Some(c), Some(d)] = own {
            return Some(([a, b, c, d], format!("that {name}_MINn and {name}_MAXn state")));
        }
    }
    if is_can {
        return Some(([CAN; MOTORS], "of commands over CAN, 0 to 8191".to_owned()));
    }
    if parameter("DSHOT_CONFIG").is_some_and(|config| config > 0.0) {
        return Some(([DSHOT; MOTORS], "of DShot, by DSHOT_CONFIG".to_owned()));
    }
    let auxiliary = ("PWM_AUX_MIN", "PWM_AUX_MAX");
    let main = [("PWM_MAIN_MIN", "PWM_MAIN_MAX"), ("PWM_MIN", "PWM_MAX")];
    let pairs = Some(auxiliary).filter(|_| drive.index > 0).into_iter().chain(main);
    let of_all = pairs.into_iter().find_map(|(low, high)| {
        Some(([range(low, high)?; MOTORS], format!("that {low} and {high} state")))
    });
    // Hardware outputs with functions also have ranges; simulated outputs have functions only.
    let is_simulated = name == Some("PWM_MAIN")
        && PULSES.contains(&most)
        && !parameters.keys().any(|name| name.starts_with("PWM_MAIN_M"));
    of_all.or_else(|| {
        is_simulated.then(|| {
            let basis = "of PX4's simulated outputs, 1000 to 2000: no parameter states another";
            ([SIMULATED; MOTORS], basis.to_owned())
        })
    })
}

/// ArduPilot's pulse widths at zero and full thrust of a motor, us.
pub(super) fn ardupilot(parameters: &BTreeMap<String, f64>) -> Option<Stated> {
    let parameter = |name: &str| parameters.get(name).copied();
    // Before ArduCopter 4.1, 0 means the range of the throttle channel.
    let stated = |low: &str, high: &str| {
        let range = [parameter(low)?, parameter(high)?];
        (range[1] > range[0]).then_some(range)
    };
    let [low, high] = stated("MOT_PWM_MIN", "MOT_PWM_MAX").or(stated("RC3_MIN", "RC3_MAX"))?;
    let [least, most] = [parameter("MOT_SPIN_MIN")?, parameter("MOT_SPIN_MAX")?];
    let [zero, one] = [least, most].map(|share| low + share * (high - low));
    let is_sound = PULSES.contains(&low) && PULSES.contains(&high) && zero < one;
    is_sound.then(|| {
        let basis = format!(
            "of {zero:.0} to {one:.0} us, by MOT_PWM_MIN, MOT_PWM_MAX, MOT_SPIN_MIN and MOT_SPIN_MAX"
        );
        ([OutputRange { zero, one }; MOTORS], basis)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use message::parameters::{ParameterFile, Parameters};

    const SIH: &str = include_str!("../../../message/tests/parameters/px4_sih.params");
    const COPTER: &str = include_str!("../../../message/tests/parameters/arducopter.parm");

    fn parameters(text: &str) -> Parameters {
        let file = ParameterFile::parse(text.as_bytes()).expect("parameters");
        file.vehicle(None).expect("one vehicle").parameters
    }

    fn main_outputs() -> Drive {
        Drive { index: 0, channels: [0, 1, 2, 3], device: Some("PWM_MAIN".to_owned()) }
    }

    #[test]
    fn arducopter_motor_range_spans_spin_min_to_spin_max() {
        let (ranges, _) = ardupilot(&parameters(COPTER)).expect("ranges");
        assert_eq!(ranges[2], OutputRange { zero: 1150.0, one: 1950.0 });
        assert_eq!([1000.0, 1550.0, 2000.0].map(|us| ranges[2].fraction(us)), [0.0, 0.5, 1.0]);
    }

    #[test]
    fn px4_output_ranges_come_from_parameters_or_simulation() {
        let (ranges, _) = px4(&parameters(SIH), &main_outputs(), 1600.0).expect("ranges");
        assert_eq!(ranges, [SIMULATED; 4]);
        let mut real = SIH.to_owned();
        for channel in 1..=4 {
            real += &format!("\nPWM_MAIN_MIN{channel} 110{channel}\nPWM_MAIN_MAX{channel} 1900");
        }
        let (ranges, basis) = px4(&parameters(&real), &main_outputs(), 1600.0).expect("ranges");
        assert_eq!(ranges[2], OutputRange { zero: 1103.0, one: 1900.0 });
        assert!(basis.contains("PWM_MAIN_MINn"));
        // Functions exist, but the range of one output is missing: no conclusion.
        let partial = real.replace("PWM_MAIN_MIN3 1103", "");
        assert_eq!(px4(&parameters(&partial), &main_outputs(), 1600.0), None);
    }
}
