//! Flies flights again in closed-loop simulation, and compares them with their logs.
//!
//! Feedback hides a plant's errors in the trajectory and shows them in the commands: a vehicle that
//! is heavier than its file flies nearly the same path with more thrust. Both are compared, for the
//! vehicle as shipped and with the named effects. The daemon's feedback flies each of them,
//! designed for the vehicle as shipped.

mod course;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;
use vehicle::effects::{AttitudeTrim, Effect, EffectSet, EstimatorLatency, Gusts};
use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::rigid_body::State;
use vehicle::rotor::Allocation;

pub use self::course::ReferenceOrigin;
use self::course::{Course, courses};
use crate::diagnose::flights::input::{DiagnosisInput, Settings};
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::flights::series::Series;
use crate::diagnose::likelihood::noise::ReportNoise;
use crate::diagnose::simulate::flight_simulator::{
    Departure, FlightSimulator, GroundControl, NotSimulated,
};
use crate::log::import::{Flight, Stream};

/// Least excess over the floor that counts as closable, as a share of the floor. A floor comes from
/// two draws only.
const GAP_MIN: f64 = 0.2;
/// Time between the compared instants, s.
const SPACING_S: f64 = 0.02;
/// Instants over which commands are averaged: the gyro's noise is in every output, and shows
/// nothing of the plant.
const AVERAGED_INSTANTS: usize = 5;

/// Why no flight was flown again.
#[derive(Debug, thiserror::Error)]
pub enum NotReflown {
    /// The vehicle cannot be flown in simulation.
    #[error(transparent)]
    NotSimulated(#[from] NotSimulated),
    /// No held-out flight has the motion and outputs to compare with.
    #[error(
        "no held-out flight has position, velocity, attitude and outputs for three seconds or more"
    )]
    NoMotion,
}

/// Root mean square difference between logs and simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize)]
pub struct Difference {
    /// With the vehicle file as shipped.
    pub before: f64,
    /// With the named effects.
    pub after: f64,
    /// Between two simulations with the named effects that differ by their noise.
    pub floor: f64,
}

impl Difference {
    /// The closed share of the closable difference: (before - after) / (before - floor); `None`
    /// where nothing is closable.
    pub fn closure(&self) -> Option<f64> {
        let closable = self.before - self.floor;
        (closable > GAP_MIN * self.floor).then(|| (self.before - self.after) / closable)
    }
}

/// The held-out flights compared with the same flights flown again in simulation.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct ClosedLoop {
    /// Length of the position's difference, m.
    pub position_m: Difference,
    /// Angle between the attitudes, rad.
    pub attitude_rad: Difference,
    /// Collective thrust of the motor outputs through the firmware's mixer, N.
    pub thrust_n: Difference,
    /// Length of the moments' difference through the same mixer, N m.
    pub moment_nm: Difference,
    /// Motor output, 0..1, root mean square over the motors.
    pub output: Difference,
    /// Each flight, or unbroken part of one, that was flown again.
    pub flights: Vec<Reflown>,
}

/// One flight, or an unbroken part of one, flown again.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Reflown {
    /// The flight's name.
    pub name: String,
    /// Source of the reference that was tracked.
    pub reference: ReferenceOrigin,
    /// Its length, s.
    pub seconds: f64,
    /// The differences over time.
    #[serde(skip)]
    pub traces: Traces,
}

/// Differences of one flight over time.
#[derive(Clone, Debug, Default)]
pub struct Traces {
    /// Time since the part's start, s.
    pub time_s: Vec<f64>,
    /// Length of the position's difference, before and after, m.
    pub position_m: [Vec<f64>; 2],
    /// Simulated less logged thrust, before and after, N.
    pub thrust_n: [Vec<f64>; 2],
    /// Logged values: north, east, down, m, and thrust, N.
    pub logged: [Vec<f64>; 4],
    /// Simulated values of the same, before and after.
    pub simulated: [[Vec<f64>; 4]; 2],
}

