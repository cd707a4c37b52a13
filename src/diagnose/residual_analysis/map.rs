//! The location of the gap: residuals of the shipped simulator against the floor, by channel and
//! time scale, by frame and by regime.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::Ned;

use crate::diagnose::catalogue::candidate::Candidate;
use crate::diagnose::flights::preparation::{Block, PreparedFlight};
use crate::diagnose::flights::spectrum::{BANDS, CELL_S, edges, mean_square_share};
use crate::diagnose::likelihood::channels::{CHANNEL_NAMES, CHANNELS, COMMAND, VELOCITY};
use crate::diagnose::likelihood::layout::{Bin, Layout};
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::likelihood::residuals::{Evaluator, Groups};

/// Time scales, each with its upper limit in Hz.
const SCALES: [(&str, f64); 3] = [("slow", 0.35), ("middle", 2.2), ("fast", 20.0)];
/// Cells over which a sample averages: 0.25 s.
const SAMPLE_CELLS: usize = 25;

/// One channel at one time scale.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Cell {
    /// Name of the channel's equation.
    pub channel: &'static str,
    /// `slow` (below 0.35 Hz), `middle` (to 2.2 Hz), `fast`.
    pub scale: &'static str,
    /// Root mean square residual of the shipped simulator, in the channel's SI unit.
    pub rms: f64,
    /// The floor: root mean square residual of the best explanation.
    pub floor: f64,
    /// Excess over the floor in units of it: (rms^2 - floor^2) / floor^2.
    pub excess: f64,
}

/// Dependence of the unexplained acceleration on one quantity.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Regime {
    /// Name of the quantity with its unit.
    pub quantity: &'static str,
    /// Bounds of its quarters: minimum, quartiles, maximum.
    pub bounds: [f64; 5],
    /// Root mean square of the unexplained acceleration in each quarter, m/s^2.
    pub rms: [f64; 4],
    /// As above for the best explanation, in the same quarters, m/s^2.
    pub rms_after: [f64; 4],
}

/// The residuals by channel, frame and regime.
#[derive(Clone, Debug, Default, JsonSchema, Serialize)]
pub struct ResidualMap {
    /// Channels and time scales, the largest excess first.
    pub cells: Vec<Cell>,
    /// Unexplained acceleration that is constant in the world: north, east, down, m/s^2.
    pub constant_in_world: Option<[f64; 3]>,
    /// Unexplained acceleration that is constant in the body: front, right, down, m/s^2.
    pub constant_in_body: Option<[f64; 3]>,
    /// Regimes, the steepest first.
    pub regimes: Vec<Regime>,
    /// A summary of the cells and regimes.
    pub sentence: String,
}

/// Maps the residuals of `shipped` and of `best`, the best explanation. `power` and `floor` are
/// their sums of squares by bin.
pub fn map(
    observed: &Observed<'_>,
    evaluator: &Evaluator,
    [shipped, best]: [&Candidate; 2],
    power: &[f64],
    floor: &[f64],
) -> ResidualMap {
    let mut cells: Vec<Cell> = (0..CHANNELS)
        .flat_map(|channel| (0..SCALES.len()).map(move |scale| (channel, scale)))
        .filter_map(|(channel, scale)| cell(observed.counts(), channel, scale, [power, floor]))
        .collect();
    cells.sort_by(|a, b| b.excess.total_cmp(&a.excess).then(a.channel.cmp(b.channel)));
    let after = samples(observed, evaluator, best);
    let samples = samples(observed, evaluator, shipped);
    let mean = |of: fn(&Sample) -> [f64; 3]| -> Option<[f64; 3]> {
        (!samples.is_empty()).then(|| {
            let n = samples.len() as f64;
            std::array::from_fn(|i| samples.iter().map(|s| of(s)[i]).sum::<f64>() / n)
        })
    };
    let mut regimes: Vec<Regime> = QUANTITIES
        .iter()
        .enumerate()
        .filter_map(|(index, quantity)| regime(&samples, &after, index, quantity))
        .collect();
    regimes.sort_by(|a, b| steepness(b).total_cmp(&steepness(a)));
    let constant_in_world = mean(|s| s.world);
    let constant_in_body = mean(|s| s.body);
    let sentence = sentence(&cells, &regimes);
    ResidualMap { cells, constant_in_world, constant_in_body, regimes, sentence }
}

