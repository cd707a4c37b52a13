//! The command line: raw flags only. Each command checks them and does the work.

mod campaign;
mod compare;
mod demo;
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
mod vehicle;
mod view;

use std::num::NonZeroUsize;
use std::path::PathBuf;

use ::vehicle::effects::EffectId;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser, Subcommand, ValueEnum};

pub use self::campaign::CampaignArgs;
pub use self::compare::{AlignChoice, CompareArgs, PairChoice};
pub use self::demo::{Contestant, DemoArgs};
pub use self::flight::{
    CollectArgs, DaemonArgs, DoctorArgs, FlyArgs, LearnArgs, ListenArgs, SimulationArgs,
};
pub use self::log::{ExportFormat, FailOnFinding, LogCommand};
pub use self::mocap::{MocapArgs, UpChoice};
pub use self::model::{FeatureChoice, MethodChoice, ModelCommand, PlanArgs, TrainArgs};
pub use self::reference::{PageChoice, ReferenceArgs};
pub use self::replay::ReplayArgs;
pub use self::schema::SchemaArgs;
pub use self::signing::{SetupArgs, SigningCommand};
pub use self::simulate::SimulateArgs;
pub use self::sweep::{Shard, SweepArgs};
pub use self::vehicle::{InitArgs, LayoutChoice, PeerChoice, VehicleCommand};
pub use self::view::{
    FlightViewArgs, ForwardArgs, METRICS_ADDRESS, ServiceArgs, VIEW_ADDRESS, ViewArgs,
};
use crate::control::{LAWS, Law};
use crate::exam::order::Kind;

