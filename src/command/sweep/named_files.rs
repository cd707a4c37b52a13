//! Files by the names that a manifest has for them.

use std::path::{Path, PathBuf};

use super::pattern;

/// The folder that names begin in: the manifest's.
#[derive(Debug)]
pub(super) struct NamedFiles(PathBuf);

impl NamedFiles {
    /// Names that begin in `folder`.
    pub fn of(folder: PathBuf) -> Self {
        Self(folder)
    }

    /// Where the names begin.
    pub fn folder(&self) -> &Path {
        &self.0
    }

    /// A file beside the manifest, else what it is called.
    pub fn resolved(&self, file: &str) -> PathBuf {
        let beside = self.0.join(file);
        if beside.exists() { beside } else { PathBuf::from(file) }
    }

    /// The files that a name with `*` in it fits, else the one that it names.
    pub fn fitting(&self, name: &str) -> Vec<PathBuf> {
        match name.contains('*') {
            true => pattern::fitting(&self.0, name)
                .map(|found| found.iter().map(|name| self.resolved(name)).collect())
                .unwrap_or_default(),
            false => vec![self.resolved(name)],
        }
    }
}