/// One channel at the time scale of index `scale`, from the sums of squares by bin of the shipped
/// simulator and of the best explanation; `None` without coefficients.
fn cell(counts: &[f64], channel: usize, scale: usize, [power, floor]: [&[f64]; 2]) -> Option<Cell> {
    let lower = scale.checked_sub(1).map_or(0.0, |below| SCALES[below].1);
    let (name, upper) = SCALES[scale];
    let (mut before, mut after, mut is_counted) = (0.0, 0.0, false);
    for band in 0..BANDS.len() {
        let bin = Bin::index_of(channel, band);
        let [from, to] = edges(band);
        if counts[bin] > 0.0 && from >= lower && to <= upper {
            let share = mean_square_share(band) / counts[bin];
            before += power[bin] * share;
            after += floor[bin] * share;
            is_counted = true;
        }
    }
    (is_counted && after > 0.0).then(|| Cell {
        channel: CHANNEL_NAMES[channel],
        scale: name,
        rms: f64::sqrt(before),
        floor: f64::sqrt(after),
        excess: (before - after) / after,
    })
}

/// Quantities that define regimes.
pub(in crate::diagnose) const QUANTITIES: [&str; 7] = [
    "speed [m/s]",
    "climb [m/s]",
    "height [m]",
    "throttle [0..1]",
    "voltage [V]",
    "turn [rad/s]",
    "time [s]",
];

/// Quantities of the body's motion, of place and of heading, for further dependences.
const OF_BODY: [&str; 6] = [
    "velocity forward [m/s]",
    "velocity right [m/s]",
    "velocity down [m/s]",
    "roll rate [rad/s]",
    "pitch rate [rad/s]",
    "yaw rate [rad/s]",
];
const OF_PLACE: [&str; 3] = ["position north [m]", "position east [m]", "heading [rad]"];

/// The unexplained acceleration over a quarter of a second, with the vehicle's motion.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Unexplained acceleration along north, east, down, m/s^2.
    pub world: [f64; 3],
    /// The same acceleration along front, right, down of the body, m/s^2.
    pub body: [f64; 3],
    /// Velocity along north, east, down, m/s.
    pub velocity: [f64; 3],
    /// Velocity in body axes, m/s.
    pub body_velocity: [f64; 3],
    /// Body rate, rad/s.
    pub body_rate: [f64; 3],
    quantities: [f64; QUANTITIES.len()],
    place: [f64; OF_PLACE.len()],
}

impl Sample {
    /// Mean motor output, 0..1.
    pub fn throttle(&self) -> f64 {
        self.quantities[3]
    }

    /// Time since the start of the flight's airborne time, s.
    pub fn time(&self) -> f64 {
        self.quantities[6]
    }
}

/// Residual accelerations of `candidate`, one sample for each quarter of a second.
pub fn samples(
    observed: &Observed<'_>,
    evaluator: &Evaluator,
    candidate: &Candidate,
) -> Vec<Sample> {
    let tasks = observed.blocks(|flight, layout| layout.has(VELOCITY) && flight.channels.attitude);
    let groups = Groups { dynamics: true, kinematics: false, command: false };
    let of_block = |(flight, layout, block): &(&PreparedFlight, &Layout, &Block)| {
        let series = evaluator.block(flight, layout, block).series(candidate, groups).residuals;
        let of_cells = |first: usize| {
            let time = block.edge(first) + 0.5 * SAMPLE_CELLS as f64 * CELL_S;
            let mean = |channel: usize| {
                let cells = &series[channel][first..first + SAMPLE_CELLS];
                cells.iter().sum::<f64>() / SAMPLE_CELLS as f64
            };
            sample(flight, time, std::array::from_fn(|axis| mean(VELOCITY + axis)))
        };
        let count = block.cells / SAMPLE_CELLS;
        (0..count).map(|k| of_cells(k * SAMPLE_CELLS)).collect::<Vec<_>>()
    };
    tasks.par_iter().flat_map_iter(of_block).collect()
}

