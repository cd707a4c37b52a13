//! The filters of a rate loop.

use std::f64::consts::{SQRT_2, TAU};

use vehicle::frame::Frd;

/// A second-order Butterworth low-pass for each axis, which both autopilots apply to the gyro.
#[derive(Clone, Debug)]
pub(super) struct Butterworth {
    /// First coefficient of the numerator, and the denominator.
    b: f64,
    a: [f64; 2],
    state: Option<[Frd; 2]>,
}

impl Butterworth {
    /// Limits the cutoff to 0.45 of the sample rate, where the bilinear transform is still valid.
    pub fn new(cutoff_hz: f64, rate_hz: f64) -> Self {
        let k = (0.5 * TAU * cutoff_hz.min(0.45 * rate_hz) / rate_hz).tan();
        let norm = 1.0 / (1.0 + SQRT_2 * k + k * k);
        let a = [2.0 * (k * k - 1.0) * norm, (1.0 - SQRT_2 * k + k * k) * norm];
        Self { b: k * k * norm, a, state: None }
    }

    pub fn reset(&mut self) {
        self.state = None;
    }

    /// Filters a sample; starts in the steady state of the first one.
    pub fn update(&mut self, input: Frd) -> Frd {
        let [a1, a2] = self.a;
        let steady = input * (1.0 / (1.0 + a1 + a2));
        let [w1, w2] = self.state.unwrap_or([steady; 2]);
        let w = input - w1 * a1 - w2 * a2;
        self.state = Some([w, w1]);
        (w + w1 * 2.0 + w2) * self.b
    }
}

/// The derivative of a signal through a first-order low-pass, for each axis.
#[derive(Clone, Debug)]
pub(super) struct Derivative {
    time_constant_s: f64,
    last: Option<Frd>,
    value: Frd,
}

impl Derivative {
    pub fn new(cutoff_hz: f64) -> Self {
        Self { time_constant_s: 1.0 / (TAU * cutoff_hz), last: None, value: Frd::zero() }
    }

    pub fn reset(&mut self) {
        (self.last, self.value) = (None, Frd::zero());
    }

    pub fn update(&mut self, input: Frd, dt: f64) -> Frd {
        let last = self.last.replace(input).unwrap_or(input);
        let raw = (input - last) * (1.0 / dt);
        let share = dt / (dt + self.time_constant_s);
        self.value += (raw - self.value) * share;
        self.value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gain of the filter at a frequency, from its response to a sine.
    fn gain(cutoff_hz: f64, at_hz: f64) -> f64 {
        let mut filter = Butterworth::new(cutoff_hz, 400.0);
        let answers = (0..4000).map(|tick| {
            let phase = TAU * at_hz * f64::from(tick) / 400.0;
            filter.update(Frd::new(phase.sin(), 0.0, 0.0)).front()
        });
        answers.skip(2000).fold(0.0, |most: f64, value| most.max(value.abs()))
    }

    #[test]
    fn gyro_filter_passes_slow_motion_and_halves_power_at_cutoff() {
        assert!((gain(40.0, 1.0) - 1.0).abs() < 0.01);
        assert!((gain(40.0, 40.0) - 0.5_f64.sqrt()).abs() < 0.02);
        assert!(gain(40.0, 150.0) < 0.05);
    }

    #[test]
    fn derivative_of_a_ramp_is_its_slope() {
        let mut derivative = Derivative::new(30.0);
        let slopes = (0..400).map(|tick| {
            derivative.update(Frd::new(f64::from(tick) * 0.01, 0.0, 0.0), 0.0025).front()
        });
        assert!((slopes.last().unwrap() - 4.0).abs() < 1e-6);
    }
}
