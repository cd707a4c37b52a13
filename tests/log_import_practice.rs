//! Practice logs import with streams that agree: attitude integrates the body rate, and position
//! the velocity.

use std::fs;
use std::path::{Path, PathBuf};

use crate::import_support::{assert_ascends, import};
use downwash::log::import::Stream;

/// Folders of practice flights: `DOWNWASH_PRACTICE`, else `shared/` beside the repository.
fn practice_tlogs() -> Vec<PathBuf> {
    let folders = match std::env::var_os("DOWNWASH_PRACTICE") {
        Some(folder) => vec![PathBuf::from(folder)],
        None => {
            let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared");
            ["practice", "practice-autopilot", "practice-real"].map(|n| shared.join(n)).to_vec()
        }
    };
    let cases = folders.iter().filter_map(|folder| fs::read_dir(folder).ok()).flatten();
    let files = cases.filter_map(|case| fs::read_dir(case.ok()?.path()).ok()).flatten();
    let mut files: Vec<PathBuf> = files
        .filter_map(|file| Some(file.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|extension| extension == "tlog"))
        .collect();
    files.sort();
    files
}

/// Slope of the least-squares line through the origin, and the share of `y` that it explains.
fn regression(pairs: &[(f64, f64)]) -> (f64, f64) {
    let sum = |f: fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>();
    let (xx, xy, yy) = (sum(|(x, _)| x * x), sum(|(x, y)| x * y), sum(|(_, y)| y * y));
    (xy / xx, xy * xy / (xx * yy))
}

/// A stream's integral from its first sample, by the trapezoidal rule.
struct Integral {
    times: Vec<f64>,
    sums: Vec<[f64; 3]>,
}

impl Integral {
    fn new(stream: &Stream<[f64; 3]>) -> Self {
        let mut sum = [0.0; 3];
        let mut sums = vec![sum];
        for (t, v) in stream.times().windows(2).zip(stream.values().windows(2)) {
            sum = std::array::from_fn(|i| sum[i] + 0.5 * (t[1] - t[0]) * (v[0][i] + v[1][i]));
            sums.push(sum);
        }
        Self { times: stream.times().to_vec(), sums }
    }

    fn at(&self, time: f64) -> Option<[f64; 3]> {
        let b = self.times.partition_point(|t| *t <= time);
        let a = b.checked_sub(1)?;
        let share = (time - self.times[a]) / (self.times.get(b)? - self.times[a]);
        Some(std::array::from_fn(|i| self.sums[a][i] + share * (self.sums[b][i] - self.sums[a][i])))
    }
}

/// Regression of the changes of `stream` over `window` seconds on the integral of `rate`: slope,
/// share explained, and the delay of `stream` that maximises the share.
fn kinematics<T>(
    stream: &Stream<T>,
    rate: &Stream<[f64; 3]>,
    window: f64,
    change: impl Fn(&T, &T) -> [f64; 3],
) -> Option<(f64, f64, f64)> {
    let integral = Integral::new(rate);
    let (first, last) = (stream.times().first()? + 0.5, stream.times().last()? - 0.5);
    let mut best = None;
    for step in -20..=20 {
        let delay = f64::from(step) * 4e-3;
        let mut pairs = Vec::new();
        let mut time = first;
        while time < last {
            let (a, b) = (stream.index_at(time)?, stream.index_at(time + window)?);
            let (from, to) = (stream.times()[a] - delay, stream.times()[b] - delay);
            if let (Some(before), Some(after)) = (integral.at(from), integral.at(to)) {
                let found = change(&stream.values()[a], &stream.values()[b]);
                pairs.extend((0..3).map(|i| (after[i] - before[i], found[i])));
            }
            time += window;
        }
        let (slope, explained) = regression(&pairs);
        if pairs.len() > 100 && best.is_none_or(|(_, most, _)| explained > most) {
            best = Some((slope, explained, delay));
        }
    }
    best
}

/// In every practice log times ascend, rates suffice and streams agree.
#[test]
fn practice_logs_import_with_consistent_streams() {
    for path in practice_tlogs() {
        let name = path.display().to_string();
        let flight = import(&path);
        assert_ascends(&flight.attitude, &name);
        assert_ascends(&flight.position, &name);
        assert_ascends(&flight.body_rate, &name);
        assert_ascends(&flight.outputs, &name);
        assert_ascends(&flight.setpoint, &name);
        assert_ascends(&flight.voltage, &name);
        assert!(flight.outputs.rate() > 50.0, "{name}: {}", flight.outputs.rate());
        // All streams of a flight span the same interval.
        let ends = |times: &[f64]| Some((*times.first()?, *times.last()?));
        let outputs = ends(flight.outputs.times()).expect("outputs");
        for times in [flight.attitude.times(), flight.position.times(), flight.body_rate.times()] {
            let Some((from, to)) = ends(times) else { continue };
            assert!((from - outputs.0).abs() < 1.0 && (to - outputs.1).abs() < 1.0, "{name}");
        }
        let period = flight.outputs.period().expect("outputs");
        let pauses = flight.outputs.times().windows(2).map(|pair| pair[1] - pair[0]);
        let longest = pauses.fold(0.0, f64::max);
        let rate = flight.body_rate.map(|rate| rate.to_array());
        let turn = kinematics(&flight.attitude, &rate, 0.1, |a, b| {
            let turn = a.inverse().compose(*b).canonical();
            [turn.x, turn.y, turn.z].map(|c| 2.0 * c)
        });
        let velocity = flight.velocity.map(|velocity| velocity.to_array());
        let way = kinematics(&flight.position, &velocity, 0.2, |a, b| (*b - *a).to_array());
        println!(
            "{name}: attitude {} at {:.1} Hz, rate {:.1}, force {:.1}, position {:.1}, \
             outputs {:.1} (longest {:.1} periods) {:?}, setpoint {:.1}, voltage {:.1}, rpm {:.1}, \
             in air {}, {:?}; turn {turn:.4?}, way {way:.4?}; {:?}",
            flight.attitude.len(),
            flight.attitude.rate(),
            flight.body_rate.rate(),
            flight.specific_force.rate(),
            flight.position.rate(),
            flight.outputs.rate(),
            longest / period,
            flight.motor_unit,
            flight.setpoint.rate(),
            flight.voltage.rate(),
            flight.rotor_speed.rate(),
            flight.in_air.len(),
            flight.clock,
            flight.left_out,
        );
        for (slope, explained, _) in [turn, way].into_iter().flatten() {
            // Real flights near hover hardly turn, so noise has a large share and lowers the slope
            // by as much.
            let tolerance = if explained > 0.9 { 0.1 } else { 0.35 };
            assert!((slope - 1.0).abs() < tolerance, "{name}: {slope} {explained}");
        }
        assert_eq!(flight.left_out, [], "{name}");
    }
}
