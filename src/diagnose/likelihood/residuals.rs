//! Residuals of a flight under a candidate vehicle, by channel and frequency.
//!
//! Each channel is an equation of motion or of measurement over a cell of [`CELL_S`], evaluated at
//! the reported state with the candidate's delays and trims:
//!
//! | channel | residual |
//! |---|---|
//! | velocity | increment of the velocity minus the acceleration of the forces, world axes |
//! | specific force | accelerometer minus the forces over mass, body axes |
//! | rate | increment of the body rate minus the angular acceleration of the moments |
//! | attitude | rotation of the attitude minus the body rate: kinematics, no vehicle model |
//! | command | collective and moments of the logged outputs minus the on-board law's |
//!
//! The coefficients of the velocity compare its increment with the candidate's acceleration smoothed
//! as the reported velocity is: times `exp(-v (2 pi f)^2 / 2)` at the frequency f, where v is the
//! variance of the times that a reported velocity averages over.
//! Specific force and attitude leave out each block's mean, and with it the constant bias of
//! accelerometer and gyro.

use std::f64::consts::PI;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use vehicle::effects::{AttitudeTrim, EffectId};
use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::physics::{Environment, Loads, Physics};
use vehicle::rigid_body::State;
use vehicle::rotor::Lag;
use vehicle::{ROTORS, VehicleParams};

use crate::diagnose::catalogue::candidate::Candidate;
use crate::diagnose::catalogue::number::Target;
use crate::diagnose::flights::command_delay::MeasuredDelay;
use crate::diagnose::flights::onboard::{OnboardLaw, Timing};
use crate::diagnose::flights::preparation::{Block, PreparedFlight};
use crate::diagnose::flights::series::attitude;
use crate::diagnose::flights::spectrum::{CELL_S, CosineTransform, band, frequency};
use crate::diagnose::likelihood::channels::{ATTITUDE, CHANNELS, COMMAND, FORCE, RATE, VELOCITY};
use crate::diagnose::likelihood::layout::Layout;

/// Sub-steps of the rotors' lag per cell.
const SUBSTEPS: usize = 4;
/// Time before a block over which the rotors' states are simulated, in time constants; at most
/// [`WARM_UP_MAX_S`].
const WARM_UP: f64 = 6.0;
const WARM_UP_MAX_S: f64 = 0.5;

/// Groups of channels that are evaluated together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Groups {
    /// Velocity, specific force, rate.
    pub dynamics: bool,
    /// Attitude.
    pub kinematics: bool,
    /// Command.
    pub command: bool,
}

impl Groups {
    /// Every group.
    pub const ALL: Self = Self { dynamics: true, kinematics: true, command: true };

    /// The groups that a number affects.
    pub fn of(target: Target) -> Self {
        let [dynamics, kinematics, command] = match target {
            Target::Effect(EffectId::PdGain | EffectId::CommandDelay, _) => [false, false, true],
            Target::Effect(EffectId::EstimatorLatency, _) => [true, true, true],
            Target::Effect(EffectId::AttitudeTrim, _) => [true, true, false],
            _ => [true, false, false],
        };
        Self { dynamics, kinematics, command }
    }

    /// Whether a channel belongs to these groups.
    pub fn has(self, channel: usize) -> bool {
        match channel {
            0..ATTITUDE => self.dynamics,
            ATTITUDE..COMMAND => self.kinematics,
            _ => self.command,
        }
    }
}

/// Inputs that all evaluations share.
#[derive(Clone, Debug)]
pub struct Evaluator {
    vehicle: VehicleParams,
    onboard: Option<OnboardLaw>,
    transform: CosineTransform,
    stop: Arc<AtomicBool>,
}

/// A block over time, one value a cell.
#[derive(Clone, Debug)]
pub struct Series {
    /// The residuals, one series a channel, in the channel's unit.
    pub residuals: [Vec<f64>; CHANNELS],
    /// The candidate's acceleration along north, east and down, m/s^2.
    acceleration: [Vec<f64>; 3],
}

