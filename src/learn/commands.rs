//! The rotors' commands: motor outputs on a regular grid, from setpoints through the on-board law
//! or as logged.

use std::ops::Range;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sitl::autopilot::offboard::AttitudeSetpoint;
use sitl::autopilot::pd::AttitudeLoop;
use vehicle::effects::PdGain;
use vehicle::frame::Frd;
use vehicle::rotor::Allocation;
use vehicle::{ROTORS, VehicleError, VehicleParams};

use super::alignment::interpolated;
use super::gaps::{intersection, unbroken, unbroken_over};
use crate::log::import::{self, Flight, MotorSource, MotorUnit, Stream, UnitUnknown};
use crate::model::actuation::{Actuation, RotorState, RotorStep};

/// Rate of the grid if the on-board law is not known, Hz.
const OUTPUT_RATE_HZ: f64 = 250.0;
/// A setpoint older than this is no longer in force, s.
pub const SETPOINT_AGE_MAX: f64 = 0.1;
/// Largest difference between the law's outputs and the logged ones, root mean square: sampling at
/// a different instant causes a few hundredths.
const LAW_ERROR_MAX: f64 = 0.08;
/// Accepted slopes of logged over computed roll and pitch moments, by least squares: different
/// gains show here first.
const LAW_SLOPES: Range<f64> = 0.7..1.4;

/// A range over the whole flight.
pub(super) const EVERYTHING: Range<f64> = f64::NEG_INFINITY..f64::INFINITY;

/// The source of u.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum CommandSource {
    /// Setpoints through the on-board law of the vehicle file (Bansal et al. 2016, eq. 14).
    OnboardLaw,
    /// Logged motor outputs.
    MotorOutputs,
    /// Logged rotor speeds, which need no lag: they are the rotors' states.
    RotorSpeeds,
}

impl CommandSource {
    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            CommandSource::OnboardLaw => "setpoints through the on-board law",
            CommandSource::MotorOutputs => "motor outputs",
            CommandSource::RotorSpeeds => "rotor speeds",
        }
    }

    /// The stream of a log that holds it.
    pub(super) fn stream(self) -> &'static str {
        match self {
            CommandSource::OnboardLaw => "setpoints",
            CommandSource::MotorOutputs => "motor outputs",
            CommandSource::RotorSpeeds => "rotor speeds",
        }
    }

    /// The parts of a flight in which this stream has no gap. A setpoint stays in force until it is
    /// too old.
    pub fn unbroken(self, flight: &Flight) -> Vec<Range<f64>> {
        match self {
            CommandSource::OnboardLaw => unbroken_over(&flight.setpoint, SETPOINT_AGE_MAX),
            CommandSource::MotorOutputs => unbroken(&flight.outputs),
            CommandSource::RotorSpeeds => unbroken(&flight.rotor_speed),
        }
    }

    /// The parts of a flight in which the outputs can be reconstructed, without regard to command
    /// delay: the law needs the attitude, the other sources only themselves.
    pub(super) fn traced(self, flight: &Flight) -> Vec<Range<f64>> {
        match self {
            CommandSource::OnboardLaw => unbroken(&flight.attitude),
            _ => self.unbroken(flight),
        }
    }

    /// The [`traced`](Self::traced) parts within `span`, for commands with a delay of `delay`
    /// seconds.
    pub(super) fn within(
        self,
        traced: &[Range<f64>],
        delay: f64,
        span: &Range<f64>,
    ) -> Vec<Range<f64>> {
        let late = if self == CommandSource::OnboardLaw { 0.0 } else { delay };
        let parts = traced
            .iter()
            .map(|part| (part.start + late).max(span.start)..(part.end + late).min(span.end));
        parts.filter(|part| part.start < part.end).collect()
    }

    /// The rotors' lag relative to this source: zero for rotor speeds.
    pub(super) fn lag_s(self, actuation: &Actuation) -> f64 {
        if self == CommandSource::RotorSpeeds { 0.0 } else { actuation.lag_s }
    }
}

