//! Identification of the rotors' response, by minimising the unexplained part of the logs.

use std::ops::Range;

use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use vehicle::VehicleParams;
use vehicle::effects::{BatterySag, Effect};
use vehicle::frame::Ned;

use super::ROW_RATE_HZ;
use super::commands::{CommandSource, Onboard};
use super::dataset::{Observation, ObservedFlight};
use crate::model::actuation::Actuation;
use crate::model::file::AccelerationSource;

/// Delays and lags of the initial grid, s.
const DELAYS: [f64; 9] = [0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08];
const LAGS: [f64; 9] = [0.0, 0.015, 0.03, 0.045, 0.06, 0.08, 0.1, 0.13, 0.16];
/// Balance times that are tried, s.
const BALANCES: [f64; 6] = [2.0, 1.0, 0.6, 0.4, 0.25, 0.15];
/// Fraction of the unexplained variance that a balance must explain to be accepted.
const BALANCE_GAIN_MIN: f64 = 0.05;
/// The search ends when its steps are this small, s.
const RESOLUTION: f64 = 0.0005;
/// Most observations in the search; more do not change the result.
const SEARCH_ROWS: usize = 12_000;
/// Of this many observations one enters the fit of the voltage's exponent; its least number.
const VERTICAL_STEP: usize = 10;
const VERTICAL_ROWS_MIN: usize = 100;
/// Range of exponents.
const EXPONENTS: [f64; 2] = [0.0, 3.0];

/// Linear regression with `K` regressors, accumulated from samples.
struct Regression<const K: usize> {
    gram: SMatrix<f64, K, K>,
    cross: SVector<f64, K>,
    square: f64,
    sum: f64,
    count: f64,
}

impl<const K: usize> Regression<K> {
    fn new() -> Self {
        Self { gram: SMatrix::zeros(), cross: SVector::zeros(), square: 0.0, sum: 0.0, count: 0.0 }
    }

    fn add(&mut self, regressors: [f64; K], y: f64) {
        let x = SVector::from(regressors);
        self.gram += x * x.transpose();
        self.cross += x * y;
        self.square += y * y;
        self.sum += y;
        self.count += 1.0;
    }

    /// Unexplained fraction of y's variance.
    fn unexplained(&self) -> Option<f64> {
        let scale = self.gram.diagonal().map(|d| 1.0 / d.max(f64::MIN_POSITIVE).sqrt());
        let scaled = SMatrix::from_diagonal(&scale) * self.gram * SMatrix::from_diagonal(&scale);
        let ridge = SMatrix::<f64, K, K>::identity() * 1e-9;
        let solution = DMatrix::from_iterator(K, K, (scaled + ridge).iter().copied())
            .cholesky()?
            .solve(&DVector::from_iterator(K, self.cross.component_mul(&scale).iter().copied()));
        let explained: f64 =
            solution.iter().zip(self.cross.component_mul(&scale).iter()).map(|(a, b)| a * b).sum();
        let variance = self.square - self.sum * self.sum / self.count;
        (variance > 0.0).then(|| (self.square - explained) / variance)
    }
}

/// A part of a flight.
pub struct FlightPart<'a> {
    /// The flight.
    pub flight: &'a ObservedFlight,
    /// Indices of the part's observations.
    pub range: Range<usize>,
}

