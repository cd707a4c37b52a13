//! Flags of what makes and looks at vehicle files.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

/// Commands on vehicle files.
#[derive(Debug, Subcommand)]
pub enum VehicleCommand {
    /// Lists the vehicles and trajectories that ship with the program; every command takes their
    /// names.
    List {
        /// Prints one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Checks which numbers of a vehicle file do not fit each other, and states what is expected.
    ///
    /// With `--log`, also compares what the file predicts with what a flight shows: the hover, the
    /// range of the outputs, how quickly the on-board loop follows, its gains. Exits with code 10
    /// if anything does not fit.
    Check {
        /// Vehicle file, or the name of a shipped one.
        file: PathBuf,
        /// A flight of the vehicle to compare the file with: .mcap, .ulg, .bin, .tlog, or .csv with
        /// --mapping.
        #[arg(long)]
        log: Option<PathBuf>,
        /// Mapping of a table's columns: a TOML file, or the name of a shipped one (motion-capture,
        /// motive).
        #[arg(long, value_name = "MAP", requires = "log")]
        mapping: Option<PathBuf>,
        /// Prints one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Writes a commented vehicle file from an autopilot's parameters and from measured numbers.
    ///
    /// Parameters come from a vehicle on a link, a flight log, or a parameter file; the vehicle is
    /// not changed. Each number that no source gives is named, with the way to measure it and the
    /// flag that takes it.
    Init(Box<InitArgs>),
    /// Exports a vehicle, including its modelled effects, to another simulator.
    ///
    /// What that simulator's equations cannot express is named on stderr and in the file.
    Export {
        /// Vehicle file, or the name of a shipped one.
        file: PathBuf,
        /// The simulator.
        #[arg(long, value_enum, value_name = "NAME")]
        to: PeerChoice,
        /// The file to write [default: stdout].
        #[arg(short, long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// Overwrites an existing file.
        #[arg(long, requires = "out")]
        force: bool,
    },
}

/// Simulators that vehicles are exported to.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum PeerChoice {
    /// RotorPy: a Python module with `quad_params`.
    #[value(name = "rotorpy")]
    RotorPy,
    /// drone-models and crazyflow: the TOML table of a drone.
    DroneModels,
    /// PX4's simulator on board: a parameter file.
    Px4Sih,
    /// MuJoCo: an XML model with a thruster for each rotor.
    #[value(name = "mujoco")]
    MuJoCo,
    /// CasADi: a Python module that builds the equations of motion.
    #[value(name = "casadi")]
    CasAdi,
}

/// Flags of `vehicle init`.
#[derive(Debug, Args)]
pub struct InitArgs {
    /// Flight log (.ulg, .bin, .mcap, .tlog), or parameter file (QGroundControl .params, Mission
    /// Planner .param, PX4's `param save`).
    #[arg(conflicts_with = "connect", group = "source")]
    pub file: Option<PathBuf>,
    /// Reads the parameters of the vehicle at this address, such as udpin:0.0.0.0:14540.
    #[arg(long, value_name = "URL", group = "source")]
    pub connect: Option<String>,
    /// Configuration file of the link, such as its signing key.
    #[arg(long, requires = "connect", conflicts_with = "file")]
    pub config: Option<PathBuf>,
    /// System id of the vehicle, where several are on the link or in a QGroundControl file.
    #[arg(long, value_name = "ID", requires = "source")]
    pub system: Option<u8>,
    /// The vehicle file to write [default: stdout].
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Overwrites an existing file.
    #[arg(long, requires = "out")]
    pub force: bool,
    /// Name of the vehicle.
    #[arg(long)]
    pub name: Option<String>,
    /// Mass as it flies, battery included.
    #[arg(long, value_name = "KG")]
    pub mass: Option<f64>,
    /// Moments of inertia about front, right and down.
    #[arg(long, value_name = "KGM2,KGM2,KGM2", value_delimiter = ',')]
    pub inertia: Vec<f64>,
    /// From the centre to a motor's axis.
    #[arg(long, value_name = "M", conflicts_with = "wheelbase")]
    pub arm: Option<f64>,
    /// Between the axes of opposite motors.
    #[arg(long, value_name = "M")]
    pub wheelbase: Option<f64>,
    /// Layout, if no parameters state it [default: x].
    #[arg(long, value_enum)]
    pub layout: Option<LayoutChoice>,
    /// Full thrust of one rotor.
    #[arg(long, value_name = "N")]
    pub thrust: Option<f64>,
    /// Throttle at which it hovers, 0 to 1.
    #[arg(long, value_name = "SHARE", conflicts_with = "thrust")]
    pub hover_throttle: Option<f64>,
    /// Diameter of a propeller.
    #[arg(long, value_name = "INCH")]
    pub propeller: Option<f64>,
    /// Drag torque of a rotor over its thrust.
    #[arg(long, value_name = "M")]
    pub torque_ratio: Option<f64>,
    /// First-order lag of the rotors, 0 for none.
    #[arg(long, value_name = "S")]
    pub motor_lag: Option<f64>,
    /// Cells in series.
    #[arg(long, value_name = "COUNT")]
    pub cells: Option<u8>,
    /// Prints what is missing and estimated as JSON, with the file's text.
    #[arg(long)]
    pub json: bool,
}

/// Layouts of quadrotors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LayoutChoice {
    /// Two rotors in front.
    X,
    /// One rotor in front.
    Plus,
}
