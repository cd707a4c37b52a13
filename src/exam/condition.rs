//! Conditions of a log: thinned, with bad stamps, or with lost frames.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::Frame;
use wire::dialect::HEARTBEAT_DATA;
use wire::tlog::{Reader, Writer};

use mavlink::MessageData;

use super::draw::Draw;

/// Largest error of a stamp, us.
const JITTER_US: f64 = 5_000.0;
/// Share of frames that are lost.
const LOST: f64 = 0.1;

/// The condition of a log.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum Condition {
    /// As written.
    Plain,
    /// Every other message of each kind is missing.
    HalfRate,
    /// The log's stamps, not the vehicle's, have uniform errors of up to 5 ms.
    Jitter,
    /// One frame in ten is lost.
    Dropouts,
}

impl Condition {
    /// Every condition.
    pub const ALL: [Self; 4] = [Self::Plain, Self::HalfRate, Self::Jitter, Self::Dropouts];

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::HalfRate => "half rate",
            Self::Jitter => "5 ms jitter",
            Self::Dropouts => "10 % lost",
        }
    }

    /// The log in this condition. Heartbeats stay.
    pub fn apply(self, log: &[u8], seed: u64) -> Vec<u8> {
        if self == Self::Plain {
            return log.to_vec();
        }
        let mut draw = Draw::new(seed, self as u64);
        let mut counts = std::collections::BTreeMap::<(u32, u32), u64>::new();
        rewritten(log, |frame| {
            let count = counts.entry((frame.system(), frame.id())).or_default();
            *count += 1;
            let is_kept = match self {
                Self::HalfRate => *count % 2 == 1,
                Self::Dropouts => !draw.chance(LOST),
                Self::Plain | Self::Jitter => true,
            };
            let off = match self {
                Self::Jitter if is_kept => draw.within([-JITTER_US, JITTER_US]).round() as i64,
                _ => 0,
            };
            (is_kept || frame.id() == HEARTBEAT_DATA::ID).then_some(off)
        })
    }
}

/// The log without the frames for which `keep` returns `None`. For the others it returns a shift of
/// the stamp, us.
pub fn rewritten(log: &[u8], mut keep: impl FnMut(&Frame) -> Option<i64>) -> Vec<u8> {
    let mut out = Writer::new(Vec::with_capacity(log.len()));
    let mut reader = Reader::new(log);
    // Neither reading from memory nor writing to it can fail.
    while let Ok(Some(entry)) = reader.read() {
        let (Some(time_us), Some(frame)) = (entry.time_us, Frame::parse(&entry.frame)) else {
            continue;
        };
        if let Some(off) = keep(&frame) {
            let _ = out.write(time_us.saturating_add_signed(off), &entry.frame);
        }
    }
    out.into_inner()
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::Encoder;
    use wire::dialect::{LOCAL_POSITION_NED_DATA, MavMessage};

    #[test]
    fn conditions_remove_the_intended_messages() {
        let mut encoder = Encoder::new(1, 1);
        let mut log = Writer::new(Vec::new());
        for number in 0..1000_u64 {
            let mut bytes = Vec::new();
            let data =
                LOCAL_POSITION_NED_DATA { time_boot_ms: number as u32, ..Default::default() };
            encoder.encode(&MavMessage::LOCAL_POSITION_NED(data), &mut bytes);
            log.write(1_767_225_600_000_000 + 10_000 * number, &bytes).expect("memory");
        }
        let log = log.into_inner();
        let count = |condition: Condition| {
            let bytes = condition.apply(&log, 4);
            let mut reader = Reader::new(bytes.as_slice());
            let mut stamps = Vec::new();
            while let Some(entry) = reader.read().expect("memory") {
                stamps.push(entry.time_us.expect("a stamp"));
            }
            stamps
        };
        assert_eq!(count(Condition::Plain).len(), 1000);
        assert_eq!(count(Condition::HalfRate).len(), 500);
        assert!((860..940).contains(&count(Condition::Dropouts).len()));
        let jittered = count(Condition::Jitter);
        let off = |(n, us): (usize, &u64)| us.abs_diff(1_767_225_600_000_000 + 10_000 * n as u64);
        let most = jittered.iter().enumerate().map(off).max();
        assert!(jittered.len() == 1000 && most.is_some_and(|us| (4_500..=5_000).contains(&us)));
    }
}
