//! A model's acceleration errors on flights that it was not fitted to.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::frame::Ned;

/// Lags of the residual's autocovariance, s. White measurement noise, which does not move the
/// vehicle, contributes to neither.
const LAGS_S: [f64; 2] = [0.1, 0.5];
/// Least and greatest correlation time, s. A disturbance that outlasts the flight, such as a
/// steady wind, has the greatest.
const CORRELATION_S: [f64; 2] = [0.05, 60.0];

/// The measured acceleration less the model's, at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Time in the flight, s.
    pub time_s: f64,
    /// Speed of the vehicle, m/s.
    pub speed_m_s: f64,
    /// Measured minus modelled acceleration in world axes, m/s^2.
    pub acceleration: Ned,
}

/// Unmodelled acceleration along an axis: a first-order process `sigma z`, where z has variance 1
/// and `sigma^2 = at_rest^2 + (per_speed v)^2` at the speed v.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisError {
    /// Standard deviation at rest, m/s^2.
    pub at_rest_m_s2: f64,
    /// Standard deviation per unit of speed, 1/s.
    pub per_speed_s: f64,
    /// Correlation time of z, s.
    pub correlation_s: f64,
}

/// A model's errors, horizontally (each of north and east) and vertically.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelError {
    /// Error along north and along east.
    pub horizontal: AxisError,
    /// Error along down.
    pub vertical: AxisError,
}

/// Products of the residual with its value one lag later, and squared speeds.
#[derive(Clone, Debug, Default)]
struct Products(Vec<[f64; 2]>);

impl AxisError {
    /// Standard deviation at a speed (m/s), m/s^2.
    pub fn deviation(&self, speed_m_s: f64) -> f64 {
        self.at_rest_m_s2.hypot(self.per_speed_s * speed_m_s)
    }

    /// Fits the process to the products at the two lags.
    fn of([near, far]: [&Products; 2]) -> Self {
        let [near_lag, far_lag] = LAGS_S;
        let [least, most] = CORRELATION_S;
        let (close, apart) = (near.mean(), far.mean());
        let correlation_s = if close <= 0.0 || apart <= 0.0 {
            least
        } else if apart >= close {
            most
        } else {
            ((far_lag - near_lag) / (close / apart).ln()).clamp(least, most)
        };
        let [at_rest, per_speed] = near.line().map(|square| {
            // Extrapolates from the lag to zero.
            (square * (near_lag / correlation_s).exp()).sqrt()
        });
        Self { at_rest_m_s2: at_rest, per_speed_s: per_speed, correlation_s }
    }
}

impl Products {
    /// Adds the products of a flight's residuals along an axis.
    fn add(&mut self, residuals: &[Residual], lag_s: f64, along: impl Fn(&Residual) -> f64) {
        let mut later = 0;
        for now in residuals {
            while residuals.get(later).is_some_and(|r| r.time_s < now.time_s + lag_s - 1e-6) {
                later += 1;
            }
            let Some(then) = residuals.get(later) else { return };
            // No product across a gap in the log.
            if then.time_s - now.time_s < 1.2 * lag_s {
                let speed = now.speed_m_s;
                self.0.push([along(now) * along(then), speed * speed]);
            }
        }
    }

    fn mean(&self) -> f64 {
        self.0.iter().map(|[product, _]| product).sum::<f64>() / self.0.len().max(1) as f64
    }

    /// Least-squares fit of `a + b v^2` to the products, with `a` and `b` at least 0.
    fn line(&self) -> [f64; 2] {
        let count = self.0.len().max(1) as f64;
        let mean = |value: &dyn Fn(&[f64; 2]) -> f64| self.0.iter().map(value).sum::<f64>() / count;
        let (product, square) = (mean(&|[p, _]| *p), mean(&|[_, s]| *s));
        let (cross, fourth) = (mean(&|[p, s]| p * s), mean(&|[_, s]| s * s));
        let spread = fourth - square * square;
        // A single speed cannot separate the two: attribute all to rest.
        if spread <= 1e-9 * fourth.max(1e-12) {
            return [product.max(0.0), 0.0];
        }
        let slope = (cross - product * square) / spread;
        let rest = product - slope * square;
        if slope < 0.0 {
            [product.max(0.0), 0.0]
        } else if rest < 0.0 {
            [0.0, (cross / fourth).max(0.0)]
        } else {
            [rest, slope]
        }
    }
}

