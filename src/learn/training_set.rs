//! Flights split into parts, with the physics identified from them, and their rows.

use std::ops::Range;

use vehicle::{VehicleError, VehicleParams};

use super::commands::Onboard;
use super::dataset::{ObservedFlight, Row};
use super::error::TrainError;
use super::error_ratio::score;
use super::evaluation::{FlightWindows, OneStep, Predictor, window_starts};
use super::gaps::intersection;
use super::identify::{self, FlightPart};
use super::physics_fit;
use super::prediction::RecordedInputs;
use super::refine::{self, FlightSpans};
use super::split::{BORDER_S, Part, Split};
use super::summary::LogSummary;
use crate::model::ACCELERATIONS;
use crate::model::actuation::Actuation;
use crate::model::features::Head;
use crate::model::file::AccelerationSource;
use crate::model::hybrid::Hybrid;
use crate::model::learned::NetworkModel;
use crate::model::physics::{PhysicsModel, PhysicsParameters};

/// The refined physics is accepted only if it lowers the validation score to this fraction.
const REFINED_MIN: f64 = 0.97;
/// Fractions of the learned correction that a hybrid may use.
const SHARES: [f64; 5] = [1.0, 0.75, 0.5, 0.25, 0.0];
/// Approximate largest number of windows for selections.
pub(super) const CHOICE_WINDOWS_MAX: usize = 500;
/// Least number of training rows.
pub const ROWS_MIN: usize = 500;

/// Approximate largest number of windows to choose between the fitted physics and its start.
const CONTINUED_WINDOWS: usize = 32;

/// Result of a training's long searches, from which a training on more of the same flights starts.
#[derive(Clone, Debug, PartialEq)]
pub struct Prepared {
    actuation: Actuation,
    acceleration: AccelerationSource,
    physics: PhysicsParameters,
    /// Shift of the first flight's commands, s.
    command_shift_s: f64,
}

/// Flights prepared for training.
pub struct TrainingSet<'a> {
    pub(super) vehicle: &'a VehicleParams,
    pub(super) onboard: &'a Onboard,
    pub(super) flights: &'a [ObservedFlight],
    pub(super) split: Split,
    pub(super) actuation: Actuation,
    pub(super) acceleration: AccelerationSource,
    pub(super) physics: PhysicsParameters,
    pub(super) rows: Vec<Vec<Row>>,
}

impl<'a> TrainingSet<'a> {
    /// Splits the flights, identifies the rotors' response on the training part, and computes the
    /// rows.
    ///
    /// # Errors
    /// [`TrainError::TooFewRows`], [`TrainError::EmptyPart`], [`TrainError::Vehicle`].
    pub fn new(
        vehicle: &'a VehicleParams,
        onboard: &'a Onboard,
        flights: &'a mut [ObservedFlight],
    ) -> Result<Self, TrainError> {
        let split = Split::of(&flights.iter().map(ObservedFlight::traits).collect::<Vec<_>>());
        // Streams with different offsets in each flight would blur the common delay.
        let source = AccelerationSource::VelocitySlope;
        let first = identify::actuation(&training_part(flights, &split), onboard, vehicle, source);
        for flight in flights.iter_mut() {
            identify::align_commands(flight, onboard, &first, source, vehicle.gravity);
        }
        let flights: &'a [ObservedFlight] = flights;
        let training = training_part(flights, &split);
        let mut dataset = Self {
            vehicle,
            onboard,
            flights,
            split,
            actuation: Actuation::default(),
            acceleration: AccelerationSource::VelocitySlope,
            physics: PhysicsParameters::default(),
            rows: Vec::new(),
        };
        // Both sources estimate the same quantity; the one that the physics explains with the
        // smaller error has less noise.
        let mut best = f64::INFINITY;
        for source in [AccelerationSource::SpecificForce, AccelerationSource::VelocitySlope] {
            let actuation = identify::actuation(&training, onboard, vehicle, source);
            let rows: Vec<Vec<Row>> =
                flights.iter().map(|f| f.rows(onboard, &actuation, source)).collect();
            let candidate = Self {
                actuation,
                acceleration: source,
                rows,
                split: dataset.split.clone(),
                physics: PhysicsParameters::default(),
                ..dataset
            };
            let fit = candidate.part(Part::Training);
            if fit.len() < ROWS_MIN {
                continue;
            }
            let physics = physics_fit::fit(&fit, vehicle)?;
            let model = PhysicsModel::new(vehicle, &physics)?;
            let error = OneStep::of(&model, &fit, &[1.0; ACCELERATIONS], |row| Some(row.label))
                .map_or(f64::INFINITY, |error| error.linear);
            if error < best {
                best = error;
                dataset = Self { physics, ..candidate };
            }
        }
        dataset.refine()?;
        dataset.check_parts()?;
        Ok(dataset)
    }

