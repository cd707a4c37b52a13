//! Setpoints that the vehicle had and the log lacks.
//!
//! A thinned log lacks setpoints that the vehicle followed. Where the numbers of their frames tell
//! that they were, they are put on the line between their neighbours, from which each lay off by the
//! noise that feedback puts into setpoints: replicas follow such ones, and log the line as well.

use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use sitl::frame::{Attitude, Frd};

use crate::log::import::{AttitudeSetpoint, Stream};

/// Setpoints this far apart tell nothing of what was between, s.
const APART_MAX_S: f64 = 0.1;
/// Share of the time between two setpoints by which one may be late or early: they keep their order.
const MOVED_MAX: f64 = 0.4;
/// A change is a jump from so many deviations on beyond what the changes around it let expect.
const JUMP: f64 = 10.0;
/// Median of a squared standard normal number.
const MEDIAN_SQUARE: f64 = 0.455;

/// `logged` with those between that are `missing` (how many before each, at its time), and the
/// indices of those.
pub(super) fn completed(
    logged: &Stream<AttitudeSetpoint>,
    missing: &Stream<u32>,
) -> (Stream<AttitudeSetpoint>, Vec<usize>) {
    let (mut all, mut inferred) = (Stream::default(), Vec::new());
    let mut missing = missing.iter().peekable();
    let mut last: Option<(f64, &AttitudeSetpoint)> = None;
    for (time, setpoint) in logged.iter() {
        let mut count = 0;
        while let Some((_, n)) = missing.next_if(|(at, _)| *at <= time) {
            count = *n;
        }
        if let Some((before, earlier)) = last.filter(|(before, _)| time - before < APART_MAX_S) {
            for k in 1..=count {
                let share = f64::from(k) / f64::from(count + 1);
                if all.push(before + share * (time - before), earlier.between(setpoint, share)) {
                    inferred.push(all.len() - 1);
                }
            }
        }
        all.push(time, *setpoint);
        last = Some((time, setpoint));
    }
    (all, inferred)
}

/// Puts the setpoints at the indices `inferred`, ascending, on the line between those around them.
pub(super) fn infer(times: &[f64], setpoints: &mut [AttitudeSetpoint], inferred: &[usize]) {
    for run in inferred.chunk_by(|a, b| b - a == 1) {
        let (Some(first), Some(last)) = (run.first(), run.last()) else { continue };
        let Some((a, b)) = first.checked_sub(1).zip(setpoints.get(last + 1).map(|_| last + 1))
        else {
            continue;
        };
        for index in run {
            let share = (times[*index] - times[a]) / (times[b] - times[a]);
            setpoints[*index] = setpoints[a].between(&setpoints[b], share);
        }
    }
}

/// The setpoints as the vehicle may have had them: those that are `inferred` scatter about the line
/// as the others do, and where what is asked jumps between two of the log, it jumps somewhere between.
pub(super) fn as_flown(
    setpoints: &Stream<AttitudeSetpoint>,
    inferred: &[usize],
    seed: u64,
) -> Stream<AttitudeSetpoint> {
    if inferred.is_empty() {
        return setpoints.clone();
    }
    let is_logged = |index: &usize| inferred.binary_search(index).is_err();
    let logged: Vec<usize> = (0..setpoints.len()).filter(is_logged).collect();
    let (times, line) = (setpoints.times(), setpoints.values());
    let scatter = scatter(times, line, &logged);
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let spread = send_spread(times, inferred);
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
            // Next to a jump that is not its own, one of both is as smooth.
            let [jump, other] = [change[i] - before[i], change[i] - after[i]];
            let jump = if other.abs() < jump.abs() { other } else { jump };
            if jump.abs() > JUMP * scatter[i] { jump } else { 0.0 }
        });
        let at: f64 = rng.random();
        let most = MOVED_MAX * (times[b] - times[a]) / (b - a) as f64;
        for index in a + 1..b {
            let share = (times[index] - times[a]) / (times[b] - times[a]);
            let jumped = if share > at { 1.0 } else { 0.0 };
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let off = std::array::from_fn(|i| scatter[i] * normal() + (jumped - share) * jump[i]);
            let late = (spread * normal()).clamp(-most, most);
            flown.push(times[index] + late, moved(&line[index], off));
        }
        flown.push(times[b], line[b]);
    }
    flown
}

/// Standard deviation of the time at which a setpoint was sent that is `inferred`, from the middle
/// between its neighbours, s: of intervals that scatter, half of a variance is each sending's.
pub(super) fn send_spread(times: &[f64], inferred: &[usize]) -> f64 {
    let is_logged = |index: &usize| inferred.binary_search(index).is_err();
    let logged: Vec<f64> = (0..times.len()).filter(is_logged).map(|i| times[i]).collect();
    let mut intervals: Vec<f64> = logged.windows(2).map(|pair| pair[1] - pair[0]).collect();
    intervals.sort_by(f64::total_cmp);
    let quantile = |share: f64| intervals.get((share * intervals.len() as f64) as usize).copied();
    // Of a normal distribution half lies within 0.674 standard deviations.
    let half = quantile(0.75).zip(quantile(0.25)).map_or(0.0, |(high, low)| 0.5 * (high - low));
    (1.5_f64 * 0.5).sqrt() * half / 0.674
}

