//! Errors of the position estimate beyond noise: slow drift, and a temporary GPS error.

use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;

use crate::config::{EstimatorConfig, GpsGlitch};
use vehicle::frame::Ned;

/// The estimator's status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EstimatorStatus {
    /// Number of resets of the estimate, modulo 256.
    pub reset_count: u8,
    /// Whether the estimator rejects GPS.
    pub rejects_gps: bool,
}

/// Error of the estimated position and velocity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct EstimateError {
    pub position: [f64; 3],
    pub velocity: [f64; 3],
}

/// A drifting error: white noise through two equal lags, `x'' + 2 w x' + w^2 x = n`.
#[derive(Clone, Copy, Debug, Default)]
struct Wander {
    value: [f64; 3],
    slope: [f64; 3],
}

impl Wander {
    /// Advances by `elapsed` s. `deviation` is the stationary standard deviation of each axis.
    fn advance(&mut self, deviation: f64, time_s: f64, elapsed: f64, rng: &mut Pcg64Mcg) {
        let w = 1.0 / time_s;
        let kick = (4.0 * w.powi(3) * elapsed).sqrt() * deviation;
        for (x, v) in self.value.iter_mut().zip(&mut self.slope) {
            let normal: f64 = rng.sample(StandardNormal);
            *v += -(2.0 * w * *v + w * w * *x) * elapsed + kick * normal;
            *x += *v * elapsed;
        }
    }
}

/// The state of the errors.
///
/// The velocity's error is the derivative of the position's drift, as in a filter, plus an
/// independent drift.
#[derive(Clone, Debug)]
pub(crate) struct ErrorModel {
    config: EstimatorConfig,
    rng: Pcg64Mcg,
    position: Wander,
    velocity: Wander,
    /// Error that the estimate has adopted from GPS, m.
    taken: [f64; 3],
    /// Vehicle time since which GPS contradicts the estimate, us.
    contradicts_since_us: Option<u64>,
    status: EstimatorStatus,
}

impl ErrorModel {
    pub fn new(config: EstimatorConfig, seed: u64) -> Self {
        Self {
            config,
            rng: Pcg64Mcg::seed_from_u64(seed),
            position: Wander::default(),
            velocity: Wander::default(),
            taken: [0.0; 3],
            contradicts_since_us: None,
            status: EstimatorStatus::default(),
        }
    }

    pub fn status(&self) -> EstimatorStatus {
        self.status
    }

    /// The errors at `now_us`, `elapsed` s after the previous call.
    pub fn advance(&mut self, now_us: u64, elapsed: f64) -> EstimateError {
        let EstimatorConfig {
            wander_m,
            wander_time_s,
            velocity_wander_m_s,
            velocity_wander_time_s,
            gps_glitch,
            ..
        } = self.config;
        let rng = &mut self.rng;
        if wander_m > 0.0 {
            self.position.advance(wander_m, wander_time_s, elapsed, rng);
        }
        if velocity_wander_m_s > 0.0 {
            self.velocity.advance(velocity_wander_m_s, velocity_wander_time_s, elapsed, rng);
        }
        if let Some(glitch) = gps_glitch {
            self.follow_gps(&glitch, now_us, elapsed);
        }
        EstimateError {
            position: std::array::from_fn(|axis| self.position.value[axis] + self.taken[axis]),
            velocity: std::array::from_fn(|axis| {
                self.position.slope[axis] + self.velocity.value[axis]
            }),
        }
    }

    /// Rejects GPS that contradicts the estimate for `reset_after_s`; then the estimate jumps to
    /// it. With `slide_time_s`, the estimate instead slides back as soon as GPS is correct again.
    fn follow_gps(&mut self, glitch: &GpsGlitch, now_us: u64, elapsed: f64) {
        let now_s = now_us as f64 * 1e-6;
        let is_wrong = (glitch.at_s..glitch.at_s + glitch.for_s).contains(&now_s);
        let gps = if is_wrong { glitch.offset_m } else { [0.0; 3] };
        let slide_s = self.config.slide_time_s;
        if !is_wrong && slide_s > 0.0 {
            self.taken = self.taken.map(|error| error * (-elapsed / slide_s).exp());
            self.status.rejects_gps = false;
            self.contradicts_since_us = None;
            return;
        }
        self.status.rejects_gps = gps != self.taken;
        if !self.status.rejects_gps {
            self.contradicts_since_us = None;
            return;
        }
        let since = *self.contradicts_since_us.get_or_insert(now_us);
        if now_us.saturating_sub(since) as f64 * 1e-6 >= self.config.reset_after_s {
            self.taken = gps;
            self.contradicts_since_us = None;
            self.status.reset_count = self.status.reset_count.wrapping_add(1);
            self.status.rejects_gps = false;
        }
    }
}

impl EstimateError {
    pub fn position(&self) -> Ned {
        Ned::from(self.position)
    }

    pub fn velocity(&self) -> Ned {
        Ned::from(self.velocity)
    }
}
