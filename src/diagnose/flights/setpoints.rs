//! Setpoints that the vehicle received and the log lacks.
//!
//! A thinned log lacks setpoints that the vehicle followed. Where frame numbers show that they
//! existed, they are put on the line between their neighbours. Each real one was off that line by
//! the noise that feedback puts into setpoints, its own and its neighbours'. Replicas follow such
//! noisy setpoints, and log the line as well. Send times follow from the logged setpoints: a
//! controller sends at a fixed period, and is now and then a little late.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use vehicle::frame::{Attitude, Frd};

use crate::diagnose::flights::normal_draws::{CHI_SQUARED_MEDIAN, standard_normals};
use crate::diagnose::flights::series::median;
use crate::log::import::{AttitudeSetpoint, Stream};
use sitl::autopilot::offboard::AttitudeSetpoint as OnboardSetpoint;

/// Setpoints this far apart do not determine those between, s.
const SPACING_MAX_S: f64 = 0.1;
/// No controller sends setpoints at a shorter period, s, whatever number a log calls missing.
const PERIOD_MIN_S: f64 = 5e-4;
/// The earliest of this many setpoints before a tick determines its time.
const PHASE_WINDOW: usize = 25;
/// Quantiles that represent the distribution of lateness.
const LATENESS: usize = 16;
/// Least distance between two setpoints, as a share of the period: they keep their order.
const SPACING_SHARE_MIN: f64 = 0.1;
/// Most that a setpoint is early relative to its tick, as a share of the period.
const EARLY_MAX: f64 = 0.3;
/// Most that a setpoint is late, as a share of the period; beyond, ticks were miscounted.
const LATE_MAX: f64 = 0.75;
/// Distance between tick numbers that are unrelated.
const GAP_TICKS: u64 = 1 << 32;
/// A change is a jump if it is off the trend of its neighbours by this many deviations.
const JUMP_DEVIATIONS: f64 = 10.0;
/// Numbers of a setpoint: a small rotation (rad), the body rate (rad/s), the thrust (0..1).
const NUMBERS: usize = 7;

/// The setpoints of a stream that the log lacks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inferred {
    /// Indices of those setpoints, ascending.
    indices: Vec<usize>,
    /// Their possible lateness, as equally likely quantiles, s.
    lateness: [f64; LATENESS],
}

impl Inferred {
    /// Whether the log lacks no setpoint.
    pub fn is_empty(&self) -> bool {
        self.indices.is_empty()
    }

    /// Whether the log lacks the setpoint at `index`.
    pub(in crate::diagnose) fn has(&self, index: usize) -> bool {
        self.indices.binary_search(&index).is_ok()
    }

    /// Possible lateness of a missing setpoint, as equally likely quantiles, s.
    pub(in crate::diagnose) fn lateness(&self) -> &[f64] {
        &self.lateness
    }

    /// Indices of the logged setpoints among `count`.
    fn logged(&self, count: usize) -> Vec<usize> {
        (0..count).filter(|index| !self.has(*index)).collect()
    }
}

/// A setpoint as an input of the on-board loop; `None` without a thrust.
pub fn as_onboard(setpoint: &AttitudeSetpoint) -> Option<OnboardSetpoint> {
    Some(OnboardSetpoint {
        attitude: setpoint.attitude.map(|attitude| attitude.euler()),
        body_rate: setpoint.body_rate.unwrap_or(Frd::zero()),
        thrust: setpoint.thrust?.clamp(0.0, 1.0),
        type_mask: wire::dialect::AttitudeTargetTypemask::empty(),
    })
}

/// `logged` completed with the setpoints that the log lacks. `missing` has their number before a
/// logged setpoint, at its time.
pub(in crate::diagnose) fn completed(
    logged: &Stream<AttitudeSetpoint>,
    missing: &Stream<u32>,
) -> (Stream<AttitudeSetpoint>, Inferred) {
    let times = logged.times();
    let Some(ticks) = ticks(times, missing) else { return (logged.clone(), Inferred::default()) };
    let period = ticks.period;
    let late = ticks.lateness_of(times);
    let mut ascending = late.clone();
    ascending.sort_by(f64::total_cmp);
    let mean = late.iter().sum::<f64>() / late.len().max(1) as f64;
    let quantile = |i: usize| {
        let share = (i as f64 + 0.5) / LATENESS as f64;
        ascending.get((share * ascending.len() as f64) as usize).map_or(0.0, |late| late - mean)
    };
    let mut inferred = Inferred { indices: Vec::new(), lateness: std::array::from_fn(quantile) };
    let mut all = Stream::default();
    for (k, (time, setpoint)) in logged.iter().enumerate() {
        if let Some(before) = k.checked_sub(1) {
            let count = ticks.between(before);
            let earlier = logged.values()[before];
            for tick in 1..count {
                let share = tick as f64 / count as f64;
                // The expected time from the setpoints before, and from those after.
                let by_before = times[before] - late[before] + tick as f64 * period;
                let by_after = time - late[k] - (count - tick) as f64 * period;
                let sent = 0.5 * (by_before + by_after) + mean;
                let (low, high) = (tick as f64, (count - tick) as f64);
                let apart = SPACING_SHARE_MIN * (time - times[before]) / count as f64;
                let sent = sent.clamp(times[before] + low * apart, time - high * apart);
                if all.push(sent, earlier.between(setpoint, share)) {
                    inferred.indices.push(all.len() - 1);
                }
            }
        }
        all.push(time, *setpoint);
    }
    (all, inferred)
}

