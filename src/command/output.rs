//! Outputs: files and stdout, and the check that none overwrites an input.

use std::fs;
use std::io::{self, BufWriter, StdoutLock, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};

use sha2::{Digest, Sha256};

use super::{Exit, ExitContext};
use crate::log::descriptor::hex;
use crate::log::partial::{PartialFile, partial_path};

/// Refuses an output file that could not be written, in a folder that does not exist, or that is also
/// an input. Called before the work, so that an error costs no work.
pub(super) fn check_output<'a>(
    out: &Path,
    inputs: impl IntoIterator<Item = &'a Path>,
) -> anyhow::Result<()> {
    refuse_input(out, inputs)?;
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty());
    let why = match folder.filter(|folder| !folder.is_dir()) {
        Some(folder) => format!("there is no folder {}", folder.display()),
        None if out.is_dir() => "expected a file, found a folder".to_owned(),
        None => return Ok(()),
    };
    Err(anyhow!("cannot write {}: {why}", out.display())).or_exit(Exit::Usage)
}

/// Refuses an output that is also an input, which writing would destroy.
pub(super) fn refuse_input<'a>(
    out: &Path,
    inputs: impl IntoIterator<Item = &'a Path>,
) -> anyhow::Result<()> {
    for input in inputs {
        if is_same_file(input, out) || is_same_file(input, &partial_path(out)) {
            let (out, input) = (out.display(), input.display());
            let error = anyhow!(
                "cannot write {out}: it would overwrite the input {input}; choose another output"
            );
            return Err(error).or_exit(Exit::Usage);
        }
    }
    Ok(())
}

/// Whether both name one existing file.
pub(super) fn is_same_file(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

/// Makes the folder for `--report`.
pub(super) fn create_report_folder(folder: Option<&Path>) -> anyhow::Result<()> {
    folder.map_or(Ok(()), |folder| create_folder("--report", folder))
}

/// Makes the folder for the outputs of `flag`, and checks that it takes files. Called before the
/// work, so that an error costs no work.
pub(super) fn create_folder(flag: &str, folder: &Path) -> anyhow::Result<()> {
    fs::create_dir_all(folder)
        .with_context(|| format!("{flag}: cannot create the folder {}", folder.display()))
        .or_exit(Exit::Usage)?;
    let probe = folder.join(format!(".downwash-{}", std::process::id()));
    fs::write(&probe, "")
        .and_then(|()| fs::remove_file(&probe))
        .with_context(|| format!("{flag}: cannot write into the folder {}", folder.display()))
        .or_exit(Exit::Usage)
}

/// SHA-256 in hexadecimal.
pub(super) fn sha256(bytes: impl AsRef<[u8]>) -> String {
    hex(&Sha256::digest(bytes))
}

/// The output of rows: a file that gets its name once it is complete, or stdout.
pub(super) enum Output {
    File(PathBuf, PartialFile),
    Stdout(BufWriter<StdoutLock<'static>>),
}

impl Output {
    /// Opens `path`, or stdout without one.
    pub fn to(path: Option<&Path>) -> anyhow::Result<Self> {
        let Some(path) = path else {
            return Ok(Self::Stdout(BufWriter::new(io::stdout().lock())));
        };
        let file = PartialFile::create(path)
            .with_context(|| format!("cannot create {}", path.display()))?;
        Ok(Self::File(path.to_owned(), file))
    }

    /// Completes the output. Without this call, no file appears.
    pub fn finish(self) -> anyhow::Result<()> {
        match self {
            Self::File(path, file) => {
                file.finish().with_context(|| format!("cannot write {}", path.display()))
            }
            Self::Stdout(mut out) => out.flush().context("standard output"),
        }
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::File(_, file) => file.write(bytes),
            Self::Stdout(out) => out.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::File(_, file) => file.flush(),
            Self::Stdout(out) => out.flush(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn output_path_equal_to_an_input_is_refused() -> anyhow::Result<()> {
        let folder = std::env::temp_dir().join(format!("downwash-output-{}", std::process::id()));
        fs::create_dir_all(&folder)?;
        let [log, other, partial] = ["a.csv", "b.csv", "b.csv.part"].map(|name| folder.join(name));
        fs::write(&log, "log")?;
        fs::write(&partial, "log")?;
        let refused = |out: &Path, input: &Path| refuse_input(out, [input]).is_err();
        let found = [
            refused(&log, &log),
            refused(&folder.join(".").join("a.csv"), &log),
            refused(&other, &partial),
            refused(&other, &log),
        ];
        fs::remove_dir_all(&folder)?;
        assert_eq!(found, [true, true, true, false]);
        Ok(())
    }

    #[test]
    fn output_without_a_folder_is_refused() {
        let folder = std::env::temp_dir();
        let refusal = |out: &Path| check_output(out, []).err().map(|error| error.to_string());
        let missing = refusal(&folder.join("downwash-no-such-folder/a.html")).unwrap_or_default();
        assert!(missing.contains("there is no folder") && missing.contains("a.html"), "{missing}");
        assert!(refusal(&folder).is_some_and(|text| text.contains("found a folder")));
        assert_eq!([folder.join("a.html"), "a.html".into()].map(|out| refusal(&out)), [None, None]);
    }
}
