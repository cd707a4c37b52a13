//! The command line of the simulated vehicle.

use std::fmt;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::time::{SystemTime, UNIX_EPOCH};

use wire::endpoint::Endpoint;
use wire::signing::{Key, KeyError, Stamp};
use wire::transport::OpenError;

use crate::autopilot::{Vehicle, VehicleRefused};
use crate::config::{Autopilot, ConfigError, SitlConfig};
use crate::room::{Room, RoomConfig, RoomFault, RoomUp};
use crate::room_sockets::RoomSockets;
use crate::server::Server;
use vehicle::effects::{EffectsRefused, Schedule};
use vehicle::{VehicleError, VehicleParams};

/// Options of the simulated vehicle.
#[derive(Clone, Debug, clap::Args)]
pub struct SitlArgs {
    /// Vehicle file (TOML or JSON), or the name of a shipped one
    #[arg(long, value_name = "FILE")]
    pub vehicle: PathBuf,
    /// Autopilot to simulate, on the wire and in flight; overrides the one in --config
    #[arg(long, value_name = "NAME")]
    pub autopilot: Option<Autopilot>,
    /// MAVLink endpoint; may be given several times, and each serves several peers:
    /// udpin:HOST:PORT, udpout:HOST:PORT, tcpin:HOST:PORT, tcp:HOST:PORT, serial:PATH:BAUD
    #[arg(long = "link", value_name = "URL", default_value = "udpin:127.0.0.1:14580")]
    pub links: Vec<Endpoint>,
    /// Settings of the simulation: sensors, battery, home, start (TOML)
    #[arg(long, visible_alias = "sitl-config", value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Vehicle seconds per second. `downwash fly` and `downwash daemon` run in real time and need
    /// 1; other factors are for clients that follow the vehicle's clock
    #[arg(long, value_name = "X", default_value = "1")]
    pub speed: Speed,
    /// Signs with the key in this file (64 hexadecimal digits, mode 0600), and accepts only frames
    /// signed with it [default: a key that SETUP_SIGNING sets]
    #[arg(long, value_name = "FILE")]
    pub signing_key: Option<PathBuf>,
    /// Seed of all random numbers
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Effects to apply: a TOML table of parameters for each id
    #[arg(long, value_name = "FILE")]
    pub effects: Option<PathBuf>,
    /// One effect, which overrides the file, such as motor_lag:tau_s=0.03 or
    /// inertia:scale=[1.2,1.1,1.0]; may be given several times. With the suffix @41.2 it sets in at
    /// 41.2 s on the vehicle's clock
    #[arg(long, value_name = "ID:KEY=VALUE,...[@S]")]
    pub effect: Vec<String>,
    /// The motion-capture room.
    #[command(flatten)]
    pub room: RoomArgs,
}

/// The motion-capture room around the vehicle. It reports `quad`, the vehicle, and `cart`, a body
/// on the floor. In it the vehicle gets its position from VISION_POSITION_ESTIMATE or ODOMETRY
/// only.
#[derive(Clone, Debug, Default, clap::Args)]
#[command(group = clap::ArgGroup::new("room").args(["mocap", "mocap_natnet"]).multiple(true))]
pub struct RoomArgs {
    /// Address to which the room sends poses as lines of JSON (docs/mocap.md)
    #[arg(long, value_name = "HOST:PORT")]
    pub mocap: Option<String>,
    /// Address at which the room serves poses as NatNet 4.1 on request (unicast)
    #[arg(long, value_name = "HOST:PORT")]
    pub mocap_natnet: Option<String>,
    /// Frames per second
    #[arg(long, value_name = "HZ", default_value_t = 100.0, requires = "room")]
    pub mocap_rate: f64,
    /// Axis of the room that points up
    #[arg(long, value_name = "AXIS", default_value = "z", requires = "room")]
    pub mocap_up: RoomUp,
    /// Heading of the room's x axis, clockwise from north, degrees
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = 0.0,
        allow_hyphen_values = true,
        requires = "room"
    )]
    pub mocap_x_heading: f64,
    /// Fault of the room, in seconds after arming: swap, freeze or drop-out, such as freeze@8, or
    /// swap@8+2 for two seconds; may be given several times
    #[arg(long, value_name = "FAULT@S[+S]", requires = "room")]
    pub mocap_fault: Vec<RoomFault>,
}

impl RoomArgs {
    fn is_there(&self) -> bool {
        self.mocap.is_some() || self.mocap_natnet.is_some()
    }

    fn check(&self) -> Result<(), SitlError> {
        if !(1.0..=1000.0).contains(&self.mocap_rate) {
            return Err(SitlError::RoomRate(self.mocap_rate));
        }
        if !self.mocap_x_heading.is_finite() {
            return Err(SitlError::RoomHeading(self.mocap_x_heading));
        }
        Ok(())
    }

    fn open(&self, seed: u64) -> Result<Option<RoomSockets>, SitlError> {
        if !self.is_there() {
            return Ok(None);
        }
        let config = RoomConfig {
            rate_hz: self.mocap_rate,
            up: self.mocap_up,
            x_heading_deg: self.mocap_x_heading,
            faults: self.mocap_fault.clone(),
        };
        let room = Room::new(config, seed);
        let (lines, natnet) = (self.mocap.as_deref(), self.mocap_natnet.as_deref());
        RoomSockets::open(room, lines, natnet).map(Some).map_err(SitlError::RoomSocket)
    }
}

