//! MAVLink 2 signing of one link: outgoing frames are signed, and incoming ones are accepted only
//! with a signature by the same key.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use wire::Frame;
use wire::signing::{Key, Refused, Signer, Stamp, StreamStamp, Verifier, VerifierSettings};

use crate::clock::HostTime;

/// Period at which the newest stamps are written to the state file.
const REMEMBER_PERIOD: Duration = Duration::from_secs(1);

/// Settings of a signed link.
#[derive(Clone, Debug, PartialEq)]
pub struct SigningSettings {
    /// The key that both ends share.
    pub key: Key,
    /// Own link id: programs that sign with the same system and component use different ones.
    pub link: u8,
    /// Ids of messages that are accepted without a signature.
    pub unsigned: Vec<u32>,
    /// Stamps further ahead of the host's clock than this are rejected.
    pub ahead_max: Duration,
    /// Stamps that earlier sessions sent and received.
    pub before: Remembered,
    /// Where this session reports its stamps.
    pub ledger: Ledger,
}

/// Stamps that must not be used or accepted again.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Remembered {
    /// The latest stamp sent or received.
    pub newest: Stamp,
    /// The latest received stamp of each stream.
    pub streams: Vec<StreamStamp>,
}

/// Holds [`Remembered`]: a session fills it, and another thread saves it.
#[derive(Clone, Default)]
pub struct Ledger(Arc<Mutex<Remembered>>);

impl Ledger {
    /// The session's last report.
    pub fn get(&self) -> Remembered {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Does not wait for a reader, and allocates only for new streams.
    fn record(&self, newest: Stamp, streams: &[StreamStamp]) -> bool {
        let Ok(mut remembered) = self.0.try_lock() else { return false };
        remembered.newest = newest;
        remembered.streams.clear();
        remembered.streams.extend_from_slice(streams);
        true
    }
}

impl fmt::Debug for Ledger {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Ledger")
    }
}

impl PartialEq for Ledger {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// The receiving end of a signed link.
#[derive(Debug)]
pub(super) struct Signing {
    verifier: Verifier,
    ledger: Ledger,
    recorded_at: HostTime,
    /// The reasons for rejection that were reported.
    reported: Vec<Refused>,
}

/// A rejected frame, the first for its reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRejection {
    /// Why it was rejected.
    pub why: Refused,
    /// The sender that it claims.
    pub sender: (u32, u8),
    /// Its message id.
    pub id: u32,
}

impl fmt::Display for FrameRejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { why, sender: (system, component), id } = self;
        write!(
            f,
            "message {id} from system {system} component {component} rejected: {why}; further ones \
             are only counted"
        )?;
        match why {
            Refused::Unsigned | Refused::OldProtocol => f.write_str(
                "; if the vehicle sent it, give it this link's key: downwash signing setup",
            ),
            Refused::Signature => {
                f.write_str("; if the vehicle sent it, its key differs from that in link.signing")
            }
            Refused::Ahead => f.write_str(
                "; check the clocks of this computer and of the vehicle (link.signing.ahead_max_s)",
            ),
            Refused::Replayed | Refused::Old => f.write_str(
                "; if the vehicle sent it, its clock is behind: run downwash signing setup again",
            ),
            Refused::Streams => Ok(()),
        }
    }
}

impl Signing {
    /// The receiving end, and the signer for outgoing frames.
    pub(super) fn new(settings: &SigningSettings, now: HostTime) -> (Self, Signer) {
        let stamp = Stamp::from_unix_ns(now.as_ns());
        let SigningSettings { key, link, unsigned, ahead_max, before, ledger } = settings;
        let after = before.newest.max(stamp);
        let verifier = VerifierSettings {
            key: key.clone(),
            unsigned: unsigned.clone(),
            ahead_max: ahead_max.as_secs().saturating_mul(Stamp::PER_S),
            streams: before.streams.clone(),
        };
        let verifier = Verifier::new(verifier, stamp);
        let signing =
            Self { verifier, ledger: ledger.clone(), recorded_at: now, reported: Vec::new() };
        (signing, Signer::new(key.clone(), *link, after))
    }

    /// Advances the time of both ends, and reports their stamps.
    pub(super) fn turn(&mut self, now: HostTime, signer: Option<&mut Signer>) {
        let stamp = Stamp::from_unix_ns(now.as_ns());
        self.verifier.turn(stamp);
        let Some(signer) = signer else { return };
        signer.turn(stamp);
        if now.since(self.recorded_at) >= REMEMBER_PERIOD
            && self.ledger.record(signer.newest(), self.verifier.streams())
        {
            self.recorded_at = now;
        }
    }

    /// Checks a frame's signature.
    ///
    /// # Errors
    /// Why the frame is rejected; `None` where this reason was already reported.
    pub(super) fn check(
        &mut self,
        frame: &Frame,
        signer: Option<&mut Signer>,
    ) -> Result<(), Option<FrameRejection>> {
        match self.verifier.check(frame) {
            Ok(stamp) => {
                signer.zip(stamp).into_iter().for_each(|(signer, stamp)| signer.observe(stamp));
                Ok(())
            }
            Err(why) if self.reported.contains(&why) => Err(None),
            Err(why) => {
                self.reported.push(why);
                let sender = (frame.system(), frame.component());
                Err(Some(FrameRejection { why, sender, id: frame.id() }))
            }
        }
    }

    /// Rejected frames, by reason.
    pub(super) fn refused(&self) -> impl Iterator<Item = (Refused, u64)> + '_ {
        self.verifier.refused()
    }
}
