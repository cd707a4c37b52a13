//! The secret key that both ends of a link share, and how to load it.

use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

/// Length of a key in bytes.
pub const KEY_LEN: usize = 32;
/// Bytes of a key file that are read at most.
const FILE_LEN_MAX: u64 = 4096;

/// A secret of 32 bytes. `Debug` and errors never show it.
#[derive(Clone, PartialEq, Eq)]
pub struct Key([u8; KEY_LEN]);

/// Why a key cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file cannot be read.
    #[error("cannot read the signing key {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Users other than the owner may access the file, or it is executable.
    #[error(
        "the signing key {path} has mode {mode:04o}, expected 0600: others may read or change it; \
         run chmod 600 {path}, and make a new key if others had access"
    )]
    Open {
        /// The file.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// The text is not a key.
    #[error(
        "{place} holds no signing key: expected 64 hexadecimal digits (32 bytes), found {found}; \
         make one with: downwash signing key FILE"
    )]
    Text {
        /// The file or variable.
        place: String,
        /// What was found, without the content.
        found: String,
    },
    /// All bytes are zero, the value that disables signing on a vehicle.
    #[error(
        "{place} holds only zeros, which is not a key; make one with: downwash signing key FILE"
    )]
    Zero {
        /// The file or variable.
        place: String,
    },
}

impl Key {
    /// Creates a key from its bytes.
    pub const fn new(bytes: [u8; KEY_LEN]) -> Self {
        Self(bytes)
    }

    /// Reads a key from a file that only its owner can access.
    ///
    /// # Errors
    /// [`KeyError`]: the file cannot be read, its mode is too open, or it holds no key.
    pub fn load(path: &Path) -> Result<Self, KeyError> {
        let read = |source| KeyError::Read { path: path.to_owned(), source };
        let file = File::open(path).map_err(read)?;
        // Checks the open file, which nobody can replace any more.
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let mode = file.metadata().map_err(read)?.permissions().mode() & 0o7777;
            if mode & 0o177 != 0 {
                return Err(KeyError::Open { path: path.to_owned(), mode });
            }
        }
        let mut text = Vec::new();
        file.take(FILE_LEN_MAX).read_to_end(&mut text).map_err(read)?;
        Self::parse(&String::from_utf8_lossy(&text), &path.display().to_string())
    }

    /// Parses a key: 64 hexadecimal digits, with white space around them ignored. `place` names the
    /// source in errors.
    ///
    /// # Errors
    /// [`KeyError::Text`] or [`KeyError::Zero`].
    pub fn parse(text: &str, place: &str) -> Result<Self, KeyError> {
        let refused = |found| KeyError::Text { place: place.to_owned(), found };
        let digits: Vec<u32> = text
            .trim()
            .chars()
            .map(|c| c.to_digit(16))
            .collect::<Option<_>>()
            .ok_or_else(|| refused("other characters".to_owned()))?;
        if digits.len() != 2 * KEY_LEN {
            return Err(refused(format!("{} digits", digits.len())));
        }
        let mut bytes = [0; KEY_LEN];
        for (byte, pair) in bytes.iter_mut().zip(digits.chunks_exact(2)) {
            *byte = pair.iter().fold(0, |byte, digit| byte << 4 | *digit as u8);
        }
        if bytes == [0; KEY_LEN] {
            return Err(KeyError::Zero { place: place.to_owned() });
        }
        Ok(Self(bytes))
    }

    /// The secret bytes.
    pub fn bytes(&self) -> &[u8; KEY_LEN] {
        &self.0
    }

    /// The key in the form that [`parse`](Self::parse) reads. It is secret: write it to a key file
    /// only.
    pub fn to_hex(&self) -> String {
        hex(&self.0)
    }

    /// Eight hexadecimal digits that distinguish keys without revealing them.
    pub fn fingerprint(&self) -> String {
        let digest = Sha256::new().chain_update(b"downwash key ").chain_update(self.0).finalize();
        hex(digest.as_slice().get(..4).unwrap_or_default())
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Key({})", self.fingerprint())
    }
}