/// Motion over a block according to the candidate.
struct Motion {
    /// At the edges of the cells, like attitude and body rate.
    velocity: Vec<Ned>,
    attitude: Vec<Attitude>,
    body_rate: Vec<Frd>,
    /// At the middles of the cells, with the mean velocity and body rate over them.
    states: Vec<State>,
    /// At the middles of the cells.
    specific_force: Vec<Frd>,
}

impl Evaluator {
    /// An evaluator for flights of `vehicle`, whose on-board law it knows if the file states one.
    pub fn new(vehicle: &VehicleParams) -> Self {
        Self {
            vehicle: vehicle.clone(),
            onboard: OnboardLaw::new(vehicle),
            transform: CosineTransform::default(),
            stop: Arc::default(),
        }
    }

    /// Stops all evaluations once the caller sets `stop`.
    pub fn until(self, stop: &Arc<AtomicBool>) -> Self {
        Self { stop: Arc::clone(stop), ..self }
    }

    /// Whether the caller has set `stop`.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Adapts the on-board law to the order of reports and ticks in `flights`.
    pub fn observing(mut self, flights: &[PreparedFlight]) -> Self {
        let shipped = self.vehicle.command_delay_s;
        let timing = |law: &OnboardLaw| {
            let command_delay = MeasuredDelay::of(flights, law).map_or(shipped, |delay| delay.mean);
            Timing { command_delay, latency: 0.0 }
        };
        self.onboard = self.onboard.map(|law| law.observing(flights, timing));
        self
    }

    /// The on-board law, if the vehicle file states it.
    pub fn onboard(&self) -> Option<&OnboardLaw> {
        self.onboard.as_ref()
    }

    /// A block of `flight`, to be evaluated under one candidate after another.
    pub fn block<'a>(
        &'a self,
        flight: &'a PreparedFlight,
        layout: &'a Layout,
        block: &'a Block,
    ) -> BlockEvaluator<'a> {
        BlockEvaluator { evaluator: self, flight, layout, block, motion: None, rotors: None }
    }

    /// The coefficients of the angular acceleration from the gyro, in `layout`'s order; 0 in other
    /// channels.
    pub fn angular_acceleration(&self, flight: &PreparedFlight, layout: &Layout) -> Vec<f64> {
        let mut out = Vec::with_capacity(layout.bins.len());
        for block in &flight.blocks {
            let mut series: [Vec<f64>; CHANNELS] = std::array::from_fn(|_| vec![0.0; block.cells]);
            let mut rate = flight.body_rate.cursor();
            let mut before = Frd::from(rate.at(block.start));
            for k in 0..block.cells {
                let after = Frd::from(rate.at(block.edge(k + 1)));
                put(&mut series, RATE, k, ((after - before) * (1.0 / CELL_S)).to_array());
                before = after;
            }
            self.transform.apply(&mut in_use(&mut series, layout, block, Groups::ALL));
            append(&mut out, layout, block, &series);
        }
        out
    }
}

/// A block of a flight, evaluated under one candidate after another. It keeps what successive
/// candidates share.
pub struct BlockEvaluator<'a> {
    evaluator: &'a Evaluator,
    flight: &'a PreparedFlight,
    layout: &'a Layout,
    block: &'a Block,
    /// The motion by latency and trim.
    motion: Option<((f64, Option<AttitudeTrim>), Motion)>,
    /// The rotors' states by the outputs' delay and lag.
    rotors: Option<([f64; 2], Vec<[f64; ROTORS]>)>,
}

