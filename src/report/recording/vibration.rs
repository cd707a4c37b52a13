//! Vibration: the part of a stream that is faster than the vehicle's motion.

use crate::log::import::Stream;

/// Length of the running mean that stands for the motion, s: what remains is faster than 10 Hz.
const MOTION_S: f64 = 0.1;
/// Length of the windows over which vibration is averaged, s.
const WINDOW_S: f64 = 0.5;

/// Each sample less the mean around it.
fn fast(stream: &Stream<[f64; 3]>) -> Vec<[f64; 3]> {
    let (times, values) = (stream.times(), stream.values());
    let (mut from, mut to) = (0, 0);
    let mut sum = [0.0; 3];
    let add = |sum: &mut [f64; 3], value: &[f64; 3], sign: f64| {
        for (s, v) in sum.iter_mut().zip(value) {
            *s += sign * v;
        }
    };
    let mut out = Vec::with_capacity(times.len());
    for (time, value) in times.iter().zip(values) {
        while to < times.len() && times[to] <= time + MOTION_S / 2.0 {
            add(&mut sum, &values[to], 1.0);
            to += 1;
        }
        while from < to && times[from] < time - MOTION_S / 2.0 {
            add(&mut sum, &values[from], -1.0);
            from += 1;
        }
        let n = (to - from).max(1) as f64;
        out.push(std::array::from_fn(|i| value[i] - sum[i] / n));
    }
    out
}

/// Whether a stream is fast enough to show vibration at all.
fn shows_vibration(stream: &Stream<[f64; 3]>) -> bool {
    stream.period().is_some_and(|period| period < MOTION_S / 4.0)
}

/// Root mean square of each axis, in the stream's unit; `None` if the stream is too slow.
pub(super) fn rms(stream: &Stream<[f64; 3]>) -> Option<[f64; 3]> {
    if !shows_vibration(stream) {
        return None;
    }
    let fast = fast(stream);
    let n = fast.len() as f64;
    Some([0, 1, 2].map(|i| (fast.iter().map(|v| v[i] * v[i]).sum::<f64>() / n).sqrt()))
}

/// Middles of windows in s, and the root mean square of each axis in them; empty if the stream is
/// too slow.
pub(in crate::report) fn over_time(stream: &Stream<[f64; 3]>) -> (Vec<f64>, [Vec<f64>; 3]) {
    let (mut middles, mut rms) = (Vec::new(), [const { Vec::new() }; 3]);
    if !shows_vibration(stream) {
        return (middles, rms);
    }
    let (times, fast) = (stream.times(), fast(stream));
    let mut from = 0;
    while let Some(start) = times.get(from).copied() {
        let to = times.partition_point(|time| *time < start + WINDOW_S).max(from + 1);
        let window = &fast[from..to];
        middles.push(start + WINDOW_S / 2.0);
        for (axis, rms) in rms.iter_mut().enumerate() {
            let square: f64 = window.iter().map(|v| v[axis] * v[axis]).sum();
            rms.push((square / window.len() as f64).sqrt());
        }
        from = to;
    }
    (middles, rms)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_motion_is_no_vibration() {
        let mut force = Stream::default();
        for k in 0..2000 {
            let time = 0.002 * f64::from(k);
            let slow = 3.0 * (2.0 * time).sin();
            let fast = 2.0 * (2.0 * std::f64::consts::PI * 100.0 * time).sin();
            force.push(time, [slow, slow + fast, -9.8]);
        }
        let [front, right, down] = rms(&force).expect("fast enough");
        assert!(
            front < 0.02 && down < 1e-9 && (right - 2_f64.sqrt()).abs() < 0.05,
            "{front} {right}"
        );
    }
}
