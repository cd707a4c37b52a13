//! From samples of a flight, each stream at its own rate, to cells of fixed length.

use std::collections::VecDeque;

use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::rotor::Lag;
use vehicle::{ROTORS, VehicleError, VehicleParams};

use super::columns::Sizes;
pub(super) use super::equations::EQUATIONS;
pub use super::equations::Row;
use super::equations::{Equations, Means};

/// Length of a cell, s: short compared with the wanted resolution of an onset, long compared with
/// the periods of reports.
pub const CELL_S: f64 = 0.05;
/// Number of points in a cell for the means.
const POINTS: usize = 5;
/// A longer gap in a stream counts as a pause, s.
const PAUSE_S: f64 = 0.35;
/// Cells after a pause in which the rotors' states are not known yet.
const SETTLING: usize = 8;
/// Samples kept per stream: a second at a kilohertz.
const KEPT: usize = 1024;

/// One sample of the vehicle's reports.
#[derive(Clone, Copy, Debug)]
pub enum Sample {
    /// Position, m.
    Position(Ned),
    /// Velocity, m/s.
    Velocity(Ned),
    /// Rotation from body to world.
    Attitude(Attitude),
    /// Body rate, rad/s.
    BodyRate(Frd),
    /// Specific force, m/s^2.
    SpecificForce(Frd),
    /// Motor outputs, 0..1.
    Outputs([f64; ROTORS]),
    /// Pack voltage, V.
    Voltage(f64),
    /// The vehicle is no longer in free flight: it is on the ground, or the log pauses.
    Pause,
}

/// One cell of a flight.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Its start, s.
    pub time: f64,
    /// Its equations.
    pub rows: [Row; EQUATIONS],
}

/// The next output from the samples.
#[derive(Clone, Debug)]
pub enum Piece {
    /// The next cell.
    Cell(Box<Cell>),
    /// What follows does not continue what came before.
    Pause,
}

/// A stream's newest samples.
#[derive(Clone, Debug)]
struct Stream<const N: usize> {
    samples: VecDeque<(f64, [f64; N])>,
}

impl<const N: usize> Default for Stream<N> {
    fn default() -> Self {
        Self { samples: VecDeque::with_capacity(KEPT) }
    }
}

impl<const N: usize> Stream<N> {
    /// Adds a finite sample that is later than the last.
    fn push(&mut self, time: f64, values: [f64; N]) {
        let is_later = self.samples.back().is_none_or(|(last, _)| time > *last);
        if is_later && values.iter().all(|value| value.is_finite()) {
            if self.samples.len() == KEPT {
                self.samples.pop_front();
            }
            self.samples.push_back((time, values));
        }
    }

    fn first(&self) -> Option<f64> {
        self.samples.front().map(|(time, _)| *time)
    }

    fn last(&self) -> Option<f64> {
        self.samples.back().map(|(time, _)| *time)
    }

    /// Whether it covers a cell that ends at `end`.
    fn reaches(&self, end: f64) -> bool {
        self.last().is_some_and(|last| last >= end)
    }

    /// Drops everything before the last sample that precedes `time`.
    fn forget(&mut self, time: f64) {
        while self.samples.get(1).is_some_and(|(next, _)| *next < time) {
            self.samples.pop_front();
        }
    }

    /// Whether it has no pause from `start` to `end`.
    fn is_unbroken(&self, start: f64, end: f64) -> bool {
        let mut before = match self.first() {
            Some(first) if first <= start => first,
            _ => return false,
        };
        for (time, _) in &self.samples {
            if *time > start && *time - before > PAUSE_S {
                return false;
            }
            before = *time;
            if *time >= end {
                return true;
            }
        }
        false
    }

    /// The value at a time, interpolated linearly.
    fn at(&self, time: f64) -> Option<[f64; N]> {
        let after = self.samples.partition_point(|(t, _)| *t < time);
        let (t1, b) = self.samples.get(after)?;
        let Some((t0, a)) = after.checked_sub(1).and_then(|before| self.samples.get(before)) else {
            return (*t1 == time).then_some(*b);
        };
        let share = (time - t0) / (t1 - t0);
        Some(std::array::from_fn(|i| a[i] + share * (b[i] - a[i])))
    }
}

