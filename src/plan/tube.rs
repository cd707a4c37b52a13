//! Tubes: bounds on the distance between a flight and its plan, at a stated confidence.
//!
//! A tube is a radius around the planned position, `r(t) = q s(t)`. The shape `s(t)` ([`Shape`])
//! propagates the model's errors on flights that it was not fitted to through the feedback; it is
//! wider where the plan is fast. Split conformal prediction over whole calibration flights gives
//! the multiplier q ([`conformal`]). A new flight stays within the tube from beginning to end with
//! at least the stated confidence if it is exchangeable with the calibration flights: the same
//! vehicle, feedback and kind of plan, and disturbances of the same distribution.

pub mod conformal;
pub mod error;
pub mod scale;
pub mod score;
pub mod search;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::{VehicleParams, bounded};

use self::error::{AxisError, ModelError};
use self::scale::{PERIOD_S, TrackingLoop};
use super::planned::PlannedThrough;
use super::planned_tube::PositionSource;
use super::problem::StateVector;

/// Identifier in the file's `schema` field.
const SCHEMA: &str = "downwash.tube";
/// Version of the file format; files of other versions are rejected.
const VERSION: u32 = 2;
/// Largest file, bytes.
const SIZE_MAX: u64 = 64 << 20;

/// The feedback and the model's errors, which give the standard deviation of the position error.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shape {
    /// Feedback gains on the position.
    pub feedback: TrackingLoop,
    /// Unmodelled acceleration.
    pub error: ModelError,
}

/// A calibrated tube: its shape, and the scores of the calibration flights.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tube {
    schema: String,
    schema_version: u32,
    /// The vehicle file with which the flights were planned.
    pub vehicle: VehicleParams,
    /// The model whose errors give the shape.
    pub model: PlannedThrough,
    /// Feedback and model errors.
    pub shape: Shape,
    /// The position that the tube bounds.
    pub position: PositionSource,
    /// Number of calibration flights.
    pub flights: usize,
    /// Scores of the flights in ascending order. A flight that ended early has none, and counts as
    /// outside of any tube.
    pub scores: Vec<f64>,
    /// Number of calibration flights of each trajectory.
    pub missions: BTreeMap<String, usize>,
}

/// The calibration flights of a tube.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The vehicle file with which the flights were planned.
    pub vehicle: VehicleParams,
    /// The model with which the flights were planned.
    pub model: PlannedThrough,
    /// The position whose errors the scores measure.
    pub position: PositionSource,
    /// Trajectory and score of each calibration flight; `None` if it ended early.
    pub flights: Vec<(String, Option<f64>)>,
}

/// A tube that cannot be read, or that does not support a confidence.
#[derive(Debug, thiserror::Error)]
pub enum TubeError {
    /// The file cannot be read.
    #[error("tube {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The file is not a tube, or is damaged.
    #[error("tube {}: {reason}; make it again with `downwash tube fit`", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Too few calibration flights for the confidence.
    #[error(
        "{flights} calibration flights are too few for a tube of confidence {confidence}: it needs at least \
         {needed}; add flights, or lower the confidence"
    )]
    TooFew {
        /// Calibration flights.
        flights: usize,
        /// The confidence.
        confidence: f64,
        /// Smallest number that supports it.
        needed: usize,
    },
    /// Too many flights ended early.
    #[error(
        "{ended} of the {flights} calibration flights ended early, too many for a tube of confidence \
         {confidence}; lower the confidence, or find out why they ended"
    )]
    EndedEarly {
        /// Number of flights that ended early.
        ended: usize,
        /// Calibration flights.
        flights: usize,
        /// The confidence.
        confidence: f64,
    },
}

/// A tube's radius at a confidence.
#[derive(Clone, Copy, Debug)]
pub struct Radius<'a> {
    shape: &'a Shape,
    /// q, in standard deviations.
    pub multiplier: f64,
}

impl Shape {
    /// Standard deviation of the distance from the plan on the grid of [`PERIOD_S`], m, from times
    /// (s) and speeds (m/s) along the plan.
    fn scale(&self, rows: impl Iterator<Item = [f64; 2]>) -> Vec<f64> {
        self.feedback.scale(&self.error, &score::on_grid(rows))
    }
}

