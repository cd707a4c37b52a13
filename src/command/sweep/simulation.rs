//! A point that is a flight.

use std::collections::BTreeMap;

use anyhow::bail;
use serde::Deserialize;
use toml::Value;
use vehicle::effects::{EffectSet, Schedule};

use super::manifest::{Manifest, Point};
use crate::command::simulate::{Inputs, Row, Simulation, configuration};

/// The inputs as the manifest gives them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Given {
    vehicle: Option<String>,
    trajectory: Option<String>,
    config: Option<String>,
    sitl_config: Option<String>,
    /// Effects, as in an effects file.
    #[serde(default)]
    effects: EffectSet,
    /// Effects that set in later, each in the form of `--effect`.
    #[serde(default)]
    onsets: Vec<String>,
    /// Settings by their dotted paths.
    #[serde(default)]
    set: BTreeMap<String, Value>,
}

/// The inputs of `simulate` at a point.
pub(super) fn inputs(manifest: &Manifest, point: &Point) -> anyhow::Result<Inputs> {
    let given: Given = manifest.inputs(point)?;
    let later = Schedule::requested(None, &given.onsets)?;
    if !later.effects.is_empty() {
        bail!("onsets: expected effects that set in, such as rotor_loss:rotor=2,scale=0.9@22");
    }
    let file = |file: Option<String>| file.map(|file| manifest.files().resolved(&file));
    Ok(Inputs {
        vehicle: file(given.vehicle),
        trajectory: file(given.trajectory),
        effects: given.effects,
        onsets: later.onsets,
        sitl_config: file(given.sitl_config),
        config: file(given.config),
        settings: given.set,
        seed: point.seed,
    })
}

/// Checks the settings of the first point: an unknown one would fail at every point.
pub(super) fn check(manifest: &Manifest) -> anyhow::Result<()> {
    let Some(first) = (manifest.points > 0).then(|| manifest.point(0)) else { return Ok(()) };
    let inputs = inputs(manifest, &first)?;
    configuration(inputs.config.as_deref(), &inputs.settings).map(drop)
}

/// Flies it.
pub(super) fn row(manifest: &Manifest, point: &Point) -> anyhow::Result<Row> {
    let simulation = Simulation::load(&inputs(manifest, point)?)?;
    Ok(simulation.fly(|_| {})?.0)
}
