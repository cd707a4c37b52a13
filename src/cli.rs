//! The command line: raw flags only. Each command checks them and does the work.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use sitl::effects::EffectId;

use crate::exam::case::Kind;
use crate::model::file::ModelKind;
use crate::plan::planner::SolverChoice;

/// Flies MAVLink quadrotors and keeps the logs that explain what happened.
///
/// Results go to stdout, progress and messages to stderr. Exit codes: 0 done, 1 failed while
/// running, 2 bad flags or files, 3 no vehicle heard or link lost, 4 preflight or vehicle refused,
/// 5 flight ended early by a safety reaction or by the pilot, 10 a check failed that was asked for, 130 interrupted after a clean stop.
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
    /// Flies the bundled vehicle once, in lockstep, and writes a report, its numbers and the log.
    Demo(DemoArgs),
    /// Connects to a vehicle, flies one trajectory from take-off to landing, and logs it.
    Fly(FlyArgs),
    /// Flies a programme that a model can be learned from, and logs each flight.
    Collect(CollectArgs),
    /// Runs for long: streams a hold, and flies whenever the pilot switches the vehicle to OFFBOARD.
    Daemon(DaemonArgs),
    /// Runs the bundled vehicle on MAVLink links.
    Sitl(sitl::cli::SitlArgs),
    /// Reads flight logs.
    #[command(subcommand)]
    Log(LogCommand),
    /// Learns a vehicle's dynamics from flight logs: networks, physics, and their hybrid.
    Train(TrainArgs),
    /// Looks at, judges, runs and exports a learned model.
    #[command(subcommand)]
    Model(ModelCommand),
    /// Plans a trajectory through a model: a reference that `fly` takes.
    Plan(PlanArgs),
    /// Says where a simulator and flights part, which effect causes it, and how far it shrinks.
    Diagnose(DiagnoseArgs),
    /// Checks the diagnosis blindly, on simulated flights whose cause it is not told.
    Exam(ExamArgs),
    /// Shows every setting and where its value comes from.
    Config(ConfigArgs),
}

/// Flags of `demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for report.html, summary.json, the logs, the model and the plans; made if missing.
    #[arg(long, default_value = "demo-out")]
    pub out: PathBuf,
    /// What flies the trajectory: feedback alone, or plans through these models of what was learned.
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = Contestant::PAPER)]
    pub fly: Vec<Contestant>,
    /// Length of the flights that the models are learned from, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 900.0)]
    pub learn: f64,
    /// Flights of each, with seeds from --seed on.
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=100))]
    pub flights: u64,
    /// Vehicle file [default: a built-in nano quadrotor].
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// Trajectory file, or with --fly model-free a plan [default: the built-in sinusoid-yaw].
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
    /// Plans through physics and networks together, made anew in flight.
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

/// What of the simulated vehicle the vehicle file does not say.
#[derive(Clone, Debug, Args)]
pub struct SimulationArgs {
    /// The simulated vehicle's own configuration: sensors, pack, start.
    #[arg(long)]
    pub sitl_config: Option<PathBuf>,
    /// Effects of the simulated vehicle that the daemon does not know: a TOML table for each id.
    #[arg(long, value_name = "FILE")]
    pub effects: Option<PathBuf>,
    /// One such effect, over those of the file: id:key=value,...
    #[arg(long, value_name = "EFFECT")]
    pub effect: Vec<String>,
}

