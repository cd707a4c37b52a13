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

/// Options of `sitl`.
#[derive(Clone, Debug, clap::Args)]
pub struct SitlArgs {
    /// Vehicle file (TOML or JSON)
    #[arg(long, value_name = "FILE")]
    pub vehicle: PathBuf,
    /// The autopilot to behave as, on the wire and in the air, in place of the one in --config
    #[arg(long, value_name = "NAME")]
    pub autopilot: Option<Autopilot>,
    /// Where to be reached; may be given several times, and each serves several peers:
    /// udpin:HOST:PORT, udpout:HOST:PORT, tcpin:HOST:PORT, tcp:HOST:PORT, serial:PATH:BAUD
    #[arg(long = "link", value_name = "URL", default_value = "udpin:127.0.0.1:14580")]
    pub links: Vec<Endpoint>,
    /// The simulation's own settings: sensors, battery, home, start (TOML)
    #[arg(long, visible_alias = "sitl-config", value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Vehicle seconds per second. `downwash fly` and `downwash daemon` run in real time and need
    /// 1; other factors are for clients that go by the vehicle's own clock
    #[arg(long, value_name = "X", default_value = "1")]
    pub speed: Speed,
    /// Signs with the key in this file (64 hexadecimal digits, mode 0600), and believes only what is
    /// signed with it [default: a key that SETUP_SIGNING sets]
    #[arg(long, value_name = "FILE")]
    pub signing_key: Option<PathBuf>,
    /// Seed of every random number
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Effects to switch on: a TOML table of parameters for each id
    #[arg(long, value_name = "FILE")]
    pub effects: Option<PathBuf>,
    /// One such effect, over those of the file, such as motor_lag:tau_s=0.03 or
    /// inertia:scale=[1.2,1.1,1.0]; may be given several times. With @41.2 behind it, it sets in at
    /// 41.2 s of the vehicle's clock
    #[arg(long, value_name = "ID:KEY=VALUE,...[@S]")]
    pub effect: Vec<String>,
    /// The room.
    #[command(flatten)]
    pub room: RoomArgs,
}

/// The motion-capture room around the vehicle: it tells of `quad`, the vehicle, and of `cart`, which stands on
/// the floor. In it the vehicle knows its position by VISION_POSITION_ESTIMATE or ODOMETRY alone.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct RoomArgs {
    /// Where the room sends its poses to, as lines of JSON (docs/mocap.md)
    #[arg(long, value_name = "HOST:PORT")]
    pub mocap: Option<String>,
    /// Where the room serves its poses as NatNet 4.1 to whoever asks (unicast)
    #[arg(long, value_name = "HOST:PORT")]
    pub mocap_natnet: Option<String>,
    /// Frames a second
    #[arg(long, value_name = "HZ", default_value_t = 100.0)]
    pub mocap_rate: f64,
    /// The room's axis that points up
    #[arg(long, value_name = "AXIS", default_value = "z")]
    pub mocap_up: RoomUp,
    /// Heading of the room's x axis, clockwise from north, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_hyphen_values = true)]
    pub mocap_x_heading: f64,
    /// What goes wrong in the room, in seconds after arming: swap, freeze or drop-out, such as freeze@8, or
    /// swap@8+2 for two seconds; may be given several times
    #[arg(long, value_name = "FAULT@S[+S]")]
    pub mocap_fault: Vec<RoomFault>,
}

impl RoomArgs {
    fn is_there(&self) -> bool {
        self.mocap.is_some() || self.mocap_natnet.is_some()
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

/// Vehicle seconds per second, 0.01 to 1000.
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

/// Why the vehicle does not run.
#[derive(Debug, thiserror::Error)]
pub enum SitlError {
    /// The vehicle file.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// The vehicle cannot be simulated.
    #[error(transparent)]
    Refused(#[from] VehicleRefused),
    /// The settings file.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The effects.
    #[error(transparent)]
    Effects(#[from] EffectsRefused),
    /// The signing key.
    #[error("--signing-key: {0}")]
    Key(#[from] KeyError),
    /// A link.
    #[error("--link: {0}")]
    Link(#[from] OpenError),
    /// The room cannot be.
    #[error("--mocap-rate: expected 1 to 1000 Hz, found {0}")]
    RoomRate(f64),
    /// A socket of the room.
    #[error("--mocap, --mocap-natnet: {0}; expected HOST:PORT")]
    RoomSocket(std::io::Error),
    /// The runtime or its signal handlers.
    #[error("cannot start: {0}")]
    Runtime(#[from] std::io::Error),
}

impl SitlError {
    /// 2 for what was asked for, 3 for a link, 1 for the rest.
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(match self {
            Self::Vehicle(_)
            | Self::Refused(_)
            | Self::Config(_)
            | Self::Effects(_)
            | Self::Key(_)
            | Self::RoomRate(_)
            | Self::RoomSocket(_) => 2,
            Self::Link(_) => 3,
            Self::Runtime(_) => 1,
        })
    }
}

/// What ended a run that began well.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// Ctrl-C.
    Interrupt,
    /// SIGTERM.
    Terminate,
}

impl Stop {
    /// 130 after Ctrl-C, else 0.
    pub fn exit_code(self) -> ExitCode {
        ExitCode::from(match self {
            Self::Interrupt => 130,
            Self::Terminate => 0,
        })
    }
}

/// The vehicle that the options describe.
///
/// # Errors
/// Any [`SitlError`] but [`SitlError::Link`].
pub fn vehicle(args: &SitlArgs) -> Result<Vehicle, SitlError> {
    let params = VehicleParams::load(&args.vehicle)?;
    let mut config = match &args.config {
        Some(path) => SitlConfig::load(path)?,
        None => SitlConfig::default(),
    };
    let rate_hz = args.room.mocap_rate;
    if !(1.0..=1000.0).contains(&rate_hz) {
        return Err(SitlError::RoomRate(rate_hz));
    }
    config.estimator.from_vision |= args.room.is_there();
    config.autopilot = args.autopilot.unwrap_or(config.autopilot);
    let schedule = Schedule::requested(args.effects.as_deref(), &args.effect)?;
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

/// Runs the vehicle until a signal stops it. Says on stderr, a line for each link, where it can be
/// reached.
///
/// # Errors
/// [`SitlError`]; it names the file or link and what to do.
pub fn run(args: &SitlArgs) -> Result<Stop, SitlError> {
    run_watched(args, |_| {})
}

/// The same; `watch` sees the vehicle whenever its time has gone on, and must not wait.
///
/// # Errors
/// As [`run`].
pub fn run_watched(args: &SitlArgs, watch: impl FnMut(&Vehicle)) -> Result<Stop, SitlError> {
    let vehicle = vehicle(args)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let room = args.room.open(args.seed)?;
        let told: Vec<_> = room.iter().flat_map(RoomSockets::describe).collect();
        let mut server = Server::open(vehicle, &args.links).await?.inside(room);
        let stop = signals()?;
        for line in server.describe().chain(told) {
            eprintln!("{line}");
        }
        Ok(server.run(args.speed.0, stop, watch).await)
    })
}

/// Ready when a signal asks to stop; listens from the call on.
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
        // Without a handler the run goes on until the process is ended.
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
    fn speeds_that_make_no_sense_are_refused() {
        assert_eq!("2.5".parse(), Ok(Speed(2.5)));
        for bad in ["0", "-1", "NaN", "inf", "fast", ""] {
            assert!(bad.parse::<Speed>().is_err(), "{bad}");
        }
    }
}
