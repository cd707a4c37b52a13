//! The numbers of a catalogue's hypotheses: their targets and priors.

use std::fmt::{self, Display};

use vehicle::ROTORS;
use vehicle::effects::{EffectId, Neutral};

use crate::diagnose::catalogue::tolerances::Known;

/// Orthonormal contrasts between four rotors. Independent errors of each rotor's thrust are
/// independent errors along these with the same deviation, plus an error of the mean with half of
/// it.
pub const CONTRASTS: [[f64; ROTORS]; 3] =
    [[0.5, 0.5, -0.5, -0.5], [0.5, -0.5, 0.5, -0.5], [0.5, -0.5, -0.5, 0.5]];

/// The quantity that a number sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// A slot of an effect, by its index.
    Effect(EffectId, usize),
    /// Thrust scale of one rotor, in rotor_loss.
    RotorScale(usize),
    /// Difference between the rotors' thrusts along one of three [contrasts](CONTRASTS). Their mean
    /// is the scale of the thrust.
    Imbalance(usize),
    /// Damping moment about one axis beyond the vehicle file's, N m s. Its causes are the air, and
    /// outputs that are logged less often than the loop ticks: the desired attitude moves on
    /// between two of them, and the logged moment is off by kp times that motion.
    Damping(usize),
    /// Delay of the motor outputs after their stamps, without the lag, s.
    OutputDelay,
    /// Variance of the times over which the reported velocity is smoothed, s^2: slopes of positions
    /// and estimators smooth, and fast accelerations then look smaller than the tilt requires.
    VelocitySmoothing,
    /// Coefficient of a term of a law.
    Term(usize),
}

impl Target {
    /// The number's name within its effect: its parameter, with the component where there are
    /// several.
    pub fn name(self) -> String {
        match self {
            Self::Effect(id, slot) => match id.spec().slots().find(|s| s.index == slot) {
                Some(slot) if slot.parameter.kind.slots() > 1 => {
                    format!("{}[{}]", slot.parameter.name, slot.component)
                }
                Some(slot) => slot.parameter.name.to_owned(),
                None => slot.to_string(),
            },
            Self::RotorScale(_) => "scale".to_owned(),
            Self::OutputDelay => "delay_s".to_owned(),
            Self::VelocitySmoothing => "smoothing of the reported velocity".to_owned(),
            Self::Term(index) => format!("term {index}"),
            Self::Imbalance(contrast) => format!("imbalance of the thrusts[{contrast}]"),
            Self::Damping(axis) => format!("damping of the rate[{axis}]"),
        }
    }

    /// Its value for a vehicle without the effect, where there is a single one.
    pub fn absent(self) -> Option<f64> {
        let Self::Effect(id, slot) = self else { return None };
        let found = id.spec().slots().find(|s| s.index == slot)?;
        match found.parameter.neutral {
            Neutral::Value(value) => Some(value),
            _ => None,
        }
    }
}

impl Display for Target {
    /// The name, after its effect's id where it belongs to one.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Effect(id, _) => write!(f, "{id} {}", self.name()),
            Self::RotorScale(rotor) => write!(f, "{} {rotor}", EffectId::RotorLoss),
            Self::OutputDelay => f.write_str("delay of the outputs"),
            Self::Imbalance(_) | Self::Damping(_) | Self::VelocitySmoothing | Self::Term(_) => {
                f.write_str(&self.name())
            }
        }
    }
}

/// A number that may be fitted.
#[derive(Clone, Copy, Debug)]
pub struct Number {
    /// The quantity that the number sets.
    pub target: Target,
    /// The vehicle file's value, or the neutral one.
    pub reference: f64,
    /// Middle of the prior as a nuisance: the reference, unless the logs show it directly.
    pub expected: f64,
    /// Width of the prior as a nuisance; 0 for a number that stays at its reference unless its
    /// effect is fitted.
    pub tolerance: f64,
    /// Standard deviation that the vehicle file's errors give it.
    pub unremarkable: f64,
    /// Width of the prior where its effect is fitted: a typical magnitude.
    pub magnitude: f64,
    /// Lowest and highest value.
    pub bounds: [f64; 2],
    /// Whether the effect grows with the square of the number: the slope is then 0 at 0.
    pub quadratic: bool,
}

impl Number {
    /// A number with its prior knowledge.
    pub(super) fn new(target: Target, reference: f64, known: Known, bounds: [f64; 2]) -> Self {
        let Known { offset, tolerance, unremarkable, magnitude } = known;
        let expected = reference + offset;
        Self {
            target,
            reference,
            expected,
            tolerance,
            unremarkable,
            magnitude,
            bounds,
            quadratic: false,
        }
    }

    /// A number that is expected at its reference, with a tolerance and a magnitude.
    pub(super) fn nuisance(
        target: Target,
        reference: f64,
        [tolerance, magnitude]: [f64; 2],
        bounds: [f64; 2],
    ) -> Self {
        let known = Known { offset: 0.0, tolerance, unremarkable: tolerance, magnitude };
        Self::new(target, reference, known, bounds)
    }

    /// Middle and width of the prior: wide about the reference where its effect is fitted.
    pub fn prior(&self, active: bool) -> [f64; 2] {
        if active { [self.reference, self.magnitude] } else { [self.expected, self.tolerance] }
    }

    /// Step for a numeric derivative at `value`.
    pub fn step(&self, value: f64) -> f64 {
        // A full magnitude, since a small step has no effect there.
        if self.quadratic && value == 0.0 { self.magnitude } else { 1e-3 * self.magnitude }
    }
}
