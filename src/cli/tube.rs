//! Flags of what makes and checks tubes around plans.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::SimulationArgs;
use crate::model::file::ModelKind;

/// Commands on tubes: how far from a plan a flight may be, with a stated probability.
#[derive(Debug, Subcommand)]
pub enum TubeCommand {
    /// Calibrates a tube on flights that fitted nothing: logs of tracked flights, or flights that it
    /// simulates.
    ///
    /// A part of the flights gives the model's errors, and so the tube's shape; the others, as whole
    /// flights, its width. A tube of 95 % takes at least 19 of these.
    Fit(TubeFitArgs),
    /// Flies a plan with a tube many times, simulated under drawn disturbances, and counts the flights
    /// that stay within it and those that touch a keep-out region.
    ///
    /// Exit code 10: a region was touched, or fewer flights stayed within than chance explains.
    Check(TubeCheckArgs),
}

/// Flags of `tube fit`.
#[derive(Debug, Args)]
pub struct TubeFitArgs {
    /// Logs of flights that tracked a plan (.mcap).
    #[arg(required_unless_present = "along", conflicts_with = "along")]
    pub logs: Vec<PathBuf>,
    /// Simulates flights along this trajectory or plan; may be given again, and each flight then draws
    /// one. A trajectory is planned through the model first.
    #[arg(long, value_name = "FILE")]
    pub along: Vec<PathBuf>,
    /// Calibration flights to simulate.
    #[arg(long, value_name = "COUNT", default_value_t = 500, requires = "along")]
    pub flights: u32,
    /// Model file of `train` [default: the vehicle file's own physics].
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Which of its models [default: the one that predicted best].
    #[arg(long, value_enum, requires = "model")]
    pub kind: Option<ModelKind>,
    /// Vehicle file, or the name of a shipped one [default: a built-in nano quadrotor].
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// The simulated vehicle; the disturbances are drawn on top of its effects.
    #[command(flatten)]
    pub simulation: SimulationArgs,
    /// Seed of the disturbances and of the choice of flights for the shape.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// The tube to write.
    #[arg(short, long, value_name = "FILE", default_value = "tube.json")]
    pub out: PathBuf,
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the summary as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Flags of `tube check`.
#[derive(Debug, Args)]
pub struct TubeCheckArgs {
    /// A plan that `plan --tube` made.
    pub plan: PathBuf,
    /// Flights to simulate. None of them is one that `tube fit` simulates, whatever the seeds.
    #[arg(long, value_name = "COUNT", default_value_t = 1000)]
    pub flights: u32,
    /// Vehicle file, or the name of a shipped one [default: a built-in nano quadrotor].
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// The simulated vehicle; the disturbances are drawn on top of its effects.
    #[command(flatten)]
    pub simulation: SimulationArgs,
    /// Seed of the disturbances.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Configuration file, with the regions of [plan] keep_out.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the summary as JSON.
    #[arg(long)]
    pub json: bool,
}