/// Identifies the rotors' response: the delay, lag and voltage exponent that together minimise the
/// variance of the accelerations left unexplained by a regression on input, rates and velocity.
///
/// Starts from the vehicle file's values, which remain if the logs do not determine better ones.
pub fn actuation(
    flights: &[FlightPart<'_>],
    onboard: &Onboard,
    vehicle: &VehicleParams,
    acceleration: AccelerationSource,
) -> Actuation {
    let total: usize = flights.iter().map(|part| part.range.len()).sum();
    let mut found = Actuation {
        delay_s: vehicle.command_delay_s,
        lag_s: vehicle.motor_time_constant_s,
        ..Actuation::default()
    };
    if total == 0 {
        return found;
    }
    found.voltage_exponent = voltage_exponent(flights, onboard, &found, acceleration, vehicle);
    // The same fraction from the middle of each flight.
    let share = (SEARCH_ROWS as f64 / total as f64).min(1.0);
    let cost = |candidate: &Actuation| {
        unexplained(flights, onboard, candidate, acceleration, vehicle.gravity, share)
            .unwrap_or(f64::INFINITY)
    };
    let mut least = cost(&found);
    for delay_s in DELAYS {
        for lag_s in LAGS {
            consider(&cost, Actuation { delay_s, lag_s, ..found }, &mut found, &mut least, 0.0);
        }
    }
    refine(&cost, &mut found, &mut least);
    for balance_s in BALANCES {
        let candidate = Actuation { balance_s: Some(balance_s), ..found };
        consider(&cost, candidate, &mut found, &mut least, BALANCE_GAIN_MIN);
    }
    if found.balance_s.is_some() {
        refine(&cost, &mut found, &mut least);
    }
    found.voltage_exponent = voltage_exponent(flights, onboard, &found, acceleration, vehicle);
    found
}

/// Estimates the additional delay of this flight's motor outputs relative to `actuation`: the shift
/// that minimises the unexplained variance of the flight's accelerations, if the improvement is
/// clear. Setpoints arrive over the link, whose delay is already in the actuation.
pub fn align_commands(
    flight: &mut ObservedFlight,
    onboard: &Onboard,
    actuation: &Actuation,
    acceleration: AccelerationSource,
    gravity: f64,
) {
    flight.command_shift_s = 0.0;
    if flight.source == CommandSource::OnboardLaw {
        return;
    }
    let count = flight.observations.len();
    let share = (SEARCH_ROWS as f64 / count.max(1) as f64).min(1.0);
    let mut best = (f64::INFINITY, 0.0);
    let mut shipped = f64::INFINITY;
    for step in -SHIFT_STEPS..=SHIFT_STEPS {
        let shift = f64::from(step) * SHIFT_STEP_S;
        flight.command_shift_s = shift;
        let all = [FlightPart { flight, range: 0..count }];
        let Some(cost) = unexplained(&all, onboard, actuation, acceleration, gravity, share) else {
            continue;
        };
        if step == 0 {
            shipped = cost;
        }
        if cost < best.0 {
            best = (cost, shift);
        }
    }
    let clear = best.0 < (1.0 - SHIFT_GAIN_MIN) * shipped;
    flight.command_shift_s = if clear { best.1 } else { 0.0 };
}

/// Step and range of the command shifts that are tried, and the fraction of the unexplained
/// variance that a shift must explain.
const SHIFT_STEP_S: f64 = 0.002;
const SHIFT_STEPS: i32 = 20;
const SHIFT_GAIN_MIN: f64 = 0.01;

/// Accepts the candidate if it reduces the least cost by at least the fraction `gain`.
fn consider(
    cost: &impl Fn(&Actuation) -> f64,
    candidate: Actuation,
    best: &mut Actuation,
    least: &mut f64,
    gain: f64,
) {
    let new = cost(&candidate);
    if new < (1.0 - gain) * *least {
        (*best, *least) = (candidate, new);
    }
}

/// Pattern search in delay and lag with steps that halve until they are small. The two trade off
/// against each other, so the search also moves along their sum.
fn refine(cost: &impl Fn(&Actuation) -> f64, best: &mut Actuation, least: &mut f64) {
    let mut step = 0.006;
    while step > RESOLUTION {
        let (from, before) = (*best, *least);
        for (a, b) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, -1.0), (-1.0, 1.0)] {
            let (delay_s, lag_s) = (from.delay_s + a * step, from.lag_s + b * step);
            if delay_s >= 0.0 && lag_s >= 0.0 {
                consider(cost, Actuation { delay_s, lag_s, ..from }, best, least, 0.0);
            }
        }
        if *least >= before {
            step *= 0.5;
        }
    }
}

