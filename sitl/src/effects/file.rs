//! The effects file: a TOML table of parameters for each effect, as `[modelled_effects]` of a
//! vehicle file.

use std::path::{Path, PathBuf};

use super::EffectSet;

/// Why an effects file is refused.
#[derive(Debug, thiserror::Error)]
pub enum EffectsFileError {
    /// The file cannot be read.
    #[error("effects file {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not TOML, or holds what is no effect.
    #[error(
        "effects file {path}: {message}; expected a table of parameters for each effect, such as \
         [motor_lag] with tau_s = 0.03"
    )]
    Syntax {
        /// The file.
        path: PathBuf,
        /// What the parser found and where.
        message: String,
    },
}

impl EffectSet {
    /// Reads an effects file.
    ///
    /// # Errors
    /// A file that cannot be read, is not TOML, or holds an effect that is refused.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, EffectsFileError> {
        let path = path.as_ref();
        let text = std::fs::read_to_string(path)
            .map_err(|source| EffectsFileError::Read { path: path.to_owned(), source })?;
        toml::from_str(&text).map_err(|error| EffectsFileError::Syntax {
            path: path.to_owned(),
            message: error.to_string().trim_end().to_owned(),
        })
    }
}