    /// As [`new`](Self::new), but takes the rotors' response from an earlier part of the same
    /// flights. The fit of the physics starts at the earlier result, and replaces it only if it
    /// predicts the validation part better in open loop.
    ///
    /// # Errors
    /// [`TrainError::TooFewRows`], [`TrainError::EmptyPart`], [`TrainError::Vehicle`].
    pub fn continued(
        vehicle: &'a VehicleParams,
        onboard: &'a Onboard,
        flights: &'a mut [ObservedFlight],
        prepared: &Prepared,
    ) -> Result<Self, TrainError> {
        let Prepared { actuation, acceleration, command_shift_s, .. } = *prepared;
        for flight in flights.iter_mut() {
            flight.command_shift_s = command_shift_s;
        }
        let flights: &'a [ObservedFlight] = flights;
        let split = Split::of(&flights.iter().map(ObservedFlight::traits).collect::<Vec<_>>());
        let rows = flights.iter().map(|f| f.rows(onboard, &actuation, acceleration)).collect();
        let physics = prepared.physics.clone();
        let mut dataset =
            Self { vehicle, onboard, flights, split, actuation, acceleration, physics, rows };
        dataset.check_parts()?;
        let fitted =
            physics_fit::fit_from(&dataset.part(Part::Training), vehicle, &dataset.physics)?;
        let windows = dataset.some_windows(Part::Validation, &actuation, CONTINUED_WINDOWS);
        let score = |physics: &PhysicsParameters| {
            let model = PhysicsModel::new(vehicle, physics)?;
            Ok::<_, VehicleError>(score(&windows, &Predictor::Model(&model)))
        };
        let is_better = score(&fitted)? < score(&dataset.physics)?;
        drop(windows);
        if is_better {
            dataset.physics = fitted;
        }
        Ok(dataset)
    }

    /// The start for a training on a later part of the same flights.
    pub fn prepared(&self) -> Prepared {
        Prepared {
            actuation: self.actuation,
            acceleration: self.acceleration,
            physics: self.physics.clone(),
            command_shift_s: self.flights.first().map_or(0.0, |flight| flight.command_shift_s),
        }
    }

    fn check_parts(&self) -> Result<(), TrainError> {
        let rows = Part::ALL.map(|part| self.part(part).len());
        if rows[0] < ROWS_MIN {
            return Err(TrainError::TooFewRows { found: rows[0], least: ROWS_MIN });
        }
        if let Some((part, _)) = Part::ALL.into_iter().zip(rows).find(|(_, rows)| *rows == 0) {
            return Err(TrainError::EmptyPart { part: part.name(), border_s: BORDER_S });
        }
        Ok(())
    }

    /// Accepts the actuation and physics with the best open-loop predictions on the training part,
    /// if they also predict the validation part better.
    fn refine(&mut self) -> Result<(), VehicleError> {
        let training = self.training_blocks();
        let refined = refine::open_loop(
            &training,
            self.onboard,
            self.vehicle,
            &self.actuation,
            &self.physics,
        );
        let Some((actuation, physics)) = refined else { return Ok(()) };
        let score = |actuation: &Actuation, physics: &PhysicsParameters| {
            let model = PhysicsModel::new(self.vehicle, physics)?;
            let windows = self.windows(Part::Validation, actuation);
            Ok::<_, VehicleError>(score(&windows, &Predictor::Model(&model)))
        };
        if score(&actuation, &physics)? < REFINED_MIN * score(&self.actuation, &self.physics)? {
            self.rows = self
                .flights
                .iter()
                .map(|f| f.rows(self.onboard, &actuation, self.acceleration))
                .collect();
            (self.actuation, self.physics) = (actuation, physics);
        }
        Ok(())
    }

    /// The net with the correction that gives the best open-loop predictions on the training part,
    /// if it also predicts the validation part better.
    pub(super) fn refine_net(&self, net: &NetworkModel) -> Option<NetworkModel> {
        let training = self.training_blocks();
        let windows = self.windows(Part::Validation, &self.actuation);
        let score = |net: &NetworkModel| score(&windows, &Predictor::Model(net));
        refine::network_open_loop(&training, self.onboard, &self.actuation, net)
            .filter(|refined| score(refined) < REFINED_MIN * score(net))
    }

