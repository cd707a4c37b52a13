//! The values of an input: listed, evenly spaced, or drawn.

use std::path::Path;

use anyhow::{anyhow, bail};
use rand::Rng;
use rand_distr::{Distribution, Normal};
use serde::Deserialize;
use toml::Value;

use super::pattern;

/// Most points of a sweep.
pub(super) const POINTS_MAX: usize = 10_000_000;

/// Values on a grid.
#[derive(Debug, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a list of values, a pattern of files, or { from = 0.0, to = 1.0, count = 5 }"
)]
pub(super) enum Axis {
    Values(Vec<Value>),
    /// A pattern of files or folders, for an input that is a path.
    Pattern(String),
    Range(Range),
}

/// Evenly spaced values, including both ends.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Range {
    from: f64,
    to: f64,
    count: usize,
    /// Evenly spaced in their logarithm.
    #[serde(default)]
    log: bool,
}

/// A distribution.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Drawn {
    /// Between two numbers.
    Uniform([f64; 2]),
    /// Between two numbers, evenly in the logarithm.
    LogUniform([f64; 2]),
    /// Mean and standard deviation.
    Normal([f64; 2]),
    /// One of these.
    Choice(Vec<Value>),
}

/// Seeds of each point.
#[derive(Debug, Deserialize)]
#[serde(untagged, expecting = "expected a number of seeds, or a list of seeds of at least 0")]
pub(super) enum Seeds {
    Count(u64),
    These(Vec<u64>),
}

impl Default for Seeds {
    fn default() -> Self {
        Self::Count(1)
    }
}

impl Seeds {
    /// All seeds; a count is cut to one more than [`POINTS_MAX`].
    pub fn each(&self) -> Vec<u64> {
        match self {
            Self::Count(count) => (1..=*count.min(&(POINTS_MAX as u64 + 1))).collect(),
            Self::These(seeds) => seeds.clone(),
        }
    }
}

impl Axis {
    /// The values; patterns are relative to `folder`.
    pub fn values(&self, folder: &Path) -> anyhow::Result<Vec<Value>> {
        match self {
            Self::Values(values) => Ok(values.clone()),
            Self::Pattern(pattern) => {
                let found = pattern::fitting(folder, pattern)?;
                Ok(found.into_iter().map(Value::String).collect())
            }
            Self::Range(Range { from, to, count, log }) => {
                let is_possible =
                    from.is_finite() && to.is_finite() && (to - from).is_finite() && *count > 0;
                if !is_possible || *log && !(*from > 0.0 && *to > 0.0) || *count > POINTS_MAX {
                    bail!(
                        "expected finite numbers, above 0 with log, and a count, found {from}, {to} \
                         and {count}"
                    );
                }
                let share = |k: usize| k as f64 / (*count - 1).max(1) as f64;
                let value = |k: usize| match (k, *log) {
                    (0, _) => *from,
                    (k, _) if k == count - 1 => *to,
                    (k, true) => from * (to / from).powf(share(k)),
                    (k, false) => from + (to - from) * share(k),
                };
                Ok((0..*count).map(|k| Value::Float(value(k))).collect())
            }
        }
    }
}

impl Drawn {
    /// Rejects an invalid distribution.
    pub fn check(&self) -> anyhow::Result<()> {
        match self {
            Self::Uniform([low, high]) if (high - low).is_finite() && low <= high => Ok(()),
            Self::LogUniform([low, high]) if *low > 0.0 && high.is_finite() && low <= high => {
                Ok(())
            }
            Self::Normal([mean, deviation])
                if mean.is_finite() && deviation.is_finite() && *deviation >= 0.0 =>
            {
                Ok(())
            }
            Self::Choice(values) if !values.is_empty() => Ok(()),
            other => Err(anyhow!(
                "expected finite bounds in their order, above 0 for log_uniform, a deviation of at \
                 least 0, or something to choose from, found {other:?}"
            )),
        }
    }

    /// Draws a value.
    pub fn draw(&self, rng: &mut impl Rng) -> Value {
        let between = |rng: &mut dyn rand::RngCore, low: f64, high: f64| {
            low + (high - low) * rng.random::<f64>()
        };
        match self {
            Self::Uniform([low, high]) => Value::Float(between(rng, *low, *high)),
            Self::LogUniform([low, high]) => {
                Value::Float(between(rng, low.ln(), high.ln()).exp().clamp(*low, *high))
            }
            Self::Normal([mean, deviation]) => {
                let drawn = Normal::new(*mean, *deviation).map(|normal| normal.sample(rng));
                Value::Float(drawn.unwrap_or(*mean))
            }
            Self::Choice(values) => values
                .get(rng.random_range(0..values.len()))
                .cloned()
                .unwrap_or(Value::Boolean(true)),
        }
    }
}
