//! Finds the files that a manifest names.

use std::path::{Path, PathBuf};

use super::pattern;

/// The folder of the manifest, to which names are relative.
#[derive(Debug)]
pub(super) struct NamedFiles(PathBuf);

impl NamedFiles {
    /// Names relative to `folder`.
    pub fn of(folder: PathBuf) -> Self {
        Self(folder)
    }

    /// The folder to which names are relative.
    pub fn folder(&self) -> &Path {
        &self.0
    }

    /// The path of a file beside the manifest; if there is none, the name itself.
    pub fn resolved(&self, file: &str) -> PathBuf {
        let beside = self.0.join(file);
        if beside.exists() { beside } else { PathBuf::from(file) }
    }

    /// The files that match a name with `*`; otherwise the named file.
    pub fn fitting(&self, name: &str) -> Vec<PathBuf> {
        match name.contains('*') {
            true => pattern::fitting(&self.0, name)
                .map(|found| found.iter().map(|name| self.resolved(name)).collect())
                .unwrap_or_default(),
            false => vec![self.resolved(name)],
        }
    }
}
