//! The session's events: vehicles that appear or change, requests that end, clocks that jump.

use super::{End, Station};
use crate::clock::HostTime;
use crate::link::counters::LinkState;
use crate::link::session::{Event, VehicleId};
use crate::link::several::choice_between;
use crate::log::record::Severity;
use crate::offboard::LinkEvent;
use crate::supervisor::{EngagePolicy, FlightState};

/// Steps of the vehicle's clock from this size on are a warning, ns.
const CLOCK_STEP_WARNED_NS: u64 = 100_000_000;

impl Station {
    pub(super) fn session_event(&mut self, now: HostTime, event: Event) {
        match event {
            Event::State { from, to } => {
                let severity = match to {
                    LinkState::Connected | LinkState::Searching => Severity::Info,
                    LinkState::Stale | LinkState::Lost => Severity::Warning,
                };
                self.report(now, severity, format!("link {from:?} -> {to:?}"));
                if to == LinkState::Lost
                    && let Some(offboard) = &mut self.offboard
                {
                    offboard.link_event(now, LinkEvent::Lost);
                }
            }
            Event::VehicleFound(id) => {
                self.found = Some(now);
                self.report(now, Severity::Info, format!("heard {id}"));
                (self.is_signing_reported, self.is_answered) = (false, false);
            }
            Event::AnotherAutopilot { vehicle, other } => self.choose(now, vehicle, other),
            Event::VehicleReplaced(id) => {
                self.found = Some(now);
                (self.is_signing_reported, self.is_answered) = (false, false);
                self.report(
                    now,
                    Severity::Warning,
                    format!("another vehicle is on the link: {id}"),
                );
                self.end_flight_of_another(now);
            }
            Event::Identified { profile, is_version_known } => {
                self.identified(now, *profile, is_version_known);
            }
            Event::Request { request, outcome, .. } => self.request_ended(now, &request, &outcome),
            Event::Interval(event) => self.report(now, Severity::Debug, format!("{event}")),
            Event::LineBudget(budget) => {
                let severity = if budget.fits() { Severity::Notice } else { Severity::Warning };
                self.report(now, severity, budget.to_string());
            }
            Event::RoundTrip(time) => {
                // The first answer shows that the vehicle accepts unsigned frames.
                if !std::mem::replace(&mut self.is_answered, true) {
                    self.check_standing(now);
                }
                if let Some(offboard) = &mut self.offboard {
                    offboard.link_event(now, LinkEvent::RoundTrip(time));
                }
            }
            Event::RequestAgain(after) => {
                if let Some(offboard) = &mut self.offboard {
                    offboard.link_event(now, LinkEvent::RequestAgain(after));
                }
            }
            Event::FrameRejected(why) => self.report(now, Severity::Warning, why.to_string()),
            Event::ClockJump { by_ns } => {
                let text = format!("the vehicle's clock jumped by {:.3} s", by_ns as f64 * 1e-9);
                // A simulator whose speed varies makes smaller steps.
                let is_small = by_ns.unsigned_abs() < CLOCK_STEP_WARNED_NS;
                let severity = if is_small { Severity::Debug } else { Severity::Warning };
                self.report(now, severity, text);
            }
        }
    }

    /// Warns that the vehicle signs and this link does not. Such a vehicle may reject unsigned
    /// frames, though some accept them.
    pub(super) fn report_signing(&mut self, now: HostTime) {
        if self.session.is_signed() && !self.session.signs() && !self.is_signing_reported {
            self.is_signing_reported = true;
            let text = "the vehicle signs its messages (MAVLink 2 signing), and downwash has no \
                        key: if it rejects unsigned messages, no rate, parameter, mode or setpoint \
                        reaches it; give its key in link.signing.key_file, or turn signing off on \
                        this link";
            self.report(now, Severity::Notice, text.to_owned());
            self.check_standing(now);
        }
    }

    /// Two autopilots answer: before a flight, nothing flies until the user chooses one; in flight,
    /// warns.
    pub(super) fn choose(&mut self, now: HostTime, vehicle: VehicleId, other: VehicleId) {
        let why = choice_between(vehicle, other);
        let is_flown = self.offboard.as_ref().is_some_and(|offboard| {
            let state = offboard.flight_state();
            state.is_in_control() || matches!(state, FlightState::Land | FlightState::Disarm)
        });
        if is_flown {
            return self.report(now, Severity::Warning, format!("{why}; the flight continues"));
        }
        self.report(now, Severity::Error, why.clone());
        self.check_standing(now);
        if self.settings.policy == EngagePolicy::Command {
            self.end.get_or_insert(End::Refused(why));
        }
    }
}
