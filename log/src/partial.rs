//! Files that appear complete or not at all.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Files in progress, for an exit of the program that runs no destructors.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// A file that gets its name once it is complete. Until then it is a separate file next to the
/// target, and an existing target stays. Dropping it unfinished removes it.
pub struct PartialFile {
    out: BufWriter<File>,
    target: PathBuf,
    /// `None` if the target is not a regular file, such as a pipe, and is written directly.
    partial: Option<PathBuf>,
}

impl PartialFile {
    /// Starts a file with the final name `path`.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn create(path: &Path) -> io::Result<Self> {
        if is_special(path) {
            let out = BufWriter::new(File::create(path)?);
            return Ok(Self { out, target: path.to_owned(), partial: None });
        }
        let target = followed(path);
        let partial = partial_path(&target);
        let out = BufWriter::new(File::create(&partial)?);
        unfinished(|files| files.push(partial.clone()));
        Ok(Self { out, target, partial: Some(partial) })
    }

    /// Flushes the file and renames it to its final name.
    ///
    /// # Errors
    /// The file cannot be flushed or renamed.
    pub fn finish(mut self) -> io::Result<()> {
        self.out.flush()?;
        if let Some(partial) = &self.partial {
            fs::rename(partial, &self.target)?;
            forget(partial);
        }
        self.partial = None;
        Ok(())
    }
}

impl Write for PartialFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.out.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

impl Drop for PartialFile {
    fn drop(&mut self) {
        if let Some(partial) = &self.partial {
            // The partial content is useless; a failure to remove it changes nothing.
            let _ = fs::remove_file(partial);
            forget(partial);
        }
    }
}

/// Removes unfinished files. For the exit of a program that does not return to them.
pub fn discard_unfinished() {
    unfinished(|files| {
        for partial in files.drain(..) {
            let _ = fs::remove_file(partial);
        }
    });
}

fn forget(partial: &Path) {
    unfinished(|files| files.retain(|file| file != partial));
}

fn unfinished(change: impl FnOnce(&mut Vec<PathBuf>)) {
    change(&mut UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner));
}

/// Path of the partial file for the target `path`.
pub fn partial_path(path: &Path) -> PathBuf {
    let mut partial = followed(path).into_os_string();
    partial.push(".part");
    partial.into()
}

/// Whether `path` exists and is not a regular file, such as a pipe or a device. It is then written
/// in place and never replaced.
pub fn is_special(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|there| !there.is_file())
}

/// Resolves links in `path`, so that a link remains one.
fn followed(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}