/// Flies the held-out flights again, with the vehicle as shipped and with `effects` put over it.
/// Reports have `noise`; the reference is chosen by [`ReferenceOrigin`]. Turbulence is left out,
/// since its draw would differ from the flight's.
///
/// # Errors
/// [`NotReflown`].
pub fn reflight(
    input: &DiagnosisInput<'_>,
    effects: &EffectSet,
    noise: &ReportNoise,
    settings: &Settings,
) -> Result<ClosedLoop, NotReflown> {
    let control = GroundControl::new(input.vehicle)?;
    let mut calm = effects.clone();
    calm.remove(Gusts::ID);
    let free = control.without_limits();
    let simulation = Simulation {
        limited: simulators(&control, input.vehicle, &calm, noise)?,
        unlimited: simulators(&free, input.vehicle, &calm, noise)?,
        reports: [&EffectSet::new(), &calm].map(|effects| Reports::of(input.vehicle, effects)),
        allocation: input.vehicle.allocation().map_err(NotSimulated::from)?,
    };
    let parts: Vec<(&PreparedFlight, Course)> = input
        .held_out
        .iter()
        .flat_map(|flight| {
            courses(flight, &control).into_iter().map(move |course| (flight, course))
        })
        .collect();
    let flown: Vec<(Reflown, [SquaredDifferences; 3])> = parts
        .par_iter()
        .enumerate()
        .map(|(part, (flight, course))| {
            let seed = settings.seed.wrapping_add((part as u64) << 32);
            simulation.compare(flight, course, seed)
        })
        .collect::<Result<_, NotSimulated>>()?;
    if flown.is_empty() {
        return Err(NotReflown::NoMotion);
    }
    let mut totals = [SquaredDifferences::default(); 3];
    for (_, sums) in &flown {
        totals.iter_mut().zip(sums).for_each(|(total, sums)| total.add(sums));
    }
    let difference = |quantity: usize| {
        let [before, after, floor] = totals.map(|sums| sums.root_mean(quantity));
        Difference { before, after, floor }
    };
    Ok(ClosedLoop {
        position_m: difference(0),
        attitude_rad: difference(1),
        thrust_n: difference(2),
        moment_nm: difference(3),
        output: difference(4),
        flights: flown.into_iter().map(|(reflown, _)| reflown).collect(),
    })
}

/// The vehicle as shipped and with `effects`, under one controller.
fn simulators<'a>(
    control: &'a GroundControl,
    vehicle: &'a VehicleParams,
    effects: &EffectSet,
    noise: &ReportNoise,
) -> Result<[FlightSimulator<'a>; 2], NotSimulated> {
    let simulator =
        |effects: &EffectSet| FlightSimulator::new(control, vehicle, effects, noise.sensors());
    Ok([simulator(&EffectSet::new())?, simulator(effects)?])
}

