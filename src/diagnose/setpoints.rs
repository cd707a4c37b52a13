//! Setpoints that the vehicle had and the log lacks.
//!
//! A thinned log lacks setpoints that the vehicle followed. Where the numbers of their frames tell
//! that they were, they are put on the line between their neighbours, from which each lay off by the
//! noise that feedback puts into setpoints: replicas follow such ones, and log the line as well.

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use sitl::frame::{Attitude, Frd};

use crate::log::import::{AttitudeSetpoint, Stream};

/// Setpoints this far apart tell nothing of what was between, s.
const APART_MAX_S: f64 = 0.1;
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

/// How far setpoints lie off the line between their neighbours: standard deviations of a small
/// rotation [rad], of the body rate [rad/s] and of the thrust.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Scatter {
    rotation: [f64; 3],
    body_rate: [f64; 3],
    thrust: f64,
}

impl Scatter {
    /// That of the setpoints that are not `inferred`; by medians, for what is asked jumps at times.
    pub fn of(setpoints: &Stream<AttitudeSetpoint>, inferred: &[usize]) -> Self {
        let is_logged = |index: &usize| inferred.binary_search(index).is_err();
        let logged: Vec<usize> = (0..setpoints.len()).filter(is_logged).collect();
        let (times, values) = (setpoints.times(), setpoints.values());
        let mut squares: [Vec<f64>; 7] = Default::default();
        for triple in logged.windows(3) {
            let &[a, b, c] = triple else { continue };
            if times[c] - times[a] > APART_MAX_S {
                continue;
            }
            let share = (times[b] - times[a]) / (times[c] - times[a]);
            let (line, setpoint) = (values[a].between(&values[c], share), values[b]);
            let turned = line.attitude.zip(setpoint.attitude).map(|(line, attitude)| {
                let off = line.inverse().compose(attitude).canonical();
                [off.x, off.y, off.z].map(|half| 2.0 * half)
            });
            let rate = line.body_rate.zip(setpoint.body_rate).map(|(a, b)| (b - a).to_array());
            let thrust = line.thrust.zip(setpoint.thrust).map(|(a, b)| b - a);
            let off = turned.into_iter().flatten().chain(rate.into_iter().flatten()).chain(thrust);
            // A part that is not asked for is so in all setpoints, or its scatter means nothing.
            squares.iter_mut().zip(off).for_each(|(squares, off)| squares.push(off * off));
        }
        let [x, y, z, p, q, r, thrust] = squares.map(|mut squares| {
            let middle = squares.len() / 2;
            if squares.is_empty() {
                return 0.0;
            }
            let median = *squares.select_nth_unstable_by(middle, f64::total_cmp).1;
            (median / MEDIAN_SQUARE).sqrt()
        });
        Self { rotation: [x, y, z], body_rate: [p, q, r], thrust }
    }

    /// A setpoint that lies off `line` by as much.
    pub fn draw(&self, line: &AttitudeSetpoint, rng: &mut Pcg64Mcg) -> AttitudeSetpoint {
        let mut normal = || -> f64 { StandardNormal.sample(rng) };
        let [x, y, z] = self.rotation.map(|deviation| 0.5 * deviation * normal());
        let off = Attitude { w: 1.0, x, y, z }.normalized();
        let rate = Frd::from(self.body_rate.map(|deviation| deviation * normal()));
        let thrust = self.thrust * normal();
        AttitudeSetpoint {
            attitude: line.attitude.map(|attitude| attitude.compose(off)),
            body_rate: line.body_rate.map(|body_rate| body_rate + rate),
            thrust: line.thrust.map(|asked| (asked + thrust).clamp(0.0, 1.0)),
        }
    }
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
        let (line, mut moved) = (all.values().to_vec(), all.values().to_vec());
        moved[2] = setpoint(-1.0, 0.0);
        infer(all.times(), &mut moved, &inferred);
        assert_eq!(moved, line);
        assert!(completed(&Stream::default(), &missing).1.is_empty());
    }

    #[test]
    fn what_is_drawn_scatters_as_what_was_found() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut stream = Stream::default();
        for k in 0..4000 {
            let time = f64::from(k) * 0.01;
            stream.push(time, setpoint(0.3 * time.sin() + 0.01 * normal(), 0.5 + 0.02 * normal()));
        }
        let found = Scatter::of(&stream, &[]);
        // A neighbour's noise is half in the line.
        let expected = 1.5_f64.sqrt();
        assert!((found.thrust / (0.02 * expected) - 1.0).abs() < 0.05, "{found:?}");
        assert!((found.rotation[0] / (0.01 * expected) - 1.0).abs() < 0.05, "{found:?}");
        assert!(found.rotation[1] < 1e-4, "{found:?}");
        let line = setpoint(0.0, 0.5);
        let squares: f64 =
            (0..4000).map(|_| (found.draw(&line, &mut rng).thrust.unwrap() - 0.5).powi(2)).sum();
        assert!(((squares / 4000.0).sqrt() / found.thrust - 1.0).abs() < 0.05);
    }
}