/// Makes cells from samples.
#[derive(Clone, Debug)]
pub struct Cells {
    equations: Equations,
    lag: Lag,
    position: Stream<3>,
    velocity: Stream<3>,
    attitude: Stream<4>,
    body_rate: Stream<3>,
    specific_force: Stream<3>,
    outputs: Stream<4>,
    voltage: Stream<1>,
    /// Start of the next cell, s.
    next: Option<f64>,
    rotors: [f64; ROTORS],
    settling: usize,
    newest: f64,
    /// Whether a pause is still to be reported.
    paused: bool,
}

impl Cells {
    /// Makes cells for flights of a vehicle.
    ///
    /// # Errors
    /// The physics rejects the vehicle.
    pub fn new(vehicle: &VehicleParams) -> Result<Self, VehicleError> {
        let equations = Equations::new(vehicle)?;
        Ok(Self {
            lag: Lag::new(equations.lag_s(), CELL_S / POINTS as f64),
            equations,
            position: Stream::default(),
            velocity: Stream::default(),
            attitude: Stream::default(),
            body_rate: Stream::default(),
            specific_force: Stream::default(),
            outputs: Stream::default(),
            voltage: Stream::default(),
            next: None,
            rotors: [0.0; ROTORS],
            settling: SETTLING,
            newest: f64::NEG_INFINITY,
            paused: false,
        })
    }

    /// The sizes that scale the slopes.
    pub fn sizes(&self) -> &Sizes {
        self.equations.sizes()
    }

    /// Adds a sample at `time`, s of the vehicle's clock. Values that are not finite, or late in
    /// their stream, are dropped.
    pub fn push(&mut self, time: f64, sample: Sample) {
        if !time.is_finite() {
            return;
        }
        self.newest = self.newest.max(time);
        match sample {
            Sample::Position(value) => self.position.push(time, value.to_array()),
            Sample::Velocity(value) => self.velocity.push(time, value.to_array()),
            Sample::Attitude(q) => {
                let mut q = [q.w, q.x, q.y, q.z];
                if let Some((_, last)) = self.attitude.samples.back()
                    && last.iter().zip(q).map(|(a, b)| a * b).sum::<f64>() < 0.0
                {
                    q = q.map(|c| -c);
                }
                self.attitude.push(time, q);
            }
            Sample::BodyRate(value) => self.body_rate.push(time, value.to_array()),
            Sample::SpecificForce(value) => self.specific_force.push(time, value.to_array()),
            Sample::Outputs(value) => self.outputs.push(time, value),
            Sample::Voltage(value) => self.voltage.push(time, [value]),
            Sample::Pause => self.pause(),
        }
    }

    /// The next piece that the samples so far complete.
    pub fn next_piece(&mut self) -> Option<Piece> {
        loop {
            if std::mem::take(&mut self.paused) {
                return Some(Piece::Pause);
            }
            let start = match self.next {
                Some(start) => start,
                None => self.begin()?,
            };
            let end = start + CELL_S;
            let is_late = self.newest > end + PAUSE_S;
            let is_reached = self.attitude.reaches(end) && self.outputs.reaches(end);
            if !is_reached && !is_late {
                return None;
            }
            let is_complete =
                self.attitude.is_unbroken(start, end) && self.outputs.is_unbroken(start, end);
            if !is_complete {
                self.pause();
                continue;
            }
            // Wait for the other streams, if the vehicle reports them.
            let is_due = |first: Option<f64>, reaches: bool| first.is_none() || reaches || is_late;
            let is_ready = is_due(self.velocity.first(), self.velocity.reaches(end))
                && is_due(self.body_rate.first(), self.body_rate.reaches(end))
                && is_due(self.specific_force.first(), self.specific_force.reaches(end));
            if !is_ready {
                return None;
            }
            self.next = Some(end);
            let cell = self.cell(start, end);
            self.forget(end);
            if self.settling > 0 {
                self.settling -= 1;
                continue;
            }
            return cell.map(|cell| Piece::Cell(Box::new(cell)));
        }
    }

