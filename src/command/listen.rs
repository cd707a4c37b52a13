//! Listens on a link for a while, for the commands that fly nothing.

use std::future::Future;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use tokio::runtime::{Builder, Runtime};
use tokio::time::sleep;
use wire::Endpoint;
use wire::transport::RECEIVE_LEN;

use super::fly::system_flag;
use super::setup::{baud, endpoint, required};
use super::signing_state::SigningState;
use super::{Exit, ExitContext, config, print_status};
use crate::cli::ListenArgs;
use crate::clock::HostTime;
use crate::config::Config;
use crate::daemon::HostClock;
use crate::link::attitude_target::ThrustMap;
use crate::link::connection::{Connection, Input};
use crate::link::profile::MessageRate;
use crate::link::session::{Delivery, Session, Settings};
use crate::link::several;
use crate::link::signing::SigningSettings;
use crate::link::silence::Silence;

/// Without a chosen vehicle, another autopilot is listened for at least so long: each sends a
/// HEARTBEAT a second.
pub(super) const OTHERS_WAIT: Duration = Duration::from_millis(1500);

/// A session that flies nothing, and its connection.
pub(super) struct Listener {
    pub session: Session,
    pub endpoint: Endpoint,
    pub clock: HostClock,
    pub config: Config,
    /// Why the endpoint is not open, after an attempt.
    pub failure: Option<String>,
    connection: Connection,
    runtime: Runtime,
    buffer: Vec<u8>,
    /// Stores the stamps of signed frames.
    _signing: Option<SigningState>,
}

impl Listener {
    /// Opens the link of the flags or of the configuration. With `is_requesting`, requests messages
    /// and rates as a flight does; otherwise requests none.
    pub fn open(args: &ListenArgs, is_requesting: bool) -> anyhow::Result<Self> {
        let state = SigningState::open(&Self::config(args)?.settings.link.signing)?;
        let listener =
            Self::signed(args, is_requesting, state.as_ref().map(SigningState::settings))?;
        Ok(Self { _signing: state, ..listener })
    }

    /// Opens the link to request nothing, with other ids than the program that flies. TIMESYNC
    /// requests are answered in the vehicle's own time.
    pub fn beside(args: &ListenArgs, system: u8, component: u8) -> anyhow::Result<Self> {
        let state = SigningState::open(&Self::config(args)?.settings.link.signing)?;
        let signing = state.as_ref().map(SigningState::settings);
        let change = |settings: &mut Settings| {
            (settings.system, settings.component) = (system, component);
            settings.answers_in_vehicle_time = true;
        };
        let listener = Self::changed(args, false, signing, change)?;
        Ok(Self { _signing: state, ..listener })
    }

    /// The configuration, with the flags applied.
    pub fn config(args: &ListenArgs) -> anyhow::Result<Config> {
        let mut flags = Vec::new();
        if let Some(url) = &args.connect {
            flags.push(("--connect", "connect", toml::Value::String(url.clone())));
        }
        flags.extend(system_flag(args.system));
        config::load(args.config.as_deref(), flags)
    }

    /// As [`open`](Self::open), with this key or none.
    pub fn signed(
        args: &ListenArgs,
        is_requesting: bool,
        signing: Option<SigningSettings>,
    ) -> anyhow::Result<Self> {
        Self::changed(args, is_requesting, signing, |_| {})
    }

