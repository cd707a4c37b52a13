//! Harmonic curves: one form for the sinusoid, figure-8, yaw and multisine families.

use std::f64::consts::TAU;

use vehicle::frame::Ned;

use super::desired_point::DesiredPoint;

/// offset + amplitude (sin(2 pi tau / period + phase) - sin(phase)) + rate tau, over phase time
/// tau. At tau = 0 the value is `offset`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Harmonic {
    pub offset: f64,
    pub amplitude: f64,
    /// s; any positive value where the amplitude is 0.
    pub period_s: f64,
    /// rad
    pub phase: f64,
    /// 1/s
    pub rate: f64,
}

impl Harmonic {
    /// A constant value.
    pub fn constant(offset: f64) -> Self {
        Self { offset, period_s: 1.0, ..Self::default() }
    }

    /// Value, first and second derivative with respect to tau.
    fn at(&self, tau: f64) -> [f64; 3] {
        let omega = TAU / self.period_s;
        let (sin, cos) = (omega * tau + self.phase).sin_cos();
        [
            self.offset + self.amplitude * (sin - self.phase.sin()) + self.rate * tau,
            self.amplitude * omega * cos + self.rate,
            -self.amplitude * omega * omega * sin,
        ]
    }
}

/// A sum of harmonics in each of north, east, down and yaw.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct HarmonicCurve {
    pub position: [Vec<Harmonic>; 3],
    pub yaw: Vec<Harmonic>,
}

impl HarmonicCurve {
    /// A curve with one harmonic per axis.
    pub fn of_one(position: [Harmonic; 3], yaw: Harmonic) -> Self {
        Self { position: position.map(|axis| vec![axis]), yaw: vec![yaw] }
    }

    /// The point at phase time tau, given tau and its first and second derivative over real time.
    pub fn sample(&self, [tau, rate, acceleration]: [f64; 3]) -> DesiredPoint {
        let axes = [0, 1, 2].map(|axis| sum_at(&self.position[axis], tau));
        let [yaw, yaw_slope, _] = sum_at(&self.yaw, tau);
        DesiredPoint {
            position: Ned::from(axes.map(|[value, ..]| value)),
            velocity: Ned::from(axes.map(|[_, slope, _]| slope * rate)),
            acceleration: Ned::from(
                axes.map(|[_, slope, curvature]| curvature * rate * rate + slope * acceleration),
            ),
            yaw,
            yaw_rate: yaw_slope * rate,
        }
    }
}

/// The sum's value, first and second derivative with respect to tau.
fn sum_at(harmonics: &[Harmonic], tau: f64) -> [f64; 3] {
    harmonics.iter().fold([0.0; 3], |sum, harmonic| {
        let at = harmonic.at(tau);
        [sum[0] + at[0], sum[1] + at[1], sum[2] + at[2]]
    })
}

/// Phase time over real time: its rate rises from 0 to 1 within `ramp_s`, and falls to 0 at the
/// end, so a vehicle at rest can follow from the first sample. The rate follows 10 x^3 - 15 x^4 + 6
/// x^5, whose first two derivatives vanish at both ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Envelope {
    ramp_s: f64,
    /// Phase time at the end.
    phase_s: f64,
}

impl Envelope {
    /// Covers `phase_s` seconds of a curve; `ramp_s` is capped at `phase_s`.
    pub fn new(phase_s: f64, ramp_s: f64) -> Self {
        Self { ramp_s: ramp_s.min(phase_s), phase_s }
    }

    /// Real time from rest to rest, s: each ramp covers half of its duration in phase time.
    pub fn duration(&self) -> f64 {
        self.phase_s + self.ramp_s
    }

    /// Phase time, its rate and its acceleration at real time `t` within the duration.
    pub fn phase(&self, t: f64) -> [f64; 3] {
        let from_end = self.duration() - t;
        if t < self.ramp_s {
            self.ramp(t)
        } else if from_end < self.ramp_s {
            let [phase, rate, acceleration] = self.ramp(from_end);
            [self.phase_s - phase, rate, -acceleration]
        } else {
            [t - 0.5 * self.ramp_s, 1.0, 0.0]
        }
    }

    fn ramp(&self, t: f64) -> [f64; 3] {
        let x = t / self.ramp_s;
        let (x2, x3) = (x * x, x * x * x);
        [
            self.ramp_s * x2 * x2 * (2.5 - 3.0 * x + x2),
            x3 * (10.0 - 15.0 * x + 6.0 * x2),
            30.0 * x2 * (1.0 - x) * (1.0 - x) / self.ramp_s,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn envelope_starts_and_ends_at_rest_and_covers_the_phase() {
        let envelope = Envelope::new(10.0, 2.0);
        assert_eq!(envelope.duration(), 12.0);
        assert_eq!(envelope.phase(0.0), [0.0, 0.0, 0.0]);
        let [phase, rate, acceleration] = envelope.phase(12.0);
        assert!((phase - 10.0).abs() < 1e-12 && rate == 0.0 && acceleration == 0.0);
        assert_eq!(envelope.phase(6.0), [5.0, 1.0, 0.0]);
    }

    proptest! {
        #[test]
        fn velocity_and_acceleration_match_finite_differences(t in 0.01..11.9f64, amplitude in -2.0..2.0f64, phase in 0.0..6.0f64, rate in -1.0..1.0f64) {
            let axis = Harmonic { offset: 0.3, amplitude, period_s: 3.0, phase, rate };
            let curve = HarmonicCurve::of_one([axis; 3], axis);
            let envelope = Envelope::new(10.0, 2.0);
            let at = |t| curve.sample(envelope.phase(t));
            let h = 1e-5;
            let (before, here, after) = (at(t - h), at(t), at(t + h));
            let velocity = (after.position.north() - before.position.north()) / (2.0 * h);
            let acceleration = (after.velocity.north() - before.velocity.north()) / (2.0 * h);
            prop_assert!((velocity - here.velocity.north()).abs() < 1e-4);
            prop_assert!((acceleration - here.acceleration.north()).abs() < 1e-3);
            let yaw_rate = (after.yaw - before.yaw) / (2.0 * h);
            prop_assert!((yaw_rate - here.yaw_rate).abs() < 1e-4);
        }
    }
}