impl Radius<'_> {
    /// The radius at each of a plan's states, which are `period_s` apart, m.
    pub fn along(&self, period_s: f64, states: &[StateVector]) -> Vec<f64> {
        let speed = |state: &StateVector| state[3].hypot(state[4]).hypot(state[5]);
        let rows = states.iter().enumerate();
        let scale = self.shape.scale(rows.map(|(n, state)| [n as f64 * period_s, speed(state)]));
        let last = scale.len().saturating_sub(1);
        (0..states.len())
            .map(|n| {
                let index = (n as f64 * period_s / PERIOD_S + 1e-6) as usize;
                scale.get(index.min(last)).map_or(f64::NAN, |scale| self.multiplier * scale)
            })
            .collect()
    }
}

impl Tube {
    /// Makes a tube of this shape with the scores of the calibration flights.
    pub fn new(shape: Shape, calibration: Calibration) -> Self {
        let Calibration { vehicle, model, position, flights } = calibration;
        let mut missions = BTreeMap::new();
        for (mission, _) in &flights {
            *missions.entry(mission.clone()).or_insert(0) += 1;
        }
        let mut scores: Vec<f64> = flights.iter().filter_map(|(_, score)| *score).collect();
        scores.sort_by(f64::total_cmp);
        Self {
            schema: SCHEMA.to_owned(),
            schema_version: VERSION,
            vehicle,
            model,
            shape,
            position,
            flights: flights.len(),
            scores,
            missions,
        }
    }

    /// Reads and checks a tube.
    ///
    /// # Errors
    /// [`TubeError`] if the file is not a tube, has another version, or holds invalid numbers.
    pub fn load(path: &Path) -> Result<Self, TubeError> {
        let text = bounded::read_to_string(path, SIZE_MAX)
            .map_err(|source| TubeError::Io { path: path.to_owned(), source })?;
        let damaged = |reason: String| TubeError::Damaged { path: path.to_owned(), reason };
        let tube: Self = serde_json::from_str(&text).map_err(|error| damaged(error.to_string()))?;
        tube.check().map_err(damaged)?;
        Ok(tube)
    }