/// Comparison of the on-board law's outputs with the logged ones.
struct LawFit {
    /// Root mean square difference of the outputs.
    error: f64,
    /// Slope of the logged moments over the law's.
    slope: f64,
}

/// The vehicle's own loop and mixer, as its file states them.
#[derive(Clone, Debug)]
pub struct Onboard {
    pub(super) law: Option<AttitudeLoop>,
    pub(super) allocation: Allocation,
    pub(super) rate_hz: f64,
    full_v: f64,
    /// Rotor speed at full output, rad/s.
    rotor_speed_max: Option<f64>,
}

impl Onboard {
    /// Builds the loop and mixer of a vehicle.
    ///
    /// # Errors
    /// The mixer cannot be inverted.
    pub fn new(vehicle: &VehicleParams) -> Result<Self, VehicleError> {
        let allocation = vehicle.allocation()?;
        let gain = vehicle.modelled_effects.get::<PdGain>();
        let pd = vehicle.attitude_pd.map(|pd| gain.map_or(pd, |gain| gain.apply(&pd)));
        Ok(Self {
            law: pd.map(|pd| AttitudeLoop::new(pd, allocation)),
            allocation,
            rate_hz: pd.map_or(OUTPUT_RATE_HZ, |pd| pd.rate_hz),
            full_v: vehicle.battery.full_v,
            rotor_speed_max: vehicle.rotor_max_rpm.map(|rpm| rpm * std::f64::consts::TAU / 60.0),
        })
    }

    /// Converts a flight's outputs to thrust fractions. If their unit is unknown and another stream
    /// holds the commands, the outputs are dropped and counted.
    ///
    /// # Errors
    /// [`UnitUnknown`] if there is no other stream.
    pub(super) fn normalise_outputs(
        &self,
        flight: &mut Flight,
        vehicle: &VehicleParams,
    ) -> Result<(), UnitUnknown> {
        let Err(unknown) = flight.normalise_outputs(vehicle) else { return Ok(()) };
        let by_speed = self.rotor_speed_max.is_some() && !flight.rotor_speed.is_empty();
        if !(by_speed || self.is_commanded(flight)) {
            return Err(unknown);
        }
        let count = flight.outputs.len() as u64;
        flight.outputs = Stream::default();
        flight.left_out.push(("motor outputs in an unknown unit".to_owned(), count));
        Ok(())
    }

    /// Whether the law can compute outputs from this flight's setpoints.
    fn is_commanded(&self, flight: &Flight) -> bool {
        self.law.is_some() && flight.setpoint.values().iter().any(|s| s.thrust.is_some())
    }

    /// For a flight that logs neither motor outputs nor rotor speeds, computes outputs from its
    /// setpoints with the on-board law, at the reported attitude and rate; a setpoint acts `delay_s`
    /// seconds after it was sent. Returns whether it did.
    pub fn complete_outputs(&self, flight: &mut Flight, delay_s: f64) -> bool {
        let is_logged = !(flight.outputs.is_empty() && flight.rotor_speed.is_empty());
        if is_logged || !self.is_commanded(flight) {
            return false;
        }
        let source = CommandSource::OnboardLaw;
        let led = intersection(&source.unbroken(flight), &source.traced(flight));
        flight.outputs = OutputTrace::new(self, flight, source, delay_s, 0.0, &led).outputs();
        flight.motor_unit = MotorUnit::ThrustFraction;
        flight.motor_source = MotorSource::OnboardLaw;
        !flight.outputs.is_empty()
    }

