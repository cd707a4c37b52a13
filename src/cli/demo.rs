//! Flags of the experiment on the simulated vehicle.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::SimulationArgs;
use crate::control::Law;
use crate::model::file::ModelKind;

/// Flags of `demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for report.html, summary.json, the logs, the model and the plans; created if missing.
    #[arg(long, default_value = "demo-out")]
    pub out: PathBuf,
    /// What flies the trajectory: feedback alone, or plans through these learned models.
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = Contestant::PAPER)]
    pub fly: Vec<Contestant>,
    /// Length of the flights that the models are learned from, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 900.0)]
    pub learn: f64,
    /// Closes the loop instead: the simulated vehicle hides an effect (--hidden, else drawn from
    /// the seed), and a short programme of flights diagnoses it; the trajectory is planned and
    /// flown with the shipped and with the improved vehicle file.
    #[arg(long, conflicts_with_all = ["fly", "learn"])]
    pub diagnose: bool,
    /// Length of the flights that are diagnosed, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 90.0, requires = "diagnose")]
    pub excite: f64,
    /// Control laws to compare: each flies the same flights, for one row of the table [default:
    /// control.law of the configuration].
    #[arg(long, value_delimiter = ',', conflicts_with = "diagnose", value_parser = super::value::law())]
    pub law: Vec<Law>,
    /// Number of flights for each, with consecutive seeds from --seed.
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=100))]
    pub flights: u64,
    /// Vehicle file, or the name of a shipped one [default: crazyflie].
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// Trajectory file, the name of a shipped one, or with --fly model-free a plan [default:
    /// sinusoid-yaw].
    #[arg(long)]
    pub trajectory: Option<PathBuf>,
    /// The simulated vehicle.
    #[command(flatten)]
    pub simulation: SimulationArgs,
    /// Seed of noise, delays and gusts.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the summary as JSON.
    #[arg(long)]
    pub json: bool,
}

/// What flies a trajectory in `demo`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Contestant {
    /// The desired trajectory as the reference, hover as the feed-forward.
    ModelFree,
    /// A plan through the learned networks.
    Net,
    /// A plan through the fitted physics.
    Physics,
    /// A plan through physics and networks together.
    Hybrid,
    /// Plans through physics and networks together, renewed in flight.
    Replanned,
}

impl Contestant {
    /// The paper's, in the order of the report.
    pub const PAPER: [Self; 4] = [Self::ModelFree, Self::Net, Self::Physics, Self::Hybrid];

    /// The model that it plans through.
    pub fn model(self) -> Option<ModelKind> {
        match self {
            Self::ModelFree => None,
            Self::Net => Some(ModelKind::Net),
            Self::Physics => Some(ModelKind::Physics),
            Self::Hybrid | Self::Replanned => Some(ModelKind::Hybrid),
        }
    }

    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Replanned => "replanned",
            _ => self.model().map_or("model-free", ModelKind::name),
        }
    }
}

impl std::fmt::Display for Contestant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}
