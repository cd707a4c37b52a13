//! The parameters of a vehicle on a link, read by their names. Nothing is changed on it.

use std::future::pending;
use std::time::Duration;

use anyhow::anyhow;

use super::listen::{Listener, OTHERS_WAIT};
use super::{Exit, ExitContext, print_status};
use crate::cli::ListenArgs;
use crate::clock::HostTime;
use crate::link::profile::Profile;
use crate::link::request::{Outcome, Request};
use crate::link::session::Event;
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

/// Reads the parameters that describe the vehicle on the link of the flags.
///
/// # Errors
/// [`Exit::Link`] if no vehicle is heard or it answers nothing, [`Exit::Refused`] if several are heard
/// and none is chosen, [`Exit::Usage`] if it is neither PX4 nor ArduCopter, or if the configuration or
/// the signing key is invalid.
pub(super) fn read(args: &ListenArgs) -> anyhow::Result<Parameters> {
    let reading = Reading {
        // Requests no streams, so that the vehicle's stay unchanged.
        listener: Listener::open(args, false)?,
        requested: Vec::new(),
        under_way: 0,
        found: Parameters::default(),
        is_reported: false,
    };
    reading.run()
}

struct Reading {
    listener: Listener,
    /// Names still to request, in reverse order.
    requested: Vec<String>,
    under_way: usize,
    found: Parameters,
    /// Whether a message has said what the command waits for.
    is_reported: bool,
}

impl Reading {
    fn run(mut self) -> anyhow::Result<Parameters> {
        let start = self.listener.clock.now();
        let mut is_identified = false;
        let mut found_at = start;
        loop {
            self.listener.wait(TICK, pending::<()>(), |_, _| {});
            let now = self.listener.clock.now();
            while let Some(event) = self.listener.session.next_event() {
                match event {
                    Event::VehicleFound(_) => found_at = now,
                    Event::AnotherAutopilot { .. } => self.listener.check_alone()?,
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
                self.listener.session.request(now, Request::ReadParameter(name));
            }
            self.listener.flush();
            let is_chosen = self.listener.session.requested_system().is_some();
            let has_listened = is_chosen || now.since(found_at) >= OTHERS_WAIT;
            let is_read = self.under_way == 0 && self.requested.is_empty();
            if is_identified && is_read && has_listened {
                return self.answer();
            }
            self.print_wait(now, start, is_identified)?;
        }
    }

    fn request_parameters(&mut self, profile: &Profile) -> anyhow::Result<()> {
        let vehicle = self.listener.session.vehicle().map(|id| id.to_string()).unwrap_or_default();
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
        let listener = &self.listener;
        let endpoint = &listener.endpoint;
        if waited > LIMIT {
            let error = anyhow!(
                "{endpoint}: the vehicle sent only {} parameters within {LIMIT:?}; use a faster link, or \
                 give a parameter file or a flight log",
                self.found.len()
            );
            return Err(error).or_exit(Exit::Link);
        }
        if is_identified || listener.session.vehicle().is_some() {
            return Ok(());
        }
        let bytes = listener.session.stats().received.bytes;
        if waited > SEARCH {
            let error = anyhow!("no vehicle was found: {}", listener.silence(now));
            return Err(error).or_exit(Exit::Link);
        }
        if waited > WAIT_REPORTED_AFTER && !self.is_reported && listener.failure.is_none() {
            print_status(format_args!(
                "waiting for the HEARTBEAT of an autopilot on {endpoint}; {bytes} bytes received \
                 so far"
            ));
            self.is_reported = true;
        }
        Ok(())
    }

    fn answer(self) -> anyhow::Result<Parameters> {
        if self.found.is_empty() {
            let error = anyhow!(
                "{}: expected answers to PARAM_REQUEST_READ, found none; check that what is sent \
                 reaches the vehicle (a vehicle that demands signing hears no one without its key, see \
                 link.signing), or give a parameter file or a flight log",
                self.listener.endpoint
            );
            return Err(error).or_exit(Exit::Link);
        }
        print_status(format_args!("received {} of them", self.found.len()));
        Ok(self.found)
    }
}