    /// The source of this flight's u, and the root mean square difference between the law's outputs
    /// and the logged ones if both exist.
    pub fn source(&self, flight: &Flight, attitude_latency: f64) -> (CommandSource, Option<f64>) {
        if !self.is_commanded(flight) {
            let speeds = flight.outputs.is_empty() && !flight.rotor_speed.is_empty();
            let other =
                if speeds { CommandSource::RotorSpeeds } else { CommandSource::MotorOutputs };
            return (other, None);
        }
        match self.law_fit(flight, attitude_latency) {
            Some(LawFit { error, slope }) => {
                let fits = error < LAW_ERROR_MAX && LAW_SLOPES.contains(&slope);
                let source =
                    if fits { CommandSource::OnboardLaw } else { CommandSource::MotorOutputs };
                (source, Some(error))
            }
            None => (CommandSource::OnboardLaw, None),
        }
    }

    /// The law's outputs against the logged ones, at the best-fitting delay.
    fn law_fit(&self, flight: &Flight, attitude_latency: f64) -> Option<LawFit> {
        let source = CommandSource::OnboardLaw;
        let traced = source.traced(flight);
        let fits = (0..12).filter_map(|k| {
            let delay = 0.005 * f64::from(k);
            let trace = OutputTrace::new(self, flight, source, delay, attitude_latency, &traced);
            let (mut error, mut count, mut cross, mut square) = (0.0, 0.0, 0.0, 0.0);
            for (time, logged) in flight.outputs.iter() {
                let Some(law) = trace.at(time) else { continue };
                error += law.iter().zip(logged).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
                count += ROTORS as f64;
                let [_, roll, pitch, _] = self.allocation.wrench(law);
                let [_, logged_roll, logged_pitch, _] = self.allocation.wrench(*logged);
                cross += roll * logged_roll + pitch * logged_pitch;
                square += roll * roll + pitch * pitch;
            }
            let slope = if square > 0.0 { cross / square } else { 1.0 };
            (count > 200.0).then(|| LawFit { error: (error / count).sqrt(), slope })
        });
        fits.min_by(|a, b| a.error.total_cmp(&b.error))
    }

    /// Outputs for a setpoint at a reported attitude and rate; `None` without a law or a thrust
    /// setpoint.
    pub(super) fn law_outputs(
        &self,
        setpoint: &import::AttitudeSetpoint,
        attitude: vehicle::frame::Attitude,
        body_rate: Frd,
    ) -> Option<[f64; ROTORS]> {
        let setpoint = AttitudeSetpoint {
            attitude: setpoint.attitude.map(|attitude| attitude.euler()),
            body_rate: setpoint.body_rate.unwrap_or(Frd::zero()),
            thrust: setpoint.thrust?.clamp(0.0, 1.0),
            type_mask: wire::dialect::AttitudeTargetTypemask::empty(),
        };
        Some(self.law.as_ref()?.outputs(&setpoint, attitude.euler(), body_rate))
    }

    /// Rotor state at a speed, as a fraction of the nominal thrust.
    fn state_at_speed(&self, speed: f64) -> f64 {
        self.rotor_speed_max.map_or(0.0, |most| (speed / most).powi(2))
    }

    /// Factor of the pack's voltage on thrust.
    pub(super) fn voltage_factor(&self, actuation: &Actuation, voltage: Option<f64>) -> f64 {
        voltage.map_or(1.0, |v| (v / self.full_v).max(0.1).powf(actuation.voltage_exponent))
    }
}

/// Motor outputs on regular grids; `None` where no command was in force.
pub(super) struct OutputTrace {
    step: f64,
    /// In time order.
    pieces: Vec<Piece>,
}

/// Outputs at regular intervals.
struct Piece {
    start: f64,
    outputs: Vec<Option<[f64; ROTORS]>>,
}

