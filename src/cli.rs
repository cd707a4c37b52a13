//! The command line: raw flags only. Each command checks them and does the work.

mod campaign;
mod compare;
mod demo;
mod exam;
mod flight;
mod log;
mod mocap;
mod model;
mod reference;
mod replay;
mod schema;
mod signing;
mod simulate;
mod sweep;
mod tube;
mod value;
mod vehicle;
mod view;

use std::path::PathBuf;

use ::vehicle::effects::EffectId;
use clap::{Args, Parser, Subcommand, ValueEnum};

pub use self::campaign::CampaignArgs;
pub use self::compare::{AlignChoice, CompareArgs, PairChoice};
pub use self::demo::{Contestant, DemoArgs};
pub use self::exam::ExamArgs;
pub use self::flight::{
    CollectArgs, DaemonArgs, DoctorArgs, FlyArgs, LearnArgs, ListenArgs, SimulationArgs,
};
pub use self::log::{ExportFormat, FailOnFinding, FlightChoiceArgs, LogCommand};
pub use self::mocap::{MocapArgs, UpChoice};
pub use self::model::{FeatureChoice, MethodChoice, ModelCommand, PlanArgs, TrainArgs};
pub use self::reference::{PageChoice, ReferenceArgs};
pub use self::replay::ReplayArgs;
pub use self::schema::SchemaArgs;
pub use self::signing::{SetupArgs, SigningCommand};
pub use self::simulate::SimulateArgs;
pub use self::sweep::{Shard, SweepArgs};
pub use self::tube::{TubeCheckArgs, TubeCommand, TubeFitArgs};
pub use self::vehicle::{InitArgs, LayoutChoice, PeerChoice, VehicleCommand};
pub use self::view::{FlightViewArgs, ForwardArgs, ServiceArgs, ViewArgs};

/// Flies MAVLink quadrotors and keeps the logs that explain what happened.
///
/// Results go to stdout, progress and messages to stderr. Exit codes: 0 done, 1 failed while
/// running, 2 bad flags or files, 3 no vehicle found or link lost, 4 preflight or vehicle refused,
/// 5 flight ended early by a safety reaction or by the pilot, 6 no flyable plan was found, 10 a
/// requested check failed, 130 interrupted after a clean stop.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// More messages on stderr (twice: even more). RUST_LOG overrides.
    #[arg(short, long, action = clap::ArgAction::Count, global = true)]
    pub verbose: u8,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Runs the whole experiment on the bundled vehicle, in lockstep: collect, learn, plan, fly,
    /// compare.
    ///
    /// Learns a model from flights of a vehicle with effects that its file does not describe, plans
    /// a trajectory through it, and flies it with and without the plans. Writes a report, its
    /// numbers, the model, the plans and the logs.
    Demo(DemoArgs),
    /// Flies the simulated vehicle along one trajectory, in lockstep, and prints the flight as one
    /// row of numbers.
    Simulate(SimulateArgs),
    /// Flies many such flights: grids, lists and draws of any input, on any number of workers, into
    /// one table.
    Sweep(SweepArgs),
    /// Flies simulated flights with randomly drawn faults, and judges the daemon by the wire and by
    /// the vehicle's true state.
    ///
    /// Vehicle, autopilot, trajectory, controller and faults follow from the seed. A flight that
    /// breaks a rule is shrunk to the shortest fault script that still breaks it. Exit code 10:
    /// some flight broke a rule.
    Campaign(CampaignArgs),
    /// Connects to a vehicle, flies one trajectory from take-off to landing, and logs it.
    Fly(FlyArgs),
    /// Flies a programme of flights to learn a model from, and logs each flight.
    Collect(CollectArgs),
    /// Runs continuously: streams a hold, and flies whenever the pilot switches the vehicle to
    /// OFFBOARD.
    Daemon(DaemonArgs),
    /// Inspects a vehicle without changing it: what arrives, what is missing, what would be
    /// refused.
    ///
    /// Exit code 0: it can be flown as far as can be seen; 3: no vehicle was found; 4: it would be
    /// refused.
    Doctor(DoctorArgs),
    /// Shows the messages on a link, with rate, size, age and last value.
    Inspect(ListenArgs),
    /// Bridges poses of a rigid body from a motion-capture room to a vehicle.
    ///
    /// Forwards only plausible poses. If the room swaps bodies, freezes, jumps or is late, it
    /// forwards nothing, and reports why and what to do. Runs beside `fly`, on its own endpoint.
    Mocap(MocapArgs),
    /// Runs the bundled vehicle on MAVLink links.
    Sitl(SimulatorArgs),
    /// Makes, checks and lists vehicle files.
    #[command(subcommand)]
    Vehicle(VehicleCommand),
    /// Reads flight logs.
    #[command(subcommand)]
    Log(LogCommand),
    /// Plays a flight log to a browser or to Foxglove, with pause, speed and seeking.
    Replay(ReplayArgs),
    /// Compares flights of any logs, A before `--` and B after it: errors with confidence
    /// intervals, and what differs between their vehicles, settings and versions.
    Compare(CompareArgs),
    /// Learns a vehicle's dynamics from flight logs: networks, physics, and their hybrid.
    Train(TrainArgs),
    /// Inspects, evaluates, runs and exports a learned model.
    #[command(subcommand)]
    Model(ModelCommand),
    /// Plans a trajectory through a model: a reference that `fly` takes.
    Plan(PlanArgs),
    /// Calibrates how far flights stay from their plan, with a stated probability, and checks it.
    #[command(subcommand)]
    Tube(TubeCommand),
    /// Finds where a simulator and flights differ, which effect causes it, and how far the gap
    /// closes.
    Diagnose(DiagnoseArgs),
    /// Finds when a vehicle changed, in a flight or between flights, and what changed.
    Onset(OnsetArgs),
    /// Tests the diagnosis blind, on simulated flights whose cause it does not know.
    Exam(ExamArgs),
    /// Makes keys for signed links (MAVLink 2), and sends them to vehicles.
    #[command(subcommand)]
    Signing(SigningCommand),
    /// Shows every setting and where its value comes from.
    Config(ConfigArgs),
    /// Prints reference pages: effects, trajectory families, vehicle keys, settings, topics of
    /// logs, exit codes, JSON.
    Reference(ReferenceArgs),
    /// Prints the JSON Schemas of what the commands print with --json.
    Schema(SchemaArgs),
}