    /// Usable times of the training part of each flight that has any.
    fn training_blocks(&self) -> Vec<FlightSpans<'_>> {
        let flights = self.flights.iter().enumerate();
        flights
            .map(|(index, flight)| FlightSpans {
                flight,
                spans: self.blocks(index, Part::Training),
            })
            .filter(|part| !part.spans.is_empty())
            .collect()
    }

    /// The rows of one part.
    pub(super) fn part(&self, part: Part) -> Vec<&Row> {
        let mut chosen = Vec::new();
        for index in 0..self.rows.len() {
            for span in self.spans(index, part) {
                let rows = &self.rows[index];
                let start = rows.partition_point(|row| row.time < span.start);
                let end = rows.partition_point(|row| row.time <= span.end);
                chosen.extend(&rows[start..end]);
            }
        }
        chosen
    }

    /// Times of one part of a flight, from the first to the last observation of each block.
    pub(super) fn spans(&self, flight: usize, part: Part) -> Vec<Range<f64>> {
        let observations = &self.flights[flight].observations;
        let time = |index: usize| observations[index].time;
        self.split.flights[flight]
            .iter()
            .filter(|(range, p)| *p == part && !range.is_empty())
            .map(|(range, _)| time(range.start)..time(range.end - 1))
            .collect()
    }

    /// Usable times of one part of a flight, without gaps.
    fn blocks(&self, flight: usize, part: Part) -> Vec<Range<f64>> {
        intersection(&self.spans(flight, part), &self.flights[flight].segments.spans)
    }

    /// Recorded inputs and start times of the windows of one part.
    pub(super) fn windows<'b>(
        &'b self,
        part: Part,
        actuation: &'b Actuation,
    ) -> Vec<FlightWindows<'b>> {
        // Selections need fewer windows than evaluations.
        let most = if part == Part::Test { usize::MAX } else { CHOICE_WINDOWS_MAX };
        self.some_windows(part, actuation, most)
    }

    /// As [`windows`](Self::windows), thinned to about `most`.
    fn some_windows<'b>(
        &'b self,
        part: Part,
        actuation: &'b Actuation,
        most: usize,
    ) -> Vec<FlightWindows<'b>> {
        let mut starts: Vec<Vec<f64>> =
            (0..self.flights.len()).map(|index| window_starts(&self.blocks(index, part))).collect();
        let total: usize = starts.iter().map(Vec::len).sum();
        let stride = total.div_ceil(most).max(1);
        for starts in &mut starts {
            *starts = starts.iter().copied().step_by(stride).collect();
        }
        let mut windows = Vec::new();
        for (flight, starts) in self.flights.iter().zip(starts) {
            if !starts.is_empty() {
                let inputs = RecordedInputs::new(flight, self.onboard, actuation);
                windows.push(FlightWindows { inputs, starts });
            }
        }
        windows
    }
}

impl TrainingSet<'_> {
    /// Scales the learned corrections, linear and angular, by the fractions with which the hybrid
    /// best predicts about `most` windows of the validation part: this removes what a network
    /// learned from noise. `step` is called after each fraction tried.
    pub(super) fn shrink(
        &self,
        residual: NetworkModel,
        physics: &PhysicsModel,
        most: usize,
        step: &mut dyn FnMut(&str),
    ) -> NetworkModel {
        let windows = self.some_windows(Part::Validation, &self.actuation, most);
        let mut best = (f64::INFINITY, [1.0, 1.0]);
        for head in Head::BOTH {
            for share in SHARES {
                let mut shares = best.1;
                shares[head as usize] = share;
                let hybrid = Hybrid::new(physics.clone(), residual.scaled(shares));
                let score = score(&windows, &Predictor::Model(&hybrid));
                // A NaN score compares as not lower.
                if score < best.0 {
                    best = (score, shares);
                }
                step("share of the correction");
            }
        }
        residual.scaled(best.1)
    }

    pub(super) fn log_summaries(&self) -> Vec<LogSummary> {
        let flights = self.flights.iter().zip(&self.rows).zip(&self.split.flights);
        flights
            .map(|((observed, rows), parts)| {
                let origin = &observed.flight.origin;
                let counted = observed.flight.left_out.iter();
                let mut left_out: Vec<(String, String)> =
                    counted.map(|(why, count)| (why.clone(), count.to_string())).collect();
                left_out.extend(
                    observed
                        .segments
                        .excluded
                        .iter()
                        .map(|e| (e.reason.clone(), format!("{:.2} s", e.seconds))),
                );
                LogSummary {
                    run: origin.run.clone(),
                    path: origin.path.clone(),
                    sha256: origin.sha256.clone(),
                    format: origin.format.to_owned(),
                    usable_s: observed.segments.seconds(),
                    rows: rows.len(),
                    parts: parts.iter().map(|(_, part)| *part).collect(),
                    source: observed.source.name().to_owned(),
                    law_error: observed.law_error,
                    attitude_latency_s: observed.alignment.attitude_s,
                    velocity_latency_s: observed.alignment.velocity_s,
                    command_shift_s: observed.command_shift_s,
                    left_out,
                }
            })
            .collect()
    }
}

/// The observations of the training part.
fn training_part<'a>(flights: &'a [ObservedFlight], split: &Split) -> Vec<FlightPart<'a>> {
    let mut chosen = Vec::new();
    for (flight, parts) in flights.iter().zip(&split.flights) {
        for (range, part) in parts {
            if *part == Part::Training {
                chosen.push(FlightPart { flight, range: range.clone() });
            }
        }
    }
    chosen
}
