//! The key of an exam and the commitment to it. Its hash is published before the first diagnosis,
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
    /// Its id in the catalogue.
    pub id: String,
    /// The vehicle's values.
    pub parameters: Parameters,
    /// The vehicle file's values, or the neutral ones.
    pub neutral: Parameters,
    /// Its strength alone, as a ratio over noise.
    pub ratio: f64,
}

/// The right answer to a case, with the conditions of its flights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyEntry {
    /// The kind of question that the case asks.
    pub kind: Kind,
    /// Condition of the logs.
    pub condition: Condition,
    /// Quality of the vehicle file.
    pub file: FileKind,
    /// The loop on board.
    pub on_board: LoopKind,
    /// Rate of the logged outputs, Hz.
    pub outputs_hz: f64,
    /// The right verdict.
    pub verdict: String,
    /// The vehicle's effects beyond its file, by their causes' ids.
    pub effects: Vec<TrueEffect>,
    /// Other ids that also name the cause.
    pub also_right: Vec<String>,
    /// Effects that these flights do not distinguish; empty for a trap that hides its effect.
    pub candidates: Vec<String>,
    /// The disturbance or law outside the catalogue.
    pub foreign: Option<Foreign>,
    /// Effects taken out of the catalogue.
    pub without: Vec<String>,
    /// Differences of the vehicle from its file within tolerances, which are never the answer.
    pub deviations: Vec<Deviation>,
    /// Distance of each effect from the file in claimed standard deviations; `None` for an effect
    /// that the file has no number for.
    pub beyond_tolerances: Vec<Option<f64>>,
    /// Ratio over noise of the whole truth after every number of the file has moved by up to three
    /// tolerances to explain it.
    pub ratio_beyond_file: Option<f64>,
    /// Whether the truth is of practical size: each effect at least three tolerances off the file,
    /// and a ratio over noise of at least three after the file's numbers have moved. In an exact
    /// world, a ratio over noise of at least two.
    pub is_practical: bool,
    /// Strength of the whole truth, as a ratio over noise.
    pub snr: Strength,
    /// Whether the truth shows less than noise.
    pub is_weak: bool,
    /// Mass in the vehicle file, kg.
    pub nominal_mass_kg: f64,
    /// The case's kind and notes on its conditions.
    pub tags: Vec<String>,
}

impl KeyEntry {
    /// Whether the flights do not show the effect at all, and a right answer names nothing.
    pub fn hides_its_effect(&self) -> bool {
        self.kind.is_trap() && self.candidates.is_empty()
    }
}

/// The key of an exam.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Key {
    /// Seed of the exam.
    pub seed: u64,
    /// A nonce, so that the hash reveals nothing.
    pub nonce: String,
    /// Classes of effects that no flight distinguishes.
    pub equivalence_classes: Vec<Vec<String>>,
    /// Entries by the name of the case.
    pub cases: BTreeMap<String, KeyEntry>,
}

impl Key {
    /// The key of `cases`, with a nonce from the system's entropy.
    pub fn new(seed: u64, cases: BTreeMap<String, KeyEntry>) -> Self {
        let nonce = format!("{:016x}{:016x}", entropy(), entropy());
        let class = ["thrust_scale", "mass"].map(str::to_owned).to_vec();
        Self { seed, nonce, equivalence_classes: vec![class], cases }
    }

    /// The bytes of key.json.
    ///
    /// # Errors
    /// A serialisation error, which a key cannot cause.
    pub fn bytes(&self) -> serde_json::Result<Vec<u8>> {
        serde_json::to_vec(self)
    }
}

/// The commitment: the SHA-256 of key.json in hexadecimal digits.
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
        // Two empty keys with the same seed have different hashes.
        let other = Key::new(1, BTreeMap::new()).bytes().expect("JSON");
        assert_ne!(commitment(&bytes), commitment(&other));
    }
}