/// The simulators for parts of flights: the vehicle as shipped, and with the effects.
struct Simulation<'a> {
    /// Under the daemon's limits, and without them.
    limited: [FlightSimulator<'a>; 2],
    unlimited: [FlightSimulator<'a>; 2],
    reports: [Reports; 2],
    allocation: Allocation,
}

impl Simulation<'_> {
    /// Flies one part again. Returns the differences of the log from the vehicle as shipped, of the
    /// log from the vehicle with the effects, and of the latter from another draw of its noise.
    fn compare(
        &self,
        flight: &PreparedFlight,
        course: &Course,
        seed: u64,
    ) -> Result<(Reflown, [SquaredDifferences; 3]), NotSimulated> {
        let log = Motion::of_logged(flight, course, &self.allocation);
        let fly = |vehicle, seed| self.fly(vehicle, flight, course, seed);
        let (before, after, again) = (fly(0, seed)?, fly(1, seed)?, fly(1, !seed)?);
        let sums = [
            log.squared_differences(&before),
            log.squared_differences(&after),
            after.squared_differences(&again),
        ];
        let reflown = Reflown {
            name: flight.name.clone(),
            reference: course.origin,
            seconds: course.seconds(),
            traces: Traces {
                time_s: (0..log.states.len()).map(|k| k as f64 * SPACING_S).collect(),
                position_m: [log.distances(&before), log.distances(&after)],
                thrust_n: [log.thrust_beyond(&before), log.thrust_beyond(&after)],
                logged: log.columns(),
                simulated: [before.columns(), after.columns()],
            },
        };
        Ok((reflown, sums))
    }

    /// The motion of the vehicle with index `vehicle` along a course.
    fn fly(
        &self,
        vehicle: usize,
        flight: &PreparedFlight,
        course: &Course,
        seed: u64,
    ) -> Result<Motion, NotSimulated> {
        let simulator = match course.origin {
            ReferenceOrigin::Setpoints => &self.unlimited[vehicle],
            ReferenceOrigin::Logged | ReferenceOrigin::Reported => &self.limited[vehicle],
        };
        let departure = self.reports[vehicle].departure(flight, course.start());
        let voltage = flight.channels.voltage.then_some(&flight.voltage);
        let mut commanded = course.clone();
        for _ in 0..course.rounds() {
            let flown = simulator.fly(&departure, &commanded.ticks, voltage, seed)?;
            commanded = course.learned(&commanded, &flown);
        }
        let flown = simulator.fly(&departure, &commanded.ticks, voltage, seed)?;
        Ok(Motion::of_simulated(&flown, course, &self.allocation))
    }
}

/// How a vehicle's reports differ from its true state.
struct Reports {
    latency_s: f64,
    untrim: Attitude,
}

impl Reports {
    fn of(vehicle: &VehicleParams, effects: &EffectSet) -> Self {
        let all = vehicle.modelled_effects.overlay(effects);
        Self {
            latency_s: all.get::<EstimatorLatency>().map_or(0.0, |effect| effect.latency_s),
            untrim: all
                .get::<AttitudeTrim>()
                .map_or(Attitude::default(), |trim| trim.rotation().inverse()),
        }
    }

    /// The true state behind the report of `flight` at `time`.
    fn departure(&self, flight: &PreparedFlight, time: f64) -> Departure {
        let reported = state_at(flight, time + self.latency_s);
        Departure {
            time,
            state: State {
                attitude: reported.attitude.compose(self.untrim),
                body_rate: flight.body_rate.at(time).into(),
                ..reported
            },
            rotors: flight.outputs.at(time),
        }
    }
}

/// The reported state at `time`.
fn state_at(flight: &PreparedFlight, time: f64) -> State {
    State {
        position: flight.position.at(time).into(),
        velocity: flight.velocity.at(time).into(),
        attitude: flight.attitude.attitude_at(time),
        body_rate: flight.body_rate.at(time).into(),
    }
}

/// Motion and commands of a flight at the compared instants.
struct Motion {
    states: Vec<(Ned, Attitude)>,
    /// Collective (N), moments (N m) and outputs.
    commands: Vec<([f64; 4], [f64; 4])>,
}

impl Motion {
    fn of_logged(flight: &PreparedFlight, course: &Course, allocation: &Allocation) -> Self {
        let pose = |time| {
            let state = state_at(flight, time);
            (state.position, state.attitude)
        };
        Self::new(course, pose, &flight.outputs, allocation)
    }

    fn of_simulated(flight: &Flight, course: &Course, allocation: &Allocation) -> Self {
        let position = Series::<3>::of(&flight.position, |p| p.to_array());
        let pose = |time| {
            let attitude = nearest(&flight.attitude, time).unwrap_or_default();
            (Ned::from(position.at(time)), attitude)
        };
        let outputs = Series::of(&flight.outputs, |u: &[f64; 4]| *u);
        Self::new(course, pose, &outputs, allocation)
    }