    fn changed(
        args: &ListenArgs,
        is_requesting: bool,
        signing: Option<SigningSettings>,
        change: impl FnOnce(&mut Settings),
    ) -> anyhow::Result<Self> {
        let config = Self::config(args)?;
        let settings = &config.settings;
        let endpoint = endpoint(&required(&settings.connect, "--connect", "connect")?)?;
        // No setpoint is sent, so the thrust map does not matter.
        let thrust = ThrustMap::linear(1.0)?;
        let link = &settings.link;
        let mut session = Settings {
            system: link.system,
            component: link.component,
            vehicle_system: link.vehicle_system,
            answer_timesync: link.answer_timesync,
            telemetry: (!is_requesting).then(Vec::<MessageRate>::new),
            baud: baud(&endpoint),
            endpoint: Some(endpoint.to_string()),
            signing,
            ..Settings::new(thrust)
        };
        change(&mut session);
        let clock = HostClock::start();
        let runtime = Builder::new_current_thread().enable_all().build();
        Ok(Self {
            session: Session::new(session, clock.now()),
            connection: Connection::new(endpoint.clone()),
            endpoint,
            clock,
            config,
            runtime: runtime.context("cannot start the link's runtime")?,
            buffer: vec![0; RECEIVE_LEN],
            failure: None,
            _signing: None,
        })
    }

    /// Listens for a while; every frame and message goes to `on`.
    pub fn listen(&mut self, duration: Duration, mut on: impl FnMut(HostTime, Delivery<'_>)) {
        let end = Instant::now() + duration;
        loop {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            self.look(left, std::future::pending::<()>(), &mut on);
        }
    }

    /// Waits once, for at most `limit`, for the vehicle or for `other`; returns the output of
    /// `other`.
    pub fn look<T>(
        &mut self,
        limit: Duration,
        other: impl Future<Output = T>,
        on: impl FnMut(HostTime, Delivery<'_>),
    ) -> Option<T> {
        let output = self.wait(limit, other, on);
        while self.session.next_event().is_some() {}
        output
    }

    /// As [`look`](Self::look), and leaves the session's events to the caller.
    pub fn wait<T>(
        &mut self,
        limit: Duration,
        other: impl Future<Output = T>,
        mut on: impl FnMut(HostTime, Delivery<'_>),
    ) -> Option<T> {
        let Self { session, connection, runtime, buffer, clock, failure, .. } = self;
        let wait = session.next_deadline().since(clock.now()).min(limit);
        let (input, output) = runtime.block_on(async {
            tokio::select! {
                input = connection.recv(buffer) => (Some(input), None),
                output = other => (None, Some(output)),
                () = sleep(wait) => (None, None),
            }
        });
        let now = clock.now();
        match input {
            Some(Input::Bytes { peer, len }) => {
                let bytes = buffer.get(..len).unwrap_or_default();
                let is_datagram = connection.is_datagram();
                session.receive(now, peer, bytes, is_datagram, &mut |delivery| on(now, delivery));
            }
            Some(Input::PeerClosed(peer)) => {
                session.peer_closed(peer);
            }
            Some(Input::Lost(_)) => session.transport_closed(),
            Some(Input::Failed { error, .. }) => {
                let text = error.to_string();
                if failure.as_ref() != Some(&text) {
                    print_status(format_args!("{text}; trying again until it opens"));
                    *failure = Some(text);
                }
            }
            Some(Input::Opened) => *failure = None,
            Some(Input::PeerOpened(_)) | None => {}
        }
        session.poll(now);
        self.flush();
        output
    }

    /// Why no vehicle is found: the endpoint is not open, or what arrives on it.
    pub fn silence(&self, now: HostTime) -> String {
        match &self.failure {
            Some(failure) => failure.clone(),
            None => Silence::of(&self.session, now).line,
        }
    }

    /// Checks that the vehicle is the only autopilot on the link, or the one that the user chose.
    ///
    /// # Errors
    /// [`Exit::Refused`], with both autopilots.
    pub fn check_alone(&self) -> anyhow::Result<()> {
        match several::choice(&self.session) {
            None => Ok(()),
            Some(choice) => Err(anyhow!("{}: {choice}", self.endpoint)).or_exit(Exit::Refused),
        }
    }

    /// Sends the session's queued frames.
    pub fn flush(&mut self) {
        let Self { session, connection, .. } = self;
        session.transmit(|to, frame| connection.send(to, frame));
    }

    /// Runs work that needs the link's runtime, such as opening a socket.
    pub fn inside<T>(&self, work: impl FnOnce() -> T) -> T {
        let _inside = self.runtime.enter();
        work()
    }
}