    /// Starts the cells at the first time that both required streams cover.
    fn begin(&mut self) -> Option<f64> {
        let start = self.attitude.first()?.max(self.outputs.first()?);
        if !(self.attitude.reaches(start) && self.outputs.reaches(start)) {
            return None;
        }
        self.rotors = self.outputs.at(start)?;
        self.settling = SETTLING;
        self.next = Some(start);
        Some(start)
    }

    /// Discards all samples; reports a pause if there were cells.
    fn pause(&mut self) {
        self.paused |= self.next.is_some();
        self.next = None;
        self.position.samples.clear();
        self.velocity.samples.clear();
        self.attitude.samples.clear();
        self.body_rate.samples.clear();
        self.specific_force.samples.clear();
        self.outputs.samples.clear();
        self.newest = f64::NEG_INFINITY;
    }

    fn forget(&mut self, time: f64) {
        self.position.forget(time);
        self.velocity.forget(time);
        self.attitude.forget(time);
        self.body_rate.forget(time);
        self.specific_force.forget(time);
        self.outputs.forget(time);
        self.voltage.forget(time);
    }

    fn cell(&mut self, start: f64, end: f64) -> Option<Cell> {
        let step = CELL_S / POINTS as f64;
        let mut rotors = [0.0; ROTORS];
        let mut before = self.outputs.at(start)?;
        for k in 0..POINTS {
            let after = self.outputs.at(start + (k + 1) as f64 * step)?;
            let [mean, state] = self.lag.follow(&self.rotors, [&before, &after]);
            (before, self.rotors) = (after, state);
            for (sum, mean) in rotors.iter_mut().zip(mean) {
                *sum += mean / POINTS as f64;
            }
        }
        let times = std::array::from_fn::<f64, POINTS, _>(|k| start + (k as f64 + 0.5) * step);
        let [w, x, y, z] = mean(&self.attitude, &times)?;
        let has = |first: Option<f64>, is_complete: bool| first.is_some() && is_complete;
        let moves = has(self.velocity.first(), self.velocity.is_unbroken(start, end));
        let turns = has(self.body_rate.first(), self.body_rate.is_unbroken(start, end));
        let feels = has(self.specific_force.first(), self.specific_force.is_unbroken(start, end));
        let gained = |stream: &Stream<3>| -> Option<[f64; 3]> {
            let (a, b) = (stream.at(start)?, stream.at(end)?);
            Some(std::array::from_fn(|i| (b[i] - a[i]) / CELL_S))
        };
        let means = Means {
            position: self.position.at(times[POINTS / 2]).map_or(Ned::zero(), Ned::from),
            velocity: mean(&self.velocity, &times).map_or(Ned::zero(), Ned::from),
            attitude: Attitude { w, x, y, z }.normalized(),
            body_rate: mean(&self.body_rate, &times).map_or(Frd::zero(), Frd::from),
            rotors,
            voltage: self.voltage.samples.back().map(|(_, [volts])| *volts),
            acceleration: gained(&self.velocity).filter(|_| moves).map(Ned::from),
            specific_force: mean(&self.specific_force, &times).filter(|_| feels).map(Frd::from),
            angular_acceleration: gained(&self.body_rate).filter(|_| turns).map(Frd::from),
        };
        Some(Cell { time: start, rows: self.equations.rows(&means) })
    }
}

fn mean<const N: usize>(stream: &Stream<N>, times: &[f64]) -> Option<[f64; N]> {
    let mut sum = [0.0; N];
    for time in times {
        for (sum, value) in sum.iter_mut().zip(stream.at(*time)?) {
            *sum += value / times.len() as f64;
        }
    }
    Some(sum)
}
