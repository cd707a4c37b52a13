//! Flags of what flies: one flight, a programme of flights, the daemon.

use std::num::NonZeroU32;
use std::path::PathBuf;

use clap::Args;

use super::view::{FlightViewArgs, ForwardArgs, ServiceArgs};
use crate::control::Law;
use crate::model::file::ModelKind;

/// Flags of `fly`.
#[derive(Debug, Args)]
pub struct FlyArgs {
    /// Trajectory file (TOML or CSV), the name of a shipped one, or a plan (.json).
    pub trajectory: PathBuf,
    /// Connection to the vehicle: udpin:HOST:PORT, udpout:, tcp:, tcpin: or serial:DEVICE:BAUD.
    #[arg(long, value_name = "URL")]
    pub connect: Option<String>,
    /// Vehicle file, or the name of a shipped one.
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// Plans anew in flight, by default ten times a second. If the trajectory file changes, the
    /// vehicle moves over to the new trajectory.
    #[arg(long)]
    pub replan: bool,
    /// Model file to plan through [default: the vehicle file's own physics].
    #[arg(long, value_name = "FILE", requires = "replan")]
    pub model: Option<PathBuf>,
    /// Which of its models [default: the one that predicted best].
    #[arg(long, value_enum, requires = "model")]
    pub kind: Option<ModelKind>,
    /// Learning in flight.
    #[command(flatten)]
    pub learning: LearnArgs,
    /// Control law [default: control.law of the configuration].
    #[arg(long, value_parser = super::value::law())]
    pub law: Option<Law>,
    /// Takes over a vehicle that is already armed or in the air.
    #[arg(long)]
    pub take_over: bool,
    /// Folder for the flight log.
    #[arg(long)]
    pub log_dir: Option<PathBuf>,
    /// Also writes every byte of the link to this .tlog.
    #[arg(long)]
    pub tlog: Option<PathBuf>,
    /// System id of the vehicle, where several are on the link.
    #[arg(long, value_name = "ID")]
    pub system: Option<u8>,
    /// Runs the preflight checks and flies nothing; exit code 4 if one fails.
    #[arg(long, conflicts_with_all = ["replan", "learn", "tlog", "view", "forward", "metrics", "tui"])]
    pub check: bool,
    /// The live view.
    #[command(flatten)]
    pub view: FlightViewArgs,
    /// The fan-out.
    #[command(flatten)]
    pub forward: ForwardArgs,
    /// What monitors ask.
    #[command(flatten)]
    pub service: ServiceArgs,
    /// Shows the flight full-screen in the terminal, such as over ssh.
    #[arg(long)]
    pub tui: bool,
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the flight's summary as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Flags of a flight in laps that learns from lap to lap.
#[derive(Clone, Debug, Default, Args)]
pub struct LearnArgs {
    /// Flies laps of a closed course, planned in flight. At the end of each lap, learns the
    /// dynamics from the newest SECONDS of this flight [60 if omitted] and plans the next laps with
    /// the learned model.
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, require_equals = true, default_missing_value = "60")]
    pub learn: Option<f64>,
    /// Laps to fly [default: 4].
    #[arg(long, value_name = "COUNT", requires = "learn")]
    pub laps: Option<NonZeroU32>,
}

