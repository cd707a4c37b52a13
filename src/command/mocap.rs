//! `downwash mocap`: poses of a rigid body from a motion-capture room to a vehicle.

mod room;
mod summary;

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use anyhow::{Context, anyhow, bail, ensure};
use tokio::net::UdpSocket;
use toml::Value;
use wire::transport::RECEIVE_LEN;

use self::room::Room;
pub(super) use self::summary::MocapSummary;
use super::fly::system_flag;
use super::listen::Listener;
use super::stop::{Stop, StopSignals};
use super::{Exit, ExitContext, Interruption, config, print_json, print_status};
use crate::cli::{ListenArgs, MocapArgs, UpChoice};
use crate::clock::HostTime;
use crate::config::Config;
use crate::link::external_pose::{ExternalPose, PoseForm};
use crate::link::profile::ARDUPILOT;
use crate::link::session::{Delivery, Session};
use crate::memory;
use crate::mocap::bridge::{Bridge, Pose};
use crate::mocap::natnet::{self, Packet, Version};
use crate::mocap::settings::MocapSettings;
use crate::mocap::stream;
use message::Inbound;

/// Longest wait for the next input.
const LOOK: Duration = Duration::from_millis(20);
/// Time until the first message on what the command waits for, and between further ones.
const FIRST_REPORT_AFTER: Duration = Duration::from_secs(2);
const NEXT_REPORT_AFTER: Duration = Duration::from_secs(10);
/// Period of requests and keep-alive messages to a NatNet server.
const KEEP_ALIVE: Duration = Duration::from_secs(1);
/// Time after which a report that the motors are off no longer counts.
const ARMED_KNOWN: Duration = Duration::from_secs(3);

pub(super) fn run(args: &MocapArgs, preparation: Interruption) -> anyhow::Result<Exit> {
    let room: Room = args.room.parse::<Room>().or_exit(Exit::Usage)?;
    let config = config::load(args.config.as_deref(), flags(args))?;
    check(args, &room, &config).or_exit(Exit::Usage)?;
    let listen = ListenArgs {
        connect: args.connect.clone(),
        system: args.system,
        seconds: None,
        config: args.config.clone(),
        json: args.json,
    };
    let MocapSettings { system, component, .. } = config.settings.mocap;
    let listener = Listener::beside(&listen, system, component)?;
    let mut signals = StopSignals::after(Some(preparation))?;
    memory::lock();
    let mut line = Line::open(room, args, config.settings.mocap, listener)?;
    let end = args.seconds.map(Duration::from_secs_f64);
    let mut failed = None;
    let stopped = loop {
        if let Some(stop) = signals.wait(Duration::ZERO) {
            break Some(stop);
        }
        if end.is_some_and(|end| line.now().since(line.started) >= end) {
            break None;
        }
        if let Err(error) = line.turn() {
            failed = Some(error);
            break None;
        }
    };
    let summary = line.summary();
    if args.json {
        print_json(&summary)?;
    } else {
        print_status(format_args!("{summary}"));
    }
    match (failed, stopped) {
        (Some(error), _) => Err(error),
        (None, Some(Stop::Interrupt)) => Ok(Exit::Interrupted),
        (None, Some(Stop::Terminate)) => Ok(Exit::Ok),
        (None, None) if !summary.was_vehicle_found() => {
            Err(anyhow!("no vehicle was found")).or_exit(Exit::Link)
        }
        (None, None) if summary.sent() == 0 => bail!(
            "no pose was sent to the vehicle; check --body and that the room's system streams"
        ),
        (None, None) => Ok(Exit::Ok),
    }
}

/// Flags as a layer of the configuration.
fn flags(args: &MocapArgs) -> Vec<(&'static str, &'static str, Value)> {
    let mut flags = Vec::new();
    if let Some(url) = &args.connect {
        flags.push(("--connect", "connect", Value::String(url.clone())));
    }
    flags.extend(system_flag(args.system));
    let text = |text: &str| Value::String(text.to_owned());
    flags.extend(args.form.map(|form| {
        let form = match form {
            PoseForm::Vision => text("vision"),
            PoseForm::Odometry => text("odometry"),
        };
        ("--as", "mocap.as", form)
    }));
    flags.extend(args.rate.map(|hz| ("--rate", "mocap.rate_hz", Value::Float(hz))));
    flags.extend(args.up.map(|up| {
        let up = if up == UpChoice::Z { text("z") } else { text("y") };
        ("--up", "mocap.up", up)
    }));
    let degrees = Value::Float;
    flags.extend(args.x_heading.map(|at| ("--x-heading", "mocap.x_heading_deg", degrees(at))));
    flags.extend(args.nose.map(|at| ("--nose", "mocap.nose_deg", degrees(at))));
    flags
}

