//! The station's status for display.

use vehicle::frame::Ned;

use super::Station;
use wire::signing::Refused;

use crate::clock::HostTime;
use crate::link::counters::LinkState;
use crate::offboard::Adjusted;
use crate::supervisor::FlightState;

/// A snapshot of the station for the status line.
#[derive(Clone, Debug, Default)]
pub struct Status {
    /// State of the link, as shown to people.
    pub link: &'static str,
    /// The vehicle's autopilot, once identified.
    pub vehicle: Option<&'static str>,
    /// The state of the flight.
    pub phase: Option<FlightState>,
    /// The vehicle's custom mode.
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
    /// Position in the vehicle's local frame, m.
    pub position: Ned,
    /// Time along the trajectory and its length, s.
    pub progress: Option<(f64, f64)>,
    /// Remaining charge, 0..1.
    pub battery: Option<f64>,
    /// Round trip of the link, s.
    pub round_trip_s: Option<f64>,
    /// What viewers changed.
    pub adjusted: Adjusted,
    /// The link's frame counters.
    pub counts: LinkCounts,
    /// When the driver took this snapshot.
    pub updated: Option<HostTime>,
    /// Records missing from the log because the disk was too slow.
    pub log_dropped: u64,
    /// Logs that an error ended.
    pub log_failures: u64,
}

/// Frames by their fate.
#[derive(Clone, Debug, Default)]
pub struct LinkCounts {
    /// From the vehicle.
    pub vehicle_frames: u64,
    /// From the vehicle, lost on the way.
    pub lost: u64,
    /// From the vehicle, repeated or late.
    pub repeated: u64,
    /// From the vehicle, with impossible content.
    pub refused: u64,
    /// From other senders.
    pub foreign: u64,
    /// Sent.
    pub sent: u64,
    /// Failed to leave.
    pub dropped: u64,
    /// Bytes that are not MAVLink.
    pub unframed_bytes: u64,
    /// Rejected for their signature, by reason; none where nothing is signed.
    pub rejected_frames: Vec<(Refused, u64)>,
}

impl Station {
    /// A snapshot for the status line.
    pub fn status(&self) -> Status {
        let link = match self.session.state() {
            LinkState::Searching => "searching",
            LinkState::Connected => "connected",
            LinkState::Stale => "stale",
            LinkState::Lost => "lost",
        };
        let stats = self.session.stats();
        let counts = LinkCounts {
            vehicle_frames: stats.vehicle_frames,
            lost: stats.lost,
            repeated: stats.repeated,
            refused: stats.refused,
            foreign: stats.foreign,
            sent: stats.sent_frames,
            dropped: stats.dropped,
            unframed_bytes: stats.received.unframed_bytes,
            rejected_frames: self.session.rejected_frames().collect(),
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
            status.mode_name = telemetry.status().mode.and_then(|mode| self.mode_name(mode));
            status.armed = telemetry.status().armed;
            status.battery = telemetry.status().battery.remaining;
            status.tick_rate_hz = telemetry.tick_rate_hz();
            status.position = telemetry.last_sample().map_or(Ned::zero(), |s| s.state.position);
        }
        status
    }

    fn mode_name(&self, mode: u32) -> Option<&'static str> {
        let names = self.profile.as_ref()?.mode_names;
        names.iter().find(|(known, _)| *known == mode).map(|(_, name)| *name)
    }
}
