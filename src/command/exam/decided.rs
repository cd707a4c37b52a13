//! `downwash exam --decide DIR`: stored evidence, decided anew and scored.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};

use crate::cli::ExamArgs;
use crate::command::{Exit, ExitContext, print_json, print_text, write_file};
use crate::diagnose::verdict::calibration::Calibration;
use crate::exam::calibrate::calibrate;
use crate::exam::score::Row;
use crate::exam::stored::StoredCase;
use crate::exam::summary::Summary;
use crate::report::exam;

pub(super) fn run(args: &ExamArgs) -> anyhow::Result<Exit> {
    let cases = stored(&args.decide)?;
    if let Some(path) = &args.calibrate {
        let calibrated = calibrate(&cases).to_string();
        write_file(path, calibrated.as_bytes())?;
        print_text(&calibrated)?;
        return Ok(Exit::Ok);
    }
    let rows: Vec<Row> = cases.iter().map(|case| case.row(Calibration::shipped())).collect();
    let summary = Summary::new(&rows);
    if args.json {
        print_json(&rows)?;
    } else {
        print_text(&exam::text(&summary, &rows))?;
    }
    Ok(if args.fail_on_miss && !summary.holds() { Exit::Check } else { Exit::Ok })
}

/// The cases in these folders, in the order of their names.
fn stored(folders: &[PathBuf]) -> anyhow::Result<Vec<StoredCase>> {
    let mut cases = Vec::new();
    for folder in folders {
        let entries = fs::read_dir(folder)
            .with_context(|| format!("cannot read the folder {}", folder.display()))
            .or_exit(Exit::Usage)?;
        let mut paths =
            entries.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<PathBuf>>>()?;
        paths.retain(|path| path.extension().is_some_and(|extension| extension == "json"));
        paths.sort_unstable();
        for path in &paths {
            cases.push(read(path)?);
        }
    }
    if cases.is_empty() {
        return Err(anyhow!("--decide: the folders hold no case that `exam --evidence` wrote"))
            .or_exit(Exit::Usage);
    }
    Ok(cases)
}

fn read(path: &Path) -> anyhow::Result<StoredCase> {
    let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_slice(&bytes)
        .with_context(|| format!("{}: not a case as `exam --evidence` writes it", path.display()))
        .or_exit(Exit::Usage)
}
