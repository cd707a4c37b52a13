//! Flags of one simulated flight.

use std::path::PathBuf;

use clap::Args;

use super::{LearnArgs, SimulationArgs, ViewArgs};

/// Flags of `simulate`.
#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// Trajectory file, the name of a shipped one, or a plan [default: sinusoid-yaw].
    pub trajectory: Option<PathBuf>,
    /// Vehicle file, or the name of a shipped one [default: crazyflie].
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// The simulated vehicle.
    #[command(flatten)]
    pub simulation: SimulationArgs,
    /// Learning in flight; it takes `learn.simulated_latency_s` of simulated time.
    #[command(flatten)]
    pub learning: LearnArgs,
    /// Overrides a setting of the configuration, such as control.thrust=0.5; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Seed of noise, delays and gusts.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Folder for the log and its report; created if missing.
    #[arg(long, value_name = "DIR", default_value = "simulate-out")]
    pub out: PathBuf,
    /// Writes no log, and therefore no report.
    #[arg(long)]
    pub no_log: bool,
    /// Writes no report.
    #[arg(long)]
    pub no_report: bool,
    /// The live view; the flight then takes as long as a real one.
    #[command(flatten)]
    pub view: ViewArgs,
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the row as JSON.
    #[arg(long)]
    pub json: bool,
}