/// Simulation speed in vehicle seconds per second, 0.01 to 1000.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speed(f64);

impl FromStr for Speed {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.parse()
            .ok()
            .filter(|speed| (0.01..=1000.0).contains(speed))
            .map(Self)
            .ok_or_else(|| "expected a number from 0.01 to 1000".to_owned())
    }
}

impl fmt::Display for Speed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Why the vehicle cannot run.
#[derive(Debug, thiserror::Error)]
pub enum SitlError {
    /// The vehicle file is refused.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// The vehicle and its settings cannot be simulated.
    #[error(transparent)]
    Refused(#[from] VehicleRefused),
    /// The settings file is refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The requested effects are refused.
    #[error(transparent)]
    Effects(#[from] EffectsRefused),
    /// The signing key cannot be read or is invalid.
    #[error("--signing-key: {0}")]
    Key(#[from] KeyError),
    /// A link does not open.
    #[error("--link: {0}")]
    Link(#[from] OpenError),
    /// The room's frame rate is outside 1 to 1000 Hz.
    #[error("--mocap-rate: expected 1 to 1000 Hz, found {0}")]
    RoomRate(f64),
    /// The heading of the room's x axis is not finite.
    #[error("--mocap-x-heading: expected a finite number of degrees, found {0}")]
    RoomHeading(f64),
    /// A socket of the room does not open.
    #[error("--mocap, --mocap-natnet: {0}; expected HOST:PORT")]
    RoomSocket(std::io::Error),
    /// The runtime or its signal handlers cannot start.
    #[error("cannot start: {0}")]
    Runtime(#[from] std::io::Error),
}

impl SitlError {
    /// Exit code 2 for invalid input, 3 for a link, 1 for the rest.
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(match self {
            Self::Vehicle(_)
            | Self::Refused(_)
            | Self::Config(_)
            | Self::Effects(_)
            | Self::Key(_)
            | Self::RoomRate(_)
            | Self::RoomHeading(_)
            | Self::RoomSocket(_) => 2,
            Self::Link(_) => 3,
            Self::Runtime(_) => 1,
        })
    }
}

/// The signal that ended a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// Ctrl-C.
    Interrupt,
    /// SIGTERM.
    Terminate,
}

impl Stop {
    /// Exit code 130 after Ctrl-C, 0 after SIGTERM.
    pub fn exit_code(self) -> ExitCode {
        ExitCode::from(match self {
            Self::Interrupt => 130,
            Self::Terminate => 0,
        })
    }
}

/// Creates the vehicle that the options describe. Prints a remark if wind has no effect on it.
///
/// # Errors
/// Any [`SitlError`] except those of links, sockets and the runtime.
pub fn vehicle(args: &SitlArgs) -> Result<Vehicle, SitlError> {
    let params = VehicleParams::load(&args.vehicle)?;
    let mut config = match &args.config {
        Some(path) => SitlConfig::load(path)?,
        None => SitlConfig::default(),
    };
    args.room.check()?;
    config.estimator.from_vision |= args.room.is_there();
    config.autopilot = args.autopilot.unwrap_or(config.autopilot);
    let schedule = Schedule::requested(args.effects.as_deref(), &args.effect)?;
    for line in Schedule::defaults_taken(&args.effect) {
        eprintln!("{line}");
    }
    let effects = schedule.effects.clone();
    let mut vehicle = Vehicle::scheduled(params, schedule, config, args.seed)?;
    if let Some(remark) = vehicle.plant().physics().unfelt(&effects) {
        eprintln!("{remark}");
    }
    if let Some(path) = &args.signing_key {
        let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        vehicle.sign(Key::load(path)?, Stamp::from_unix_ns(since_epoch.as_nanos() as u64));
    }
    Ok(vehicle)
}

/// Runs the vehicle until a signal stops it. Prints each link's address to stderr.
///
/// # Errors
/// [`SitlError`], which names the file or link.
pub fn run(args: &SitlArgs) -> Result<Stop, SitlError> {
    run_watched(args, |_| {})
}

/// As [`run`]; calls `watch` with the vehicle whenever its time has advanced. `watch` must not
/// block.
///
/// # Errors
/// As [`run`].
pub fn run_watched(args: &SitlArgs, watch: impl FnMut(&Vehicle)) -> Result<Stop, SitlError> {
    let vehicle = vehicle(args)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let room = args.room.open(args.seed)?;
        let room_lines: Vec<_> = room.iter().flat_map(RoomSockets::describe).collect();
        let mut server = Server::open(vehicle, &args.links).await?.inside(room);
        let stop = signals()?;
        for line in server.describe().chain(room_lines) {
            eprintln!("{line}");
        }
        Ok(server.run(args.speed.0, stop, watch).await)
    })
}

/// Installs handlers for SIGINT and SIGTERM; the future resolves at the first signal.
#[cfg(unix)]
fn signals() -> std::io::Result<impl Future<Output = Stop>> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => Stop::Interrupt,
            _ = terminate.recv() => Stop::Terminate,
        }
    })
}

#[cfg(not(unix))]
fn signals() -> std::io::Result<impl Future<Output = Stop>> {
    Ok(async {
        // Without a handler, the run continues until the process is killed.
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
        Stop::Interrupt
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_speeds_are_refused() {
        assert_eq!("2.5".parse(), Ok(Speed(2.5)));
        for bad in ["0", "-1", "NaN", "inf", "fast", ""] {
            assert!(bad.parse::<Speed>().is_err(), "{bad}");
        }
    }
}