/// Numbers of a setpoint: a small rotation [rad], the body rate [rad/s], the thrust.
const NUMBERS: usize = 7;

/// What leads from one setpoint to another; 0 in what they do not ask for.
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

/// The setpoint that an offset leads to.
fn moved(from: &AttitudeSetpoint, [x, y, z, p, q, r, thrust]: [f64; NUMBERS]) -> AttitudeSetpoint {
    let turn = Attitude { w: 1.0, x: 0.5 * x, y: 0.5 * y, z: 0.5 * z }.normalized();
    AttitudeSetpoint {
        attitude: from.attitude.map(|attitude| attitude.compose(turn)),
        body_rate: from.body_rate.map(|rate| rate + Frd::new(p, q, r)),
        thrust: from.thrust.map(|asked| (asked + thrust).clamp(0.0, 1.0)),
    }
}

/// Standard deviations of setpoints from the line between their neighbours, among those of the
/// indices `logged`; by medians, for what is asked jumps at times.
fn scatter(times: &[f64], setpoints: &[AttitudeSetpoint], logged: &[usize]) -> [f64; NUMBERS] {
    let mut squares: [Vec<f64>; NUMBERS] = Default::default();
    for triple in logged.windows(3) {
        let &[a, b, c] = triple else { continue };
        if times[c] - times[a] > APART_MAX_S {
            continue;
        }
        let share = (times[b] - times[a]) / (times[c] - times[a]);
        let off = offset(&setpoints[a].between(&setpoints[c], share), &setpoints[b]);
        squares.iter_mut().zip(off).for_each(|(squares, off)| squares.push(off * off));
    }
    squares.map(|mut squares| {
        let middle = squares.len() / 2;
        if squares.is_empty() {
            return 0.0;
        }
        let median = *squares.select_nth_unstable_by(middle, f64::total_cmp).1;
        (median / MEDIAN_SQUARE).sqrt()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use sitl::frame::Euler;

    fn setpoint(roll: f64, thrust: f64) -> AttitudeSetpoint {
        let attitude = Euler { roll, pitch: 0.1, yaw: 2.0 }.attitude();
        let body_rate = Some(Frd::new(10.0 * roll, 0.0, 0.0));
        AttitudeSetpoint { attitude: Some(attitude), body_rate, thrust: Some(thrust) }
    }

    #[test]
    fn what_is_missing_lies_between_its_neighbours() {
        let (mut logged, mut missing) = (Stream::default(), Stream::default());
        for (time, roll) in [(0.0, 0.0), (0.01, 0.1), (0.04, 0.4), (1.0, 0.0)] {
            logged.push(time, setpoint(roll, 0.5 + roll));
        }
        missing.push(0.04, 2);
        // Too far from the last to tell.
        missing.push(1.0, 95);
        let (all, inferred) = completed(&logged, &missing);
        assert_eq!(inferred, [2, 3]);
        assert_eq!(all.len(), 6);
        for (time, setpoint) in all.iter().take(5) {
            assert!((setpoint.attitude.unwrap().euler().roll - 10.0 * time).abs() < 1e-3, "{time}");
            assert!((setpoint.thrust.unwrap() - 0.5 - 10.0 * time).abs() < 1e-9, "{time}");
        }
        let mut moved = all.values().to_vec();
        moved[2] = setpoint(-1.0, 0.0);
        infer(all.times(), &mut moved, &inferred);
        assert!((moved[2].thrust.unwrap() - 0.7).abs() < 1e-9);
        assert!(completed(&Stream::default(), &missing).1.is_empty());
    }

    /// Every other one is missing.
    fn thinned(all: &Stream<AttitudeSetpoint>) -> (Stream<AttitudeSetpoint>, Vec<usize>) {
        let (mut logged, mut missing) = (Stream::default(), Stream::default());
        for (time, setpoint) in all.iter().step_by(2) {
            logged.push(time, *setpoint);
            missing.push(time, 1);
        }
        completed(&logged, &missing)
    }

    #[test]
    fn what_is_missing_scatters_as_the_rest() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut all = Stream::default();
        for k in 0..8001 {
            let time = f64::from(k) * 0.01;
            all.push(time, setpoint(0.3 * time.sin() + 0.01 * normal(), 0.5 + 0.02 * normal()));
        }
        let (line, inferred) = thinned(&all);
        assert_eq!(inferred.len(), 4000);
        let flown = as_flown(&line, &inferred, 3);
        let off = |of: &Stream<AttitudeSetpoint>, number: usize| {
            let square = |i: &usize| offset(&line.values()[*i], &of.values()[*i])[number].powi(2);
            (inferred.iter().map(square).sum::<f64>() / 4000.0).sqrt()
        };
        for number in [0, 3, 6] {
            let (truly, drawn) = (off(&all, number), off(&flown, number));
            assert!((drawn / truly - 1.0).abs() < 0.1, "{number}: {drawn} for {truly}");
        }
        assert!(off(&flown, 1) < 1e-3);
        assert_eq!(flown.len(), line.len());
        assert_eq!(flown.values()[0], all.values()[0]);
    }

    #[test]
    fn what_jumps_is_on_one_side_of_the_jump_or_the_other() {
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
}