fn check(args: &MocapArgs, room: &Room, config: &Config) -> anyhow::Result<()> {
    let MocapSettings { rate_hz, position_deviation_m, system, .. } = config.settings.mocap;
    ensure!((1.0..=500.0).contains(&rate_hz), "mocap.rate_hz: expected 1 to 500, found {rate_hz}");
    ensure!(
        position_deviation_m > 0.0,
        "mocap.position_deviation_m: expected more than 0, found {position_deviation_m}"
    );
    ensure!(
        system > 0 && system != config.settings.link.system,
        "mocap.system: expected neither 0 nor link.system ({}), which flies",
        config.settings.link.system
    );
    let is_number = args.body.parse().is_ok_and(|id: i32| id.to_string() == args.body);
    ensure!(
        is_number || matches!(room, Room::Stream(_)),
        "--body {}: expected the streaming id of the rigid body, a number: NatNet sends no names",
        args.body
    );
    Ok(())
}

/// A time without poses for the vehicle.
struct Wait {
    since: HostTime,
    /// When the newest message on it was printed.
    reported: Option<HostTime>,
}

/// The bridge between its two sockets.
struct Line {
    room: Room,
    form: PoseForm,
    settings: MocapSettings,
    listener: Listener,
    socket: UdpSocket,
    server: Option<SocketAddr>,
    natnet: natnet::Decoder,
    bridge: Bridge,
    buffer: Vec<u8>,
    started: HostTime,
    requested_at: Option<HostTime>,
    /// Whether the motors run, and when the last HEARTBEAT reported it.
    armed: Option<(HostTime, bool)>,
    waiting: Option<Wait>,
    sent: u64,
    /// Number of poses without a vehicle, or without its clock.
    unsent: u64,
    is_vehicle_known: bool,
    is_another_reported: bool,
}

impl Line {
    fn open(
        room: Room,
        args: &MocapArgs,
        settings: MocapSettings,
        listener: Listener,
    ) -> anyhow::Result<Self> {
        let open = || -> io::Result<_> { Ok((room.open()?, room.server()?)) };
        let (socket, server) = listener
            .inside(open)
            .with_context(|| format!("--room {room}: cannot open it"))
            .or_exit(Exit::Usage)?;
        let local = socket.local_addr().context("the room's socket")?;
        match &room {
            Room::Stream(_) => {
                print_status(format_args!("listening to the room on stream:{local}"))
            }
            _ => print_status(format_args!(
                "listening to the room on {room} (port {})",
                local.port()
            )),
        }
        let [major, minor] = settings.natnet_version;
        let started = listener.clock.now();
        Ok(Self {
            form: settings.form,
            natnet: natnet::Decoder::new(Version { major, minor }),
            bridge: Bridge::new(args.body.clone(), settings.clone(), started),
            settings,
            room,
            listener,
            socket,
            server,
            buffer: vec![0; RECEIVE_LEN],
            started,
            requested_at: None,
            armed: None,
            waiting: None,
            sent: 0,
            unsent: 0,
            is_vehicle_known: false,
            is_another_reported: false,
        })
    }

    fn now(&self) -> HostTime {
        self.listener.clock.now()
    }

    /// Waits for the next input from either side, and handles it.
    fn turn(&mut self) -> anyhow::Result<()> {
        self.request_stream();
        let Self { listener, socket, buffer, armed, .. } = self;
        let received = listener.look(LOOK, receive(socket, buffer), |now, delivery| {
            if let Delivery::Message(message) = delivery
                && let Inbound::Heartbeat { armed: is_armed, .. } = message.message
            {
                *armed = Some((now, is_armed));
            }
        });
        let now = self.now();
        if let Some(length) = received {
            self.take(now, length);
        }
        self.bridge.tick(now);
        while let Some(news) = self.bridge.next_news() {
            print_status(format_args!("{news}"));
        }
        self.look_at_vehicle()?;
        self.print_wait(now);
        Ok(())
    }

    fn take(&mut self, now: HostTime, length: usize) {
        let datagram = self.buffer.get(..length).unwrap_or_default();
        // A vehicle in an unknown state counts as armed, which makes the bridge stricter.
        let is_armed =
            self.armed.is_none_or(|(at, is_armed)| is_armed || now.since(at) > ARMED_KNOWN);
        let mut poses = Vec::new();
        match &self.room {
            Room::Stream(_) => stream::decode(datagram, |line| match line {
                Ok(sample) => poses.extend(self.bridge.take(now, &sample, is_armed)),
                Err(error) => self.bridge.malformed(now, error.to_string()),
            }),
            Room::NatNet(_) | Room::NatNetMulticast(_) => match self.natnet.datagram(datagram) {
                Ok(Packet::Frame(samples)) => {
                    for sample in &samples {
                        poses.extend(self.bridge.take(now, sample, is_armed));
                    }
                }
                Ok(Packet::Server { version: Version { major, minor } }) => {
                    tracing::debug!("the room speaks NatNet {major}.{minor}");
                }
                Ok(Packet::Other) => {}
                Err(error) => self.bridge.malformed(now, error.to_string()),
            },
        }
        for pose in poses {
            self.send(&pose);
        }
    }

