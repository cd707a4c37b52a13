//! The key of an exam, and the commitment to it: its hash is published before the first diagnosis,
//! the key after the last.

use std::collections::BTreeMap;
use std::hash::{BuildHasher, Hasher, RandomState};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use vehicle::foreign::Foreign;

use super::condition::Condition;
use super::deviations::{Deviation, Parameters};
use super::order::Kind;
use super::strength::Strength;
use super::world::{FileKind, LoopKind};

/// An effect that the vehicle has beyond its file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrueEffect {
    /// Id.
    pub id: String,
    /// The vehicle's values.
    pub parameters: Parameters,
    /// What the vehicle file says, or the neutral values.
    pub neutral: Parameters,
    /// How strongly it shows by itself.
    pub ratio: f64,
}

/// The right answer to a case, and what was flown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyEntry {
    /// What it asks.
    pub kind: Kind,
    /// State of the logs.
    pub condition: Condition,
    /// How good the vehicle file is.
    pub file: FileKind,
    /// Which loop is on board.
    pub on_board: LoopKind,
    /// Rate of the logged outputs, Hz.
    pub outputs_hz: f64,
    /// The right verdict.
    pub verdict: String,
    /// The effects that the vehicle has beyond its file, by their causes' ids.
    pub effects: Vec<TrueEffect>,
    /// Further ids that name the cause as well.
    pub also_right: Vec<String>,
    /// What these flights cannot tell apart; none of a trap that hides its effect.
    pub candidates: Vec<String>,
    /// What the catalogue does not have.
    pub foreign: Option<Foreign>,
    /// Effects that the diagnosis is to do without.
    pub without: Vec<String>,
    /// What of the vehicle file is off by its tolerances, which is never the answer.
    pub deviations: Vec<Deviation>,
    /// How many claimed standard deviations each effect is off the file; none of one that no number
    /// of the file is.
    pub beyond_tolerances: Vec<Option<f64>>,
    /// How strongly all of it shows when every number of the file has moved by up to three
    /// tolerances to explain it.
    pub ratio_beyond_file: Option<f64>,
    /// Whether each effect is of practical size: at least three tolerances off the file, and as
    /// strong as three times noise when its numbers have moved. Of an exact file with an exact
    /// world about it, whether it shows twice as much as noise.
    pub is_practical: bool,
    /// How strongly all of it shows.
    pub snr: Strength,
    /// Whether it shows less than noise.
    pub is_weak: bool,
    /// Mass in the vehicle file, kg.
    pub nominal_mass_kg: f64,
    /// Kind and notes.
    pub tags: Vec<String>,
}

impl KeyEntry {
    /// Whether the flights do not show the effect at all, so that nothing must be named.
    pub fn hides_its_effect(&self) -> bool {
        self.kind.is_trap() && self.candidates.is_empty()
    }
}

/// The key: by case.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Key {
    /// Seed of the exam.
    pub seed: u64,
    /// A number that nobody can guess, so that the hash gives nothing away.
    pub nonce: String,
    /// Effects that no flight can tell apart.
    pub equivalence_classes: Vec<Vec<String>>,
    /// By the case's name.
    pub cases: BTreeMap<String, KeyEntry>,
}

impl Key {
    /// The key of `cases`, with a nonce from the system.
    pub fn new(seed: u64, cases: BTreeMap<String, KeyEntry>) -> Self {
        let nonce = format!("{:016x}{:016x}", entropy(), entropy());
        let class = ["thrust_scale", "mass"].map(str::to_owned).to_vec();
        Self { seed, nonce, equivalence_classes: vec![class], cases }
    }

    /// The bytes of key.json.
    ///
    /// # Errors
    /// None that a key can cause.
    pub fn bytes(&self) -> serde_json::Result<Vec<u8>> {
        serde_json::to_vec(self)
    }
}

/// What is published beforehand: the SHA-256 of key.json, in hexadecimal digits.
pub fn commitment(key: &[u8]) -> String {
    Sha256::digest(key).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A number from the system's entropy.
pub fn entropy() -> u64 {
    RandomState::new().build_hasher().finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commitment_is_the_hash_of_the_file() {
        assert_eq!(
            commitment(b"abc"),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
        let key = Key::new(1, BTreeMap::new());
        let bytes = key.bytes().expect("JSON");
        assert_eq!(serde_json::from_slice::<Key>(&bytes).expect("a key"), key);
        // Even an empty key with the same seed hashes differently every time.
        let other = Key::new(1, BTreeMap::new()).bytes().expect("JSON");
        assert_ne!(commitment(&bytes), commitment(&other));
    }
}
