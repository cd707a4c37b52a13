//! Rows from flights: the vehicle's motion at 100 Hz, and its input.

use std::ops::Range;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::{ROTORS, VehicleParams};

use super::ROW_RATE_HZ;
use super::alignment::{Alignment, interpolated};
use super::commands::{CommandSource, Onboard, OutputTrace, lerp};
use super::gaps::unbroken;
use super::segments::{Cut, Segments, Unusable};
use super::split::Traits;
use super::window::{BANDWIDTH, Sliding};
use crate::log::import::{Flight, Stream};
use crate::model::actuation::{Actuation, RotorState};
use crate::model::file::AccelerationSource;
use crate::model::{ACCELERATIONS, Model, Point};

/// Windows of the labels.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct WindowSettings {
    /// Half width of the window for rates, specific force and input, s.
    pub half_s: f64,
    /// Half width of the window for velocity, if its slope is the acceleration, s.
    pub velocity_half_s: f64,
}

impl WindowSettings {
    /// -3 dB bandwidth of the labels from rates and specific force, Hz.
    pub fn bandwidth_hz(&self) -> f64 {
        BANDWIDTH / self.half_s
    }
}

impl Default for WindowSettings {
    fn default() -> Self {
        Self { half_s: 0.022, velocity_half_s: 0.055 }
    }
}

/// The measurements at one instant, without the input.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    /// Time on the gyro's clock, s.
    pub time: f64,
    /// Velocity in world axes, m/s.
    pub velocity: Ned,
    /// Rotation from body to world.
    pub attitude: Attitude,
    /// Body rate, rad/s.
    pub body_rate: Frd,
    /// Linear acceleration from the accelerometer, m/s^2.
    pub by_force: Option<Ned>,
    /// Linear acceleration from the velocity's slope, m/s^2.
    pub by_slope: Option<Ned>,
    /// Slope of the body rate, rad/s^2.
    pub angular: Frd,
    /// The simulator's true accelerations.
    pub truth: Option<[f64; ACCELERATIONS]>,
    /// Pack voltage, V.
    pub voltage: Option<f64>,
}

/// A flight with its observations.
pub struct ObservedFlight {
    /// The flight.
    pub flight: Flight,
    /// Its usable parts.
    pub segments: Segments,
    /// The latencies of its streams.
    pub alignment: Alignment,
    /// The source of its u.
    pub source: CommandSource,
    /// Root mean square difference between the on-board law's outputs and the logged ones.
    pub law_error: Option<f64>,
    /// Additional delay of its commands relative to the training flights, s: the streams of one log
    /// may be offset, differently in each log.
    pub command_shift_s: f64,
    /// The observations, in time order.
    pub observations: Vec<Observation>,
    /// Parts in which the rotors' commands can be reconstructed.
    traced: Vec<Range<f64>>,
    /// Half width of the windows, s.
    half_s: f64,
}

/// A row of the dataset.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Time on the gyro's clock, s.
    pub time: f64,
    /// State and input.
    pub point: Point,
    /// The measured accelerations: linear in world axes, angular in body axes.
    pub label: [f64; ACCELERATIONS],
    /// The simulator's true accelerations.
    pub truth: Option<[f64; ACCELERATIONS]>,
}

impl Row {
    /// The label less the accelerations of a model.
    pub(super) fn residual(&self, model: &dyn Model) -> [f64; ACCELERATIONS] {
        let modelled = model.accelerations(&self.point);
        std::array::from_fn(|i| self.label[i] - modelled[i])
    }
}

/// The log cannot be of this vehicle, or does not show that it is.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Implausible {
    /// Its commands do not carry the vehicle's weight.
    #[error(
        "its commands lift {found:.2} of the vehicle's weight on average, not about 1: it is from \
         another vehicle, or the motors' unit is wrong"
    )]
    OtherVehicle {
        /// Mean commanded thrust over the weight.
        found: f64,
    },
    /// The rotors' commands are unknown at all usable times.
    #[error(
        "it has no rotor commands from {} at any usable time: log setpoints with thrust or motor \
         outputs at 10 Hz or more",
        by.name()
    )]
    NoInput {
        /// The source that lacks them.
        by: CommandSource,
    },
}

impl ObservedFlight {
    /// Observes a flight of a vehicle, without the times in `cuts`.
    ///
    /// # Errors
    /// [`Unusable`] if the flight has no usable data.
    pub fn new(
        mut flight: Flight,
        vehicle: &VehicleParams,
        onboard: &Onboard,
        settings: &WindowSettings,
        cuts: &[Cut],
    ) -> Result<Self, Unusable> {
        onboard.normalise_outputs(&mut flight, vehicle)?;
        Segments::check_streams(&flight)?;
        if flight.position.is_empty() {
            return Err(Unusable::Missing("position"));
        }
        let alignment = Alignment::of(&flight);
        let (source, law_error) = onboard.source(&flight, alignment.attitude_s.unwrap_or(0.0));
        let segments = Segments::driven(&flight, vehicle.hover_share(), source, cuts)?;
        let traced = source.traced(&flight);
        let mut observed = Self {
            flight,
            segments,
            alignment,
            source,
            law_error,
            command_shift_s: 0.0,
            observations: Vec::new(),
            traced,
            half_s: 0.0,
        };
        observed.observe(vehicle, settings);
        Ok(observed)
    }

