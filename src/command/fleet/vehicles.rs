//! The vehicles of a fleet and their logs.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde::Deserialize;

/// A vehicle of a fleet, as the user names it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Given {
    /// Its name.
    pub name: String,
    /// Its logs, in the order of their names.
    pub logs: Vec<PathBuf>,
}

/// The TOML file of a fleet.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    vehicles: BTreeMap<String, Logs>,
}

/// A file or folder, or several.
#[derive(Deserialize)]
#[serde(untagged)]
enum Logs {
    One(PathBuf),
    Several(Vec<PathBuf>),
}

/// The vehicles of a folder or of a TOML file, by name.
pub(super) fn vehicles(source: &Path) -> anyhow::Result<Vec<Given>> {
    let found = if source.is_dir() { in_folder(source)? } else { in_manifest(source)? };
    if found.len() < 2 {
        bail!(
            "{}: expected at least two vehicles, found {}; for one vehicle, give its logs without \
             --fleet",
            source.display(),
            found.len()
        );
    }
    Ok(found)
}

fn in_folder(folder: &Path) -> anyhow::Result<Vec<Given>> {
    let mut found = Vec::new();
    for path in entries(folder)?.into_iter().filter(|path| path.is_dir()) {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let logs = files(&path)?;
        if logs.is_empty() {
            bail!("{}: expected the logs of a vehicle, found no file", path.display());
        }
        found.push(Given { name, logs });
    }
    Ok(found)
}

fn in_manifest(path: &Path) -> anyhow::Result<Vec<Given>> {
    let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let manifest: Manifest = toml::from_str(&text).with_context(|| path.display().to_string())?;
    let folder = path.parent().unwrap_or_else(|| Path::new(""));
    let mut found = Vec::new();
    for (name, logs) in manifest.vehicles {
        let given = match logs {
            Logs::One(one) => vec![one],
            Logs::Several(several) => several,
        };
        let mut logs = Vec::new();
        for log in given {
            let log = folder.join(log);
            if log.is_dir() { logs.extend(files(&log)?) } else { logs.push(log) }
        }
        if logs.is_empty() {
            bail!("{}: {name}: expected at least one log, found none", path.display());
        }
        found.push(Given { name, logs });
    }
    Ok(found)
}

/// Files of a folder that are not hidden, by name.
fn files(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    Ok(entries(folder)?.into_iter().filter(|path| path.is_file()).collect())
}

fn entries(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let read = fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut paths = Vec::new();
    for entry in read {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        let is_hidden =
            path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if !is_hidden {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_manifest_list_the_same_vehicles() -> anyhow::Result<()> {
        let folder = std::env::temp_dir().join(format!("downwash-fleet-{}", std::process::id()));
        for name in ["b", "a"] {
            fs::create_dir_all(folder.join(name))?;
            fs::write(folder.join(name).join("1.tlog"), b"")?;
            fs::write(folder.join(name).join(".hidden"), b"")?;
        }
        let by_folder = vehicles(&folder)?;
        let manifest = folder.join("fleet.toml");
        fs::write(&manifest, "[vehicles]\na = \"a\"\nb = [\"b/1.tlog\"]\n")?;
        let by_manifest = vehicles(&manifest)?;
        fs::write(&manifest, "[vehicles]\na = \"a\"\n")?;
        let alone = vehicles(&manifest);
        fs::remove_dir_all(&folder)?;
        assert_eq!(by_folder, by_manifest);
        assert_eq!(by_folder.iter().map(|v| v.name.as_str()).collect::<Vec<_>>(), ["a", "b"]);
        assert_eq!(by_folder[0].logs.len(), 1);
        assert!(alone.is_err());
        Ok(())
    }
}
