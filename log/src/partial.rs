//! Files that come into being whole or not at all.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Files that are being written, for an end of the program that drops nothing.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// A file that takes its name once it is complete. Until then it is written beside it, and what
/// had the name before stays; dropped unfinished, it is removed.
pub struct PartialFile {
    out: BufWriter<File>,
    target: PathBuf,
    /// `None` where the target is no regular file, such as a pipe, and is written to directly.
    partial: Option<PathBuf>,
}

impl PartialFile {
    /// Starts a file that is to be at `path`.
    ///
    /// # Errors
    /// If it cannot be created.
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

    /// Gives the complete file its name.
    ///
    /// # Errors
    /// If its end cannot be written, or the name not be taken.
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
            // What is there of it is of no use; that it cannot be removed changes nothing.
            let _ = fs::remove_file(partial);
            forget(partial);
        }
    }
}

/// Removes what is there of files that are not finished. For the end of a program that does not
/// come back to them.
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

/// Where a file that is to be at `path` is written until it is complete.
pub fn partial_path(path: &Path) -> PathBuf {
    let mut partial = followed(path).into_os_string();
    partial.push(".part");
    partial.into()
}

/// Whether something is there that is no regular file, such as a pipe or a device: it is written
/// into and never replaced.
pub fn is_special(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|there| !there.is_file())
}

/// The file that `path` leads to, so that a link stays one.
fn followed(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}
