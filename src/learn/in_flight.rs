//! A hybrid model learned while the vehicle flies, from the flight so far.
//!
//! The long searches run ahead ([`InFlight::prepare`]): they find the rotors' response and the
//! physics with the best open-loop predictions. After the last sample, [`InFlight::learn`]
//! continues from their result in a fraction of their time: it computes new rows, refines the
//! physics, trains the networks, and judges the model on held-out samples.

use vehicle::effects::BatterySag;
use vehicle::{VehicleError, VehicleParams};

use super::commands::Onboard;
use super::dataset::{Implausible, ObservedFlight, Row, WindowSettings};
use super::error::TrainError;
use super::error_ratio::relative;
use super::evaluation::{HORIZONS_S, MultiStep, Predictor, multi_step};
use super::networks::train_both;
use super::prediction::Baseline;
use super::segments::{Cut, Unusable};
use super::split::Part;
use super::summary::TrainSettings;
use super::training::Method;
use super::training_set::{Prepared, TrainingSet};
use crate::log::import::Flight;
use crate::model::Model;
use crate::model::actuation::Actuation;
use crate::model::features::Features;
use crate::model::hybrid::Hybrid;
use crate::model::physics::{PhysicsModel, PhysicsParameters};

/// Hidden units of each network: a minute of flight supports no more.
const HIDDEN: usize = 40;
/// Largest number of windows that select the fraction of the networks' correction.
const CHOICE_WINDOWS: usize = 16;
/// Lag of the autocovariance that gives the persistent part of a residual, in rows. It exceeds the
/// windows of the labels, whose noise is correlated within a window.
const LASTING_ROWS: usize = 10;
/// Index in [`HORIZONS_S`] of the horizon of reported errors.
const REPORTED_HORIZON: usize = 2;

/// Why a flight gives no model to fly with.
#[derive(Debug, thiserror::Error)]
pub enum Discarded {
    /// The samples cannot be used.
    #[error("unusable samples: {0}")]
    Unusable(#[from] Unusable),
    /// The commands do not fit the vehicle.
    #[error("{0}")]
    Implausible(#[from] Implausible),
    /// The training gives no model.
    #[error("{0}")]
    Training(#[from] TrainError),
    /// Its predictions are not finite.
    #[error("its predictions of the held-out samples are not finite")]
    NotFinite,
    /// It predicts held-out samples no better than another model.
    #[error(
        "it predicts the held-out samples no better than {than}: position error {learned_m:.4} m after \
         {after_s} s, against {present_m:.4} m"
    )]
    NoBetter {
        /// Its position error, m.
        learned_m: f64,
        /// The horizon, s.
        after_s: f64,
        /// The other model.
        than: &'static str,
        /// Position error of the other model, m.
        present_m: f64,
    },
}

/// Errors of a model on held-out samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOutErrors {
    /// Errors of open-loop predictions at [`HORIZONS_S`].
    pub open_loop: MultiStep,
    /// Sum of their ratios to the errors of holding the state.
    score: f64,
    /// RMS residual of the linear acceleration, m/s^2.
    pub residual_m_s2: f64,
    /// Its persistent part, m/s^2: the root of its autocovariance at a lag of a tenth of a second,
    /// to which measurement noise does not contribute.
    pub lasting_m_s2: f64,
}

impl HeldOutErrors {
    /// Error of the predicted position at [`AFTER_S`](Self::AFTER_S), m.
    pub fn position_m(&self) -> f64 {
        self.open_loop[REPORTED_HORIZON].position_m
    }

    /// The horizon of [`position_m`](Self::position_m), s.
    pub const AFTER_S: f64 = HORIZONS_S[REPORTED_HORIZON];

    /// Noise of the reported position, m: the error at the shortest horizon, where the model hardly
    /// matters, over the square root of two since both ends contribute.
    pub fn noise_m(&self) -> f64 {
        self.open_loop[0].position_m / 2.0_f64.sqrt()
    }

    fn is_finite(&self) -> bool {
        self.score.is_finite() && self.residual_m_s2.is_finite()
    }
}

/// A model, and the rotors' response that it was learned with.
#[derive(Clone, Debug)]
pub struct Learned {
    /// The physics with the networks' correction.
    pub model: Hybrid,
    /// The rotors' delay and lag, and the effect of the voltage.
    pub actuation: Actuation,
    /// Usable length of the flight that it was learned from, s.
    pub flown_s: f64,
    /// The model's errors on the held-out samples.
    pub held_out: HeldOutErrors,
    /// Errors of the vehicle file's physics on the same samples.
    pub nominal: HeldOutErrors,
}

/// Learns models of one vehicle while it flies.
pub struct InFlight {
    vehicle: VehicleParams,
    onboard: Onboard,
    nominal: PhysicsModel,
    windows: WindowSettings,
    settings: TrainSettings,
}

impl InFlight {
    /// A learner for a vehicle.
    ///
    /// # Errors
    /// The vehicle's physics is invalid.
    pub fn new(vehicle: VehicleParams) -> Result<Self, VehicleError> {
        let onboard = Onboard::new(&vehicle)?;
        let nominal = PhysicsModel::new(&vehicle, &PhysicsParameters::default())?;
        let windows = WindowSettings::default();
        let settings = TrainSettings {
            features: Features::Body,
            hidden: HIDDEN,
            passes: 100,
            method: Method::Adam,
            regularization: vec![1e-5],
            seed: 1,
            window_half_s: windows.half_s,
            windows_half_s: vec![windows.half_s],
        };
        Ok(Self { vehicle, onboard, nominal, windows, settings })
    }

