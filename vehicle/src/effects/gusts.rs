//! Gusts: Dryden turbulence with time constant tau = length / speed.
//!
//! White noise of unit density drives a filter for each axis. North is first order, H = sigma
//! sqrt(2 tau) / (1 + tau s); east and down are second order, H = sigma sqrt(tau) (1 + sqrt(3) tau
//! s) / (1 + tau s)^2. The standard deviations are sigma, sigma and 0.6 sigma (MIL-F-8785C forms
//! with a constant airspeed).

use std::f64::consts::{FRAC_PI_2, TAU};

use rand::Rng;
use rand_distr::StandardNormal;

use super::{Effect, EffectId, Need, Parameter, Slots, Spec};
use crate::frame::Ned;

/// Dryden turbulence of the air.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gusts {
    /// Standard deviation along north and east, m/s.
    pub sigma_m_s: f64,
    /// Turbulence length scale in m.
    pub length_m: f64,
    /// Speed at which the turbulence passes the vehicle, m/s.
    pub speed_m_s: f64,
}

impl Effect for Gusts {
    const ID: EffectId = EffectId::Gusts;
    const SPEC: Spec = Spec {
        id: "gusts",
        parameters: &[
            Parameter::scalar("sigma_m_s", "m/s", 0.0, [0.0, 20.0]),
            Parameter::scalar("length_m", "m", 5.0, [0.05, 2000.0]).shape(),
            Parameter::scalar("speed_m_s", "m/s", 5.0, [0.05, 100.0]).shape(),
        ],
        needs: &[Need::Pose, Need::Input],
        strong: |_, chance, growth| {
            growth.by[0] = 4.0;
            growth.from[1] = chance.log_within([2.0, 20.0]);
            growth.from[2] = chance.within([2.0, 8.0]);
        },
        ..Spec::PLAIN
    };

    fn from_slots(&[sigma_m_s, length_m, speed_m_s, ..]: &Slots) -> Self {
        Self { sigma_m_s, length_m, speed_m_s }
    }
}

impl Gusts {
    /// Share of the north component's power between two frequencies, Hz: `2/pi (atan(2 pi f tau))`
    /// from the lower to the upper.
    pub fn share_of_power(&self, from_hz: f64, to_hz: f64) -> f64 {
        let below = |hz: f64| (TAU * hz * self.length_m / self.speed_m_s).atan() / FRAC_PI_2;
        below(to_hz) - below(from_hz)
    }
}

/// The state of the turbulence, advanced exactly from step to step.
///
/// With z1 a unit-variance first-order process and z2 the same low pass applied to z1, the second
/// order output of variance 1 is (sqrt(3) z1 + (1 - sqrt(3)) z2) / sqrt(2).
#[derive(Clone, Debug)]
pub struct Turbulence {
    sigma: f64,
    decay: f64,
    coupling: f64,
    /// Lower triangle of the Cholesky factor of the noise in (z1, z2) of one step.
    noise: [f64; 3],
    north: f64,
    east: [f64; 2],
    down: [f64; 2],
}

impl Turbulence {
    /// Turbulence in its stationary state, for steps of `step_s`.
    pub fn new(gusts: &Gusts, step_s: f64, rng: &mut impl Rng) -> Self {
        let ratio = step_s * gusts.speed_m_s / gusts.length_m;
        let decay = (-ratio).exp();
        let coupling = ratio * decay;
        // Q = P - A P A^T with the stationary covariance P = [[1, 1/2], [1/2, 1/2]] and
        // A = [[decay, 0], [coupling, decay]].
        let q11 = 1.0 - decay * decay;
        let q12 = 0.5 - decay * (coupling + 0.5 * decay);
        let q22 = 0.5 - (coupling * coupling + coupling * decay + 0.5 * decay * decay);
        let l11 = q11.sqrt();
        let l21 = q12 / l11;
        // At short steps the difference is smaller than the rounding error.
        let l22 = (q22 - l21 * l21).max(0.0).sqrt();
        let mut pair = || {
            let (a, b): (f64, f64) = (rng.sample(StandardNormal), rng.sample(StandardNormal));
            [a, 0.5 * a + 0.5 * b]
        };
        let (east, down, [north, _]) = (pair(), pair(), pair());
        let noise = [l11, l21, l22];
        Self { sigma: gusts.sigma_m_s, decay, coupling, noise, north, east, down }
    }