/// Flags of `sitl`.
#[derive(Clone, Debug, Args)]
pub struct SimulatorArgs {
    /// The vehicle.
    #[command(flatten)]
    pub vehicle: sitl::cli::SitlArgs,
    /// The live view.
    #[command(flatten)]
    pub view: ViewArgs,
}

/// Flags of `diagnose`.
#[derive(Clone, Debug, Args)]
pub struct DiagnoseArgs {
    /// Flight logs of the real vehicle.
    #[arg(required_unless_present = "fleet")]
    pub logs: Vec<PathBuf>,
    /// The simulator's vehicle file, or the name of a shipped one.
    #[arg(long)]
    pub vehicle: PathBuf,
    /// Diagnoses many vehicles of one type, instead of one vehicle from its logs. A folder with a
    /// folder of logs for each, or a TOML file with a table `[vehicles]` of names with their logs,
    /// files or folders. Separates what all share from what single vehicles have.
    #[arg(
        long,
        value_name = "DIR|FILE",
        conflicts_with_all = ["logs", "holdout", "new", "next_flight", "config", "evidence", "discover"]
    )]
    pub fleet: Option<PathBuf>,
    /// Folder for the finished work on each vehicle of a fleet; the same command resumes from it.
    #[arg(long, value_name = "DIR", default_value = "fleet-rows", conflicts_with = "logs")]
    pub rows: PathBuf,
    /// A log to hold out of the fit and to report the gap on; may be repeated [default: the last
    /// log, or the second half of a single one].
    #[arg(long, value_name = "FILE")]
    pub holdout: Vec<PathBuf>,
    /// A log of the flight that an earlier diagnosis requested: part of the fit, never held out;
    /// may be repeated.
    #[arg(long, value_name = "FILE")]
    pub new: Vec<PathBuf>,
    /// The vehicle file to write, with the effects that were found.
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Folder for report.html and report.json; created if missing.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// The trajectory file to write, of the flight that would best resolve what these logs leave
    /// open.
    #[arg(long, value_name = "FILE")]
    pub next_flight: Option<PathBuf>,
    /// Configuration file; its `collect` and `envelope` bound the next flight.
    #[arg(long, requires = "next_flight")]
    pub config: Option<PathBuf>,
    /// Mapping of the columns of CSV logs.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// Number of simulated flights without any effect, which show how large the evidence becomes by
    /// chance.
    #[arg(long, default_value_t = TWINS)]
    pub twins: u32,
    /// Seed of the simulated flights.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// The JSON file to write, with the evidence behind the verdict.
    #[arg(long, value_name = "FILE")]
    pub evidence: Option<PathBuf>,
    /// An effect to leave out, together with any other that acts in the same way; may be repeated.
    /// What the flights contain of it is then a cause outside the catalogue.
    #[arg(long, value_name = "EFFECT")]
    pub without: Vec<EffectId>,
    /// Also searches for a law: a formula that explains what no effect of the catalogue does. Takes
    /// some seconds more.
    #[arg(long)]
    pub discover: bool,
    /// The effects file to write if a law is named, with the law and what acts beside it; every
    /// command with --effects takes it.
    #[arg(long, value_name = "FILE", requires = "discover")]
    pub law: Option<PathBuf>,
    /// Exits with code 10 on this verdict.
    #[arg(long, value_enum, value_name = "VERDICT")]
    pub fail_on: Option<FailOnVerdict>,
    /// Prints the answer as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Simulated flights without any effect in a diagnosis.