impl ModelError {
    /// Estimates the errors from the residuals of flights, each in order of time. `None` if no two
    /// residuals of a flight are half a second apart.
    pub fn of(flights: &[Vec<Residual>]) -> Option<Self> {
        let products = |along: &[fn(&Residual) -> f64]| {
            LAGS_S.map(|lag| {
                let mut products = Products::default();
                for flight in flights {
                    along.iter().for_each(|along| products.add(flight, lag, along));
                }
                products
            })
        };
        let horizontal = products(&[|r| r.acceleration.north(), |r| r.acceleration.east()]);
        let vertical = products(&[|r| r.acceleration.down()]);
        if horizontal[1].0.is_empty() {
            return None;
        }
        Some(Self {
            horizontal: AxisError::of(horizontal.each_ref()),
            vertical: AxisError::of(vertical.each_ref()),
        })
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64Mcg;

    use super::*;

    #[test]
    fn drawn_process_is_recovered_under_white_noise() {
        let truth = AxisError { at_rest_m_s2: 0.3, per_speed_s: 0.4, correlation_s: 0.8 };
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let mut normal = || random.sample::<f64, _>(StandardNormal);
        let keep = (-0.01 / truth.correlation_s).exp();
        let flights: Vec<Vec<Residual>> = (0..60)
            .map(|flight| {
                let mut z: [f64; 3] = std::array::from_fn(|_| normal());
                (0..3000)
                    .map(|k| {
                        let time_s = 0.01 * f64::from(k);
                        let speed_m_s = (0.3 * time_s + f64::from(flight)).sin().abs() * 2.0;
                        z = z.map(|z| keep * z + (1.0 - keep * keep).sqrt() * normal());
                        let [n, e, d] = z.map(|z| truth.deviation(speed_m_s) * z + 0.5 * normal());
                        Residual { time_s, speed_m_s, acceleration: Ned::new(n, e, d) }
                    })
                    .collect()
            })
            .collect();
        let found = ModelError::of(&flights).expect("products");
        for axis in [found.horizontal, found.vertical] {
            assert!((axis.at_rest_m_s2 - 0.3).abs() < 0.06, "{axis:?}");
            assert!((axis.per_speed_s - 0.4).abs() < 0.04, "{axis:?}");
            assert!((axis.correlation_s - 0.8).abs() < 0.15, "{axis:?}");
        }
    }

    #[test]
    fn constant_error_is_steady_and_pure_noise_is_zero() {
        let steady = |push: f64| {
            let at = |k: i32| Residual {
                time_s: 0.01 * f64::from(k),
                speed_m_s: 0.0,
                acceleration: Ned::new(push, -push, 0.5 * push),
            };
            (0..500).map(at).collect::<Vec<_>>()
        };
        let found = ModelError::of(&[steady(0.4), steady(-0.4)]).expect("products");
        assert!((found.horizontal.at_rest_m_s2 - 0.4).abs() < 1e-3, "{found:?}");
        assert!((found.vertical.at_rest_m_s2 - 0.2).abs() < 1e-3, "{found:?}");
        assert_eq!((found.horizontal.correlation_s, found.horizontal.per_speed_s), (60.0, 0.0));
        let none = ModelError::of(&[steady(0.0)]).expect("products");
        assert_eq!(none.horizontal.deviation(3.0), 0.0);
        assert_eq!(ModelError::of(&[]), None);
        assert_eq!(ModelError::of(&[steady(1.0)[..20].to_vec()]), None);
    }
}
