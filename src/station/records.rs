//! The log's records of messages, ticks and the link.

use message::{Battery, Inbound, MotorSource};

use crate::clock::HostTime;
use crate::link::counters;
use crate::link::received::Received;
use crate::log::record::{self, LinkStats, Record, Severity, Source, Stamp};
use crate::offboard::Tick;

/// The record of a message besides its frame. Motor outputs are recorded from one source only.
pub(super) fn record_of(received: &Received, motors: Option<MotorSource>) -> Option<Record> {
    let stamp = match received.vehicle {
        Some(vehicle) => Stamp::new(received.host, vehicle, received.host),
        None => Stamp::host(received.host),
    };
    match &received.message {
        Inbound::Imu { specific_force, body_rate } => {
            Some(Record::Imu { stamp, specific_force: *specific_force, body_rate: *body_rate })
        }
        Inbound::MotorOutputs { source, outputs } if Some(*source) == motors => {
            Some(Record::Motors { stamp, outputs: *outputs })
        }
        Inbound::Battery(Battery { voltage, current, remaining, .. }) => Some(Record::Battery {
            stamp,
            voltage: *voltage,
            current: *current,
            remaining: *remaining,
        }),
        Inbound::StatusText { severity, text } => Some(Record::Event {
            host: received.host,
            severity: Severity::from(*severity),
            source: Source::Vehicle,
            text: text.clone(),
        }),
        _ => None,
    }
}

pub(super) fn tick_record(tick: &Tick, sampled: HostTime) -> record::Tick {
    record::Tick {
        stamp: Stamp::new(tick.host, tick.vehicle, sampled),
        state: tick.state,
        reference: Some(tick.reference),
        desired: Some(tick.desired),
        tube_radius_m: tick.tube_radius_m,
        feedback: tick.feedback,
        setpoint: tick.setpoint,
        saturation: tick.saturation.bits(),
        phase: tick.phase.name(),
        trajectory_time: tick.trajectory_time,
        sample_age: tick.sample_age,
    }
}

/// Computes rates from the link's counters.
pub(super) struct LinkMeter {
    last: Counts,
    opened: u64,
}

/// The counters at the last report.
#[derive(Clone, Copy, Default)]
struct Counts {
    host: HostTime,
    received_frames: u64,
    received_bytes: u64,
    unknown: u64,
    vehicle_frames: u64,
    lost: u64,
    sent_frames: u64,
    sent_bytes: u64,
}

impl LinkMeter {
    pub(super) fn new(now: HostTime) -> Self {
        Self { last: Counts { host: now, ..Counts::default() }, opened: 0 }
    }

    /// Counts an opening of the endpoint.
    pub(super) fn opened(&mut self) {
        self.opened += 1;
    }

    /// Share of the vehicle's frames that were lost since the last [`LinkMeter::read`]; `None` if
    /// none arrived.
    pub(super) fn loss(&self, stats: &counters::LinkStats) -> Option<f64> {
        let vehicle_frames = stats.vehicle_frames.saturating_sub(self.last.vehicle_frames);
        // A message outside the dialect leaves a gap too, and its sender is unknown. On a link with
        // other senders of such messages, some losses go unnoticed.
        let unknown = stats.received.unknown.saturating_sub(self.last.unknown);
        let lost = stats.lost.saturating_sub(self.last.lost).saturating_sub(unknown);
        (vehicle_frames > 0).then(|| lost as f64 / (lost as f64 + vehicle_frames as f64))
    }

    /// The link's statistics since the last call.
    pub(super) fn read(&mut self, now: HostTime, stats: &counters::LinkStats) -> LinkStats {
        let period = now.since(self.last.host).as_secs_f64();
        let rate = |count: u64, before: u64| count.saturating_sub(before) as f64 / period;
        let of = |ids: &[u32]| {
            let counts = stats.messages.iter().filter(|count| ids.contains(&count.id));
            counts.map(|count| count.rate_hz).fold(0.0, f64::max)
        };
        let record = LinkStats {
            rx_frames_hz: rate(stats.received.frames, self.last.received_frames),
            rx_bytes_per_s: rate(stats.received.bytes, self.last.received_bytes),
            tx_frames_hz: rate(stats.sent_frames, self.last.sent_frames),
            tx_bytes_per_s: rate(stats.sent_bytes, self.last.sent_bytes),
            attitude_hz: of(&[30, 31]),
            position_hz: of(&[32]),
            odometry_hz: of(&[331]),
            crc_errors: stats.received.crc_errors,
            lost_frames: stats.lost,
            unknown_frames: stats.received.unknown,
            unframed_bytes: stats.received.unframed_bytes,
            foreign_frames: stats.foreign,
            stray_frames: stats.stray,
            refused_frames: stats.refused,
            dropped_frames: stats.dropped,
            reconnects: self.opened.saturating_sub(1),
            rtt_s: stats.round_trip.map_or(f64::NAN, |rtt| rtt.as_secs_f64()),
            clock_offset_s: stats.clock.map_or(f64::NAN, |clock| clock.offset_ns as f64 * 1e-9),
        };
        self.last = Counts {
            host: now,
            received_frames: stats.received.frames,
            received_bytes: stats.received.bytes,
            unknown: stats.received.unknown,
            vehicle_frames: stats.vehicle_frames,
            lost: stats.lost,
            sent_frames: stats.sent_frames,
            sent_bytes: stats.sent_bytes,
        };
        record
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use wire::DecoderStats;

    use super::*;
    use crate::link::counters::LinkState;

    #[test]
    fn loss_is_the_share_of_vehicle_frames_since_last_reading() {
        let stats = |vehicle_frames, lost, unknown| counters::LinkStats {
            state: LinkState::Connected,
            vehicle: None,
            received: DecoderStats { frames: 9000, unknown, ..DecoderStats::default() },
            foreign: 0,
            stray: 0,
            refused: 0,
            vehicle_frames,
            lost,
            repeated: 0,
            sent_frames: 0,
            sent_bytes: 0,
            dropped: 0,
            round_trip: None,
            clock: None,
            messages: Vec::new(),
        };
        let start = HostTime::from_ns(0);
        let mut meter = LinkMeter::new(start);
        assert_eq!(meter.loss(&stats(0, 0, 0)), None);
        assert_eq!(meter.loss(&stats(75, 25, 0)), Some(0.25));
        meter.read(start + Duration::from_secs(1), &stats(75, 25, 0));
        assert_eq!(meter.loss(&stats(75, 25, 0)), None, "silence is not loss");
        assert_eq!(meter.loss(&stats(175, 25, 0)), Some(0.0));
        assert_eq!(
            meter.loss(&stats(165, 35, 10)),
            Some(0.0),
            "messages unknown to the dialect are not losses"
        );
    }
}