    /// Advances by one step.
    pub fn advance(&mut self, rng: &mut impl Rng) {
        let mut normal = || -> f64 { rng.sample(StandardNormal) };
        let [l11, l21, l22] = self.noise;
        self.north = self.decay * self.north + l11 * normal();
        for z in [&mut self.east, &mut self.down] {
            let (a, b) = (normal(), normal());
            z[1] = self.coupling * z[0] + self.decay * z[1] + l21 * a + l22 * b;
            z[0] = self.decay * z[0] + l11 * a;
        }
    }

    /// Velocity of the air on top of the steady wind, m/s.
    pub fn velocity(&self) -> Ned {
        let second = |[z1, z2]: [f64; 2]| {
            let root3 = 3.0_f64.sqrt();
            std::f64::consts::FRAC_1_SQRT_2 * (root3 * z1 + (1.0 - root3) * z2)
        };
        Ned::new(self.north, second(self.east), 0.6 * second(self.down)) * self.sigma
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    /// Sample moments over many correlation times, at one step much shorter than the time constant
    /// and one comparable to it.
    #[test]
    fn gust_deviations_match_the_specification() {
        for step in [0.02, 0.5] {
            let mut rng = Pcg64Mcg::seed_from_u64(4);
            let gusts = Gusts { sigma_m_s: 2.0, length_m: 2.0, speed_m_s: 4.0 };
            let mut air = Turbulence::new(&gusts, step, &mut rng);
            let (mut sums, count) = ([0.0; 3], 400_000);
            for _ in 0..count {
                air.advance(&mut rng);
                for (sum, v) in sums.iter_mut().zip(air.velocity().to_array()) {
                    *sum += v * v;
                }
            }
            for (sum, sigma) in sums.iter().zip([2.0, 2.0, 1.2]) {
                let found = (sum / f64::from(count)).sqrt();
                assert!((found / sigma - 1.0).abs() < 0.04, "step {step}: {found} not {sigma}");
            }
        }
    }

    #[test]
    fn half_of_the_power_lies_below_the_corner_frequency() {
        let gusts = Gusts { sigma_m_s: 1.0, length_m: 6.0, speed_m_s: 3.0 };
        assert!((gusts.share_of_power(0.0, 1.0 / (TAU * 2.0)) - 0.5).abs() < 1e-12);
        assert!((gusts.share_of_power(0.0, 1e9) - 1.0).abs() < 1e-6);
    }

    /// Autocorrelations: exp(-t / tau) along north, (1 - t / (2 tau)) exp(-t / tau) across.
    #[test]
    fn gust_correlations_match_dryden() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let gusts = Gusts { sigma_m_s: 1.0, length_m: 1.0, speed_m_s: 1.0 };
        let mut air = Turbulence::new(&gusts, 0.1, &mut rng);
        let series: Vec<_> = (0..400_000)
            .map(|_| {
                air.advance(&mut rng);
                air.velocity().to_array()
            })
            .collect();
        let lag = 10; // one time constant
        let correlation = |axis: usize| {
            let pairs = series.iter().zip(&series[lag..]);
            let sum: f64 = pairs.map(|(a, b)| a[axis] * b[axis]).sum();
            sum / (series.len() - lag) as f64
        };
        let e = (-1.0_f64).exp();
        assert!((correlation(0) - e).abs() < 0.03);
        assert!((correlation(1) - 0.5 * e).abs() < 0.03);
    }
}
