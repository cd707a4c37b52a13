//! The secret that both ends of a link share, and where it may come from.

use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

/// Bytes of a key.
pub const KEY_LEN: usize = 32;
/// Longest key file.
const FILE_LEN_MAX: u64 = 4096;

/// A secret of 32 bytes. It is shown nowhere: not by `Debug`, and in no error.
#[derive(Clone, PartialEq, Eq)]
pub struct Key([u8; KEY_LEN]);

/// Why there is no key.
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
    /// Others than its owner may read or write the file.
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
    /// The text is no key.
    #[error(
        "{place} holds no signing key: expected 64 hexadecimal digits (32 bytes), found {found}; \
         make one with: downwash signing key FILE"
    )]
    Text {
        /// The file or variable.
        place: String,
        /// What was found, without what it says.
        found: String,
    },
    /// All bytes are zero: what switches signing off on a vehicle.
    #[error("{place} holds only zeros, which is no key; make one with: downwash signing key FILE")]
    Zero {
        /// The file or variable.
        place: String,
    },
}

impl Key {
    /// A key of these bytes.
    pub const fn new(bytes: [u8; KEY_LEN]) -> Self {
        Self(bytes)
    }

    /// Reads a key from a file of its owner alone.
    ///
    /// # Errors
    /// [`KeyError`]: no such file, a mode that lets others in, no key in it.
    pub fn load(path: &Path) -> Result<Self, KeyError> {
        let read = |source| KeyError::Read { path: path.to_owned(), source };
        let file = File::open(path).map_err(read)?;
        // Of the file that is open, which no one can exchange any more.
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

    /// Reads a key as text: 64 hexadecimal digits, white space around them. `place` is where it
    /// stands, for messages.
    ///
    /// # Errors
    /// [`KeyError::Text`], [`KeyError::Zero`].
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

    /// The secret itself.
    pub fn bytes(&self) -> &[u8; KEY_LEN] {
        &self.0
    }

    /// As [`parse`](Self::parse) reads it. A secret: for a key file alone.
    pub fn to_hex(&self) -> String {
        hex(&self.0)
    }

    /// Eight digits that tell keys apart and give nothing of them away.
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