/// Logged setpoints as ticks of the controller's period.
struct Ticks {
    /// Time between ticks, s.
    period: f64,
    /// Tick number of each; across a gap, numbers jump by [`GAP_TICKS`].
    numbers: Vec<u64>,
}

/// The ticks of setpoints at `times` with some `missing` between; `None` where none are.
fn ticks(times: &[f64], missing: &Stream<u32>) -> Option<Ticks> {
    let mut missing = missing.iter().peekable();
    let mut lacking = Vec::with_capacity(times.len());
    for time in times {
        let mut count = 0;
        while let Some((_, n)) = missing.next_if(|(at, _)| at <= time) {
            count = *n;
        }
        lacking.push(count);
    }
    if lacking.iter().all(|count| *count == 0) {
        return None;
    }
    let near = |pair: &[f64]| pair[1] - pair[0] < SPACING_MAX_S;
    let pairs = times.windows(2).zip(lacking.iter().skip(1));
    let periods: Vec<f64> = pairs
        .clone()
        .filter(|(pair, _)| near(pair))
        .map(|(pair, lacking)| (pair[1] - pair[0]) / (f64::from(*lacking) + 1.0))
        .collect();
    if periods.is_empty() {
        return None;
    }
    let period = median(periods).max(PERIOD_MIN_S);
    let mut seconds = 0.0;
    let mut numbers: Vec<u64> = vec![0];
    for (k, (pair, lacking)) in pairs.enumerate() {
        let number = numbers[k];
        if !near(pair) {
            numbers.push(number + GAP_TICKS);
            continue;
        }
        // The last tick, from the earliest of the setpoints before: the last one may be late.
        let on_this_side = |j: &usize| number - numbers[*j] < GAP_TICKS;
        let before = (k.saturating_sub(PHASE_WINDOW)..=k).filter(on_this_side);
        let tick = before
            .map(|j| times[j] + (number - numbers[j]) as f64 * period)
            .fold(pair[0], f64::min);
        // Missing frames may be other messages; there are no more setpoints than fit the time.
        let fit = ((pair[1] - tick) / period + EARLY_MAX).floor().max(1.0) as u64;
        numbers.push(number + fit.min(u64::from(*lacking) + 1));
        seconds += pair[1] - pair[0];
    }
    let number = numbers.last().copied().unwrap_or_default();
    // Counts between gaps telescope, so errors of single intervals cancel.
    Some(Ticks { period: seconds / (number % GAP_TICKS) as f64, numbers })
}

impl Ticks {
    /// Ticks from a logged setpoint to the next; 1 across a gap.
    fn between(&self, index: usize) -> u64 {
        let count = self.numbers[index + 1] - self.numbers[index];
        if count < GAP_TICKS { count } else { 1 }
    }

    /// Lateness of each setpoint relative to its tick, s. The earliest of its neighbours determines
    /// the tick.
    fn lateness_of(&self, times: &[f64]) -> Vec<f64> {
        (0..times.len())
            .map(|k| {
                let around =
                    k.saturating_sub(PHASE_WINDOW)..(k + PHASE_WINDOW + 1).min(times.len());
                let by = |j: usize| {
                    let ticks = self.numbers[k] as f64 - self.numbers[j] as f64;
                    times[j] + ticks * self.period
                };
                // More than that is a miscounted tick or a gap.
                let least = times[k] - LATE_MAX * self.period;
                times[k] - around.map(by).filter(|at| *at > least).fold(times[k], f64::min)
            })
            .collect()
    }
}

