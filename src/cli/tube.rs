//! Flags of the commands that make and check tubes around plans.

use std::path::PathBuf;

use clap::{Args, Subcommand, value_parser};

use super::SimulationArgs;
use crate::model::file::ModelKind;

/// Commands for tubes: bounds on the distance between a flight and its plan, at a stated
/// confidence.
#[derive(Debug, Subcommand)]
pub enum TubeCommand {
    /// Calibrates a tube on flights that the model was not trained on: logs of tracked flights, or
    /// simulated flights.
    ///
    /// Some of the flights give the model's errors and thereby the tube's shape. The others, as
    /// whole flights, give its width. A 95 % tube needs at least 19 of these.
    Fit(TubeFitArgs),
    /// Simulates many flights of a plan with a tube under random disturbances. Counts the flights
    /// that stay within the tube and those that touch a keep-out region.
    ///
    /// Exit code 10: a flight touched a region, or fewer flights stayed within the tube than chance
    /// explains.
    Check(TubeCheckArgs),
}

/// Flags of `tube fit`.
#[derive(Debug, Args)]
pub struct TubeFitArgs {
    /// Logs of flights that tracked a plan (.mcap).
    #[arg(required_unless_present = "along", conflicts_with = "along")]
    pub logs: Vec<PathBuf>,
    /// Trajectory or plan along which to simulate flights. If repeated, each flight picks one at
    /// random. A trajectory is first planned with the model.
    #[arg(long, value_name = "FILE")]
    pub along: Vec<PathBuf>,
    /// Calibration flights to simulate.
    #[arg(long, value_name = "COUNT", default_value_t = 500, requires = "along")]
    pub flights: u32,
    /// Model file from `train` [default: the vehicle file's own physics].
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Which of its models [default: the one that predicted best].
    #[arg(long, value_enum, requires = "model")]
    pub kind: Option<ModelKind>,
    /// Vehicle file, or the name of a shipped one [default: crazyflie].
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// The simulated vehicle. Each flight's random disturbances are added to its effects.
    #[command(flatten)]
    pub simulation: SimulationArgs,
    /// Seed of the disturbances, or of the choice of logs for the shape.
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
    /// Plan from `plan --tube`.
    pub plan: PathBuf,
    /// Flights to simulate. None repeats a flight of `tube fit`, whatever the seeds.
    #[arg(
        long,
        value_name = "COUNT",
        default_value_t = 1000,
        value_parser = value_parser!(u32).range(1..)
    )]
    pub flights: u32,
    /// Vehicle file, or the name of a shipped one [default: crazyflie].
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// The simulated vehicle. Each flight's random disturbances are added to its effects.
    #[command(flatten)]
    pub simulation: SimulationArgs,
    /// Seed of the disturbances.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Configuration file with the regions of `plan.keep_out`.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the summary as JSON.
    #[arg(long)]
    pub json: bool,
}