/// Flags of `collect`.
#[derive(Debug, Args)]
pub struct CollectArgs {
    /// Folder for the logs, one per flight; created if missing. Flights whose complete log is in it
    /// are not flown again.
    #[arg(long)]
    pub out: PathBuf,
    /// Vehicle file, or the name of a shipped one [default: in simulation crazyflie].
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// Flies the vehicle at this address, one flight after the other, instead of the simulated one.
    #[arg(long, value_name = "URL", conflicts_with_all = ["sitl_config", "effects", "effect", "jobs"])]
    pub connect: Option<String>,
    /// System id of the vehicle, where several are on the link.
    #[arg(long, value_name = "ID", requires = "connect")]
    pub system: Option<u8>,
    /// Length of the programme's trajectories, s; landings and take-offs are extra.
    #[arg(long, value_name = "SECONDS", default_value_t = 2400.0)]
    pub seconds: f64,
    /// Length of additional flights that move and turn at once, to test a model on, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub combined: f64,
    /// Seed of the programme and, in simulation, of noise, delays and gusts.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// The simulated vehicle.
    #[command(flatten)]
    pub simulation: SimulationArgs,
    /// Simulated flights in parallel [default: one for each core]. The logs do not depend on it.
    #[arg(long, value_name = "COUNT")]
    pub jobs: Option<std::num::NonZeroUsize>,
    /// Shows the programme without flying it.
    #[arg(long)]
    pub list: bool,
    /// Writes the programme's trajectory files, for `fly`, into this folder without flying them.
    #[arg(long, value_name = "FOLDER")]
    pub write_trajectories: Option<PathBuf>,
    /// Configuration file; its `collect` and `envelope` set where and how aggressively to fly.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the flights as JSON.
    #[arg(long)]
    pub json: bool,
}

impl CollectArgs {
    /// A programme of `seconds` into the folder `out`, flown by the simulated vehicle.
    pub fn simulated(out: PathBuf, seconds: f64, seed: u64, simulation: SimulationArgs) -> Self {
        Self {
            out,
            vehicle: None,
            connect: None,
            system: None,
            seconds,
            combined: 0.0,
            seed,
            simulation,
            jobs: None,
            list: false,
            write_trajectories: None,
            config: None,
            json: false,
        }
    }
}

/// What the simulated vehicle has beyond its vehicle file.
#[derive(Clone, Debug, Args)]
pub struct SimulationArgs {
    /// The simulated vehicle's own configuration: sensors, battery, start.
    #[arg(long)]
    pub sitl_config: Option<PathBuf>,
    /// Effects of the simulated vehicle that the controller does not know: a TOML file with a table
    /// for each id.
    #[arg(long, value_name = "FILE")]
    pub effects: Option<PathBuf>,
    /// One such effect, which overrides the file's: id:key=value,... With the suffix @41.2, it sets
    /// in at 41.2 s on the vehicle's clock.
    #[arg(long, visible_alias = "hidden", value_name = "EFFECT[@S]")]
    pub effect: Vec<String>,
}

/// Flags of `daemon`.
#[derive(Debug, Args)]
pub struct DaemonArgs {
    /// Configuration file: vehicle, trajectory, connect, and more.
    #[arg(long)]
    pub config: PathBuf,
    /// Also writes every byte of the link to this .tlog.
    #[arg(long)]
    pub tlog: Option<PathBuf>,
    /// The live view.
    #[command(flatten)]
    pub view: FlightViewArgs,
    /// The fan-out.
    #[command(flatten)]
    pub forward: ForwardArgs,
    /// What monitors ask.
    #[command(flatten)]
    pub service: ServiceArgs,
    /// Shows the flight full-screen in the terminal, such as over ssh.
    #[arg(long)]
    pub tui: bool,
}

/// Flags of `doctor` and `inspect`.
#[derive(Debug, Args)]
pub struct ListenArgs {
    /// Connection to the vehicle: udpin:HOST:PORT, udpout:, tcp:, tcpin: or serial:DEVICE:BAUD.
    #[arg(long, value_name = "URL")]
    pub connect: Option<String>,
    /// System id of the vehicle, where several are on the link.
    #[arg(long, value_name = "ID")]
    pub system: Option<u8>,
    /// How long to listen, s [default: 8; `inspect` on a terminal: until Ctrl-C].
    #[arg(long, value_name = "SECONDS", value_parser = super::value::seconds)]
    pub seconds: Option<f64>,
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// Flags of `doctor`.
#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// The link.
    #[command(flatten)]
    pub listen: ListenArgs,
    /// Also requests the messages and rates of a flight, to see whether the link carries them; the
    /// vehicle keeps them until it restarts.
    #[arg(long)]
    pub rates: bool,
}