const TWINS: u32 = 40;

impl DiagnoseArgs {
    /// A diagnosis of `logs` against the vehicle file `vehicle`, as without another flag.
    pub fn new(logs: Vec<PathBuf>, vehicle: PathBuf) -> Self {
        Self {
            logs,
            vehicle,
            fleet: None,
            rows: PathBuf::from("fleet-rows"),
            holdout: Vec::new(),
            new: Vec::new(),
            out: None,
            report: None,
            next_flight: None,
            config: None,
            mapping: None,
            twins: TWINS,
            seed: 1,
            evidence: None,
            without: Vec::new(),
            discover: false,
            law: None,
            fail_on: None,
            json: false,
        }
    }
}

/// Flags of `onset`.
#[derive(Clone, Debug, Args)]
pub struct OnsetArgs {
    /// Flight logs of one vehicle, in the order of their dates.
    #[arg(required = true)]
    pub logs: Vec<PathBuf>,
    /// Vehicle file, or the name of a shipped one.
    #[arg(long)]
    pub vehicle: PathBuf,
    /// Mapping of the columns of CSV logs.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// Mean time between false alarms that sets the bound on the evidence, h of flight.
    #[arg(long, value_name = "H", default_value_t = FALSE_ALARM_H, value_parser = value::hours)]
    pub false_alarm_h: f64,
    /// Folder for report.html and report.json; created if missing.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// Exits with code 10 if something changed.
    #[arg(long)]
    pub fail_on_change: bool,
    /// Prints the answer as JSON.
    #[arg(long)]
    pub json: bool,
}

impl OnsetArgs {
    /// What changed in `logs` of the vehicle at `vehicle`, as without another flag.
    pub fn new(logs: Vec<PathBuf>, vehicle: PathBuf) -> Self {
        Self {
            logs,
            vehicle,
            mapping: None,
            false_alarm_h: FALSE_ALARM_H,
            report: None,
            fail_on_change: false,
            json: false,
        }
    }
}

/// Mean time between false alarms of `onset`, h of flight.
const FALSE_ALARM_H: f64 = 1000.0;

/// Verdicts that a command may fail on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FailOnVerdict {
    /// An effect was named; of a fleet, of the type or of any vehicle.
    Effect,
    /// There is a gap, explained or not; of a fleet, in any vehicle.
    Gap,
    /// The type of a fleet has an effect.
    Shared,
}

/// Flags of `config`.
#[derive(Debug, Args)]
pub struct ConfigArgs {
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints one JSON object.
    #[arg(long)]
    pub json: bool,
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[derive(Parser)]
    struct Diagnose {
        #[command(flatten)]
        args: DiagnoseArgs,
    }

    #[test]
    fn command_flags_do_not_conflict() {
        Cli::command().debug_assert();
    }

    #[test]
    fn numbers_without_a_meaning_are_refused() {
        let refused =
            |flags: &[&str]| Cli::try_parse_from(["downwash"].iter().chain(flags)).is_err();
        let onset = ["onset", "a.mcap", "--vehicle", "crazyflie", "--false-alarm-h"];
        for hours in ["0", "-1", "nan", "inf", "1e300"] {
            assert!(refused(&[&onset[..], &[hours]].concat()), "{hours}");
        }
        assert!(!refused(&[&onset[..], &["100"]].concat()));
        for flags in [
            ["exam", "--seconds", "nan"],
            ["campaign", "--flights", "0"],
            ["exam", "--fleet=1", "--vehicles=0"],
            ["exam", "--fleet=1", "--damaged=7"],
            ["exam", "--fleet=1", "--fail-on-miss"],
        ] {
            assert!(refused(&flags), "{flags:?}");
        }
    }

    #[derive(Parser)]
    struct Onset {
        #[command(flatten)]
        args: OnsetArgs,
    }

    #[test]
    fn onset_args_default_to_the_command_line_defaults() {
        let typed = Onset::try_parse_from(["onset", "a.mcap", "--vehicle", "v.toml"]);
        let made = OnsetArgs::new(vec!["a.mcap".into()], "v.toml".into());
        assert_eq!(format!("{:?}", typed.expect("arguments").args), format!("{made:?}"));
    }

    #[test]
    fn diagnose_args_default_to_the_command_line_defaults() {
        let typed = Diagnose::try_parse_from(["diagnose", "a.mcap", "--vehicle", "v.toml"]);
        let made = DiagnoseArgs::new(vec!["a.mcap".into()], "v.toml".into());
        assert_eq!(format!("{:?}", typed.expect("arguments").args), format!("{made:?}"));
    }
}
