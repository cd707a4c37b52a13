//! Setpoints from the ground: their times, and how many the log lacks.
//!
//! The log stamps a setpoint when it is recorded. If these time stamps are rough (a separate
//! process wrote the log, or the host was shared), the ground's time stamp in the message is
//! better, despite its resolution of 1 ms. Sequence numbers reveal the setpoints that the log lacks
//! and that the vehicle may have followed.

use super::clocks::{Arrival, ClockMap, Envelope, FrameTime};
use super::flight::AttitudeSetpoint;

/// Resolution of the ground's time stamps, s.
const RESOLUTION_S: f64 = 1e-3;
/// The log's time stamps are rough if their median lateness exceeds this, s.
const ROUGH_S: f64 = 1.5e-3;

/// A setpoint as sent to the vehicle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sent {
    /// Time stamp in the log.
    pub frame_time: FrameTime,
    /// The ground's time stamp in the message, s.
    pub stamp_s: f64,
    /// Number of the sender's frames missing since the last setpoint.
    pub missing: u32,
    /// The commanded setpoint.
    pub setpoint: AttitudeSetpoint,
}

/// Replaces rough time stamps of the log with the ground's, mapped to the log's clock at the least
/// delay. The vehicle's messages, which serve as the reference, are at their least delay too.
pub(super) fn steadied(mut sent: Vec<Sent>) -> Vec<Sent> {
    let steps_back = sent.windows(2).any(|pair| pair[1].stamp_s < pair[0].stamp_s);
    let stands = sent.first().map(|s| s.stamp_s) == sent.last().map(|s| s.stamp_s);
    if steps_back || stands {
        return sent;
    }
    let mut envelope = Envelope::default();
    for Sent { frame_time, stamp_s, .. } in &sent {
        let (index, ground) = (frame_time.index, frame_time.ground);
        envelope.add(Arrival { index, ground, vehicle: *stamp_s });
    }
    let map = ClockMap::new([(&envelope, 0.0)].into_iter(), 0.0);
    let earliest: Option<Vec<f64>> =
        sent.iter().map(|sent| map.ground_time(sent.stamp_s)).collect();
    let Some(earliest) = earliest.filter(|_| map.steps() == 0) else { return sent };
    let mut late: Vec<f64> = sent
        .iter()
        .zip(&earliest)
        .map(|(sent, earliest)| sent.frame_time.ground - earliest)
        .collect();
    let middle = late.len() / 2;
    if late.is_empty() || *late.select_nth_unstable_by(middle, f64::total_cmp).1 < ROUGH_S {
        return sent;
    }
    for (sent, earliest) in sent.iter_mut().zip(earliest) {
        sent.frame_time.ground = earliest + 0.5 * RESOLUTION_S;
    }
    sent
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A minute at 100 Hz from a ground station whose clock is 3 s behind and runs slow; the log's
    /// timestamps are off by up to `rough` s.
    fn flown(rough: f64) -> Vec<Sent> {
        let setpoint = AttitudeSetpoint { attitude: None, body_rate: None, thrust: Some(0.5) };
        (0..6000)
            .map(|k| {
                let time = 10.0 + f64::from(k) * 0.01 + 0.0004;
                let off = rough * (f64::from(k * 7919 % 1000) / 499.5 - 1.0);
                let own = (time - 3.0) * (1.0 - 1e-4);
                Sent {
                    frame_time: FrameTime { index: k as u32, ground: time + off },
                    stamp_s: (own * 1e3).floor() * 1e-3,
                    missing: 0,
                    setpoint,
                }
            })
            .collect()
    }

    #[test]
    fn accurate_log_timestamps_are_kept() {
        let sent = flown(2e-4);
        for (before, after) in sent.iter().zip(steadied(sent.clone())) {
            assert_eq!(before.frame_time, after.frame_time);
        }
    }

    #[test]
    fn rough_log_timestamps_are_replaced_by_ground_timestamps() {
        let rough = 5e-3;
        for (k, sent) in steadied(flown(rough)).into_iter().enumerate() {
            let time = 10.0 + k as f64 * 0.01 + 0.0004;
            let off = sent.frame_time.ground - (time - rough);
            assert!(off.abs() < 8e-4, "{k}: {off}");
        }
    }

    #[test]
    fn log_timestamps_are_kept_without_a_ground_clock() {
        let mut sent = flown(5e-3);
        sent.iter_mut().for_each(|sent| sent.stamp_s = 0.0);
        for (before, after) in sent.iter().zip(steadied(sent.clone())) {
            assert_eq!(before.frame_time, after.frame_time);
        }
    }
}
