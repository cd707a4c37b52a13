//! What is done at each point of a sweep.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::case_files::CaseFiles;
use super::named_files::NamedFiles;

/// The command that a sweep repeats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Subject {
    /// A flight, by `simulate`.
    #[default]
    Simulate,
    /// A diagnosis of logs, by `diagnose`.
    Diagnose,
    /// A case of an exam, by `exam`.
    Exam,
}

/// Size beyond which a log's hash covers only its length and its ends, bytes.
const HASHED_IN_FULL: u64 = 1 << 20;
/// Part of either end in that hash, bytes.
const END: u64 = 1 << 16;

impl Subject {
    /// Inputs that may vary.
    fn inputs(self) -> &'static [&'static str] {
        match self {
            Self::Simulate => &["vehicle", "trajectory", "config", "sitl_config", "onsets"],
            Self::Diagnose => {
                &["case", "vehicle", "logs", "holdout", "mapping", "twins", "without", "discover"]
            }
            Self::Exam => &["seconds", "strengths", "exact", "twins"],
        }
    }

    /// Inputs that are the same at each point, because they decide the number of points.
    fn constants(self) -> &'static [&'static str] {
        match self {
            Self::Simulate | Self::Diagnose => &[],
            Self::Exam => &["cases", "nulls", "kinds", "round_trip"],
        }
    }

    /// Tables in which each key is an input.
    fn tables(self) -> &'static [&'static str] {
        match self {
            Self::Simulate => &["effects", "set"],
            Self::Diagnose | Self::Exam => &[],
        }
    }

    /// Inputs that name files.
    pub fn files(self) -> &'static [&'static str] {
        match self {
            Self::Simulate => &["vehicle", "trajectory", "config", "sitl_config"],
            Self::Diagnose => &["case", "vehicle", "logs", "holdout", "mapping"],
            Self::Exam => &[],
        }
    }

    /// Whether it may vary.
    pub fn is_input(self, path: &str) -> bool {
        let of_table = path.split_once('.').is_some_and(|(head, _)| self.tables().contains(&head));
        of_table || self.inputs().contains(&path)
    }

    /// Whether it may be given for every point.
    pub fn is_fixed_input(self, key: &str) -> bool {
        let mut all = self.inputs().iter().chain(self.constants()).chain(self.tables());
        all.any(|known| *known == key)
    }

    /// The inputs that may vary, for people.
    pub fn inputs_text(self) -> String {
        let inputs = self.inputs().join(", ");
        match self {
            Self::Simulate => {
                format!("{inputs}, effects.ID.PARAMETER or set.SETTING; seeds vary by `seeds`")
            }
            Self::Diagnose | Self::Exam => format!("one of {inputs}; seeds vary by `seeds`"),
        }
    }

    /// The inputs that may be given for every point, for people.
    pub fn fixed_text(self) -> String {
        let all = self.inputs().iter().chain(self.constants()).chain(self.tables());
        let all: Vec<&str> = all.copied().collect();
        format!("one of {}, or of, grid, list, draw, samples, draw_seed and seeds", all.join(", "))
    }

    /// Adds the files that an input names to a hash.
    pub fn hash(self, input: &str, name: &str, files: &NamedFiles, hash: &mut Sha256) {
        let path = files.resolved(name);
        // A file that cannot be read makes its points fail.
        let _ = match input {
            "logs" | "holdout" => files.fitting(name).iter().try_for_each(|log| ends(log, hash)),
            "case" => CaseFiles::in_folder(&path).and_then(|case| {
                hash_file(&case.vehicle, hash)?;
                case.logs.iter().try_for_each(|log| ends(log, hash))
            }),
            _ => hash_file(&path, hash),
        };
    }
}

fn hash_file(path: &Path, hash: &mut Sha256) -> io::Result<()> {
    hash.update(fs::read(path)?);
    Ok(())
}

/// A log's name with its bytes, or its length and its ends.
fn ends(path: &Path, hash: &mut Sha256) -> io::Result<()> {
    hash.update(path.file_name().unwrap_or_default().as_encoded_bytes());
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    if length <= HASHED_IN_FULL {
        return hash_file(path, hash);
    }
    hash.update(length.to_le_bytes());
    let mut bytes = vec![0; END as usize];
    for from in [0, length - END] {
        file.seek(SeekFrom::Start(from))?;
        file.read_exact(&mut bytes)?;
        hash.update(&bytes);
    }
    Ok(())
}
