//! Which outputs drive the motors, and what their numbers mean.

use super::{Autopilot, Parameters};

/// PX4's function of an output that drives the first motor; the others follow.
const PX4_MOTOR_1: f64 = 101.0;
/// ArduPilot's.
const SERVO_MOTOR_1: f64 = 33.0;
/// Outputs of a group that are looked through.
const CHANNELS: usize = 16;
/// A pulse in us.
const PULSES: std::ops::RangeInclusive<f64> = 500.0..=2500.0;
/// What PX4's simulated outputs span; no parameter says so.
const SIMULATED: OutputRange = OutputRange { zero: 1000.0, one: 2000.0 };

/// A motor's output as a number of the autopilot, at no and at full thrust.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputRange {
    /// At no thrust.
    pub zero: f64,
    /// At full thrust.
    pub one: f64,
}

impl OutputRange {
    /// The share of the range, within 0..1.
    pub fn fraction(self, value: f64) -> f64 {
        ((value - self.zero) / (self.one - self.zero)).clamp(0.0, 1.0)
    }
}

/// The outputs of motors 1 to 4.
#[derive(Clone, Debug, PartialEq)]
pub struct MotorOutputs {
    /// Their channels, from 0.
    pub channels: [usize; 4],
    /// Whether parameters say so, or it is taken to be the first four.
    pub is_said: bool,
    /// Their ranges, and what states them.
    pub ranges: Option<([OutputRange; 4], String)>,
}

impl Parameters {
    /// The outputs of a quadrotor's motors on the main outputs: those that SERVO_OUTPUT_RAW and
    /// ACTUATOR_OUTPUT_STATUS carry. None where it is not known whose parameters they are.
    pub fn motor_outputs(&self) -> Option<MotorOutputs> {
        match self.autopilot()? {
            Autopilot::Px4 => {
                let (channels, is_said) =
                    self.channels(PX4_MOTOR_1, |channel| format!("PWM_MAIN_FUNC{channel}"));
                Some(MotorOutputs { channels, is_said, ranges: self.px4_ranges(channels, is_said) })
            }
            Autopilot::ArduCopter => {
                let (channels, is_said) =
                    self.channels(SERVO_MOTOR_1, |channel| format!("SERVO{channel}_FUNCTION"));
                let said = "MOT_PWM_MIN, MOT_PWM_MAX, MOT_SPIN_MIN and MOT_SPIN_MAX";
                let ranges = self.pulse_range().map(|range| ([range; 4], said.to_owned()));
                Some(MotorOutputs { channels, is_said, ranges })
            }
        }
    }

    fn channels(&self, motor_1: f64, name: impl Fn(usize) -> String) -> ([usize; 4], bool) {
        let channel = |motor: f64| {
            (0..CHANNELS).find(|at| self.number(&name(at + 1)) == Some(motor_1 + motor))
        };
        let said = || Some([channel(0.0)?, channel(1.0)?, channel(2.0)?, channel(3.0)?]);
        said().map_or(([0, 1, 2, 3], false), |channels| (channels, true))
    }

    fn px4_ranges(
        &self,
        channels: [usize; 4],
        is_said: bool,
    ) -> Option<([OutputRange; 4], String)> {
        let range = |low: &str, high: &str| {
            let [zero, one] = [self.number(low)?, self.number(high)?];
            (one > zero).then_some(OutputRange { zero, one })
        };
        let own = channels.map(|channel| {
            let name = |end: &str| format!("PWM_MAIN_{end}{}", channel + 1);
            range(&name("MIN"), &name("MAX"))
        });
        if let [Some(a), Some(b), Some(c), Some(d)] = own {
            return Some(([a, b, c, d], "PWM_MAIN_MINn and PWM_MAIN_MAXn".to_owned()));
        }
        for (low, high) in [("PWM_MAIN_MIN", "PWM_MAIN_MAX"), ("PWM_MIN", "PWM_MAX")] {
            if let Some(range) = range(low, high) {
                return Some(([range; 4], format!("{low} and {high}")));
            }
        }
        // Outputs that have functions but no range are PX4's simulated ones.
        is_said.then(|| ([SIMULATED; 4], "the range of PX4's simulated outputs".to_owned()))
    }

    /// ArduPilot's pulses at the least and at the full thrust of a motor, us.
    pub fn pulse_range(&self) -> Option<OutputRange> {
        let [low, high] = self.numbers(["MOT_PWM_MIN", "MOT_PWM_MAX"]);
        let [least, most] = self.numbers(["MOT_SPIN_MIN", "MOT_SPIN_MAX"]);
        let ([low, high], [least, most]) = ([low?, high?], [least?, most?]);
        let [zero, one] = [least, most].map(|share| low + share * (high - low));
        let is_sound = PULSES.contains(&low) && PULSES.contains(&high) && zero < one;
        is_sound.then_some(OutputRange { zero, one })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{COPTER, SIH, parameters};
    use super::*;

    #[test]
    fn arducopters_motors_span_spin_min_to_spin_max() {
        let outputs = parameters(COPTER).motor_outputs().expect("outputs");
        let (ranges, _) = outputs.ranges.expect("ranges");
        assert_eq!(ranges[2], OutputRange { zero: 1150.0, one: 1950.0 });
        assert_eq!(ranges[2].fraction(1550.0), 0.5);
        assert_eq!(ranges[2].fraction(1000.0), 0.0);
    }

    #[test]
    fn motors_are_where_their_functions_are() {
        let moved = SIH.replace("FUNC1 101", "FUNC5 101");
        let outputs = parameters(&moved).motor_outputs().expect("outputs");
        assert_eq!((outputs.channels, outputs.is_said), ([4, 1, 2, 3], true));
        let unsaid = SIH.replace("FUNC1 101", "FUNC1 0");
        let outputs = parameters(&unsaid).motor_outputs().expect("outputs");
        assert_eq!(
            (outputs.channels, outputs.is_said, outputs.ranges),
            ([0, 1, 2, 3], false, None)
        );
    }

    #[test]
    fn px4_states_a_range_for_each_output_or_simulates_them() {
        let (ranges, _) = parameters(SIH).motor_outputs().unwrap().ranges.expect("ranges");
        assert_eq!(ranges, [SIMULATED; 4]);
        let mut real = SIH.to_owned();
        for channel in 1..=4 {
            real += &format!("\nPWM_MAIN_MIN{channel} 110{channel}\nPWM_MAIN_MAX{channel} 1900");
        }
        let (ranges, said) = parameters(&real).motor_outputs().unwrap().ranges.expect("ranges");
        assert_eq!(ranges[2], OutputRange { zero: 1103.0, one: 1900.0 });
        assert!(said.contains("PWM_MAIN_MINn"));
    }
}
