//! File name patterns with `*`.

use std::fs;
use std::path::Path;

use anyhow::{Context, bail};

/// The files and folders below `folder` that match a pattern, in the order of their names. Each
/// part of the path may contain `*`, which matches any text. Names that begin with a dot are hidden
/// and do not match.
///
/// # Errors
/// A folder cannot be read, or nothing matches.
pub(super) fn fitting(folder: &Path, pattern: &str) -> anyhow::Result<Vec<String>> {
    let root = if pattern.starts_with('/') { "/" } else { "" };
    let mut found = vec![root.to_owned()];
    for part in pattern.split('/').filter(|part| !part.is_empty()) {
        let mut next = Vec::new();
        for before in found {
            let join = |name: &str| match before.as_str() {
                "" | "/" => format!("{before}{name}"),
                before => format!("{before}/{name}"),
            };
            if !part.contains('*') {
                let path = join(part);
                next.extend(folder.join(&path).exists().then_some(path));
                continue;
            }
            let inside = folder.join(&before);
            // A file has nothing inside.
            if inside.is_file() {
                continue;
            }
            let inside = if inside.as_os_str().is_empty() { Path::new(".") } else { &inside };
            for entry in fs::read_dir(inside).with_context(|| inside.display().to_string())? {
                let name = entry.with_context(|| inside.display().to_string())?.file_name();
                let name = name.to_string_lossy();
                if !name.starts_with('.') && fits(part, &name) {
                    next.push(join(&name));
                }
            }
        }
        found = next;
    }
    found.sort();
    if found.is_empty() {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        bail!("{pattern:?}: expected at least one file in {}, found none", folder.display());
    }
    Ok(found)
}

/// Whether a name matches `pattern`.
fn fits(pattern: &str, name: &str) -> bool {
    let Some((first, rest)) = pattern.split_once('*') else { return pattern == name };
    let Some(mut left) = name.strip_prefix(first) else { return false };
    let mut parts: Vec<&str> = rest.split('*').collect();
    let last = parts.pop().unwrap_or_default();
    for part in parts {
        // The earliest match leaves the most text for the rest of the pattern.
        let Some(at) = left.find(part) else { return false };
        left = &left[at + part.len()..];
    }
    left.ends_with(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn star_matches_any_text() {
        for (pattern, name) in [("*", ""), ("*.ulg", "a.ulg"), ("a*b*c", "aXbbYc"), ("a", "a")] {
            assert!(fits(pattern, name), "{pattern} {name}");
        }
        for (pattern, name) in [("*.ulg", "a.ulg2"), ("a*b*c", "acb"), ("ab*bc", "abc"), ("a", "b")]
        {
            assert!(!fits(pattern, name), "{pattern} {name}");
        }
    }

    #[test]
    fn matching_files_are_sorted_by_name() -> anyhow::Result<()> {
        let folder = std::env::temp_dir().join(format!("downwash-pattern-{}", std::process::id()));
        for name in ["b/2.ulg", "b/1.ulg", "a/3.ulg", "a/3.txt", "c.ulg", ".d/4.ulg"] {
            let path = folder.join(name);
            fs::create_dir_all(path.parent().unwrap_or(&folder))?;
            fs::write(path, "")?;
        }
        let found = fitting(&folder, "*/*.ulg");
        let none = fitting(&folder, "*/*.bin");
        let absolute = fitting(Path::new(""), &format!("{}/b", folder.display()));
        fs::remove_dir_all(&folder)?;
        assert_eq!(found?, ["a/3.ulg", "b/1.ulg", "b/2.ulg"]);
        assert!(none.is_err());
        assert_eq!(absolute?, [format!("{}/b", folder.display())]);
        Ok(())
    }
}