/// The [`QUANTITIES`] of a flight at a time, which counts from the start of its airborne time, s.
pub(in crate::diagnose) fn quantities(
    flight: &PreparedFlight,
    time: f64,
) -> [f64; QUANTITIES.len()] {
    let [vn, ve, vd] = flight.velocity.at(time);
    let [_, _, down] = flight.position.at(time);
    let [p, q, r] = flight.body_rate.at(time);
    [
        (vn * vn + ve * ve + vd * vd).sqrt(),
        -vd,
        -down,
        flight.outputs.at(time).iter().sum::<f64>() / 4.0,
        flight.voltage.at(time)[0],
        (p * p + q * q + r * r).sqrt(),
        time - flight.spans.first().map_or(0.0, |span| span.start),
    ]
}

fn sample(flight: &PreparedFlight, time: f64, world: [f64; 3]) -> Sample {
    let attitude = flight.attitude.attitude_at(time);
    let [north, east, _] = flight.position.at(time);
    let velocity = flight.velocity.at(time);
    Sample {
        world,
        body: attitude.to_body(Ned::from(world)).to_array(),
        velocity,
        body_velocity: attitude.to_body(Ned::from(velocity)).to_array(),
        body_rate: flight.body_rate.at(time),
        place: [north, east, attitude.yaw()],
        quantities: quantities(flight, time),
    }
}

/// The regime of quantity `index` of [`QUANTITIES`]. `after` holds the samples of the explanation
/// at the same times.
fn regime(
    samples: &[Sample],
    after: &[Sample],
    index: usize,
    quantity: &'static str,
) -> Option<Regime> {
    let mut order: Vec<(&Sample, &Sample)> = samples.iter().zip(after).collect();
    let value = |sample: &Sample| sample.quantities[index];
    order.sort_by(|(a, _), (b, _)| value(a).total_cmp(&value(b)));
    let n = order.len();
    let (first, last) = (value(order.first()?.0), value(order.last()?.0));
    if n < 16 || last <= first {
        return None;
    }
    let at = |quarter: usize| value(order[(quarter * n / 4).min(n - 1)].0);
    let square = |sample: &Sample| sample.world.iter().map(|x| x * x).sum::<f64>();
    let quarter = |quarter: usize| &order[quarter * n / 4..(quarter + 1) * n / 4];
    let rms = |part: &[(&Sample, &Sample)], of: fn(&(&Sample, &Sample)) -> Sample| {
        let sum: f64 = part.iter().map(|pair| square(&of(pair))).sum();
        (sum / part.len() as f64).sqrt()
    };
    Some(Regime {
        quantity,
        bounds: std::array::from_fn(at),
        rms: std::array::from_fn(|k| rms(quarter(k), |(before, _)| **before)),
        rms_after: std::array::from_fn(|k| rms(quarter(k), |(_, after)| **after)),
    })
}

/// Parts of the samples between which a dependence is sought.
const GROUPS: usize = 8;
/// Least share of the unexplained acceleration that depends on a quantity worth mentioning.
const DEPENDENCE_SHARE_MIN: f64 = 0.2;
/// Samples that count as one, since residuals last longer than a sample.
const CORRELATED: f64 = 4.0;

