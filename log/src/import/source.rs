//! Detects a file's format from its content.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

use sha2::{Digest, Sha256};
use wire::tlog::Reader;

use super::error::ImportError;
use super::flight::Origin;
use super::{dataflash, foreign, table, ulog};
use crate::descriptor::hex;

/// Bytes at the start of a file that determine its format.
const HEAD: u64 = 256 * 1024;

/// Supported formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    Mcap,
    Tlog,
    Ulog,
    DataFlash,
    Csv,
}

impl Format {
    pub fn name(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Tlog => "tlog",
            Self::Ulog => "ulog",
            Self::DataFlash => "dataflash",
            Self::Csv => "csv",
        }
    }
}

/// Detects the format of a file.
///
/// # Errors
/// The file cannot be read or has no supported format.
pub(super) fn recognise(path: &Path) -> Result<Format, ImportError> {
    let fail = |source| ImportError::Read { path: path.to_owned(), source };
    let mut head = Vec::new();
    File::open(path).map_err(fail)?.take(HEAD).read_to_end(&mut head).map_err(fail)?;
    let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    let extension = extension.as_deref();
    if let Some(found) = foreign::known(&head, extension) {
        return Err(ImportError::not_a_log(path, found.to_owned()));
    }
    let magic = ::mcap::MAGIC;
    if head.starts_with(magic) || magic.starts_with(&head) {
        return Ok(Format::Mcap);
    }
    if head.starts_with(&ulog::MAGIC) {
        return Ok(Format::Ulog);
    }
    if dataflash::begins(&head) {
        return Ok(Format::DataFlash);
    }
    let mut entries = Reader::new(head.as_slice());
    while let Ok(Some(entry)) = entries.read() {
        if entry.time_us.is_some() {
            return Ok(Format::Tlog);
        }
    }
    if dataflash::has_messages(&head) {
        return Ok(Format::DataFlash);
    }
    let found = match text(&head) {
        Some(text) => match foreign::known_text(&text) {
            None if table::looks_like_one(&text) => return Ok(Format::Csv),
            None => "text without a line of numbers",
            Some(found) => found,
        },
        None => {
            "data of another kind: neither a known log's first bytes nor MAVLink frames with \
             timestamps"
        }
    };
    Err(ImportError::not_a_log(path, found.to_owned()))
}

/// Decodes bytes as text in any encoding that tables use. Returns `None` for control characters or
/// invalid bytes.
fn text(head: &[u8]) -> Option<String> {
    let mut bytes = Vec::new();
    table::decoded(head).ok()?.read_to_end(&mut bytes).ok()?;
    let text = match std::str::from_utf8(&bytes) {
        Ok(text) => text.to_owned(),
        // The head may end in the middle of a character.
        Err(error) if error.valid_up_to() + 4 > bytes.len() => {
            String::from_utf8_lossy(bytes.get(..error.valid_up_to())?).into_owned()
        }
        // Names may have an umlaut or a degree sign in a pre-Unicode encoding.
        Err(_) => bytes.iter().map(|byte| char::from(*byte)).collect(),
    };
    let is_plain = |c: char| !c.is_control() || matches!(c, '\t' | '\r' | '\n');
    let strange = text.chars().filter(|c| !c.is_ascii()).count();
    (text.chars().all(is_plain) && 10 * strange <= text.chars().count()).then_some(text)
}

/// The origin of a flight: path, name and hash.
///
/// # Errors
/// The file cannot be read.
pub(super) fn origin(path: &Path, format: Format) -> Result<Origin, ImportError> {
    let sha256 =
        hash(path).map_err(|source| ImportError::Read { path: path.to_owned(), source })?;
    let run = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Origin { path: path.to_owned(), run, sha256, format: format.name() })
}

/// Gives logs of different paths different names. `a/1.ulg` and `b/1.ulg` share the file stem `1`,
/// and get the shortest ends of their paths that differ, here the whole paths.
pub fn tell_apart<'a>(logs: impl IntoIterator<Item = (&'a mut String, &'a Path)>) {
    let logs: Vec<(&mut String, &Path)> = logs.into_iter().collect();
    let mut paths: BTreeMap<String, BTreeSet<&Path>> = BTreeMap::new();
    for (name, path) in &logs {
        paths.entry((*name).clone()).or_default().insert(*path);
    }
    for (name, path) in logs {
        let Some(namesakes) = paths.get(name.as_str()).filter(|paths| paths.len() > 1) else {
            continue;
        };
        let differ = |parts: &usize| {
            let ends: BTreeSet<PathBuf> = namesakes.iter().map(|path| end(path, *parts)).collect();
            ends.len() == namesakes.len()
        };
        let most = path.components().count();
        *name = end(path, (1..most).find(differ).unwrap_or(most)).display().to_string();
    }
}

/// The last parts of a path.
fn end(path: &Path, parts: usize) -> PathBuf {
    let mut last: Vec<Component<'_>> = path.components().rev().take(parts).collect();
    last.reverse();
    last.into_iter().collect()
}

fn hash(path: &Path) -> io::Result<String> {
    let mut file = File::open(path)?;
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match file.read(&mut buffer) {
            Ok(0) => return Ok(hex(&hasher.finalize())),
            Ok(count) => hasher.update(&buffer[..count]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_names_of_different_files_become_ends_of_their_paths() {
        let files = ["x/a/1.ulg", "x/b/1.ulg", "b/2.ulg", "b/2.ulg", "3.ulg", "b/3.ulg"];
        let mut names = ["1", "1", "2", "2", "3", "3"].map(str::to_owned);
        tell_apart(names.iter_mut().zip(files.map(Path::new)));
        assert_eq!(names, ["a/1.ulg", "b/1.ulg", "2", "2", "3.ulg", "b/3.ulg"]);
    }
}