/// Flags of `collect`.
#[derive(Debug, Args)]
pub struct CollectArgs {
    /// Folder for the logs, one a flight; made if missing. Flights whose whole log is there are
    /// not flown again.
    #[arg(long)]
    pub out: PathBuf,
    /// Vehicle file [default: in simulation a built-in nano quadrotor].
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// Flies the vehicle there, one flight after the other, instead of the simulated one.
    #[arg(long, value_name = "URL", conflicts_with_all = ["sitl_config", "effects", "effect", "jobs"])]
    pub connect: Option<String>,
    /// Length of the programme's trajectories, s; landings and take-offs are extra.
    #[arg(long, value_name = "SECONDS", default_value_t = 2400.0)]
    pub seconds: f64,
    /// Adds flights that move and turn at once, to test a model on, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub combined: f64,
    /// Seed of the programme and, in simulation, of noise, delays and gusts.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// The simulated vehicle.
    #[command(flatten)]
    pub simulation: SimulationArgs,
    /// Simulated flights at once [default: one for each core]. The logs do not depend on it.
    #[arg(long, value_name = "COUNT")]
    pub jobs: Option<NonZeroUsize>,
    /// Shows the programme and flies nothing.
    #[arg(long)]
    pub list: bool,
    /// Writes the programme's trajectory files, which `fly` takes, into this folder and flies
    /// nothing.
    #[arg(long, value_name = "FOLDER")]
    pub write_trajectories: Option<PathBuf>,
    /// Configuration file; its [collect] says where and how boldly is flown.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the flights as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Flags of `fly`.
#[derive(Debug, Args)]
pub struct FlyArgs {
    /// Trajectory file (TOML or CSV), or a plan (.json).
    pub trajectory: PathBuf,
    /// Where the vehicle is: udpin:HOST:PORT, udpout:, tcp:, tcpin: or serial:DEVICE:BAUD.
    #[arg(long, value_name = "URL")]
    pub connect: Option<String>,
    /// Vehicle file.
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// Plans anew in flight, through the model of --model. Where the trajectory's file changes in
    /// flight, the vehicle is led over to what it then says.
    #[arg(long)]
    pub replan: bool,
    /// Model file to replan through [default: the vehicle file's own physics].
    #[arg(long, value_name = "FILE", requires = "replan")]
    pub model: Option<PathBuf>,
    /// Which of its models [default: the one that predicted best].
    #[arg(long, value_enum, requires = "model")]
    pub kind: Option<ModelKind>,
    /// Folder for the flight log.
    #[arg(long)]
    pub log_dir: Option<PathBuf>,
    /// Also writes every byte of the link to this .tlog.
    #[arg(long)]
    pub tlog: Option<PathBuf>,
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the flight's summary as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Flags of `plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// Desired trajectory (TOML or CSV).
    pub trajectory: PathBuf,
    /// Model file of `train` [default: the vehicle file's own physics].
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Which of its models [default: the one that predicted best].
    #[arg(long, value_enum, requires = "model")]
    pub kind: Option<ModelKind>,
    /// Vehicle file [default: the model's vehicle, else a built-in nano quadrotor].
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// The plan to write.
    #[arg(short, long, value_name = "FILE", default_value = "plan.json")]
    pub out: PathBuf,
    /// Folder for report.html and report.json; made if missing.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// What solves the subproblems.
    #[arg(long, value_enum)]
    pub solver: Option<SolverChoice>,
    /// Ends the search after this time with the best plan so far.
    #[arg(long, value_name = "SECONDS")]
    pub time_limit: Option<f64>,
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the summary as JSON.
    #[arg(long)]
    pub json: bool,
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
}

/// Commands on flight logs.
#[derive(Debug, Subcommand)]
pub enum LogCommand {
    /// What is in a log, also in one that was cut short.
    Info {
        /// Flight logs (.mcap).
        #[arg(required = true)]
        files: Vec<PathBuf>,
        /// Prints one JSON object a file.
        #[arg(long)]
        json: bool,
    },
    /// Writes a topic as CSV or as JSON lines.
    Export {
        /// Flight log (.mcap).
        file: PathBuf,
        /// Topic, such as /state [default: every flat topic, one file each into the folder --out].
        #[arg(long)]
        topic: Option<String>,
        /// Form of the rows.
        #[arg(long, value_enum, default_value_t = ExportFormat::Csv)]
        format: ExportFormat,
        /// File for one topic, folder for all [default: stdout for one topic].
        #[arg(short, long)]
        out: Option<PathBuf>,
    },
    /// Reads any flight log, and writes it as one of this program's, each stream at its own rate.
    ///
    /// Takes telemetry logs (.tlog), own logs (.mcap), logs of PX4 (.ulg) and ArduPilot (.bin), and
    /// tables (.csv), told by their content. A table needs a mapping file, which names columns, units, frames and orders; nothing of these
    /// is guessed, and config/mappings/motion-capture.toml is one to start from.
    Import {
        /// Flight log.
        file: PathBuf,
        /// What the columns of a table are (TOML).
        #[arg(long, value_name = "MAP")]
        mapping: Option<PathBuf>,
        /// The log to write (.mcap).
        #[arg(short, long, value_name = "OUT")]
        out: PathBuf,
        /// Prints what was found as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Says what is wrong with flight logs before any physics: gaps, frozen or impossible values,
    /// late or turned streams, biased sensors, flights that are there twice; and what the log's
    /// channels cannot show.
    Audit {
        /// Flight logs of any kind that `log import` takes.
        #[arg(required = true)]
        logs: Vec<PathBuf>,
        /// What the columns of a table are (TOML).
        #[arg(long, value_name = "MAP")]
        mapping: Option<PathBuf>,
        /// Ends with exit code 10 if anything this bad, or worse, is found.
        #[arg(long, value_enum)]
        fail_on: Option<FailOnFinding>,
        /// Prints what was found as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Writes the report on a flight: path, tracking error, setpoints and timing, as one HTML file.
    Report {
        /// Flight log (.mcap).
        file: PathBuf,
        /// The report [default: beside the log, under its name].
        #[arg(short, long)]
        out: Option<PathBuf>,
        /// Prints the numbers as JSON.
        #[arg(long)]
        json: bool,
    },
}

/// Findings that end `log audit` with exit code 10.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FailOnFinding {
    /// Faults of the data.
    Fault,
    /// These, and flaws of the measurement.
    Measurement,
}

/// Flags of `train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// Flight logs: .mcap, .tlog, .ulg, .bin, or .csv with --mapping.
    #[arg(required = true)]
    pub logs: Vec<PathBuf>,
    /// Vehicle file.
    #[arg(long)]
    pub vehicle: PathBuf,
    /// The model file to write.
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,
    /// Folder for report.html and report.json; made if missing.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// What the columns of CSV logs mean.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// What the networks are given.
    #[arg(long, value_enum, default_value_t = FeatureChoice::Heading)]
    pub features: FeatureChoice,
    /// How weights follow the gradient.
    #[arg(long, value_enum, default_value_t = MethodChoice::Adam)]
    pub method: MethodChoice,
    /// Hidden units of each network.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub hidden: u16,
    /// Passes through the training rows at most.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..))]
    pub passes: u32,
    /// Weights of the squared weights to try; the validation rows decide.
    #[arg(long, value_delimiter = ',', default_values_t = [1e-6, 1e-5, 1e-4])]
    pub regularization: Vec<f64>,
    /// Half widths of the window that makes labels, ms. A later one is tried only where the models
    /// of the earlier do not predict better than holding the state.
    #[arg(long, value_name = "MS", value_delimiter = ',', default_values_t = [22.0, 60.0])]
    pub window: Vec<f64>,
    /// Seed of the weights.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Threads [default: one for each core]. The model does not depend on it.
    #[arg(long)]
    pub threads: Option<usize>,
    /// Goes on from the checkpoint that an interrupted training left beside --out.
    #[arg(long)]
    pub resume: bool,
    /// Prints the summary as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Flags of `diagnose`.
#[derive(Debug, Args)]
pub struct DiagnoseArgs {
    /// Flight logs of the real vehicle.
    #[arg(required = true)]
    pub logs: Vec<PathBuf>,
    /// The simulator's vehicle file.
    #[arg(long)]
    pub vehicle: PathBuf,
    /// A log to keep from the fit and to report the gap on; may be given again [default: the last
    /// of the logs; of a single one its second half].
    #[arg(long, value_name = "FILE")]
    pub holdout: Vec<PathBuf>,
    /// The vehicle file to write, with the effects that were found.
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Folder for report.html and report.json; made if missing.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// What the columns of CSV logs mean.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// Simulated flights without any effect, which say how large chance makes the evidence.
    #[arg(long, default_value_t = 40)]
    pub twins: u32,
    /// Seed of the simulated flights.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// An effect that is not to be considered, nor another that acts in the same way; may be given
    /// again. What the flights hold of it is then a cause outside of the catalogue.
    #[arg(long, value_name = "EFFECT")]
    pub without: Vec<EffectId>,
    /// Ends with exit code 10 on this verdict.
    #[arg(long, value_enum, value_name = "VERDICT")]
    pub fail_on: Option<FailOnVerdict>,
    /// Prints the answer as JSON.
    #[arg(long)]
    pub json: bool,
}

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
    /// Seed of everything that is drawn [default: from the system, and said].
    #[arg(long)]
    pub seed: Option<u64>,
    /// Length of each of a case's flights, s.
    #[arg(long, default_value_t = 22.5)]
    pub seconds: f64,
    /// How strongly single effects show, least and most: prediction errors that they cause over
    /// those of noise.
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
    /// Ends with exit code 10 if a rate misses what is asked of it.
    #[arg(long)]
    pub fail_on_miss: bool,
    /// Prints the result as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Verdicts that a command may fail on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FailOnVerdict {
    /// An effect was named.
    Effect,
    /// There is a gap, explained or not.
    Gap,
}

/// What the networks are given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FeatureChoice {
    /// As in the paper: all in world axes.
    World,
    /// Seen from the vehicle's heading, so that what holds at one heading holds at every other.
    Heading,
}