    /// Observes the flight with the given windows, and resets the command shift.
    pub fn observe(&mut self, vehicle: &VehicleParams, settings: &WindowSettings) {
        let Self { flight, segments, alignment, .. } = &*self;
        let attitude = flight.attitude.clone().shifted(-alignment.attitude_s.unwrap_or(0.0));
        let velocity = flight.velocity.clone().shifted(-alignment.velocity_s.unwrap_or(0.0));

        let mut accelerations: Stream<[f64; 3]> = Stream::default();
        for (time, force) in flight.specific_force.iter() {
            if let Some(attitude) = interpolated(&attitude, time) {
                let [n, e, d] = attitude.to_world(*force).to_array();
                accelerations.push(time, [n, e, d + vehicle.gravity]);
            }
        }
        // The windows contain at least three samples at any rate.
        let half = |period: Option<f64>, least: f64| least.max(1.6 * period.unwrap_or(0.0));
        let half_s = half(flight.body_rate.period(), settings.half_s);
        let force_half = half(flight.specific_force.period(), settings.half_s);
        let velocity_half = half(velocity.period(), settings.velocity_half_s);

        let voltage = scalar(&flight.voltage);
        let mut observations = Vec::new();
        for span in &segments.spans {
            let mut rates = Sliding::new(&flight.body_rate, half_s);
            let mut forces = Sliding::new(&accelerations, force_half);
            let mut velocities = Sliding::new(&velocity, velocity_half);
            for time in grid(span) {
                let inside = span.start + velocity_half < time && time < span.end - velocity_half;
                let Some((body_rate, angular)) = rates.line(time) else { continue };
                let by_force = forces.mean(time);
                let Some((mean, slope)) = velocities.line(time) else { continue };
                let Some(attitude) = interpolated(&attitude, time) else { continue };
                let now = lerp(&velocity, time).unwrap_or(mean);
                if inside {
                    observations.push(Observation {
                        time,
                        velocity: Ned::from(now),
                        attitude,
                        body_rate: Frd::from(body_rate),
                        by_force: by_force.map(Ned::from),
                        by_slope: Some(Ned::from(slope)),
                        angular: Frd::from(angular),
                        truth: truth_at(flight, time),
                        voltage: lerp(&voltage, time)
                            .map(|[v]| v)
                            .or(flight.voltage.held_at(time).copied()),
                    });
                }
            }
        }
        self.observations = observations;
        self.half_s = half_s;
        self.command_shift_s = 0.0;
        self.remove_accelerometer_bias();
    }

    /// The parts of its log between the pauses of the attitude.
    pub fn recorded(&self) -> Vec<Range<f64>> {
        unbroken(&self.flight.attitude)
    }

    /// Checks that commands and motion are plausible for the vehicle: the mean commanded thrust is
    /// within a factor of two of its weight.
    ///
    /// # Errors
    /// [`Implausible`] with the value found.
    pub fn check_vehicle(
        &self,
        vehicle: &VehicleParams,
        onboard: &Onboard,
    ) -> Result<(), Implausible> {
        let shipped = Actuation { lag_s: vehicle.motor_time_constant_s, ..Actuation::default() };
        let inputs = self.inputs(onboard, &shipped, 0..self.observations.len());
        let (mut lift, mut count) = (0.0, 0.0);
        for input in inputs.into_iter().flatten() {
            lift += input[0];
            count += 1.0;
        }
        if count == 0.0 {
            return Err(Implausible::NoInput { by: self.source });
        }
        let found = lift / count / (vehicle.mass * vehicle.gravity);
        (0.5..2.0).contains(&found).then_some(()).ok_or(Implausible::OtherVehicle { found })
    }

    /// Removes the accelerometer's mean deviation from the velocity's slope, in body axes.
    fn remove_accelerometer_bias(&mut self) {
        let (mut sum, mut count) = (Frd::zero(), 0.0);
        for o in &self.observations {
            if let (Some(force), Some(slope)) = (o.by_force, o.by_slope) {
                sum += o.attitude.to_body(force - slope);
                count += 1.0;
            }
        }
        if count < ROW_RATE_HZ {
            return;
        }
        let bias = sum * (1.0 / count);
        for o in &mut self.observations {
            o.by_force = o.by_force.map(|force| force - o.attitude.to_world(bias));
        }
    }

