//! Recognises a programme's flight in a log, and whether the log holds all of it.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use rayon::prelude::*;
use sha2::{Digest, Sha256};

use crate::command::simulation::Truth;
use crate::command::vehicle_file::VehicleFile;
use crate::command::{error_text, print_status};
use crate::config::Config;
use crate::log::LogReader;
use crate::log::descriptor::hex;
use crate::log::info::{LogInfo, TrackingInfo};
use crate::plan::programme::ProgrammeFlight;

/// Key of a log's metadata for the flight and the programme that it holds.
const FINGERPRINT: &str = "collect_flight";
/// A whole log lacks at most this much of the trajectory, s.
const MISSING_MAX_S: f64 = 0.25;
/// The inputs that identify a flight.
pub(super) struct Identity<'a> {
    pub config: &'a Config,
    pub vehicle: &'a VehicleFile,
    pub truth: Option<&'a Truth>,
    pub seed: u64,
}

impl Identity<'_> {
    /// A digest of everything that the flight depends on.
    pub fn fingerprint(&self, flight: &ProgrammeFlight) -> anyhow::Result<String> {
        let mut parts = vec![flight.name.clone(), flight.text.clone(), self.vehicle.text.clone()];
        match self.truth {
            Some(truth) => {
                parts.push(self.seed.to_string());
                parts.push(self.config.to_toml());
                parts.push(truth.effects_text()?);
                parts.push(truth.onsets_text()?);
                parts.push(toml::to_string(&truth.config).context("the SITL configuration")?);
            }
            // Another link or other gains do not make it another flight.
            None => parts.push("real".to_owned()),
        }
        let mut digest = Sha256::new();
        for part in &parts {
            digest.update((part.len() as u64).to_le_bytes());
            digest.update(part.as_bytes());
        }
        Ok(hex(&digest.finalize()))
    }
}

/// What a log holds of a flight.
pub(super) struct LogOf {
    pub path: PathBuf,
    finished: bool,
    pub tracked_s: f64,
    pub tracking: Option<TrackingInfo>,
}

impl LogOf {
    /// Reads a log.
    pub fn read(path: &Path) -> anyhow::Result<(Option<String>, Self)> {
        let mut reader = LogReader::open(path)?;
        let info = LogInfo::read(&mut reader)?;
        let track = info.phases.iter().filter(|phase| phase.name == "track");
        let log = Self {
            path: path.to_owned(),
            finished: info.finished && info.damaged == 0,
            // The empty sum of f64 is -0.
            tracked_s: track.fold(0.0, |sum, phase| sum + phase.duration_s),
            tracking: info.tracking,
        };
        Ok((info.run.get(FINGERPRINT).cloned(), log))
    }

    pub fn is_complete(&self, length_s: f64) -> bool {
        self.finished && self.tracked_s >= length_s - MISSING_MAX_S
    }
}

/// The logs in a folder that hold flights of a programme, by fingerprint, in the order of their
/// names.
pub(super) fn logs_of_flights(folder: &Path) -> anyhow::Result<BTreeMap<String, Vec<LogOf>>> {
    let context = || format!("cannot read the folder {}", folder.display());
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).with_context(context)? {
        let path = entry.with_context(context)?.path();
        if path.extension().is_some_and(|extension| extension == "mcap") {
            paths.push(path);
        }
    }
    paths.sort();
    let mut logs: BTreeMap<String, Vec<LogOf>> = BTreeMap::new();
    let read: Vec<_> = paths.par_iter().map(|path| LogOf::read(path)).collect();
    for (path, read) in paths.iter().zip(read) {
        match read {
            Ok((Some(fingerprint), log)) => logs.entry(fingerprint).or_default().push(log),
            Ok((None, _)) => {}
            Err(error) => {
                print_status(format_args!(
                    "{}: left alone: {}",
                    path.display(),
                    error_text(&error)
                ));
            }
        }
    }
    Ok(logs)
}

/// What a flight's log says about its place in the programme.
pub(super) fn metadata(flight: &ProgrammeFlight, fingerprint: &str) -> BTreeMap<String, String> {
    BTreeMap::from([
        (FINGERPRINT.to_owned(), fingerprint.to_owned()),
        ("collect_kind".to_owned(), flight.kind.name().to_owned()),
        ("trajectory".to_owned(), flight.text.clone()),
    ])
}