impl BlockEvaluator<'_> {
    /// The coefficients in use under `candidate`, in the layout's order; 0 outside `groups`.
    pub fn coefficients(&mut self, candidate: &Candidate, groups: Groups) -> Vec<f64> {
        let Series { residuals: mut series, mut acceleration } = self.series(candidate, groups);
        let Self { evaluator, layout, block, .. } = self;
        let is_smoothed =
            groups.dynamics && layout.has(VELOCITY) && candidate.velocity_smoothing > 0.0;
        let mut in_use = in_use(&mut series, layout, block, groups);
        if is_smoothed {
            in_use.extend(acceleration.iter_mut().map(Vec::as_mut_slice));
        }
        evaluator.transform.apply(&mut in_use);
        if is_smoothed {
            for (residual, acceleration) in series[VELOCITY..FORCE].iter_mut().zip(&acceleration) {
                for index in layout.used(VELOCITY, block) {
                    let angular = 2.0 * PI * frequency(index, block.cells);
                    let kept = (-0.5 * candidate.velocity_smoothing * angular * angular).exp();
                    residual[index] += (1.0 - kept) * acceleration[index];
                }
            }
        }
        let mut out = Vec::new();
        append(&mut out, layout, block, &series);
        out
    }

    /// The block over time. Its residuals are those of an unsmoothed velocity.
    pub fn series(&mut self, candidate: &Candidate, groups: Groups) -> Series {
        let cells = self.block.cells;
        let mut series = Series {
            residuals: std::array::from_fn(|_| vec![0.0; cells]),
            acceleration: std::array::from_fn(|_| vec![0.0; cells]),
        };
        if groups.dynamics || groups.kinematics {
            self.motion(candidate, &mut series);
        }
        if groups.command && self.layout.has(COMMAND) {
            self.command(candidate, &mut series.residuals);
        }
        series
    }

    /// Fills in the velocity, specific force, rate and attitude channels.
    fn motion(
        &mut self,
        candidate: &Candidate,
        Series { residuals: series, acceleration }: &mut Series,
    ) {
        let (flight, block) = (self.flight, self.block);
        let seen = (candidate.latency, candidate.trim);
        let motion = match self.motion.take().filter(|(of, _)| *of == seen) {
            Some((_, motion)) => motion,
            None => motion(flight, block, candidate),
        };
        let driven = [candidate.output_delay, candidate.lag];
        let rotors = match self.rotors.take().filter(|(of, _)| *of == driven) {
            Some((_, rotors)) => rotors,
            None => rotors(flight, block, candidate),
        };
        let physics = &candidate.physics;
        let loads = self.loads(physics, &rotors);
        let mut voltage = flight.voltage.cursor();
        let full_v = self.evaluator.vehicle.battery.full_v;
        let gravity = Ned::new(0.0, 0.0, physics.body().gravity());
        for (k, (state, loads)) in motion.states.iter().zip(&loads).enumerate() {
            let [volts] = voltage.at(block.middle(k));
            let volts = if flight.channels.voltage { volts } else { full_v };
            let time = block.middle(k);
            let environment = Environment { time, ..physics.environment(volts, Ned::zero()) };
            let (linear, angular) = physics.accelerations_under(state, loads, &environment);
            let gained = (motion.velocity[k + 1] - motion.velocity[k]) * (1.0 / CELL_S);
            put(series, VELOCITY, k, (gained - linear).to_array());
            acceleration
                .iter_mut()
                .zip(linear.to_array())
                .for_each(|(axis, value)| axis[k] = value);
            let force = state.attitude.to_body(linear - gravity);
            put(series, FORCE, k, (motion.specific_force[k] - force).to_array());
            let turned = (motion.body_rate[k + 1] - motion.body_rate[k]) * (1.0 / CELL_S);
            put(series, RATE, k, (turned - angular).to_array());
            let turn = motion.attitude[k].inverse().compose(motion.attitude[k + 1]).canonical();
            let turn = Frd::new(turn.x, turn.y, turn.z) * (2.0 / CELL_S);
            put(series, ATTITUDE, k, (turn - state.body_rate).to_array());
        }
        self.motion = Some((seen, motion));
        self.rotors = Some((driven, rotors));
    }

    /// Loads over each cell, with the reaction to the rotors' change of speed.
    fn loads(&self, physics: &Physics, rotors: &[[f64; ROTORS]]) -> Vec<Loads<f64>> {
        let Self { evaluator, flight, block, .. } = self;
        let mut voltage = flight.voltage.cursor();
        let loads: Vec<Loads<f64>> = (0..block.cells)
            .map(|k| {
                let [volts] = voltage.at(block.middle(k));
                let volts =
                    if flight.channels.voltage { volts } else { evaluator.vehicle.battery.full_v };
                physics.loads(&rotors[k], &physics.environment(volts, Ned::zero()))
            })
            .collect();
        if !physics.has_spin_momentum() {
            return loads;
        }
        let last = block.cells - 1;
        (0..block.cells)
            .map(|k| {
                let (a, b) = (k.saturating_sub(1), (k + 1).min(last));
                let change = loads[b].spin_momentum() - loads[a].spin_momentum();
                loads[k].with_spin_momentum_rate(change / ((b - a) as f64 * CELL_S))
            })
            .collect()
    }

    /// Logged outputs minus the on-board law's, as collective thrust and moments.
    fn command(&self, candidate: &Candidate, series: &mut [Vec<f64>; CHANNELS]) {
        let Self { evaluator, flight, block, .. } = self;
        let Some(onboard) = &evaluator.onboard else { return };
        let law = onboard.with_gains(candidate.gains);
        let timing = Timing { command_delay: candidate.command_delay, latency: candidate.latency };
        let (first, last) = (block.start - 2.0 * CELL_S, block.end() + 2.0 * CELL_S);
        let times = flight.outputs.times();
        let from = times.partition_point(|t| *t < first);
        let to = times.partition_point(|t| *t <= last);
        let mut found: Vec<(f64, [f64; 4])> = Vec::with_capacity(to - from);
        for (time, logged) in times[from..to].iter().zip(&flight.outputs.values()[from..to]) {
            // The logged output is that of the loop's latest tick.
            let tick = onboard.tick_of_report(*time);
            if let Some(by_law) = onboard.outputs(&law, flight, tick, timing) {
                let difference = std::array::from_fn(|i| logged[i] - by_law[i]);
                found.push((*time, onboard.allocation().wrench(difference)));
            }
        }
        if to - from < 2 {
            return;
        }
        if found.len() < 2 || found.len() < (to - from) / 2 {
            // A law that predicts less than half of the logged outputs explains nothing.
            series[COMMAND..].iter_mut().for_each(|channel| channel.fill(f64::NAN));
            return;
        }
        let mut index = 0;
        for k in 0..block.cells {
            let time = block.middle(k);
            while index + 2 < found.len() && found[index + 1].0 <= time {
                index += 1;
            }
            let ((t0, a), (t1, b)) = (found[index], found[index + 1]);
            let share = ((time - t0) / (t1 - t0)).clamp(0.0, 1.0);
            put(
                series,
                COMMAND,
                k,
                std::array::from_fn::<f64, 4, _>(|i| a[i] + share * (b[i] - a[i])),
            );
        }
    }
}