/// Sum of the unexplained fractions of the three angular accelerations and of the specific force
/// along z.
fn unexplained(
    flights: &[FlightPart<'_>],
    onboard: &Onboard,
    actuation: &Actuation,
    acceleration: AccelerationSource,
    gravity: f64,
    share: f64,
) -> Option<f64> {
    let mut angular: [Regression<6>; 3] = std::array::from_fn(|_| Regression::new());
    let mut vertical = Regression::<3>::new();
    for FlightPart { flight, range } in flights {
        let used = ((range.len() as f64 * share).ceil() as usize).min(range.len());
        let start = range.start + (range.len() - used) / 2;
        let inputs = flight.inputs(onboard, actuation, start..start + used);
        for (o, input) in flight.observations[start..start + used].iter().zip(inputs) {
            let (Some([u1, u2, u3, u4]), Some(linear)) = (input, o.acceleration(acceleration))
            else {
                continue;
            };
            let [p, q, r] = o.body_rate.to_array();
            let body_velocity = o.attitude.to_body(o.velocity);
            let regressors = [
                [u2, p, q * r, u1, body_velocity.right(), 1.0],
                [u3, q, p * r, u1, body_velocity.front(), 1.0],
                [u4, r, p * q, u1, body_velocity.down(), 1.0],
            ];
            for ((regression, x), y) in angular.iter_mut().zip(regressors).zip(o.angular.to_array())
            {
                regression.add(x, y);
            }
            let force = specific_force_z(o, linear, gravity);
            vertical.add([u1, body_velocity.down(), 1.0], force);
        }
    }
    let turning: f64 = angular.iter().map(Regression::unexplained).sum::<Option<f64>>()?;
    Some(turning + vertical.unexplained()?)
}

/// Specific force along body z, m/s^2.
fn specific_force_z(o: &Observation, acceleration: Ned, gravity: f64) -> f64 {
    o.attitude.to_body(acceleration - Ned::new(0.0, 0.0, gravity)).down()
}

/// The exponent of the pack's voltage in the thrust, by golden-section search.
///
/// Minimises `T ln(unexplained) + ((e - e_0) / s)^2`, twice the negative log posterior: the share of
/// the specific force along z that thrust and drag leave unexplained, one error a second for `T`
/// seconds of flight; the vehicle file's exponent `e_0`; and the effect's typical deviation `s` from
/// it. Where the voltage hardly varies, or the labels err by much, the file's exponent remains.
fn voltage_exponent(
    flights: &[FlightPart<'_>],
    onboard: &Onboard,
    actuation: &Actuation,
    acceleration: AccelerationSource,
    vehicle: &VehicleParams,
) -> f64 {
    let of_file = vehicle.modelled_effects.get::<BatterySag>().map_or(0.0, |sag| sag.exponent);
    let [typical, ..] = (BatterySag::SPEC.typical)(vehicle);
    let mut rows: Vec<VerticalRow> = Vec::new();
    for FlightPart { flight, range } in flights {
        let plain = Actuation { voltage_exponent: 0.0, ..*actuation };
        let inputs = flight.inputs(onboard, &plain, range.clone());
        for (o, input) in
            flight.observations[range.clone()].iter().zip(inputs).step_by(VERTICAL_STEP)
        {
            let (Some([thrust, ..]), Some(voltage), Some(linear)) =
                (input, o.voltage, o.acceleration(acceleration))
            else {
                continue;
            };
            let along_z = |world: Ned| o.attitude.to_body(world).down();
            let v_z = along_z(o.velocity);
            let north = along_z(Ned::new(1.0, 0.0, 0.0));
            let east = along_z(Ned::new(0.0, 1.0, 0.0));
            rows.push(VerticalRow {
                thrust,
                voltage,
                air: [v_z, v_z * v_z.abs(), north, east],
                force: specific_force_z(o, linear, vehicle.gravity),
            });
        }
    }
    let voltages = rows.iter().map(|row| row.voltage);
    let (low, high) = voltages.fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
    if rows.len() < VERTICAL_ROWS_MIN || !(low > 0.0 && high > low) {
        return of_file;
    }
    let seconds = rows.len() as f64 * VERTICAL_STEP as f64 / ROW_RATE_HZ;
    let cost = |exponent: f64| {
        let mut regression = Regression::<5>::new();
        for VerticalRow { thrust, voltage, air: [a, b, c, d], force } in &rows {
            let factor = (voltage / high).powf(exponent);
            // Without a constant: thrust vanishes with its input at any voltage.
            regression.add([thrust * factor, *a, *b, *c, *d], *force);
        }
        let unexplained = regression.unexplained().unwrap_or(f64::INFINITY);
        let off = (exponent - of_file) / typical;
        seconds * unexplained.max(f64::MIN_POSITIVE).ln() + off * off
    };
    golden_section(EXPONENTS, cost)
}

/// An observation for the fit of the voltage's exponent.
struct VerticalRow {
    /// Thrust input at full voltage, N.
    thrust: f64,
    /// Voltage of the pack, V.
    voltage: f64,
    /// Along body z: velocity, m/s; velocity times its magnitude; and the unit vectors north and
    /// east, along which a wind adds to the velocity.
    air: [f64; 4],
    /// Specific force along body z, m/s^2.
    force: f64,
}

/// Minimum of a unimodal function between `low` and `high`.
fn golden_section([mut low, mut high]: [f64; 2], cost: impl Fn(f64) -> f64) -> f64 {
    let ratio = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (mut a, mut b) = (high - ratio * (high - low), low + ratio * (high - low));
    let (mut at_a, mut at_b) = (cost(a), cost(b));
    while high - low > 1e-3 {
        if at_a < at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - ratio * (high - low);
            at_a = cost(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + ratio * (high - low);
            at_b = cost(b);
        }
    }
    0.5 * (low + high)
}