/// Puts the `inferred` setpoints on the line between their neighbours.
pub(in crate::diagnose) fn infer(setpoints: &mut [AttitudeSetpoint], inferred: &Inferred) {
    for run in inferred.indices.chunk_by(|a, b| b - a == 1) {
        let (Some(first), Some(last)) = (run.first(), run.last()) else { continue };
        let Some((a, b)) = first.checked_sub(1).zip(setpoints.get(last + 1).map(|_| last + 1))
        else {
            continue;
        };
        for index in run {
            let share = (index - a) as f64 / (b - a) as f64;
            setpoints[*index] = setpoints[a].between(&setpoints[b], share);
        }
    }
}

/// The setpoints as the vehicle may have received them. The `inferred` ones get noise of their own,
/// without their neighbours' noise that the line contains. Where the command jumps between two
/// logged setpoints, it jumps at a random time between them.
pub(in crate::diagnose) fn as_flown(
    setpoints: &Stream<AttitudeSetpoint>,
    inferred: &Inferred,
    seed: u64,
) -> Stream<AttitudeSetpoint> {
    if inferred.is_empty() {
        return setpoints.clone();
    }
    let logged = inferred.logged(setpoints.len());
    let (times, line) = (setpoints.times(), setpoints.values());
    let scatter = scatter(times, line, &logged);
    // The distance from the middle of two contains its own noise and the mean of theirs.
    let noise = scatter.map(|scatter| scatter / 1.5_f64.sqrt());
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut noise_before: [f64; NUMBERS] = standard_normals(&mut rng);
    let mut flown = Stream::default();
    if let Some(first) = logged.first() {
        flown.push(times[*first], line[*first]);
    }
    for (k, pair) in logged.windows(2).enumerate() {
        let &[a, b] = pair else { continue };
        let slope = |from: usize, to: usize| {
            let across = offset(&line[from], &line[to]);
            across.map(|change| change * (times[b] - times[a]) / (times[to] - times[from]))
        };
        let before = k.checked_sub(1).map(|k| slope(logged[k], a));
        let after = logged.get(k + 2).map(|after| slope(b, *after));
        let [before, after] = [before.or(after), after.or(before)].map(Option::unwrap_or_default);
        let change = offset(&line[a], &line[b]);
        let jump: [f64; NUMBERS] = std::array::from_fn(|i| {
            // Next to another jump, the smoother side decides.
            let [jump, other] = [change[i] - before[i], change[i] - after[i]];
            let jump = if other.abs() < jump.abs() { other } else { jump };
            if jump.abs() > JUMP_DEVIATIONS * scatter[i] { jump } else { 0.0 }
        });
        let at: f64 = rng.random();
        // Between the neighbours, in order.
        let room = SPACING_SHARE_MIN * (times[b] - times[a]) / (b - a) as f64;
        let mut last = times[a];
        let noise_after: [f64; NUMBERS] = standard_normals(&mut rng);
        for index in a + 1..b {
            let share = (index - a) as f64 / (b - a) as f64;
            let jumped = if share > at { 1.0 } else { 0.0 };
            let own: [f64; NUMBERS] = standard_normals(&mut rng);
            let off = std::array::from_fn(|i| {
                let of_line = (1.0 - share) * noise_before[i] + share * noise_after[i];
                noise[i] * (own[i] - of_line) + (jumped - share) * jump[i]
            });
            let late = inferred.lateness[rng.random_range(0..LATENESS)];
            let latest = times[b] - (b - index) as f64 * room;
            last = (times[index] + late).max(last + room).min(latest);
            flown.push(last, displaced(&line[index], off));
        }
        flown.push(times[b], line[b]);
        noise_before = noise_after;
    }
    flown
}

/// The difference from one setpoint to another; 0 for numbers that either lacks.
fn offset(from: &AttitudeSetpoint, to: &AttitudeSetpoint) -> [f64; NUMBERS] {
    let attitudes = from.attitude.zip(to.attitude);
    let [x, y, z] = attitudes.map_or([0.0; 3], |(from, to)| {
        let turn = from.inverse().compose(to).canonical();
        [turn.x, turn.y, turn.z].map(|half| 2.0 * half)
    });
    let rates = from.body_rate.zip(to.body_rate);
    let [p, q, r] = rates.map_or([0.0; 3], |(from, to)| (to - from).to_array());
    let thrust = from.thrust.zip(to.thrust).map_or(0.0, |(from, to)| to - from);
    [x, y, z, p, q, r, thrust]
}

