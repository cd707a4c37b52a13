//! The load of a link: the bytes a second of each message.

use std::fmt;

use wire::message_name;

use super::budget::frame_len;
use super::counters::MessageCount;

/// Bytes of a signature at the end of a frame.
const SIGNATURE_LEN: usize = 13;
/// Number of the largest messages that are named.
const NAMED: usize = 4;
/// Smaller loads are not worth naming, bytes/s.
const NAMED_MIN_BYTES_PER_S: f64 = 50.0;

/// The arriving load in bytes a second, for full payloads without extensions. MAVLink 2 omits
/// trailing zeros, so the true load may be lower.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkLoad {
    /// All messages from the vehicle.
    pub bytes_per_s: f64,
    /// Messages that nothing here requested, by id, largest load first.
    pub unrequested: Vec<(u32, f64)>,
}

impl LinkLoad {
    /// The load of the messages that arrive; `is_requested` returns whether one was requested.
    pub fn of(
        messages: &[MessageCount],
        is_signed: bool,
        is_requested: impl Fn(u32) -> bool,
    ) -> Self {
        let signature = if is_signed { SIGNATURE_LEN } else { 0 };
        let load = |count: &MessageCount| {
            (count.id, (frame_len(count.id) + signature) as f64 * count.rate_hz)
        };
        let loads: Vec<_> = messages.iter().map(load).collect();
        let bytes_per_s = loads.iter().map(|(_, bytes_per_s)| bytes_per_s).sum();
        let mut unrequested: Vec<_> = loads
            .into_iter()
            .filter(|(id, bytes_per_s)| !is_requested(*id) && *bytes_per_s > NAMED_MIN_BYTES_PER_S)
            .collect();
        unrequested.sort_by(|a, b| b.1.total_cmp(&a.1));
        Self { bytes_per_s, unrequested }
    }
}

impl fmt::Display for LinkLoad {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "about {:.0} bytes/s arrive", self.bytes_per_s)?;
        for (k, (id, bytes_per_s)) in self.unrequested.iter().take(NAMED).enumerate() {
            let before = if k == 0 { ", including unrequested " } else { ", " };
            write!(f, "{before}{} {bytes_per_s:.0}", message_name(*id))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unrequested_messages_are_named_with_their_load() {
        let count = |id, rate_hz| MessageCount { id, total: 1, rate_hz };
        // Payloads: ATTITUDE_QUATERNION 32 bytes, HIGHRES_IMU 62, VFR_HUD 20, HEARTBEAT 9.
        let messages = [count(31, 10.0), count(105, 10.0), count(74, 20.0), count(0, 1.0)];
        let load = LinkLoad::of(&messages, false, |id| id == 31);
        let expected = 10.0 * 44.0 + 10.0 * 74.0 + 20.0 * 32.0 + 21.0;
        assert!((load.bytes_per_s - expected).abs() < 1e-9, "{}", load.bytes_per_s);
        assert_eq!(
            load.to_string(),
            "about 1841 bytes/s arrive, including unrequested HIGHRES_IMU 740, VFR_HUD 640"
        );
        let signed = LinkLoad::of(&messages, true, |id| id == 31);
        assert!((signed.bytes_per_s - expected - 41.0 * 13.0).abs() < 1e-9);
    }
}
