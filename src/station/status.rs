//! What the station shows of itself.

use vehicle::frame::Ned;

use super::Station;
use wire::signing::Refused;

use crate::clock::HostTime;
use crate::link::counters::LinkState;
use crate::offboard::Adjusted;
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
    /// What viewers changed.
    pub adjusted: Adjusted,
    /// What the link counted.
    pub counts: LinkCounts,
    /// When the driver took this look.
    pub updated: Option<HostTime>,
    /// Records that the log lacks, because its disk was too slow.
    pub log_dropped: u64,
    /// Logs that ended by an error.
    pub log_failures: u64,
}

/// Frames by what became of them.
#[derive(Clone, Debug, Default)]
pub struct LinkCounts {
    /// The vehicle's.
    pub heard: u64,
    /// The vehicle's that were lost on the way.
    pub lost: u64,
    /// The vehicle's that came again, or late.
    pub repeated: u64,
    /// The vehicle's that cannot be true.
    pub refused: u64,
    /// Other senders'.
    pub foreign: u64,
    /// Those that were sent.
    pub sent: u64,
    /// Those that did not leave.
    pub dropped: u64,
    /// Bytes that are no MAVLink.
    pub unframed_bytes: u64,
    /// Those without a right signature, by why; none where nothing is signed.
    pub disbelieved: Vec<(Refused, u64)>,
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
        let stats = self.session.stats();
        let counts = LinkCounts {
            heard: stats.heard,
            lost: stats.lost,
            repeated: stats.repeated,
            refused: stats.refused,
            foreign: stats.foreign,
            sent: stats.sent_frames,
            dropped: stats.dropped,
            unframed_bytes: stats.received.unframed_bytes,
            disbelieved: self.session.disbelieved().collect(),
        };
        let mut status = Status {
            link,
            counts,
            vehicle: self.profile.as_ref().map(|profile| profile.name),
            setpoints: self.setpoints,
            tracking_error_m: self.tracking_error_m,
            progress: self.trajectory_time.map(|t| (t, self.settings.reference.duration())),
            round_trip_s: stats.round_trip.map(|rtt| rtt.as_secs_f64()),
            ..Status::default()
        };
        if let Some(offboard) = &self.offboard {
            let telemetry = offboard.telemetry();
            status.phase = Some(offboard.flight_state());
            status.adjusted = offboard.adjusted();
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