/// The setpoint at an offset from another.
fn displaced(
    from: &AttitudeSetpoint,
    [x, y, z, p, q, r, thrust]: [f64; NUMBERS],
) -> AttitudeSetpoint {
    let turn = Attitude { w: 1.0, x: 0.5 * x, y: 0.5 * y, z: 0.5 * z }.normalized();
    AttitudeSetpoint {
        attitude: from.attitude.map(|attitude| attitude.compose(turn)),
        body_rate: from.body_rate.map(|rate| rate + Frd::new(p, q, r)),
        thrust: from.thrust.map(|commanded| (commanded + thrust).clamp(0.0, 1.0)),
    }
}

/// Standard deviations of the setpoints `logged` from the line between their neighbours. They come
/// from medians, since commands jump at times.
fn scatter(times: &[f64], setpoints: &[AttitudeSetpoint], logged: &[usize]) -> [f64; NUMBERS] {
    let mut squares: [Vec<f64>; NUMBERS] = Default::default();
    for triple in logged.windows(3) {
        let &[a, b, c] = triple else { continue };
        if (times[b] - times[a]).max(times[c] - times[b]) >= SPACING_MAX_S {
            continue;
        }
        let share = (times[b] - times[a]) / (times[c] - times[a]);
        let off = offset(&setpoints[a].between(&setpoints[c], share), &setpoints[b]);
        squares.iter_mut().zip(off).for_each(|(squares, off)| squares.push(off * off));
    }
    squares.map(|squares| (median(squares) / CHI_SQUARED_MEDIAN).sqrt())
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use rand::SeedableRng;
    use vehicle::frame::Euler;

    fn setpoint(roll: f64, thrust: f64) -> AttitudeSetpoint {
        let attitude = Euler { roll, pitch: 0.1, yaw: 2.0 }.attitude();
        let body_rate = Some(Frd::new(10.0 * roll, 0.0, 0.0));
        AttitudeSetpoint { attitude: Some(attitude), body_rate, thrust: Some(thrust) }
    }

    #[test]
    fn missing_setpoints_are_interpolated_between_neighbours() {
        let (mut logged, mut missing) = (Stream::default(), Stream::default());
        for (time, roll) in [(0.0, 0.0), (0.01, 0.1), (0.04, 0.4), (1.0, 0.0)] {
            logged.push(time, setpoint(roll, 0.5 + roll));
        }
        missing.push(0.04, 2);
        // Too far from the last one to infer.
        missing.push(1.0, 95);
        let (all, inferred) = completed(&logged, &missing);
        assert_eq!(inferred.indices, [2, 3]);
        assert_eq!(all.len(), 6);
        for (time, setpoint) in all.iter().take(5) {
            assert!((setpoint.attitude.unwrap().euler().roll - 10.0 * time).abs() < 1e-3, "{time}");
            assert!((setpoint.thrust.unwrap() - 0.5 - 10.0 * time).abs() < 1e-9, "{time}");
        }
        let mut displaced = all.values().to_vec();
        displaced[2] = setpoint(-1.0, 0.0);
        infer(&mut displaced, &inferred);
        assert!((displaced[2].thrust.unwrap() - 0.7).abs() < 1e-9);
        assert!(completed(&Stream::default(), &missing).1.is_empty());
    }

    /// Leaves out every other setpoint.
    fn thinned(all: &Stream<AttitudeSetpoint>) -> (Stream<AttitudeSetpoint>, Inferred) {
        let (mut logged, mut missing) = (Stream::default(), Stream::default());
        for (time, setpoint) in all.iter().step_by(2) {
            logged.push(time, *setpoint);
            missing.push(time, 1);
        }
        completed(&logged, &missing)
    }

    #[test]
    fn inferred_setpoints_scatter_like_the_logged_ones() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut all = Stream::default();
        for k in 0..32_001 {
            let time = f64::from(k) * 0.01;
            all.push(time, setpoint(0.3 * time.sin() + 0.01 * normal(), 0.5 + 0.02 * normal()));
        }
        let (line, inferred) = thinned(&all);
        assert_eq!(inferred.indices.len(), 16_000);
        let flown = as_flown(&line, &inferred, 3);
        // Singly, and averaged over a while: the noise of its ends offsets the line.
        let off = |of: &Stream<AttitudeSetpoint>, number: usize, run: usize| {
            let off = |i: &usize| offset(&line.values()[*i], &of.values()[*i])[number];
            let mean = |run: &[usize]| run.iter().map(off).sum::<f64>() / run.len() as f64;
            let runs = inferred.indices.chunks(run);
            (runs.clone().map(|run| mean(run).powi(2)).sum::<f64>() / runs.len() as f64).sqrt()
        };
        for (number, run) in [(0, 1), (3, 1), (6, 1), (0, 8), (3, 8), (6, 8)] {
            let (truly, drawn) = (off(&all, number, run), off(&flown, number, run));
            assert!((drawn / truly - 1.0).abs() < 0.07, "{number}: {drawn} for {truly}");
        }
        assert!(off(&flown, 1, 1) < 1e-3);
        assert_eq!(flown.len(), line.len());
        assert_eq!(flown.values()[0], all.values()[0]);
    }

    #[test]
    fn inferred_setpoints_fall_on_either_side_of_a_step() {
        let mut all = Stream::default();
        for k in 0..4001 {
            let step = if (k + 1) / 200 % 2 == 0 { 0.0 } else { 0.2 };
            all.push(f64::from(k) * 0.01, setpoint(step, 0.5));
        }
        let (line, inferred) = thinned(&all);
        let flown = as_flown(&line, &inferred, 3);
        let thrusts = flown.values().iter().map(|s| s.attitude.unwrap().euler().roll);
        let counts = thrusts.fold([0; 2], |[low, high], roll| {
            let is = |level: f64| (roll - level).abs() < 1e-3;
            assert!(is(0.0) || is(0.2), "{roll}");
            [low + usize::from(is(0.0)), high + usize::from(is(0.2))]
        });
        // Of twenty jumps some are early and some are late.
        assert!(counts.iter().all(|count| (1990..2012).contains(count)), "{counts:?}");
        let on_line = |r: f64| (r - 0.1).abs() < 0.02;
        let undecided = line.values().iter().filter(|s| on_line(s.attitude.unwrap().euler().roll));
        assert!(undecided.count() > 5);
    }

    #[test]
    fn inferred_setpoints_share_the_send_jitter() {
        let (mut logged, mut missing) = (Stream::default(), Stream::default());
        let mut sent = Vec::new();
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        for k in 0..3000 {
            let late: f64 = rand_distr::Exp1.sample(&mut rng);
            let time = f64::from(k) * 0.010_001 + 0.003 + 1e-3 * late;
            if k % 2 == 0 {
                logged.push(time, setpoint(0.0, 0.5));
                missing.push(time, 1);
            }
            sent.push(time);
        }
        let (all, inferred) = completed(&logged, &missing);
        assert_eq!(inferred.indices.len(), 1499);
        let late = |index: &usize| sent[*index] - all.times()[*index];
        let mean = inferred.indices.iter().map(late).sum::<f64>() / 1499.0;
        assert!(mean.abs() < 1e-4, "{mean}");
        let spread = inferred.indices.iter().map(|i| late(i).powi(2)).sum::<f64>() / 1499.0;
        assert!((spread.sqrt() - 1e-3).abs() < 1e-4, "{spread}");
        // Quantiles of an exponential distribution, about its mean.
        for (k, quantile) in inferred.lateness().iter().enumerate() {
            let share = (k as f64 + 0.5) / LATENESS as f64;
            let expected = -1e-3 * (1.0 - share).ln() - 1e-3;
            // The last ones come from few samples.
            let close = if share < 0.9 { 1.5e-4 } else { 3e-4 };
            assert!((quantile - expected).abs() < close, "{k}: {quantile} for {expected}");
        }
    }

    #[test]
    fn one_very_late_setpoint_does_not_shift_the_others() {
        let (mut logged, mut missing) = (Stream::default(), Stream::default());
        for k in 0..400 {
            let late = if k == 200 { 7e-3 } else { 1e-4 * f64::from(k % 7) };
            if k % 2 == 0 {
                let time = f64::from(k) * 0.01 + late;
                logged.push(time, setpoint(0.0, 0.5));
                missing.push(time, 1);
            }
        }
        let (all, inferred) = completed(&logged, &missing);
        assert_eq!(inferred.indices.len(), 199);
        for index in inferred.indices {
            let off = all.times()[index] - 0.01 * index as f64;
            assert!((0.0..1e-3).contains(&off), "{index}: {off}");
        }
    }

    #[test]
    fn inferred_setpoints_are_limited_by_the_elapsed_time() {
        let (mut logged, mut missing) = (Stream::default(), Stream::default());
        for k in 0..100 {
            let time = f64::from(k) * 0.01 + if k < 50 { 0.0 } else { 0.02 };
            logged.push(time, setpoint(0.0, 0.5));
            // Heartbeats that are not setpoints, and two missing setpoints.
            if k % 10 == 0 {
                missing.push(time, 2);
            }
        }
        let (all, inferred) = completed(&logged, &missing);
        assert_eq!((all.len(), inferred.indices), (102, vec![50, 51]));
    }
}
