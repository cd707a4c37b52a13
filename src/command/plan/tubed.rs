//! A plan with a tube: what `--tube` names, and what is said of it.

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;

use crate::command::{Exit, ExitContext};
use crate::plan::desire::Desire;
use crate::plan::planned::PlannedThrough;
use crate::plan::planner::Planner;
use crate::plan::problem::StateVector;
use crate::plan::scp::{Outcome, Record};
use crate::plan::tube::Tube;
use crate::plan::tube::search::{Radii, plan_within};
use crate::plan::{PlannedTube, PositionSource};

/// A tube's file and a confidence.
pub(super) struct ChosenTube {
    path: PathBuf,
    tube: Tube,
    confidence: f64,
    margin_confidence: f64,
}

impl ChosenTube {
    /// The margin's confidence is that of the worst calibration flight where none is given.
    pub fn load(path: &Path, confidence: f64, margin: Option<f64>) -> anyhow::Result<Self> {
        let tube = Tube::load(path).or_exit(Exit::Usage)?;
        let margin_confidence = margin.unwrap_or(tube.confidence_max()).max(confidence);
        Ok(Self { path: path.to_owned(), tube, confidence, margin_confidence })
    }

    /// Refuses a tube that says nothing of this vehicle and model.
    pub fn check(&self, vehicle: &VehicleParams, model: &PlannedThrough) -> anyhow::Result<()> {
        let Tube { vehicle: of, model: made, .. } = &self.tube;
        let path = self.path.display();
        if *of != vehicle.name {
            return Err(anyhow!(
                "tube {path}: it is of the vehicle {of:?}, this is {:?}; make one for this vehicle",
                vehicle.name
            ))
            .or_exit(Exit::Usage);
        }
        if made != model {
            return Err(anyhow!(
                "tube {path}: it is of flights planned through the {} model{}, not through this one; \
                 make it again with the same --model and --kind",
                made.kind,
                made.sha256.as_ref().map_or(String::new(), |hash| format!(
                    " of the file with SHA-256 {hash}"
                ))
            ))
            .or_exit(Exit::Usage);
        }
        Ok(())
    }

    /// Plans with the tube's radius as the margin.
    pub fn plan(
        &self,
        planner: &Planner,
        desire: &Desire,
        start: StateVector,
        watch: &dyn Fn(&[Record]) -> bool,
    ) -> anyhow::Result<(Outcome<7>, Option<PlannedTube>)> {
        let radius = |confidence| self.tube.radius(confidence).or_exit(Exit::Usage);
        let (tube, margin) = (radius(self.confidence)?, radius(self.margin_confidence)?);
        let tubed = plan_within(planner, desire, start, &Radii { tube, margin }, watch);
        let planned = PlannedTube {
            confidence: self.confidence,
            margin_confidence: self.margin_confidence,
            position: self.tube.position,
            flights: self.tube.flights,
            multiplier: tube.multiplier,
            radius_m: tubed.radius_m,
        };
        Ok((tubed.outcome, Some(planned)))
    }
}

/// What is said of a plan's tube.
#[derive(Clone, Copy, Debug, JsonSchema, Serialize)]
pub(super) struct TubeOfPlan {
    /// Probability with which a whole flight stays within, at least.
    confidence: f64,
    /// The same for the margin to keep-out regions.
    margin_confidence: f64,
    /// The position that it bounds.
    position: PositionSource,
    /// Calibration flights behind it.
    flights: usize,
    /// Radius over standard deviation.
    multiplier: f64,
    radius_mean_m: f64,
    radius_max_m: f64,
}

impl From<&PlannedTube> for TubeOfPlan {
    fn from(tube: &PlannedTube) -> Self {
        let PlannedTube {
            confidence,
            margin_confidence,
            position,
            flights,
            multiplier,
            ref radius_m,
        } = *tube;
        Self {
            confidence,
            margin_confidence,
            position,
            flights,
            multiplier,
            radius_mean_m: radius_m.iter().sum::<f64>() / radius_m.len() as f64,
            radius_max_m: radius_m.iter().copied().fold(0.0, f64::max),
        }
    }
}

impl TubeOfPlan {
    /// For people, a whole line.
    pub fn in_words(&self) -> String {
        format!(
            "tube        {} %: {:.3} m on average, {:.3} m at most, around {}, from {} flights\n\
             margin      to what it avoids: that of {:.2} %\n",
            100.0 * self.confidence,
            self.radius_mean_m,
            self.radius_max_m,
            self.position.in_words(),
            self.flights,
            100.0 * self.margin_confidence
        )
    }
}