    /// The content of its file.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string(self)
    }

    fn check(&self) -> Result<(), String> {
        if self.schema != SCHEMA || self.schema_version != VERSION {
            return Err(format!(
                "expected schema {SCHEMA} of version {VERSION}, found {} of version {}",
                self.schema, self.schema_version
            ));
        }
        let Shape { feedback, error } = &self.shape;
        let gains = feedback.stiffness_s2.iter().chain(&feedback.damping_s);
        if !gains.chain(&feedback.rejection_s).all(|gain| (1e-6..=1e6).contains(gain)) {
            return Err("a gain of the feedback is out of range".to_owned());
        }
        for AxisError { at_rest_m_s2, per_speed_s, correlation_s } in
            [&error.horizontal, &error.vertical]
        {
            let sizes = [at_rest_m_s2, per_speed_s].iter().all(|size| (0.0..=1e6).contains(*size));
            if !(sizes && (1e-3..=1e6).contains(correlation_s)) {
                return Err("a size of the model's error is out of range".to_owned());
            }
        }
        let is_sorted = self.scores.windows(2).all(|pair| pair[0] <= pair[1]);
        let is_sound = self.scores.iter().all(|score| score.is_finite() && *score >= 0.0);
        if !(is_sorted && is_sound && self.scores.len() <= self.flights) {
            return Err(
                "expected scores of at least 0 in ascending order, at most one for each flight"
                    .to_owned(),
            );
        }
        Ok(())
    }

    /// The highest confidence that the flights support: that of the largest score.
    pub fn confidence_max(&self) -> f64 {
        self.scores.len() as f64 / (self.flights as f64 + 1.0)
    }

    /// The radius within which a new flight stays from beginning to end with a probability of at
    /// least `confidence`, in 0..1.
    ///
    /// # Errors
    /// [`TubeError::TooFew`], [`TubeError::EndedEarly`].
    pub fn radius(&self, confidence: f64) -> Result<Radius<'_>, TubeError> {
        let (flights, needed) = (self.flights, conformal::flights_needed(confidence));
        if flights < needed {
            return Err(TubeError::TooFew { flights, confidence, needed });
        }
        let multiplier = conformal::bound(&self.scores, flights, confidence).ok_or_else(|| {
            TubeError::EndedEarly { ended: flights - self.scores.len(), flights, confidence }
        })?;
        Ok(Radius { shape: &self.shape, multiplier })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tube(scores: &[Option<f64>]) -> Tube {
        let axis = AxisError { at_rest_m_s2: 0.1, per_speed_s: 0.4, correlation_s: 1.0 };
        let feedback =
            TrackingLoop { stiffness_s2: [8.0; 2], damping_s: [4.0; 2], rejection_s: None };
        let shape = Shape { feedback, error: ModelError { horizontal: axis, vertical: axis } };
        Tube::new(
            shape,
            Calibration {
                vehicle: VehicleParams::load("crazyflie").expect("a vehicle"),
                model: PlannedThrough::nominal(),
                position: PositionSource::True,
                flights: scores.iter().map(|score| ("circle".to_owned(), *score)).collect(),
            },
        )
    }

    #[test]
    fn confidence_needs_nineteen_flights_and_aborted_flight_is_worst() {
        let score = |k: i32| Some(f64::from(k));
        let few = tube(&(1..=18).map(score).collect::<Vec<_>>());
        let said = few.radius(0.95).expect_err("too few").to_string();
        assert!(said.contains("18 calibration flights") && said.contains("at least 19"), "{said}");
        let mut scores: Vec<_> = (1..=19).rev().map(score).collect();
        let nineteen = tube(&scores);
        assert_eq!(nineteen.radius(0.95).expect("a radius").multiplier, 19.0);
        let most = nineteen.confidence_max();
        assert_eq!(nineteen.radius(most).expect("a radius").multiplier, 19.0);
        scores[0] = None;
        assert!(matches!(
            tube(&scores).radius(0.95),
            Err(TubeError::EndedEarly { ended: 1, flights: 19, .. })
        ));
        let one_ended = tube(&scores);
        assert_eq!(one_ended.radius(0.9).expect("a radius").multiplier, 18.0);
        assert_eq!(one_ended.radius(one_ended.confidence_max()).expect("one").multiplier, 18.0);
    }

    #[test]
    fn faster_plan_has_a_wider_tube() {
        let tube = tube(&[Some(2.0); 19]);
        let radius = tube.radius(0.95).expect("a radius");
        let states = |speed: f64| {
            let mut state = [0.0; 12];
            state[4] = speed;
            vec![state; 50]
        };
        let (slow, fast) = (radius.along(0.02, &states(0.0)), radius.along(0.02, &states(2.0)));
        assert_eq!(slow.len(), 50);
        assert!(fast[49] > 4.0 * slow[49] && slow[49] > 0.0, "{} {}", fast[49], slow[49]);
        // The same plan with another period.
        let fine = radius.along(0.005, &vec![states(2.0)[0]; 200]);
        assert!((fine[199] - fast[49]).abs() < 1e-6);
    }

    #[test]
    fn tube_file_round_trips_and_damaged_one_is_refused() {
        let tube = tube(&[Some(1.0), Some(3.0), None]);
        let path = std::env::temp_dir().join(format!("downwash-tube-{}.json", std::process::id()));
        let read = |tube: &Tube| {
            std::fs::write(&path, tube.to_json().expect("JSON")).expect("a file");
            Tube::load(&path)
        };
        assert_eq!(read(&tube).expect("a tube"), tube);
        let damages: [fn(&mut Tube); 4] = [
            |tube| tube.scores.reverse(),
            |tube| tube.flights = 1,
            |tube| tube.shape.feedback.stiffness_s2[0] = -1.0,
            |tube| tube.schema_version = 9,
        ];
        for damage in damages {
            let mut damaged = tube.clone();
            damage(&mut damaged);
            assert!(matches!(read(&damaged), Err(TubeError::Damaged { .. })));
        }
        let _ = std::fs::remove_file(&path);
    }
}