    fn new(
        course: &Course,
        pose: impl Fn(f64) -> (Ned, Attitude),
        outputs: &Series<4>,
        allocation: &Allocation,
    ) -> Self {
        let count = (course.seconds() / SPACING_S) as usize;
        let at = |k: usize| course.start() + k as f64 * SPACING_S;
        let mut cursor = outputs.cursor();
        let raw: Vec<[f64; 4]> = (0..count).map(|k| cursor.at(at(k))).collect();
        let commands = (0..count)
            .map(|k| {
                let near = &raw[k.saturating_sub(AVERAGED_INSTANTS / 2)
                    ..(k + AVERAGED_INSTANTS / 2 + 1).min(count)];
                let mean = std::array::from_fn(|i| {
                    near.iter().map(|u| u[i]).sum::<f64>() / near.len() as f64
                });
                (allocation.wrench(mean), mean)
            })
            .collect();
        Self { states: (0..count).map(|k| pose(at(k))).collect(), commands }
    }

    /// North, east, down, m, and thrust, N, over time.
    fn columns(&self) -> [Vec<f64>; 4] {
        let axis = |axis: usize| self.states.iter().map(|(p, _)| p.to_array()[axis]).collect();
        let thrust = self.commands.iter().map(|(wrench, _)| wrench[0]).collect();
        [axis(0), axis(1), axis(2), thrust]
    }

    /// Distances between the positions over time, m.
    fn distances(&self, other: &Self) -> Vec<f64> {
        let pairs = self.states.iter().zip(&other.states);
        pairs.map(|((p, _), (q, _))| (*p - *q).norm()).collect()
    }

    /// Thrust of `other` beyond that of `self`, N.
    fn thrust_beyond(&self, other: &Self) -> Vec<f64> {
        let pairs = self.commands.iter().zip(&other.commands);
        pairs.map(|((a, _), (b, _))| b[0] - a[0]).collect()
    }

    fn squared_differences(&self, other: &Self) -> SquaredDifferences {
        let mut sums = SquaredDifferences::default();
        for (((p, a), (wrench, u)), ((q, b), (other_wrench, v))) in
            self.states.iter().zip(&self.commands).zip(other.states.iter().zip(&other.commands))
        {
            let moment: Frd = std::array::from_fn(|i| wrench[i + 1] - other_wrench[i + 1]).into();
            let output = u.iter().zip(v).map(|(u, v)| (u - v).powi(2)).sum::<f64>() / 4.0;
            sums.count += 1.0;
            let squares = [
                (*p - *q).norm().powi(2),
                a.angle_to(*b).powi(2),
                (wrench[0] - other_wrench[0]).powi(2),
                moment.norm().powi(2),
                output,
            ];
            sums.squares.iter_mut().zip(squares).for_each(|(sum, square)| *sum += square);
        }
        sums
    }
}

/// The attitude of the sample nearest to `time`.
fn nearest(stream: &Stream<Attitude>, time: f64) -> Option<Attitude> {
    let index = stream.index_at(time).unwrap_or(0);
    let next = (index + 1).min(stream.len().checked_sub(1)?);
    let times = stream.times();
    let is_nearer = (times[next] - time).abs() < (times[index] - time).abs();
    stream.values().get(if is_nearer { next } else { index }).copied()
}

/// Sums of squared differences of position, attitude, thrust, moment and output.
#[derive(Clone, Copy, Default)]
struct SquaredDifferences {
    squares: [f64; 5],
    count: f64,
}

impl SquaredDifferences {
    fn add(&mut self, other: &Self) {
        self.squares.iter_mut().zip(other.squares).for_each(|(a, b)| *a += b);
        self.count += other.count;
    }

    /// Root mean square difference of the quantity with this index.
    fn root_mean(&self, quantity: usize) -> f64 {
        (self.squares[quantity] / self.count.max(1.0)).sqrt()
    }
}
