//! The rows of many flights in a folder: one file for each shard, which grows by whole lines only,
//! so any worker may die at any time.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions};
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::{Exit, print_status};
use crate::cli::Shard;

/// Prints how to continue an interrupted run.
pub fn interrupted(out: &Path) -> Exit {
    print_status(format_args!(
        "run the same command again to continue with the rows in {}",
        out.display()
    ));
    Exit::Interrupted
}

/// A row of a shard's file.
pub trait Numbered: Serialize + DeserializeOwned {
    /// Its number among all rows.
    fn number(&self) -> usize;
}

/// The identity of a folder's rows.
#[derive(Debug, Deserialize, PartialEq, Serialize)]
pub struct Header {
    pub schema: String,
    pub schema_version: u32,
    pub version: String,
    /// Hash of everything on which the rows depend.
    pub manifest_sha256: String,
    pub points: usize,
}

/// A folder of rows.
pub struct Folder<L> {
    path: PathBuf,
    rows: PhantomData<L>,
}

impl<L: Numbered> Folder<L> {
    /// Opens or makes the folder; `file` identifies its rows.
    pub fn open(path: &Path, file: &str, header: &Header) -> anyhow::Result<Self> {
        fs::create_dir_all(path)
            .with_context(|| format!("cannot create the folder {}", path.display()))?;
        let file = path.join(file);
        if !file.exists() {
            let text = serde_json::to_string_pretty(header).context("the header")? + "\n";
            Self::replace(&file, text.as_bytes())?;
        }
        let text = fs::read_to_string(&file).with_context(|| file.display().to_string())?;
        let found: Header =
            serde_json::from_str(&text).with_context(|| file.display().to_string())?;
        if found != *header {
            bail!(
                "{} holds rows of another {}: {} points of {} by version {}, expected {} of {} by {}; \
                 give another --out",
                path.display(),
                header.schema.trim_start_matches("downwash."),
                found.points,
                found.manifest_sha256,
                found.version,
                header.points,
                header.manifest_sha256,
                header.version
            );
        }
        Ok(Self { path: path.to_owned(), rows: PhantomData })
    }

    /// Writes a file whole, even if other workers write it too.
    pub fn replace(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let unique = format!(".{name}.{}.part", std::process::id());
        let partial = path.with_file_name(unique);
        let write = || fs::write(&partial, bytes).and_then(|()| fs::rename(&partial, path));
        write().with_context(|| format!("cannot write {}", path.display()))
    }

    /// The numbers of the points that have a row.
    pub fn done(&self) -> anyhow::Result<BTreeSet<usize>> {
        let mut done = BTreeSet::new();
        self.read(|line| {
            done.insert(line.number());
        })?;
        Ok(done)
    }

    /// Every row, in the order of the points.
    pub fn rows(&self) -> anyhow::Result<BTreeMap<usize, L>> {
        let mut rows = BTreeMap::new();
        self.read(|line| {
            rows.insert(line.number(), line);
        })?;
        Ok(rows)
    }

    /// Passes every whole line to `show`; skips the partial line of a worker that died.
    fn read(&self, mut show: impl FnMut(L)) -> anyhow::Result<()> {
        let entries = fs::read_dir(&self.path).with_context(|| self.path.display().to_string())?;
        for entry in entries {
            let path = entry.with_context(|| self.path.display().to_string())?.path();
            if path.extension().is_none_or(|extension| extension != "jsonl") {
                continue;
            }
            let file = File::open(&path).with_context(|| path.display().to_string())?;
            for text in BufReader::new(file).split(b'\n') {
                let text = text.with_context(|| path.display().to_string())?;
                if let Ok(line) = serde_json::from_slice(&text) {
                    show(line);
                }
            }
        }
        Ok(())
    }

    /// Opens a shard's file to add rows to.
    pub fn append(&self, shard: Shard) -> anyhow::Result<Rows<L>> {
        let path = self.path.join(format!("rows-{}-of-{}.jsonl", shard.index, shard.count));
        let open = || -> std::io::Result<File> {
            let mut file = OpenOptions::new().create(true).read(true).append(true).open(&path)?;
            let mut last = [b'\n'];
            if file.metadata()?.len() > 0 {
                file.seek(SeekFrom::End(-1))?;
                file.read_exact(&mut last)?;
            }
            // A worker died while it wrote a line.
            if last != [b'\n'] {
                file.write_all(b"\n")?;
            }
            Ok(file)
        };
        let file = open().with_context(|| format!("cannot open {}", path.display()))?;
        Ok(Rows { file, path, rows: PhantomData })
    }
}

/// A shard's file.
pub struct Rows<L> {
    file: File,
    path: PathBuf,
    rows: PhantomData<L>,
}

impl<L: Numbered> Rows<L> {
    /// Adds a row in one write.
    pub fn add(&mut self, line: &L) -> anyhow::Result<()> {
        let mut text = serde_json::to_vec(line).context("a row")?;
        text.push(b'\n');
        self.file.write_all(&text).with_context(|| format!("cannot write {}", self.path.display()))
    }
}