/// Flies MAVLink quadrotors and keeps the logs that explain what happened.
///
/// Results go to stdout, progress and messages to stderr. Exit codes: 0 done, 1 failed while
/// running, 2 bad flags or files, 3 no vehicle heard or link lost, 4 preflight or vehicle refused,
/// 5 flight ended early by a safety reaction or by the pilot, 6 no plan was found that may be
/// flown, 10 a check failed that was asked for, 130 interrupted after a clean stop.
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
    /// The whole experiment on the bundled vehicle, in lockstep: collect, learn, plan, fly,
    /// compare.
    ///
    /// Learns a model from flights of a vehicle with effects that its file does not say, plans a
    /// trajectory through it, and flies it with and without the plans. Leaves a report, its
    /// numbers, the model, the plans and the logs.
    Demo(DemoArgs),
    /// Flies the simulated vehicle along one trajectory, in lockstep, and prints the flight as one
    /// row of numbers.
    Simulate(SimulateArgs),
    /// Flies many of these flights: grids, lists and draws of any input, on any number of workers,
    /// into one table.
    Sweep(SweepArgs),
    /// Flies simulated flights under drawn faults, and judges by the wire and by the vehicle's true
    /// state what the daemon made of them.
    ///
    /// Vehicle, autopilot, trajectory, controller and faults follow from the seed. A flight that breaks
    /// a rule is shrunk to the shortest fault script that does. Exit code 10: some flight broke a
    /// rule.
    Campaign(CampaignArgs),
    /// Connects to a vehicle, flies one trajectory from take-off to landing, and logs it.
    Fly(FlyArgs),
    /// Flies a programme that a model can be learned from, and logs each flight.
    Collect(CollectArgs),
    /// Runs for long: streams a hold, and flies whenever the pilot switches the vehicle to
    /// OFFBOARD.
    Daemon(DaemonArgs),
    /// Looks at a vehicle without changing it: what comes, what is missing, what would be refused.
    ///
    /// Exit code 0: it can be flown as far as that can be told; 3: no vehicle was heard; 4: it would
    /// be refused.
    Doctor(DoctorArgs),
    /// Shows the messages on a link, with rate, size, age and last value.
    Inspect(ListenArgs),
    /// Bridges poses of a rigid body from a motion-capture room to a vehicle.
    ///
    /// It forwards only poses that it believes. Where the room swaps bodies, freezes, jumps or is late, it
    /// forwards nothing, and says why and what to do. It runs beside `fly`, on an endpoint of its own.
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
    /// Lays flights of any logs side by side, A before `--` and B after it: errors with what chance
    /// leaves open, and what differs between their vehicles, settings and versions.
    Compare(CompareArgs),
    /// Learns a vehicle's dynamics from flight logs: networks, physics, and their hybrid.
    Train(TrainArgs),
    /// Looks at, judges, runs and exports a learned model.
    #[command(subcommand)]
    Model(ModelCommand),
    /// Plans a trajectory through a model: a reference that `fly` takes.
    Plan(PlanArgs),
    /// Says where a simulator and flights part, which effect causes it, and how far it shrinks.
    Diagnose(DiagnoseArgs),
    /// Says when something of the vehicle changed, in a flight or between flights, and what.
    Onset(OnsetArgs),
    /// Checks the diagnosis blindly, on simulated flights whose cause it is not told.
    Exam(ExamArgs),
    /// Makes keys for signed links (MAVLink 2), and gives them to vehicles.
    #[command(subcommand)]
    Signing(SigningCommand),
    /// Shows every setting and where its value comes from.
    Config(ConfigArgs),
    /// Pages to look things up: effects, trajectory families, vehicle keys, settings, topics of logs,
    /// exit codes, JSON.
    Reference(ReferenceArgs),
    /// JSON Schemas of what the commands print with --json.
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
    /// The simulator's vehicle file.
    #[arg(long)]
    pub vehicle: PathBuf,
    /// Instead of logs of one vehicle: many vehicles of the type. A folder with a folder of logs for each,
    /// or a TOML file with a table `[vehicles]` of names with their logs, files or folders. What all share
    /// is told apart from what single ones have.
    #[arg(
        long,
        value_name = "DIR|FILE",
        conflicts_with_all = ["logs", "holdout", "new", "next_flight", "config", "evidence", "discover"]
    )]
    pub fleet: Option<PathBuf>,
    /// Folder for what is done of each vehicle of a fleet; the same command goes on with it.
    #[arg(long, value_name = "DIR", default_value = "fleet-rows")]
    pub rows: PathBuf,
    /// A log to keep from the fit and to report the gap on; may be given again [default: the last
    /// of the logs; of a single one its second half].
    #[arg(long, value_name = "FILE")]
    pub holdout: Vec<PathBuf>,
    /// A log of the flight that an earlier diagnosis asked for: part of the fit, never held out;
    /// may be given again.
    #[arg(long, value_name = "FILE")]
    pub new: Vec<PathBuf>,
    /// The vehicle file to write, with the effects that were found.
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Folder for report.html and report.json; made if missing.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// The trajectory file to write, of the flight that would best tell what these logs leave open.
    #[arg(long, value_name = "FILE")]
    pub next_flight: Option<PathBuf>,
    /// Configuration file: room and envelope of the next flight.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// What the columns of CSV logs mean.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// Simulated flights without any effect, which say how large chance makes the evidence.
    #[arg(long, default_value_t = TWINS)]
    pub twins: u32,
    /// Seed of the simulated flights.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// The JSON file to write, of the evidence that the verdict rests on.
    #[arg(long, value_name = "FILE")]
    pub evidence: Option<PathBuf>,
    /// An effect that is not to be considered, nor another that acts in the same way; may be given
    /// again. What the flights hold of it is then a cause outside of the catalogue.
    #[arg(long, value_name = "EFFECT")]
    pub without: Vec<EffectId>,
    /// Also looks for a law: a formula that explains what no effect of the catalogue does. It takes
    /// some more seconds.
    #[arg(long)]
    pub discover: bool,
    /// The effects file to write, of the law and what acts beside it, where a law is named; whatever
    /// takes --effects takes it.
    #[arg(long, value_name = "FILE", requires = "discover")]
    pub law: Option<PathBuf>,
    /// Ends with exit code 10 on this verdict.
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
    /// The vehicle file.
    #[arg(long)]
    pub vehicle: PathBuf,
    /// What the columns of CSV logs mean.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// Mean time between false alarms that the bound on the evidence is for, h of flight.
    #[arg(long, value_name = "H", default_value_t = FALSE_ALARM_H)]
    pub false_alarm_h: f64,
    /// Folder for report.html and report.json; made if missing.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// Ends with exit code 10 if something changed.
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

