//! The candidate of an exam: a process that sees only a case's files.

use std::fs;
use std::io::{self, Read};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use anyhow::{Context, anyhow};
use vehicle::VehicleParams;
use vehicle::effects::{EffectId, EffectSet};

use crate::command::logs::open_for;
use crate::command::{program, write_file};
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::likelihood::noise::ReportNoise;
use crate::exam::answer::GivenAnswer;
use crate::exam::case::Case;
use crate::exam::closure::closure;
use crate::exam::key::KeyEntry;

/// Where a diagnosis leaves its evidence.
pub(super) const EVIDENCE: &str = "evidence.json";
/// Period of checks whether a diagnosis has ended, or the exam is interrupted.
const ENDED_PERIOD: Duration = Duration::from_millis(20);

/// A case whose logs are on disk, and the parts of it that stay in memory.
pub(in crate::command) struct Flown {
    pub name: String,
    known: VehicleParams,
    truth: EffectSet,
    pub key: KeyEntry,
    noise: ReportNoise,
    logs: usize,
}

/// What a diagnosis receives of a case.
pub(in crate::command) struct Sheet<'a> {
    /// Where the vehicle file and the logs are.
    pub folder: &'a Path,
    pub logs: &'a [String],
    /// The held-out logs; if empty, the last one.
    pub holdout: &'a [String],
    /// Effects that it must not use.
    pub without: &'a [String],
    /// Whether it leaves its evidence in the folder.
    pub evidence: bool,
}

/// The settings of the process.
pub(in crate::command) struct Candidate<'a> {
    /// The `--twins` of `diagnose`; `None` omits the flag.
    pub twins: Option<u32>,
    /// Number of its threads.
    pub threads: usize,
    /// Ends the process once set.
    pub interrupted: &'a AtomicBool,
}

impl Flown {
    /// Writes what a diagnosis may see of a case into a new folder.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn write(name: &str, case: Case, folder: &Path) -> anyhow::Result<Self> {
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot create the folder {}", folder.display()))?;
        let vehicle = serde_json::to_vec_pretty(&case.nominal).context("vehicle.json")?;
        write_file(&folder.join("vehicle.json"), &vehicle)?;
        for (log, bytes) in log_names(case.logs.len()).zip(&case.logs) {
            write_file(&folder.join(log), bytes)?;
        }
        Ok(Self {
            name: name.to_owned(),
            known: case.known,
            truth: case.truth,
            key: case.key,
            noise: case.noise,
            logs: case.logs.len(),
        })
    }

    /// The names of its logs.
    pub fn logs(&self) -> Vec<String> {
        log_names(self.logs).collect()
    }

    /// The share of the effects' own gap on the held-out flight that the answer truly closes, given
    /// the true values of the named effects that exist. `None` if the answer names nothing, or if
    /// the truth is outside the catalogue.
    pub fn closed(&self, folder: &Path, given: &GivenAnswer) -> Option<f64> {
        let last = log_names(self.logs).last()?;
        if self.truth.is_empty() || given.verdict != "effect" {
            return None;
        }
        let flight = open_for(&folder.join(last), None, &self.known).ok()?;
        let held_out = [PreparedFlight::new(flight, &self.known).ok()?];
        let is_there =
            |id: EffectId| self.truth.iter().any(|(true_id, _)| true_id.class() == id.class());
        let mut answer = given.effect_set();
        EffectId::ALL.into_iter().filter(|id| !is_there(*id)).for_each(|id| answer.remove(id));
        closure(&self.known, &self.truth, &answer, &held_out, &self.noise).ok()?
    }
}

impl Candidate<'_> {
    /// The answer of a process that sees only the case's files; `None` if interrupted.
    ///
    /// # Errors
    /// A process that cannot be started, or ends without an answer.
    pub fn answer(&self, sheet: &Sheet<'_>) -> anyhow::Result<Option<Vec<u8>>> {
        let mut command = Command::new(program()?);
        command
            .env_clear()
            .env("RAYON_NUM_THREADS", self.threads.to_string())
            .current_dir(sheet.folder)
            // Ctrl-C goes to this process only, which ends the others.
            .process_group(0)
            .args(["diagnose", "--json", "--vehicle", "vehicle.json"])
            .args(sheet.logs);
        for log in sheet.holdout {
            command.args(["--holdout", log]);
        }
        if let Some(twins) = self.twins {
            command.args(["--twins", &twins.to_string()]);
        }
        if sheet.evidence {
            command.args(["--evidence", EVIDENCE]);
        }
        for effect in sheet.without {
            command.args(["--without", effect]);
        }
        let output = self.output(&mut command).context("cannot run the diagnosis")?;
        let Some(output) = output else { return Ok(None) };
        if !output.status.success() {
            let errors = String::from_utf8_lossy(&output.stderr);
            let last = errors.lines().last().unwrap_or_default();
            return Err(anyhow!("the diagnosis ended with {}: {last}", output.status));
        }
        Ok(Some(output.stdout))
    }

    /// Runs a process to its end; kills it and returns `None` if interrupted.
    fn output(&self, command: &mut Command) -> io::Result<Option<Output>> {
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut process = command.spawn()?;
        let (stdout, stderr) = (process.stdout.take(), process.stderr.take());
        thread::scope(|scope| {
            let stdout = scope.spawn(|| read_all(stdout));
            let stderr = scope.spawn(|| read_all(stderr));
            let status = loop {
                if let Some(status) = process.try_wait()? {
                    break Some(status);
                }
                if self.interrupted.load(Ordering::Relaxed) {
                    process.kill()?;
                    process.wait()?;
                    break None;
                }
                thread::sleep(ENDED_PERIOD);
            };
            let joined = |pipe: thread::ScopedJoinHandle<'_, io::Result<Vec<u8>>>| match pipe.join()
            {
                Ok(bytes) => bytes,
                Err(panic) => std::panic::resume_unwind(panic),
            };
            let (stdout, stderr) = (joined(stdout)?, joined(stderr)?);
            Ok(status.map(|status| Output { status, stdout, stderr }))
        })
    }
}

fn read_all(pipe: Option<impl Read>) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    if let Some(mut pipe) = pipe {
        pipe.read_to_end(&mut bytes)?;
    }
    Ok(bytes)
}

/// Names of a case's logs.
pub(super) fn log_names(count: usize) -> impl Iterator<Item = String> {
    (1..=count).map(|number| format!("flight_{number}.tlog"))
}
