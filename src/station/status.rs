//! What the station shows of itself.

use vehicle::frame::Ned;

use super::Station;
use crate::link::counters::LinkState;
use crate::supervisor::FlightState;

/// A look at the station for the status line.
#[derive(Clone, Debug, Default)]
pub struct Status {
    /// State of the link in words.
    pub link: &'static str,
    /// The vehicle's autopilot, once identified.
    pub vehicle: Option<&'static str>,
    /// Where the flight stands.
    pub phase: Option<FlightState>,
    /// The vehicle's mode word.
    pub mode: Option<u32>,
    /// The mode's name, where the autopilot's profile has one.
    pub mode_name: Option<&'static str>,
    /// Whether the motors are armed.
    pub armed: Option<bool>,
    /// Rate of control ticks, Hz.
    pub tick_rate_hz: f64,
    /// Setpoints sent.
    pub setpoints: u64,
    /// Distance from the reference, m.
    pub tracking_error_m: f64,
    /// Position, m.
    pub position: Ned,
    /// Time along the trajectory and its length, s.
    pub progress: Option<(f64, f64)>,
    /// Remaining charge, 0..1.
    pub battery: Option<f64>,
    /// Round trip of the link, s.
    pub round_trip_s: Option<f64>,
}

impl Station {
    /// A look for the status line.
    pub fn status(&self) -> Status {
        let link = match self.session.state() {
            LinkState::Searching => "searching",
            LinkState::Connected => "connected",
            LinkState::Stale => "stale",
            LinkState::Lost => "lost",
        };
        let mut status = Status {
            link,
            vehicle: self.profile.as_ref().map(|profile| profile.name),
            setpoints: self.setpoints,
            tracking_error_m: self.tracking_error_m,
            progress: self.trajectory_time.map(|t| (t, self.settings.reference.duration())),
            round_trip_s: self.session.stats().round_trip.map(|rtt| rtt.as_secs_f64()),
            ..Status::default()
        };
        if let Some(pilot) = &self.pilot {
            let telemetry = pilot.telemetry();
            status.phase = Some(pilot.flight_state());
            status.mode = telemetry.status().mode;
            status.mode_name = telemetry.status().mode.and_then(|word| self.mode_name(word));
            status.armed = telemetry.status().armed;
            status.battery = telemetry.status().battery.remaining;
            status.tick_rate_hz = telemetry.tick_rate_hz();
            status.position = telemetry.last_sample().map_or(Ned::zero(), |s| s.state.position);
        }
        status
    }

    fn mode_name(&self, word: u32) -> Option<&'static str> {
        let names = self.profile.as_ref()?.mode_names;
        names.iter().find(|(mode, _)| *mode == word).map(|(_, name)| *name)
    }
}