    /// Runs the long searches on the flight so far, without the times in `cuts`.
    ///
    /// # Errors
    /// [`Discarded`].
    pub fn prepare(&self, flight: Flight, cuts: &[Cut]) -> Result<Prepared, Discarded> {
        let mut flights = [self.observed(flight, cuts)?];
        Ok(TrainingSet::new(&self.vehicle, &self.onboard, &mut flights)?.prepared())
    }

    /// Learns from the flight so far, without the times in `cuts`, and compares the result with the
    /// vehicle file's physics and with the `present` model on held-out samples.
    ///
    /// # Errors
    /// [`Discarded`], also if one of the two predicts at least as well.
    pub fn learn(
        &self,
        flight: Flight,
        cuts: &[Cut],
        prepared: &Prepared,
        present: Option<&Learned>,
    ) -> Result<Learned, Discarded> {
        let observed = self.observed(flight, cuts)?;
        let flown_s = observed.segments.seconds();
        let mut flights = [observed];
        let set = TrainingSet::continued(&self.vehicle, &self.onboard, &mut flights, prepared)?;
        let physics = PhysicsModel::new(&self.vehicle, &set.physics).map_err(TrainError::from)?;
        let parts = [set.part(Part::Training), set.part(Part::Validation)];
        let target = |row: &Row| row.residual(&physics);
        let residual = train_both([&parts[0], &parts[1]], &self.settings, &target)?;
        let residual = set.shrink(residual, &physics, CHOICE_WINDOWS, &mut |_| {});
        let model = Hybrid::new(physics, residual);

        let judge = |model: &dyn Model, actuation: &Actuation| judge(&set, model, actuation);
        let held_out = judge(&model, &set.actuation);
        let nominal = judge(&self.nominal, &self.nominal_actuation());
        if !held_out.is_finite() {
            return Err(Discarded::NotFinite);
        }
        let present = present.map(|present| judge(&present.model, &present.actuation));
        let others =
            [("the vehicle file's physics", Some(nominal)), ("the current model", present)];
        for (than, other) in others {
            if let Some(other) = other.filter(|other| held_out.score >= other.score) {
                return Err(Discarded::NoBetter {
                    learned_m: held_out.position_m(),
                    after_s: HeldOutErrors::AFTER_S,
                    than,
                    present_m: other.position_m(),
                });
            }
        }
        Ok(Learned { model, actuation: set.actuation, flown_s, held_out, nominal })
    }

    fn observed(&self, flight: Flight, cuts: &[Cut]) -> Result<ObservedFlight, Discarded> {
        let observed =
            ObservedFlight::new(flight, &self.vehicle, &self.onboard, &self.windows, cuts)?;
        observed.check_vehicle(&self.vehicle, &self.onboard)?;
        Ok(observed)
    }

    /// The rotors' response according to the vehicle file.
    fn nominal_actuation(&self) -> Actuation {
        let sag = self.vehicle.modelled_effects.get::<BatterySag>();
        Actuation {
            delay_s: self.vehicle.command_delay_s,
            lag_s: self.vehicle.motor_time_constant_s,
            voltage_exponent: sag.map_or(0.0, |sag| sag.exponent),
            ..Actuation::default()
        }
    }
}

/// Computes a model's errors on the held-out part.
fn judge(set: &TrainingSet<'_>, model: &dyn Model, actuation: &Actuation) -> HeldOutErrors {
    let windows = set.windows(Part::Test, actuation);
    let none = [Default::default(); HORIZONS_S.len()];
    let errors = multi_step(&windows, &Predictor::Model(model));
    let hold = multi_step(&windows, &Predictor::Baseline(Baseline::Hold));
    let score = match (&errors, &hold) {
        (Some(errors), Some(hold)) => relative(&errors.all(), &hold.all()),
        _ => f64::INFINITY,
    };
    let (residual_m_s2, lasting_m_s2) = residuals(&set.part(Part::Test), model);
    let open_loop = errors.map_or(none, |errors| errors.all());
    HeldOutErrors { open_loop, score, residual_m_s2, lasting_m_s2 }
}

/// RMS residual of the linear acceleration, and its persistent part, m/s^2.
fn residuals(rows: &[&Row], model: &dyn Model) -> (f64, f64) {
    let residual = |row: &&Row| -> [f64; 3] {
        let [north, east, down, ..] = row.residual(model);
        [north, east, down]
    };
    let residuals: Vec<[f64; 3]> = rows.iter().map(residual).collect();
    let product = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mean = |sum: f64, count: usize| sum / count.max(1) as f64;
    let square = residuals.iter().map(|r| product(r, r)).sum();
    let later = residuals.iter().skip(LASTING_ROWS);
    let lasting = residuals.iter().zip(later).map(|(a, b)| product(a, b)).sum();
    let pairs = residuals.len().saturating_sub(LASTING_ROWS);
    (mean(square, residuals.len()).sqrt(), mean(lasting, pairs).max(0.0).sqrt())
}
