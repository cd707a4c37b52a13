//! Which of a training's models a file names as its default.

use super::comparison::{Compared, HOLD};
use super::error_ratio::{AS_HOLDING, relative};
use super::evaluation::{MultiStep, WindowErrors};
use super::split::SplitKind;
use crate::model::file::ModelKind;

/// Share of the physics' error by which another model must be better. A plan leads where networks
/// have seen little, and there an advantage of a few per cent within the data turns into a loss.
const ADVANTAGE_MIN: f64 = 0.05;
/// Normal quantile of a one-sided 95 % bound.
const NORMAL_95: f64 = 1.645;

/// The model with the best open-loop predictions, or the physics, unless another is better by
/// [`ADVANTAGE_MIN`] with a probability of 95 %: on a single flight in gusts a network can win by
/// luck. With few flights, `split` into blocks, validation repeats the manoeuvres of the training
/// and shows nothing of how the networks generalise: the physics is then preferred if it predicts
/// better than holding the state. The default of the file if none can be determined.
pub(super) fn preferred(validation: &[Compared], split: SplitKind) -> ModelKind {
    let score = |kind: ModelKind| {
        let pair = errors_of(validation, kind.name()).zip(errors_of(validation, HOLD));
        pair.map_or(f64::INFINITY, |(model, hold)| relative(&model.all(), &hold.all()))
    };
    if split == SplitKind::Blocks && score(ModelKind::Physics) < AS_HOLDING {
        return ModelKind::Physics;
    }
    let is_better = |kind: ModelKind| {
        kind == ModelKind::Physics
            || advantage_at_least(validation, kind) > -(1.0 - ADVANTAGE_MIN).ln()
    };
    let scores = ModelKind::ALL.map(|kind| (kind, score(kind)));
    let best = scores.into_iter().filter(|(kind, score)| score.is_finite() && is_better(*kind));
    best.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(ModelKind::Hybrid, |(kind, _)| kind)
}

/// Lower 95 % bound on the logarithm of the physics' error over that of another model, by the
/// jackknife over blocks of windows (Efron and Stein 1981); infinite if the physics has no finite
/// error, negative infinite if there are fewer than two blocks.
fn advantage_at_least(validation: &[Compared], kind: ModelKind) -> f64 {
    let [model, physics, hold] =
        [kind.name(), ModelKind::Physics.name(), HOLD].map(|name| errors_of(validation, name));
    let (Some(model), Some(hold)) = (model, hold) else { return f64::NEG_INFINITY };
    let Some(physics) = physics else { return f64::INFINITY };
    let advantage = |errors: &dyn Fn(&WindowErrors) -> MultiStep| {
        let hold = errors(hold);
        (relative(&errors(physics), &hold) / relative(&errors(model), &hold)).ln()
    };
    let whole = advantage(&WindowErrors::all);
    if whole == f64::INFINITY {
        return whole;
    }
    let blocks = hold.blocks();
    if blocks < 2 {
        return f64::NEG_INFINITY;
    }
    let parts: Vec<f64> = (0..blocks)
        .map(|block| advantage(&|errors: &WindowErrors| errors.without(block)))
        .collect();
    let n = blocks as f64;
    let mean = parts.iter().sum::<f64>() / n;
    let variance = (n - 1.0) / n * parts.iter().map(|part| (part - mean).powi(2)).sum::<f64>();
    whole - NORMAL_95 * variance.sqrt()
}

fn errors_of<'a>(compared: &'a [Compared], name: &str) -> Option<&'a WindowErrors> {
    compared.iter().find(|compared| compared.predictor == name).map(|compared| &compared.errors)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same errors in every quantity, in each block.
    fn compared(predictor: &'static str, errors: &[f64]) -> Compared {
        Compared { predictor, errors: WindowErrors::of_blocks(errors) }
    }

    const WHOLE: SplitKind = SplitKind::WholeFlights;

    #[test]
    fn physics_is_preferred_if_validation_repeats_the_training() {
        let seen = |physics| {
            let models = [("net", 0.1), ("physics", physics), ("hybrid", 0.1), (HOLD, 1.0)];
            let compared = models.map(|(name, error)| compared(name, &[error, error]));
            preferred(&compared, SplitKind::Blocks)
        };
        assert_eq!(seen(0.5), ModelKind::Physics);
        assert_ne!(seen(1.1), ModelKind::Physics, "no better than holding the state");
        assert_ne!(seen(f64::NAN), ModelKind::Physics);
    }

    #[test]
    fn model_with_non_finite_errors_is_never_best() {
        let seen = |net, physics, hybrid| {
            let models = [("net", net), ("physics", physics), ("hybrid", hybrid), (HOLD, 1.0)];
            preferred(&models.map(|(name, error)| compared(name, &[error, error])), WHOLE)
        };
        assert_eq!(seen(f64::NAN, 3.0, 2.0), ModelKind::Hybrid);
        assert_eq!(seen(-f64::NAN, 2.0, f64::INFINITY), ModelKind::Physics);
        assert_eq!(seen(0.5, f64::NAN, f64::NAN), ModelKind::Net);
        assert_eq!(seen(0.5, 2.0, 1.0), ModelKind::Net);
        assert_eq!(seen(2.0, 1.0, 0.97), ModelKind::Physics, "hardly worse");
        assert_eq!(seen(2.0, 1.0, 0.94), ModelKind::Hybrid);
        assert_eq!(preferred(&[], WHOLE), ModelKind::Hybrid);
    }

    #[test]
    fn advantage_in_one_block_does_not_beat_the_physics() {
        let seen = |hybrid: &[f64]| {
            let physics = vec![1.0; hybrid.len()];
            let models = [("physics", &physics[..]), ("hybrid", hybrid), (HOLD, &physics[..])];
            preferred(&models.map(|(name, errors)| compared(name, errors)), WHOLE)
        };
        assert_eq!(seen(&[0.1, 1.1, 1.1, 1.1]), ModelKind::Physics);
        assert_eq!(seen(&[0.7, 0.9, 0.8, 0.6]), ModelKind::Hybrid);
        // A single block shows no spread.
        assert_eq!(seen(&[0.5]), ModelKind::Physics);
    }
}