/// How weights follow the gradient.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MethodChoice {
    /// Adam over shuffled batches: reaches lower errors in fewer passes.
    Adam,
    /// Resilient backpropagation over all rows at once, as in the paper.
    Rprop,
}

/// Commands on model files.
#[derive(Debug, Subcommand)]
pub enum ModelCommand {
    /// What is in a model file, and how it was trained.
    Info {
        /// Model file.
        #[arg(required_unless_present = "model")]
        file: Option<PathBuf>,
        /// Model file.
        #[arg(long, conflicts_with = "file")]
        model: Option<PathBuf>,
        /// Prints one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Judges a model on flight logs: accelerations and open-loop predictions.
    Eval {
        /// Flight logs: .mcap, .tlog, .ulg, .bin, or .csv with --mapping.
        #[arg(required = true)]
        logs: Vec<PathBuf>,
        /// Model file.
        #[arg(long)]
        model: PathBuf,
        /// Vehicle file of the logs, to check that the model is for it.
        #[arg(long)]
        vehicle: Option<PathBuf>,
        /// What the columns of CSV logs mean.
        #[arg(long, value_name = "FILE")]
        mapping: Option<PathBuf>,
        /// Prints one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Writes open-loop predictions from every sample of a log as CSV.
    ///
    /// Columns run,start,h,x,y,z,vx,vy,vz,qw,qx,qy,qz,wx,wy,wz; world NED, body FRD, SI. A sample
    /// is a row of a CSV log, or of the 100 Hz grid of any other.
    Predict {
        /// Flight log: .mcap, .tlog, .ulg, .bin, or .csv with --mapping.
        log: PathBuf,
        /// Model file.
        #[arg(long)]
        model: PathBuf,
        /// How far to predict, s.
        #[arg(long, default_value_t = 0.5)]
        horizon: f64,
        /// Which of the file's models [default: the one that did best in its validation].
        #[arg(long, value_enum)]
        kind: Option<ModelKind>,
        /// Vehicle file of the log, to check that the model is for it.
        #[arg(long)]
        vehicle: Option<PathBuf>,
        /// What the columns of a CSV log mean.
        #[arg(long, value_name = "FILE")]
        mapping: Option<PathBuf>,
        /// The CSV to write [default: stdout].
        #[arg(short, long)]
        out: Option<PathBuf>,
    },
    /// Writes the networks for other programs.
    Export {
        /// Model file.
        #[arg(required_unless_present = "model")]
        file: Option<PathBuf>,
        /// Model file.
        #[arg(long, conflicts_with = "file")]
        model: Option<PathBuf>,
        /// The ONNX file to write.
        #[arg(long, value_name = "FILE")]
        onnx: PathBuf,
        /// `net`, or `hybrid` for the networks on what the physics leaves over.
        #[arg(long, value_enum, default_value_t = ModelKind::Net)]
        kind: ModelKind,
    },
}

/// Forms of exported rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// Comma-separated values with a header.
    Csv,
    /// One JSON object a line; NaN is null.
    Jsonl,
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
