//! A plan with a tube: `--tube`, its checks, and its summary.

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

/// A tube from a file, with the confidences of the tube and of the margin.
pub(super) struct ChosenTube {
    path: PathBuf,
    tube: Tube,
    confidence: f64,
    margin_confidence: f64,
}

impl ChosenTube {
    /// Without `margin`, the margin has the highest confidence that the tube supports. Its
    /// confidence is at least the tube's.
    pub fn load(path: &Path, confidence: f64, margin: Option<f64>) -> anyhow::Result<Self> {
        let tube = Tube::load(path).or_exit(Exit::Usage)?;
        let margin_confidence = margin.unwrap_or(tube.confidence_max()).max(confidence);
        Ok(Self { path: path.to_owned(), tube, confidence, margin_confidence })
    }

    /// Checks that the tube was made for this vehicle and model. The effects that the file models
    /// are a part of the model only where none was learned.
    pub fn check(&self, vehicle: &VehicleParams, model: &PlannedThrough) -> anyhow::Result<()> {
        let Tube { vehicle: of, model: made, .. } = &self.tube;
        let path = self.path.display();
        let differs_in = match vehicle.difference(of) {
            Some(difference) => Some(difference.to_string()),
            None if made.is_nominal() && !vehicle.is_modelled_as(of) => {
                Some("the lag, the delay or modelled_effects".to_owned())
            }
            None => None,
        };
        if let Some(difference) = differs_in {
            return Err(anyhow!(
                "tube {path}: its flights were planned for another vehicle file, {:?}: {difference}; \
                 make one for this vehicle",
                of.name
            ))
            .or_exit(Exit::Usage);
        }
        if made != model {
            return Err(anyhow!(
                "tube {path}: its flights were planned through another model, the {} model{}; make it \
                 again with the same --model and --kind",
                made.kind,
                made.sha256.as_ref().map_or(String::new(), |hash| format!(
                    " from the file with SHA-256 {hash}"
                ))
            ))
            .or_exit(Exit::Usage);
        }
        Ok(())
    }

    /// Plans with the radius at the margin's confidence as the margin.
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

/// The tube of a plan.
#[derive(Clone, Copy, Debug, JsonSchema, Serialize)]
pub(super) struct TubeOfPlan {
    /// Least probability that a whole flight stays within the tube.
    confidence: f64,
    /// Least probability that a whole flight strays from its plan by less than the margin that the
    /// plan keeps to keep-out regions and to the box.
    margin_confidence: f64,
    /// The position that the tube bounds.
    position: PositionSource,
    /// Number of calibration flights.
    flights: usize,
    /// Ratio of the radius to the standard deviation of the position error.
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
    /// Lines for people, with line ends.
    pub fn text(&self) -> String {
        format!(
            "tube        {:.2} %: {:.3} m on average, {:.3} m at most, for {}, from {} flights\n\
             margin      the radius at {:.2} %, to keep-out regions and to the sides of the box\n",
            100.0 * self.confidence,
            self.radius_mean_m,
            self.radius_max_m,
            self.position.text(),
            self.flights,
            100.0 * self.margin_confidence
        )
    }
}