impl OutputTrace {
    /// The outputs of a flight within `spans`, for commands with a delay of `delay` seconds and
    /// attitudes logged `attitude_latency` seconds late. Pauses of the log must be between spans: a
    /// grid over a pause could have any size.
    pub fn new(
        onboard: &Onboard,
        flight: &Flight,
        source: CommandSource,
        delay: f64,
        attitude_latency: f64,
        spans: &[Range<f64>],
    ) -> Self {
        let step = 1.0 / onboard.rate_hz;
        let by_law = |t: f64| {
            let sent = t - delay;
            let setpoint = fresh_setpoint(flight, sent)?;
            // On board, the estimate has no latency.
            let attitude = interpolated(&flight.attitude, t + attitude_latency)?;
            let rate = lerp(&flight.body_rate, t)?;
            onboard.law_outputs(setpoint, attitude, Frd::from(rate))
        };
        let outputs = |t: f64| match source {
            CommandSource::OnboardLaw => by_law(t),
            CommandSource::MotorOutputs => lerp(&flight.outputs, t - delay),
            CommandSource::RotorSpeeds => {
                let speeds = lerp(&flight.rotor_speed, t - delay)?;
                Some(speeds.map(|speed| onboard.state_at_speed(speed)))
            }
        };
        let piece = |span: &Range<f64>| {
            let start = (span.start / step).ceil() * step;
            let count = ((span.end - start) / step).max(0.0) as usize;
            let ticks = (0..count).map(|k| start + k as f64 * step);
            Piece { start, outputs: ticks.map(outputs).collect() }
        };
        Self { step, pieces: spans.iter().map(piece).collect() }
    }

    /// The known outputs.
    fn outputs(&self) -> Stream<[f64; ROTORS]> {
        let mut stream = Stream::default();
        for piece in &self.pieces {
            for (k, outputs) in piece.outputs.iter().enumerate() {
                if let Some(outputs) = outputs {
                    stream.push(piece.start + k as f64 * self.step, *outputs);
                }
            }
        }
        stream
    }

    fn at(&self, time: f64) -> Option<[f64; ROTORS]> {
        let before = self.pieces.partition_point(|piece| piece.start <= time + 1e-6 * self.step);
        let piece = self.pieces.get(before.checked_sub(1)?)?;
        let index = ((time - piece.start) / self.step + 1e-6).floor();
        piece.outputs.get(index as usize).copied().flatten()
    }

    /// The rotors' states that follow from these outputs: at each instant the state and its
    /// average.
    pub fn states(&self, actuation: &Actuation, lag_s: f64) -> Stream<[f64; 2 * ROTORS]> {
        let rotors = RotorStep::new(actuation, lag_s, self.step);
        let balanced = actuation.balance_s.is_some();
        let mut states = Stream::default();
        // The outputs before the first one are unknown; their effect fades within a few lags.
        let settling = 3.0 * lag_s;
        for piece in &self.pieces {
            let mut current: Option<(f64, RotorState)> = None;
            for (k, outputs) in piece.outputs.iter().enumerate() {
                let time = piece.start + k as f64 * self.step;
                let Some(outputs) = outputs else {
                    current = None;
                    continue;
                };
                let (since, state) =
                    current.unwrap_or((time, RotorState::settled(*outputs, balanced)));
                let [_, after] = rotors.advance(&state, outputs);
                current = Some((since, after));
                if time - since >= settling {
                    states.push(time + self.step, after.into());
                }
            }
        }
        states
    }
}

/// The setpoint in force at `sent`; `None` if the newest is too old.
pub(super) fn fresh_setpoint(flight: &Flight, sent: f64) -> Option<&import::AttitudeSetpoint> {
    let index = flight.setpoint.index_at(sent)?;
    let age = sent - flight.setpoint.times().get(index)?;
    flight.setpoint.values().get(index).filter(|_| age < SETPOINT_AGE_MAX)
}

/// A vector stream, interpolated; `None` outside it.
pub(super) fn lerp<V: Copy + Into<[f64; N]>, const N: usize>(
    stream: &Stream<V>,
    time: f64,
) -> Option<[f64; N]> {
    let index = stream.index_at(time)?;
    let before: [f64; N] = stream.values()[index].into();
    let times = stream.times();
    if times[index] == time {
        return Some(before);
    }
    let after: [f64; N] = (*stream.values().get(index + 1)?).into();
    let share = (time - times[index]) / (times[index + 1] - times[index]);
    Some(std::array::from_fn(|i| before[i] + share * (after[i] - before[i])))
}