/// Flags of `exam`.
#[derive(Debug, Args)]
pub struct ExamArgs {
    /// Cases with something to find [default: 60; of a round trip all].
    #[arg(long, value_name = "COUNT")]
    pub cases: Option<usize>,
    /// Cases with nothing to find.
    #[arg(long, value_name = "COUNT", default_value_t = 20)]
    pub nulls: usize,
    /// Only cases of these kinds [default: all, in fixed shares].
    #[arg(long, value_enum, value_delimiter = ',')]
    pub kinds: Vec<Kind>,
    /// Instead: every effect at three strengths on both shipped vehicles, with logs as they are, at
    /// half their rate, with stamps 5 ms off, and with a tenth lost. Takes an hour or more.
    #[arg(long, conflicts_with = "kinds")]
    pub round_trip: bool,
    /// Instead: the labelled flights of this folder, which somebody else made: a folder for each case
    /// with vehicle.json and flight_1.tlog and so on, and key.json, graded by the script that lies
    /// with them. Nothing is drawn, and nothing is ever fitted to them.
    #[arg(
        long,
        value_name = "DIR",
        conflicts_with_all = ["cases", "kinds", "round_trip", "exact", "seed", "fail_on_miss"]
    )]
    pub practice: Option<PathBuf>,
    /// Instead: the evidence of an earlier exam's cases, decided anew and scored; a folder that
    /// --evidence filled. Nothing is flown.
    #[arg(
        long,
        value_name = "DIR",
        conflicts_with_all = ["cases", "kinds", "round_trip", "practice", "exact", "seed"]
    )]
    pub decide: Vec<PathBuf>,
    /// The file to write, of the numbers of the decision that serve these cases best: those of some
    /// families of cases; the others test them.
    #[arg(long, value_name = "FILE", requires = "decide")]
    pub calibrate: Option<PathBuf>,
    /// Instead: this many vehicles with a law that the catalogue does not have, and --nulls without, from
    /// whose flights laws are searched: how much of the gap on another mission each closes, whether it
    /// depends on what the true one does, and how often a law is invented.
    #[arg(
        long,
        value_name = "COUNT",
        conflicts_with_all = ["cases", "kinds", "round_trip", "practice", "decide", "evidence"]
    )]
    pub laws: Option<usize>,
    /// Instead: flies this many flights in which something of the vehicle changes at an instant, and --nulls of
    /// ten minutes in which nothing does. Prints how near to the true time the detector dates the change, from
    /// logs and live, and how often it reports one that is not there.
    #[arg(
        long,
        value_name = "COUNT",
        conflicts_with_all = ["cases", "kinds", "round_trip", "practice", "decide", "evidence", "laws"]
    )]
    pub onsets: Option<usize>,
    /// Instead: this many fleets of --vehicles each with an effect that all share, and --nulls without one;
    /// some vehicles have an effect of their own. Prints how often what is shared is named, and what single
    /// vehicles have.
    #[arg(
        long,
        value_name = "COUNT",
        conflicts_with_all =
            ["cases", "kinds", "round_trip", "practice", "decide", "evidence", "laws", "onsets"]
    )]
    pub fleet: Option<usize>,
    /// Vehicles of a fleet.
    #[arg(long, value_name = "COUNT", default_value_t = 50, requires = "fleet")]
    pub vehicles: usize,
    /// Share of a fleet's vehicles that have an effect of their own.
    #[arg(long, value_name = "SHARE", default_value_t = 0.2, requires = "fleet")]
    pub damaged: f64,
    /// Folder for each case's key, answer and the evidence that its verdict rests on; made if missing.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["practice", "decide"])]
    pub evidence: Option<PathBuf>,
    /// Instead of vehicle files as builders have them: files whose every number is the vehicle's, the
    /// bundled on-board loop, and logs without nuisances.
    #[arg(long)]
    pub exact: bool,
    /// Seed of everything that is drawn [default: from the system, and said].
    #[arg(long)]
    pub seed: Option<u64>,
    /// Length of each of a case's flights, s.
    #[arg(long, default_value_t = 22.5)]
    pub seconds: f64,
    /// How strongly single effects show with --exact, least and most: prediction errors that they
    /// cause over those of noise.
    #[arg(long, value_name = "RATIO", num_args = 2, default_values_t = [0.3, 30.0])]
    pub strengths: Vec<f64>,
    /// Simulated flights without any effect in each diagnosis [default: as `diagnose`].
    #[arg(long, value_name = "COUNT")]
    pub twins: Option<u32>,
    /// Cases at once [default: one for each core].
    #[arg(long, value_name = "COUNT")]
    pub jobs: Option<NonZeroUsize>,
    /// Folder for commitment.txt, the answers, key.json, summary.json and report.html; it must not
    /// hold another exam.
    #[arg(long, value_name = "DIR", default_value = "exam-out")]
    pub out: PathBuf,
    /// Keeps vehicle files and logs.
    #[arg(long)]
    pub keep: bool,
    /// Ends with exit code 10 if a rate or the Brier score misses its bound.
    #[arg(long)]
    pub fail_on_miss: bool,
    /// Prints the result as JSON.
    #[arg(long)]
    pub json: bool,
}

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

/// Takes the id of a control law; its help is the table of laws.
fn law() -> impl TypedValueParser<Value = Law> {
    let values = LAWS.map(|spec| PossibleValue::new(spec.id).help(spec.summary));
    PossibleValuesParser::new(values).map(|id| Law::named(&id).unwrap_or_default())
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
    fn flags_of_no_command_are_in_each_others_way() {
        Cli::command().debug_assert();
    }

    #[derive(Parser)]
    struct Onset {
        #[command(flatten)]
        args: OnsetArgs,
    }

    #[test]
    fn a_search_for_changes_without_flags_is_the_one_of_the_command_line() {
        let typed = Onset::try_parse_from(["onset", "a.mcap", "--vehicle", "v.toml"]);
        let made = OnsetArgs::new(vec!["a.mcap".into()], "v.toml".into());
        assert_eq!(format!("{:?}", typed.expect("arguments").args), format!("{made:?}"));
    }

    #[test]
    fn a_diagnosis_without_flags_is_the_one_of_the_command_line() {
        let typed = Diagnose::try_parse_from(["diagnose", "a.mcap", "--vehicle", "v.toml"]);
        let made = DiagnoseArgs::new(vec!["a.mcap".into()], "v.toml".into());
        assert_eq!(format!("{:?}", typed.expect("arguments").args), format!("{made:?}"));
    }
}
