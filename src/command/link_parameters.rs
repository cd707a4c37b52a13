//! The parameters of a vehicle on a link, read by their names. Nothing is changed on it.

use std::time::Duration;

use anyhow::anyhow;
use wire::Endpoint;

use super::listen::OTHERS_WAIT;
use super::setup::baud;
use super::{Exit, ExitContext, print_status};
use crate::clock::HostTime;
use crate::daemon::HostClock;
use crate::link::attitude_target::ThrustMap;
use crate::link::connection::{Connection, Input};
use crate::link::profile::Profile;
use crate::link::request::{Outcome, Request};
use crate::link::session::{Event, Session, Settings};
use crate::link::several::choice_between;
use crate::link::silence::Silence;
use crate::parameters::{Autopilot, Parameters};

/// Number of requests in progress at once.
const AT_ONCE: usize = 16;
/// Wait for a vehicle.
const SEARCH: Duration = Duration::from_secs(20);
/// Time after which a message says what the command waits for.
const WAIT_REPORTED_AFTER: Duration = Duration::from_secs(3);
/// Time limit of the whole.
const LIMIT: Duration = Duration::from_secs(120);
/// Longest wait between two checks of the clock.
const TICK: Duration = Duration::from_millis(50);

/// Reads the parameters that describe the vehicle at `endpoint`.
///
/// # Errors
/// [`Exit::Link`] if no vehicle is heard or it answers nothing, [`Exit::Refused`] if several are heard
/// and none is chosen, [`Exit::Usage`] if it is neither PX4 nor ArduCopter.
pub(super) fn read(endpoint: Endpoint, system: Option<u8>) -> anyhow::Result<Parameters> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let thrust = ThrustMap::linear(1.0)?;
    let clock = HostClock::start();
    let settings = Settings {
        vehicle_system: system,
        endpoint: Some(endpoint.to_string()),
        // Requests no streams, so that the vehicle's stay unchanged.
        telemetry: Some(Vec::new()),
        baud: baud(&endpoint),
        ..Settings::new(thrust)
    };
    let reading = Reading {
        session: Session::new(settings, clock.now()),
        connection: Connection::new(endpoint),
        clock,
        is_chosen: system.is_some(),
        requested: Vec::new(),
        under_way: 0,
        found: Parameters::default(),
        is_reported: false,
        failure: None,
    };
    runtime.block_on(reading.run())
}

struct Reading {
    session: Session,
    connection: Connection,
    clock: HostClock,
    /// Whether the user chose a system.
    is_chosen: bool,
    /// Names still to request, in reverse order.
    requested: Vec<String>,
    under_way: usize,
    found: Parameters,
    is_reported: bool,
    /// Why the endpoint is not open, after an attempt.
    failure: Option<String>,
}

impl Reading {
    async fn run(mut self) -> anyhow::Result<Parameters> {
        let mut buffer = vec![0; 1 << 16];
        let start = self.clock.now();
        let mut is_identified = false;
        let mut found_at = start;
        loop {
            let input = tokio::time::timeout(TICK, self.connection.recv(&mut buffer)).await;
            let now = self.clock.now();
            if let Ok(input) = input {
                self.take(now, input, &buffer);
            }
            self.session.poll(now);
            while let Some(event) = self.session.next_event() {
                match event {
                    Event::VehicleFound(_) => found_at = now,
                    Event::AnotherAutopilot { vehicle, other } => {
                        let endpoint = self.connection.endpoint();
                        let error = anyhow!("{endpoint}: {}", choice_between(vehicle, other));
                        return Err(error).or_exit(Exit::Refused);
                    }
                    Event::Identified { profile, .. } if !is_identified => {
                        self.request_parameters(&profile)?;
                        is_identified = true;
                    }
                    Event::Request { request: Request::ReadParameter(name), outcome, .. } => {
                        self.under_way = self.under_way.saturating_sub(1);
                        if let Outcome::Parameter(value) = outcome {
                            self.found.set(name, value);
                        }
                    }
                    _ => {}
                }
            }
            while self.under_way < AT_ONCE
                && let Some(name) = self.requested.pop()
            {
                self.under_way += 1;
                self.session.request(now, Request::ReadParameter(name));
            }
            let Self { session, connection, .. } = &mut self;
            session.transmit(|peer, frame| connection.send(peer, frame));
            let has_listened = self.is_chosen || now.since(found_at) >= OTHERS_WAIT;
            let is_read = self.under_way == 0 && self.requested.is_empty();
            if is_identified && is_read && has_listened {
                return self.answer();
            }
            self.print_wait(now, start, is_identified)?;
        }
    }

