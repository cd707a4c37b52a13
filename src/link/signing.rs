//! MAVLink 2 signing of one link: what is sent is signed, and what is heard is believed only with
//! a signature of the same key.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use wire::Frame;
use wire::signing::{Key, Refused, Signer, Stamp, StreamStamp, Verifier, VerifierSettings};

use crate::clock::HostTime;

/// Period at which the newest stamps go to the state file.
const REMEMBER_PERIOD: Duration = Duration::from_secs(1);

/// Settings of a signed link.
#[derive(Clone, Debug, PartialEq)]
pub struct SigningSettings {
    /// The key that both ends share.
    pub key: Key,
    /// Own number of the link: each that signs with the same ids takes one of its own.
    pub link: u8,
    /// Ids of messages that are believed without a signature.
    pub unsigned: Vec<u32>,
    /// Stamps further ahead of the host's clock than this are not believed.
    pub ahead_max: Duration,
    /// What earlier sessions sent and heard.
    pub before: Remembered,
    /// Where this session tells what it sends and hears.
    pub ledger: Ledger,
}

/// Stamps that must not be used or believed again.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Remembered {
    /// The latest that was sent or heard.
    pub newest: Stamp,
    /// The latest of each stream that was heard.
    pub streams: Vec<StreamStamp>,
}

/// A place for [`Remembered`], which a session fills and another thread keeps.
#[derive(Clone, Default)]
pub struct Ledger(Arc<Mutex<Remembered>>);

impl Ledger {
    /// What the session reported last.
    pub fn get(&self) -> Remembered {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Does not wait for who reads, and takes memory only for streams that are new.
    fn tell(&self, newest: Stamp, streams: &[StreamStamp]) -> bool {
        let Ok(mut told) = self.0.try_lock() else { return false };
        told.newest = newest;
        told.streams.clear();
        told.streams.extend_from_slice(streams);
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
    told: HostTime,
    /// The reasons for refused frames that were reported.
    said: Vec<Refused>,
}

/// A frame that is not believed, where it is the first of its kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Disbelief {
    /// Why.
    pub why: Refused,
    /// Whose it says it is.
    pub sender: (u32, u8),
    /// Its message id.
    pub id: u32,
}

impl fmt::Display for Disbelief {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { why, sender: (system, component), id } = self;
        write!(
            f,
            "message {id} of system {system} component {component} is not believed: {why}; further \
             ones are counted"
        )?;
        match why {
            Refused::Unsigned | Refused::OldProtocol => f.write_str(
                "; if it is the vehicle's, give it this link's key: downwash signing setup",
            ),
            Refused::Signature => {
                f.write_str("; if it is the vehicle's, it has another key than link.signing")
            }
            Refused::Ahead => f.write_str(
                "; check this computer's clock, and the vehicle's (link.signing.ahead_max_s)",
            ),
            Refused::Replayed | Refused::Old | Refused::Streams => Ok(()),
        }
    }
}

impl Signing {
    /// The receiving end, and the signer of what is sent.
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
        let signing = Self { verifier, ledger: ledger.clone(), told: now, said: Vec::new() };
        (signing, Signer::new(key.clone(), *link, after))
    }

    /// Advances the time.
    pub(super) fn turn(&mut self, now: HostTime, signer: Option<&mut Signer>) {
        let stamp = Stamp::from_unix_ns(now.as_ns());
        self.verifier.turn(stamp);
        let Some(signer) = signer else { return };
        signer.turn(stamp);
        if now.since(self.told) >= REMEMBER_PERIOD
            && self.ledger.tell(signer.newest(), self.verifier.streams())
        {
            self.told = now;
        }
    }

    /// Judges a frame.
    ///
    /// # Errors
    /// Why it is not believed; `Some` where that is worth saying.
    pub(super) fn check(
        &mut self,
        frame: &Frame,
        signer: Option<&mut Signer>,
    ) -> Result<(), Option<Disbelief>> {
        match self.verifier.check(frame) {
            Ok(stamp) => {
                signer.zip(stamp).into_iter().for_each(|(signer, stamp)| signer.heard(stamp));
                Ok(())
            }
            Err(why) if self.said.contains(&why) => Err(None),
            Err(why) => {
                self.said.push(why);
                let sender = (frame.system(), frame.component());
                Err(Some(Disbelief { why, sender, id: frame.id() }))
            }
        }
    }

    /// Frames that were not believed, by why.
    pub(super) fn refused(&self) -> impl Iterator<Item = (Refused, u64)> + '_ {
        self.verifier.refused()
    }
}