/// Quantities that the mean of the unexplained acceleration depends on, in world or body axes, the
/// strongest first. The measure is the correlation ratio (Pearson 1905) over eighths of the
/// samples, less its value by chance.
pub fn depends_on(samples: &[Sample]) -> Vec<String> {
    let of_sample = |sample: &Sample| -> Vec<f64> {
        let own = sample.quantities.iter().chain(&sample.body_velocity).chain(&sample.body_rate);
        own.chain(&sample.place).copied().collect()
    };
    let names = QUANTITIES.iter().chain(&OF_BODY).chain(&OF_PLACE);
    let mut found: Vec<(f64, &str)> = names
        .enumerate()
        .map(|(index, name)| {
            let value = |sample: &Sample| of_sample(sample).get(index).copied().unwrap_or(0.0);
            let mut order: Vec<&Sample> = samples.iter().collect();
            order.sort_by(|a, b| value(a).total_cmp(&value(b)));
            // A constant or missing quantity would leave the samples in order of time.
            let differs = order.first().map(|s| value(s)) < order.last().map(|s| value(s));
            let share = |of: fn(&Sample) -> [f64; 3]| correlation_ratio(&order, of);
            let most = share(|s| s.world).max(share(|s| s.body));
            (if differs { most } else { 0.0 }, *name)
        })
        .filter(|(share, _)| *share > DEPENDENCE_SHARE_MIN)
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|(share, name)| format!("{name}: {:.0} %", 100.0 * share)).collect()
}

/// Share of a vector's variance between [`GROUPS`] of the ordered samples, less chance.
fn correlation_ratio(order: &[&Sample], of: fn(&Sample) -> [f64; 3]) -> f64 {
    let n = order.len();
    if n < 4 * GROUPS {
        return 0.0;
    }
    let mean = |part: &[&Sample]| -> [f64; 3] {
        std::array::from_fn(|i| part.iter().map(|s| of(s)[i]).sum::<f64>() / part.len() as f64)
    };
    let square =
        |a: [f64; 3], b: [f64; 3]| -> f64 { a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum() };
    let all = mean(order);
    let total: f64 = order.iter().map(|s| square(of(s), all)).sum();
    let between: f64 = (0..GROUPS)
        .map(|k| &order[k * n / GROUPS..(k + 1) * n / GROUPS])
        .map(|part| part.len() as f64 * square(mean(part), all))
        .sum();
    let chance = (GROUPS - 1) as f64 / (n as f64 / CORRELATED - 1.0).max(1.0);
    if total > 0.0 { between / total - chance } else { 0.0 }
}

/// Ratio of the largest quarter to the smallest.
fn steepness(regime: &Regime) -> f64 {
    let most = regime.rms.iter().copied().fold(0.0, f64::max);
    let least = regime.rms.iter().copied().fold(f64::INFINITY, f64::min);
    most / least.max(1e-9)
}

/// Least excess that the summary mentions.
const EXCESS_MIN: f64 = 0.3;
/// Least ratio between quarters of a regime that the summary mentions.
const STEEPNESS_MIN: f64 = 2.0;

fn sentence(cells: &[Cell], regimes: &[Regime]) -> String {
    let shown: Vec<&Cell> = cells.iter().filter(|cell| cell.excess > EXCESS_MIN).take(3).collect();
    if shown.is_empty() {
        return "No channel stands out above the noise floor.".to_owned();
    }
    let list: Vec<String> = shown
        .iter()
        .map(|cell| {
            let factor = (1.0 + cell.excess).sqrt();
            format!("{} ({}, {factor:.1} times the noise floor)", cell.channel, cell.scale)
        })
        .collect();
    let mut sentence = format!("The gap is largest in {}", list.join(", "));
    if let Some(regime) = regimes.first().filter(|regime| steepness(regime) > STEEPNESS_MIN) {
        let (factor, quantity) = (steepness(regime), regime.quantity);
        let rises = regime.rms[3] > regime.rms[0];
        sentence += &format!(
            "; the unexplained acceleration {} with {quantity}, by a factor of {factor:.1} between \
             quarters",
            if rises { "grows" } else { "falls" }
        );
    }
    let command = shown.iter().all(|cell| CHANNEL_NAMES[COMMAND..].contains(&cell.channel));
    if command {
        sentence += "; it is between setpoint and motor output, not in the motion";
    }
    sentence + "."
}