    fn take(&mut self, now: HostTime, input: Input, buffer: &[u8]) {
        match input {
            Input::Bytes { peer, len } => {
                let is_datagram = self.connection.is_datagram();
                self.session.receive(now, peer, &buffer[..len], is_datagram, &mut |_| {});
            }
            Input::Failed { error, .. } => {
                let failure = error.to_string();
                if !self.is_reported {
                    print_status(format_args!("{failure}; trying again until it opens"));
                    self.is_reported = true;
                }
                self.failure = Some(failure);
            }
            Input::Lost(_) => self.session.transport_closed(),
            Input::PeerClosed(peer) => {
                self.session.peer_closed(peer);
            }
            Input::Opened => self.failure = None,
            Input::PeerOpened(_) => {}
        }
    }

    fn request_parameters(&mut self, profile: &Profile) -> anyhow::Result<()> {
        let vehicle = self.session.vehicle().map(|id| id.to_string()).unwrap_or_default();
        let autopilot = if profile.name == Profile::ARDUCOPTER.name {
            Autopilot::ArduCopter
        } else if profile.name == Profile::UNKNOWN.name {
            let error = anyhow!(
                "{vehicle}: only the parameters of PX4 and ArduCopter describe the vehicle"
            );
            return Err(error).or_exit(Exit::Usage);
        } else {
            Autopilot::Px4
        };
        self.requested = autopilot.parameter_names();
        self.requested.reverse();
        print_status(format_args!("{vehicle}: reading {} parameters", self.requested.len()));
        Ok(())
    }

    fn print_wait(
        &mut self,
        now: HostTime,
        start: HostTime,
        is_identified: bool,
    ) -> anyhow::Result<()> {
        let waited = now.since(start);
        let endpoint = self.connection.endpoint();
        if waited > LIMIT {
            let error = anyhow!(
                "{endpoint}: the vehicle sent only {} parameters within {LIMIT:?}; use a faster link, or \
                 give a parameter file or a flight log",
                self.found.len()
            );
            return Err(error).or_exit(Exit::Link);
        }
        if is_identified || self.session.vehicle().is_some() {
            return Ok(());
        }
        let bytes = self.session.stats().received.bytes;
        if waited > SEARCH {
            let why = self.failure.clone();
            let why = why.unwrap_or_else(|| Silence::of(&self.session, now).line);
            let error = anyhow!("no vehicle was found: {why}");
            return Err(error).or_exit(Exit::Link);
        }
        if waited > WAIT_REPORTED_AFTER && !self.is_reported && self.failure.is_none() {
            self.is_reported = true;
            print_status(format_args!(
                "waiting for the HEARTBEAT of an autopilot on {endpoint}; {bytes} bytes received \
                 so far"
            ));
        }
        Ok(())
    }

    fn answer(self) -> anyhow::Result<Parameters> {
        if self.found.is_empty() {
            let error = anyhow!(
                "{}: expected answers to PARAM_REQUEST_READ, found none; check that what is sent \
                 reaches the vehicle (a vehicle that demands signing hears no one without its key), or \
                 give a parameter file or a flight log",
                self.connection.endpoint()
            );
            return Err(error).or_exit(Exit::Link);
        }
        print_status(format_args!("received {} of them", self.found.len()));
        Ok(self.found)
    }
}
