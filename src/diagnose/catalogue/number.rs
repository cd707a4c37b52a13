//! The numbers that a catalogue's hypotheses are made of: what each stands for, and its prior.

use std::fmt::{self, Display};

use vehicle::ROTORS;
use vehicle::effects::{EffectId, Neutral};

use crate::diagnose::catalogue::tolerances::Known;

/// Orthonormal contrasts between four rotors. Independent errors of each rotor's thrust are
/// independent errors along these, with the same deviation, and an error of the mean with half of it.
pub const CONTRASTS: [[f64; ROTORS]; 3] =
    [[0.5, 0.5, -0.5, -0.5], [0.5, -0.5, 0.5, -0.5], [0.5, -0.5, -0.5, 0.5]];

/// What a number of a hypothesis stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// A slot of an effect.
    Effect(EffectId, usize),
    /// Scale of one rotor, in rotor_loss.
    RotorScale(usize),
    /// How unequal the rotors' thrusts are, along one of three [contrasts](CONTRASTS): what all have
    /// in common is the thrust's scale.
    Imbalance(usize),
    /// Moment against the body rate about one axis beyond the vehicle file's, N m s. Air does it,
    /// and so do outputs that are logged less often than the loop ticks: between two of them the
    /// desired attitude moves on, and the logged moment is off by kp times that.
    Damping(usize),
    /// How much later than logged the motor outputs act, without the lag, s.
    OutputDelay,
    /// Coefficient of a term of a law.
    Term(usize),
}

impl Target {
    /// The name of a number within its effect: of its parameter, and the component where it has
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
            Self::Term(index) => format!("term {index}"),
            Self::Imbalance(contrast) => format!("imbalance of the thrusts[{contrast}]"),
            Self::Damping(axis) => format!("damping of the rate[{axis}]"),
        }
    }
}

impl Target {
    /// What it is of a vehicle without its effect, where that is one value.
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
    /// With the effect that the number is one of.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Effect(id, _) => write!(f, "{id} {}", self.name()),
            Self::RotorScale(rotor) => write!(f, "{} {rotor}", EffectId::RotorLoss),
            Self::OutputDelay => f.write_str("delay of the outputs"),
            Self::Imbalance(_) | Self::Damping(_) | Self::Term(_) => f.write_str(&self.name()),
        }
    }
}

/// A number that may be fitted.
#[derive(Clone, Copy, Debug)]
pub struct Number {
    /// What it stands for.
    pub target: Target,
    /// What the vehicle file says, or the neutral value.
    pub reference: f64,
    /// Middle of the prior within tolerance: the reference, unless the logs say it directly.
    pub expected: f64,
    /// Width of the prior within tolerance; 0 where the number stays at its reference unless its
    /// effect is fitted.
    pub tolerance: f64,
    /// What the vehicle file's numbers may bring about of it, one standard deviation.
    pub unremarkable: f64,
    /// Width of the prior where its effect is fitted: a typical magnitude.
    pub magnitude: f64,
    /// Physical bounds.
    pub bounds: [f64; 2],
    /// Whether the effect grows with the square of the number: at 0 there is no slope.
    pub quadratic: bool,
}

impl Number {
    /// A number of which so much is known beside its reference.
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

    /// A number that is expected at its reference, with its tolerance and magnitude.
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

    /// A step for numeric derivatives at `value`.
    pub fn step(&self, value: f64) -> f64 {
        // Over a typical magnitude, where an infinitesimal step would see nothing.
        if self.quadratic && value == 0.0 { self.magnitude } else { 1e-3 * self.magnitude }
    }
}