    fn send(&mut self, pose: &Pose) {
        let session = &mut self.listener.session;
        let Some(clock) = session.clock() else {
            self.unsent += 1;
            return;
        };
        let pose = ExternalPose {
            time: clock.to_vehicle(pose.at),
            position: pose.position,
            attitude: pose.attitude,
            position_deviation_m: self.settings.position_deviation_m,
            attitude_deviation_rad: self.settings.attitude_deviation_rad,
            reset_count: pose.reset_count,
        };
        if session.send_pose(&pose, self.form) {
            self.sent += 1;
            self.listener.flush();
        } else {
            self.unsent += 1;
        }
    }

    /// Reports the vehicle, and refuses a form of poses that it does not accept, and another vehicle
    /// beside it. An armed vehicle keeps its poses.
    fn look_at_vehicle(&mut self) -> anyhow::Result<()> {
        let Some(vehicle) = self.listener.session.vehicle() else { return Ok(()) };
        if let Err(refused) = self.listener.check_alone() {
            if self.armed.is_none_or(|(_, is_armed)| !is_armed) {
                return Err(refused);
            }
            if !self.is_another_reported {
                self.is_another_reported = true;
                print_status(format_args!("{refused}; the vehicle is armed and keeps its poses"));
            }
        }
        if self.is_vehicle_known {
            return Ok(());
        }
        self.is_vehicle_known = true;
        print_status(format_args!("heard {vehicle} on {}", self.listener.endpoint));
        if self.form == PoseForm::Odometry && vehicle.autopilot == ARDUPILOT {
            let error = anyhow!(
                "--as odometry: ArduPilot fuses the velocity in ODOMETRY, which a room does not measure; use \
                 --as vision"
            );
            return Err(error).or_exit(Exit::Refused);
        }
        Ok(())
    }

    fn request_stream(&mut self) {
        let now = self.now();
        let Some(server) = self.server else { return };
        if self.requested_at.is_none_or(|at| now.since(at) >= KEEP_ALIVE) {
            // A server that does not answer gets another request.
            let _ = self.socket.try_send_to(&natnet::connect(), server);
            let _ = self.socket.try_send_to(&natnet::keep_alive(), server);
            self.requested_at = Some(now);
        }
    }

    /// The present reason why the vehicle gets no poses.
    fn waits_for(&self, now: HostTime) -> Option<String> {
        let session = &self.listener.session;
        let is_live = session.last_received().is_some_and(|at| now.since(at) < FIRST_REPORT_AFTER);
        if session.vehicle().is_none() || !is_live {
            return Some(format!("waiting for the vehicle: {}", self.listener.silence(now)));
        }
        if session.clock().is_none() {
            return Some(
                "waiting for the vehicle's clock: it answers no TIMESYNC and sends no timestamps"
                    .to_owned(),
            );
        }
        self.bridge.waits_for(now)
    }

    fn print_wait(&mut self, now: HostTime) {
        let Some(text) = self.waits_for(now) else {
            self.waiting = None;
            return;
        };
        let wait = self.waiting.get_or_insert(Wait { since: now, reported: None });
        let is_due = match wait.reported {
            None => now.since(wait.since) >= FIRST_REPORT_AFTER,
            Some(at) => now.since(at) >= NEXT_REPORT_AFTER,
        };
        if is_due {
            print_status(format_args!("{text}"));
            wait.reported = Some(now);
        }
    }

    fn summary(&self) -> MocapSummary {
        let session: &Session = &self.listener.session;
        MocapSummary::new(summary::Ended {
            room: self.room.to_string(),
            vehicle: session.vehicle().filter(|_| self.is_vehicle_known).map(|id| id.to_string()),
            form: self.form,
            seconds: self.now().since(self.started).as_secs_f64(),
            sent: self.sent,
            unsent: self.unsent,
            clock: session.clock(),
            tally: self.bridge.tally(),
        })
    }
}

/// The length of the next datagram, into `buffer`.
async fn receive(socket: &UdpSocket, buffer: &mut [u8]) -> usize {
    loop {
        // The error belongs to an earlier datagram that nobody received.
        if let Ok((length, _)) = socket.recv_from(buffer).await {
            return length;
        }
    }
}
