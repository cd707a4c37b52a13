//! Reads the motor commands and the rotor speeds from an ArduPilot log, and the unit of the
//! commands.

use super::{CHANNELS, Contents, stamp};
use crate::import::facts::VehicleFacts;
use crate::import::flight::{Flight, MotorSource, MotorUnit, Stream};
use crate::import::functions::{self, Stated, numbered};
use crate::import::onboard::Sample;
use crate::import::ranges;
use crate::import::tally::Tally;

/// Valid pulse widths, us; 0 means no pulse.
const PULSES: std::ops::RangeInclusive<f64> = 500.0..=2500.0;
/// Rate below which outputs do not show the rotors' response, Hz.
const SLOW_HZ: f64 = 50.0;
/// Longest time between the speeds of two rotors in one sample, s.
const ROUND: f64 = 0.5;

impl Contents {
    pub(super) fn fill_outputs(
        &self,
        flight: &mut Flight,
        facts: &mut VehicleFacts,
        tally: &mut Tally,
    ) {
        let Some(topic) = self.topics.primary("RCOU", 0, tally) else { return };
        let channels = match functions::ardupilot_motors(&self.stated.parameters) {
            Stated::Motors(channels) => {
                let numbers = numbered(&channels);
                facts.notes.push(format!(
                    "motors 1 to 4 are outputs {numbers} of RCOU, by SERVOn_FUNCTION"
                ));
                channels
            }
            Stated::Nothing => {
                facts.notes.push(
                    "motors 1 to 4 are assumed to be outputs 1, 2, 3, 4 of RCOU: no \
                     SERVOn_FUNCTION is logged"
                        .to_owned(),
                );
                [0, 1, 2, 3]
            }
            Stated::Without(missing) => {
                let missing: Vec<String> = missing.iter().map(usize::to_string).collect();
                let missing = missing.join(", ");
                facts.notes.push(format!(
                    "no motor outputs: SERVOn_FUNCTION states no output of motor {missing}"
                ));
                return;
            }
        };
        let names: Option<Vec<&str>> =
            channels.iter().map(|channel| CHANNELS.get(*channel).copied()).collect();
        let Some([a, b, c, d]) = names.as_deref() else {
            facts.notes.push("no motor outputs: RCOU lacks outputs beyond 14".to_owned());
            return;
        };
        let names = [*a, *b, *c, *d];
        flight.outputs = self.topics.stream(topic, tally, |row| {
            let pulses = row.finite(names).filter(|p| p.iter().all(|p| PULSES.contains(p)));
            Sample::of(stamp(&row), pulses)
        });
        flight.motor_source = MotorSource::Rcou;
        match ranges::ardupilot(&self.stated.parameters) {
            Some((ranges, basis)) => {
                flight.scale_outputs(ranges);
                facts.notes.push(format!("outputs over the range {basis}"));
            }
            None => flight.motor_unit = MotorUnit::VehicleFile,
        }
        let rate = flight.outputs.rate();
        if rate < SLOW_HZ && !flight.outputs.is_empty() {
            facts.notes.push(format!(
                "outputs update at only {rate:.0} Hz: too slow to show lag, delay and inertia; \
                 record SERVO_OUTPUT_RAW over telemetry at 50 Hz or more"
            ));
        }
    }

    /// Fills the rotor speeds. The log has one message for each rotor; a sample combines the
    /// nearest of all four.
    pub(super) fn fill_rotor_speed(&self, flight: &mut Flight, tally: &mut Tally) {
        let channels = match functions::ardupilot_motors(&self.stated.parameters) {
            Stated::Motors(channels) => channels,
            Stated::Nothing => [0, 1, 2, 3],
            Stated::Without(_) => return,
        };
        let mut single: Vec<(usize, Stream<f64>)> = Vec::new();
        for (motor, channel) in channels.into_iter().enumerate() {
            let Some(topic) = self.topics.instance("ESC", channel as u8) else { return };
            let stream = self.topics.stream(topic, tally, |row| {
                let speed = row.get("RPM").abs();
                Sample::of(stamp(&row), speed.is_finite().then_some(speed))
            });
            single.push((motor, stream));
        }
        let Some((_, first)) = single.first() else { return };
        for (time, _) in first.iter() {
            let near = |stream: &Stream<f64>| {
                let after = stream.times().partition_point(|t| *t < time);
                let at = [after.checked_sub(1)?, after].into_iter().filter(|at| *at < stream.len());
                let distance = |at: &usize| (stream.times()[*at] - time).abs();
                let at = at.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
                (distance(&at) < ROUND).then(|| stream.values()[at])
            };
            let speeds: Option<Vec<f64>> = single.iter().map(|(_, stream)| near(stream)).collect();
            if let Some([a, b, c, d]) = speeds.as_deref() {
                flight.rotor_speed.push(time, [*a, *b, *c, *d]);
            }
        }
    }
}