/// The channels of `groups` in use in a block.
fn in_use<'a>(
    series: &'a mut [Vec<f64>; CHANNELS],
    layout: &Layout,
    block: &Block,
    groups: Groups,
) -> Vec<&'a mut [f64]> {
    let is_used = |channel: usize| {
        groups.has(channel) && layout.has(channel) && !layout.used(channel, block).is_empty()
    };
    let channels = series.iter_mut().enumerate().filter(|(channel, _)| is_used(*channel));
    channels.map(|(_, values)| values.as_mut_slice()).collect()
}

/// Appends the coefficients in use of a block's transformed series.
fn append(out: &mut Vec<f64>, layout: &Layout, block: &Block, series: &[Vec<f64>; CHANNELS]) {
    for (channel, values) in series.iter().enumerate() {
        let used = layout.used(channel, block);
        if used.is_empty() || !layout.has(channel) {
            continue;
        }
        let is_banded = |index: &usize| band(frequency(*index, block.cells)).is_some();
        out.extend(used.filter(is_banded).map(|index| values[index]));
    }
}

/// Writes `values` to cell `k` of the channels from `first`.
fn put<const N: usize>(
    series: &mut [Vec<f64>; CHANNELS],
    first: usize,
    k: usize,
    values: [f64; N],
) {
    for (channel, value) in series[first..first + N].iter_mut().zip(values) {
        channel[k] = value;
    }
}