    /// Summary of how the flight was flown, for the split.
    pub(super) fn traits(&self) -> Traits {
        let count = self.observations.len().max(1) as f64;
        let rms = |square: &dyn Fn(&Observation) -> f64| {
            (self.observations.iter().map(square).sum::<f64>() / count).sqrt()
        };
        let voltages: Vec<f64> = self.observations.iter().filter_map(|o| o.voltage).collect();
        Traits {
            rows: self.observations.len(),
            speeds_m_s: [
                rms(&|o| o.velocity.north().powi(2) + o.velocity.east().powi(2)),
                rms(&|o| o.velocity.down().powi(2)),
            ],
            rates_rad_s: [
                rms(&|o| o.body_rate.front().powi(2) + o.body_rate.right().powi(2)),
                rms(&|o| o.body_rate.down().powi(2)),
            ],
            voltage_v: voltages.iter().sum::<f64>() / voltages.len().max(1) as f64,
        }
    }

    /// Delay from this flight's commands to their effect, without the lag, s.
    pub fn delay_s(&self, actuation: &Actuation) -> f64 {
        actuation.delay_s + self.command_shift_s
    }

    /// The rotors' states within a span under an actuation: at each instant the state and its
    /// average.
    pub(super) fn rotor_states(
        &self,
        onboard: &Onboard,
        actuation: &Actuation,
        span: &Range<f64>,
    ) -> Stream<[f64; 2 * ROTORS]> {
        let lag_s = self.source.lag_s(actuation);
        let late = self.alignment.attitude_s.unwrap_or(0.0);
        let delay = self.delay_s(actuation);
        let spans = self.source.within(&self.traced, delay, span);
        OutputTrace::new(onboard, &self.flight, self.source, delay, late, &spans)
            .states(actuation, lag_s)
    }

    /// The acting input at each observation in `range`; `None` if commands are missing.
    pub fn inputs(
        &self,
        onboard: &Onboard,
        actuation: &Actuation,
        range: Range<usize>,
    ) -> Vec<Option<[f64; 4]>> {
        let observations = &self.observations[range];
        let (Some(first), Some(last)) = (observations.first(), observations.last()) else {
            return Vec::new();
        };
        // Lag and balance need a past to settle.
        let past = 4.0 * (actuation.lag_s + actuation.balance_s.unwrap_or(0.0)) + 0.5;
        let span = first.time - past..last.time + 0.5;
        let states = self.rotor_states(onboard, actuation, &span);
        let mut window = Sliding::new(&states, self.half_s);
        observations
            .iter()
            .map(|o| {
                let states = RotorState::from(window.mean(o.time)?);
                let factor = onboard.voltage_factor(actuation, o.voltage);
                Some(states.input(&onboard.allocation, factor))
            })
            .collect()
    }

    /// The rows under an actuation, with labels from `acceleration`.
    pub fn rows(
        &self,
        onboard: &Onboard,
        actuation: &Actuation,
        acceleration: AccelerationSource,
    ) -> Vec<Row> {
        let inputs = self.inputs(onboard, actuation, 0..self.observations.len());
        let rows = self.observations.iter().zip(inputs).filter_map(|(o, input)| {
            let linear = o.acceleration(acceleration)?;
            let ([n, e, d], [p, q, r]) = (linear.to_array(), o.angular.to_array());
            Some(Row {
                time: o.time,
                point: Point {
                    velocity: o.velocity,
                    body_rate: o.body_rate,
                    attitude: o.attitude.euler(),
                    input: input?,
                },
                label: [n, e, d, p, q, r],
                truth: o.truth,
            })
        });
        rows.filter(|row| row.label.iter().chain(&row.point.to_array()).all(|x| x.is_finite()))
            .collect()
    }
}

impl Observation {
    /// The linear acceleration from one of its sources, world axes, m/s^2.
    pub fn acceleration(&self, source: AccelerationSource) -> Option<Ned> {
        match source {
            AccelerationSource::SpecificForce => self.by_force,
            AccelerationSource::VelocitySlope => self.by_slope,
        }
    }
}

/// Times of the rows within a span.
fn grid(span: &Range<f64>) -> impl Iterator<Item = f64> {
    let first = (span.start * ROW_RATE_HZ).ceil() as i64;
    let last = (span.end * ROW_RATE_HZ).floor() as i64;
    (first..=last).map(|k| k as f64 / ROW_RATE_HZ)
}

fn scalar(stream: &Stream<f64>) -> Stream<[f64; 1]> {
    let mut out = Stream::default();
    for (time, value) in stream.iter() {
        out.push(time, [*value]);
    }
    out
}

/// The simulator's accelerations at `time`, interpolated.
fn truth_at(flight: &Flight, time: f64) -> Option<[f64; ACCELERATIONS]> {
    let (a, b, share) = flight.truth.around(time)?;
    let mix = |a: f64, b: f64| a + share * (b - a);
    let [n, e, d] = a.acceleration.to_array();
    let [n2, e2, d2] = b.acceleration.to_array();
    let [p, q, r] = a.angular_acceleration.to_array();
    let [p2, q2, r2] = b.angular_acceleration.to_array();
    Some([mix(n, n2), mix(e, e2), mix(d, d2), mix(p, p2), mix(q, q2), mix(r, r2)])
}
