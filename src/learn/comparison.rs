//! Open-loop errors of several models, and of baselines, over the same windows.

use super::evaluation::{FlightWindows, HORIZONS_S, Predictor, WindowErrors, multi_step};
use super::networks::Watch;
use super::prediction::Baseline;
use super::summary::MultiStepSummary;
use crate::model::Model;
use crate::model::file::ModelKind;

/// A model file's models, each with its kind.
pub(super) type Models = Vec<(ModelKind, Box<dyn Model>)>;

/// Name of the predictor that the others are compared with.
pub(super) const HOLD: &str = "hold";

/// The open-loop errors of a model or a baseline.
pub(super) struct Compared {
    pub predictor: &'static str,
    pub errors: WindowErrors,
}

/// Open-loop errors of models and baselines over the same windows.
pub(super) fn compare(
    windows: &[FlightWindows<'_>],
    models: &Models,
    watch: &mut dyn Watch,
) -> Vec<Compared> {
    let mut predictors: Vec<(&'static str, Predictor<'_>)> = Vec::new();
    for (kind, model) in models {
        predictors.push((kind.name(), Predictor::Model(model.as_ref())));
    }
    predictors.push((HOLD, Predictor::Baseline(Baseline::Hold)));
    predictors.push(("constant velocity", Predictor::Baseline(Baseline::ConstantVelocity)));
    predictors
        .into_iter()
        .filter_map(|(predictor, source)| {
            let found = multi_step(windows, &source);
            watch.step("test windows");
            Some(Compared { predictor, errors: found? })
        })
        .collect()
}

/// The comparison as a training's JSON states it.
pub(super) fn summaries(compared: &[Compared]) -> Vec<MultiStepSummary> {
    let summary = |Compared { predictor, errors }: &Compared| MultiStepSummary {
        predictor: (*predictor).to_owned(),
        errors: errors.all(),
        horizons_s: HORIZONS_S.to_vec(),
        windows: errors.windows(),
    };
    compared.iter().map(summary).collect()
}