/// The reported motion, with the candidate's latency and trim removed.
fn motion(flight: &PreparedFlight, block: &Block, candidate: &Candidate) -> Motion {
    let channels = &flight.channels;
    let untrim = candidate.trim.map(|trim| trim.rotation().inverse());
    let n = block.cells;
    let late = candidate.latency;
    let attitude_at = |raw: [f64; 4]| match (channels.attitude, untrim) {
        (false, _) => Attitude::default(),
        (true, None) => attitude(raw),
        (true, Some(untrim)) => attitude(raw).compose(untrim),
    };
    let mut cursor = flight.attitude.cursor();
    let attitude: Vec<Attitude> =
        (0..=n).map(|k| attitude_at(cursor.at(block.edge(k) + late))).collect();
    let mut cursor = flight.attitude.cursor();
    let middle: Vec<Attitude> =
        (0..n).map(|k| attitude_at(cursor.at(block.middle(k) + late))).collect();
    let mut cursor = flight.velocity.cursor();
    let velocity: Vec<Ned> = (0..=n).map(|k| Ned::from(cursor.at(block.edge(k) + late))).collect();
    let mut cursor = flight.body_rate.cursor();
    let body_rate: Vec<Frd> = (0..=n).map(|k| Frd::from(cursor.at(block.edge(k)))).collect();
    let mut rate = flight.body_rate.cursor();
    let mut position = flight.position.cursor();
    let mut force = flight.specific_force.cursor();
    let (mut states, mut specific_force) = (Vec::with_capacity(n), Vec::with_capacity(n));
    for k in 0..n {
        let time = block.middle(k);
        let ends = body_rate[k] + body_rate[k + 1];
        states.push(State {
            position: position.at(time + late).into(),
            velocity: (velocity[k] + velocity[k + 1]) * 0.5,
            attitude: middle[k],
            // Simpson's mean over the cell.
            body_rate: (ends + Frd::from(rate.at(time)) * 4.0) * (1.0 / 6.0),
        });
        specific_force.push(Frd::from(force.at(time)));
    }
    Motion { velocity, attitude, body_rate, states, specific_force }
}

/// Mean states of the rotors over each cell.
fn rotors(flight: &PreparedFlight, block: &Block, candidate: &Candidate) -> Vec<[f64; ROTORS]> {
    let step = CELL_S / SUBSTEPS as f64;
    let lag = Lag::new(candidate.lag, step);
    let warm = (WARM_UP * candidate.lag).min(WARM_UP_MAX_S);
    let warm_steps = (warm / step).ceil() as usize;
    let start = block.start - warm_steps as f64 * step;
    let mut outputs = flight.outputs.cursor();
    let at = |k: usize| start + k as f64 * step - candidate.output_delay;
    let mut before = outputs.at(at(0));
    let mut state = before;
    let mut means = Vec::with_capacity(block.cells);
    let mut sum = [0.0; ROTORS];
    for k in 0..warm_steps + block.cells * SUBSTEPS {
        let u = outputs.at(at(k + 1));
        let [mean, end] = lag.follow(&state, [&before, &u]);
        (before, state) = (u, end);
        if k < warm_steps {
            continue;
        }
        for (sum, s) in sum.iter_mut().zip(mean) {
            *sum += s / SUBSTEPS as f64;
        }
        if (k - warm_steps) % SUBSTEPS == SUBSTEPS - 1 {
            means.push(std::mem::replace(&mut sum, [0.0; ROTORS]));
        }
    }
    means
}
