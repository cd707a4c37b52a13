//! `downwash train`: from flight logs to a model file and a report.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, anyhow, bail};
use vehicle::VehicleParams;

use super::logs::{Logs, check_named, listed};
use super::output::{check_output, create_report_folder, sha256};
use super::progress::StageBar;
use super::vehicle_file::warn;
use super::{
    Exit, ExitContext, Interruption, error_text, model, print_json, print_status, print_text,
    write_file,
};
use crate::cli::{FeatureChoice, MethodChoice, TrainArgs};
use crate::learn::commands::Onboard;
use crate::learn::dataset::WindowSettings;
use crate::learn::error::TrainError;
use crate::learn::judgement::{Best, standing};
use crate::learn::networks::Progress;
use crate::learn::networks::Watch as _;
use crate::learn::procedure::{Outcome, belongs, train};
use crate::learn::summary::{TrainSettings, TrainingSummary};
use crate::learn::training::Method;
use crate::learn::training_set::TrainingSet;
use crate::model::features::Features;

pub(super) fn run(args: &TrainArgs, interruption: &Interruption) -> anyhow::Result<Exit> {
    let resume = if args.resume { Resume::Always } else { Resume::Never };
    let Trained { summary, report } = match learn(args, resume, &interruption.flag())? {
        Learning::Done(trained) => *trained,
        Learning::Interrupted(checkpoint) => {
            print_status(format_args!(
                "run the same command with --resume to continue from {}",
                checkpoint.display()
            ));
            return Ok(Exit::Interrupted);
        }
    };
    if args.json {
        print_json(&summary)?;
    } else {
        let mut text = model::summary_text(&summary);
        text += &format!("model   {}\n", args.out.display());
        if let Some(page) = report {
            text += &format!("report  {}\n", page.display());
        }
        print_text(&text)?;
    }
    Ok(Exit::Ok)
}

/// The results of a training besides its model file.
pub struct Trained {
    /// The data and the errors.
    pub summary: TrainingSummary,
    /// The report's page, if requested.
    pub report: Option<PathBuf>,
}

/// How a training ended.
pub enum Learning {
    /// The model file is written.
    Done(Box<Trained>),
    /// The progress is in this checkpoint.
    Interrupted(PathBuf),
}

/// Whether a training goes on from the checkpoint beside its model file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Resume {
    /// Begins anew.
    Never,
    /// Continues; a missing or damaged checkpoint, or one of another training, is an error.
    Always,
    /// Continues if there is a checkpoint of this training.
    IfItBelongs,
}

/// An interrupted training.
struct Earlier {
    resume: Resume,
    /// Its progress, until a training takes it.
    progress: Option<Progress>,
}

/// Checks the flags before the training, so that an error costs no work.
fn check(args: &TrainArgs) -> anyhow::Result<()> {
    let weight = args.regularization.iter().find(|weight| !(0.0..1.0).contains(*weight));
    if let Some(weight) = weight {
        bail!("--regularization: expected at least 0 and below 1, found {weight}");
    }
    if let Some(window) = args.window.iter().find(|w| !(1.0..=200.0).contains(*w)) {
        bail!("--window: expected 1 to 200 ms, found {window}");
    }
    Ok(())
}

/// Trains, and writes the model file and the report. Ignores `args.resume`, which the caller turns
/// into `resume`.
///
/// # Errors
/// Flags that fit no training, or no usable log.
pub fn learn(
    args: &TrainArgs,
    resume: Resume,
    interrupted: &Arc<AtomicBool>,
) -> anyhow::Result<Learning> {
    let checkpoint_path = checkpoint_path(&args.out);
    let inputs = || args.logs.iter().chain([&args.vehicle]).chain(&args.mapping);
    for out in [&args.out, &checkpoint_path] {
        check_output(out, inputs().map(PathBuf::as_path))?;
    }
    let vehicle = VehicleParams::load(&args.vehicle).or_exit(Exit::Usage)?;
    warn(&args.vehicle, &vehicle);
    let onboard = Onboard::new(&vehicle).or_exit(Exit::Usage)?;
    check(args).or_exit(Exit::Usage)?;
    check_named(&args.logs, args.mapping.as_deref())?;
    create_report_folder(args.report.as_deref())?;
    if let Some(threads) = args.threads.map(usize::from) {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().context("threads")?;
    }
    let progress = match resume {
        Resume::Never => None,
        Resume::Always => Some(load_checkpoint(&checkpoint_path)?),
        Resume::IfItBelongs => load_checkpoint(&checkpoint_path).ok(),
    };
    let mut earlier = Earlier { resume, progress };

    let mut bar = StageBar::new(Arc::clone(interrupted));
    let windows_of =
        |window: &f64| WindowSettings { half_s: window * 1e-3, ..WindowSettings::default() };
    let (first, others) = args
        .window
        .split_first()
        .context("--window: expected at least one")
        .or_exit(Exit::Usage)?;
    let mut logs = read(args, &vehicle, &onboard, &windows_of(first), &mut bar)?;
    let (mut windows, mut others) = (windows_of(first), others.iter());
    let mut best = None;
    let (standing, done) = loop {
        let done = match train_with(
            args,
            &vehicle,
            &onboard,
            &windows,
            &mut logs,
            &mut earlier,
            &mut bar,
        ) {
            Ok(Outcome::Done(done)) => done,
            Ok(Outcome::Interrupted(reached)) => {
                bar.clear();
                // A checkpoint that was not reached yet belongs to a later window, and holds more.
                if earlier.progress.is_none() {
                    keep(&reached, &checkpoint_path)?;
                }
                return Ok(Learning::Interrupted(checkpoint_path));
            }
            // Another window may leave too few rows; the earlier result remains.
            Err(error) => {
                let Some(found) = best.take() else { return Err(error) };
                bar.clear();
                print_status(format_args!(
                    "warning: with the window of {:.1} ms: {}; using the earlier window's models",
                    1e3 * windows.half_s,
                    error_text(&error)
                ));
                break found;
            }
        };
        let standing = standing(&done.1);
        let settled = standing.settled;
        let found = match best.take() {
            Some((before, done)) if !standing.beats(&before) => (before, done),
            _ => (standing, done),
        };
        let Some(next) = others.next().filter(|_| !settled) else { break found };
        best = Some(found);
        windows = windows_of(next);
        bar.stage("logs", logs.flights.len() as u64);
        logs.observe(&vehicle, &windows, |path| bar.step(&path.display().to_string()));
    };
    bar.clear();
    match standing.best {
        Best::NotFinite => {
            let reason = standing.best.reason().unwrap_or_default();
            return Err(TrainError::NotFinite { reason }).or_exit(Exit::Usage);
        }
        Best::NoBetterThanHolding => {
            let reason = standing.best.reason().unwrap_or_default();
            print_status(format_args!(
                "warning: {reason}; check the logs with `downwash log audit`, or give more flights"
            ));
        }
        Best::NotJudged | Best::Better => {}
    }
    let (mut file, summary) = *done;
    file.training = serde_json::to_value(&summary).context("summary")?;
    write_file(&args.out, &file.to_bytes().context("the model")?)?;
    if checkpoint_path.exists() {
        fs::remove_file(&checkpoint_path)
            .with_context(|| format!("cannot remove {}", checkpoint_path.display()))?;
    }
    let mut report = None;
    if let Some(folder) = &args.report {
        let page = folder.join("report.html");
        write_file(&page, crate::report::training::html(&summary).as_bytes())?;
        let json = serde_json::to_vec_pretty(&summary).context("report.json")?;
        write_file(&folder.join("report.json"), &json)?;
        report = Some(page);
    }
    Ok(Learning::Done(Box::new(Trained { summary, report })))
}

/// Reads the logs and observes them by the first window.
fn read(
    args: &TrainArgs,
    vehicle: &VehicleParams,
    onboard: &Onboard,
    windows: &WindowSettings,
    bar: &mut StageBar,
) -> anyhow::Result<Logs> {
    bar.stage("logs", args.logs.len() as u64);
    let mapping = args.mapping.as_deref();
    let logs = Logs::read(&args.logs, mapping, vehicle, onboard, windows, |path| {
        bar.step(&path.display().to_string());
    });
    if logs.flights.is_empty() {
        bar.clear();
        return Err(anyhow!("none of the logs can be used: {}", listed(&args.logs)))
            .or_exit(Exit::Usage);
    }
    Ok(logs)
}

/// Trains with labels of one window. Takes the earlier progress if it is of this training and window.
fn train_with(
    args: &TrainArgs,
    vehicle: &VehicleParams,
    onboard: &Onboard,
    windows: &WindowSettings,
    logs: &mut Logs,
    earlier: &mut Earlier,
    bar: &mut StageBar,
) -> anyhow::Result<Outcome> {
    let settings = TrainSettings {
        features: match args.features {
            FeatureChoice::World => Features::World,
            FeatureChoice::Heading => Features::Heading,
            FeatureChoice::Body => Features::Body,
        },
        hidden: usize::from(args.hidden),
        passes: args.passes as usize,
        method: match args.method {
            MethodChoice::Adam => Method::Adam,
            MethodChoice::Rprop => Method::Rprop,
        },
        regularization: args.regularization.clone(),
        seed: args.seed,
        window_half_s: windows.half_s,
        windows_half_s: args.window.iter().map(|window| window * 1e-3).collect(),
    };
    bar.stage("physics", 1);
    let names = listed(&args.logs);
    let set = TrainingSet::new(vehicle, onboard, &mut logs.flights)
        .with_context(|| names.clone())
        .or_exit(Exit::Usage)?;
    let Earlier { resume, progress } = earlier;
    if progress.as_ref().is_some_and(|progress| !belongs(progress, &set, &settings)) {
        if *resume == Resume::Always {
            bar.clear();
            return Err(TrainError::Checkpoint).or_exit(Exit::Usage);
        }
        *progress = None;
    }
    let own = progress.take_if(|progress| progress.window_half_s() == settings.window_half_s);
    let path = checkpoint_path(&args.out);
    let keep_trained: Box<dyn Fn(&Progress) + Send> = Box::new(move |reached| {
        if let Err(error) = keep(reached, &path) {
            print_status(format_args!("warning: {}", error_text(&error)));
        }
    });
    // A checkpoint of a later window stays, as after an interruption.
    bar.keep_by(progress.is_none().then_some(keep_trained));
    train(&set, &settings, windows, logs.refused.clone(), own, bar)
        .with_context(|| names)
        .or_exit(Exit::Usage)
}

/// The path of the checkpoint of a model file's training.
fn checkpoint_path(out: &Path) -> PathBuf {
    let mut path = out.as_os_str().to_owned();
    path.push(".checkpoint");
    PathBuf::from(path)
}

/// Writes a checkpoint.
fn keep(reached: &Progress, path: &Path) -> anyhow::Result<()> {
    let json = serde_json::to_vec(reached).context("checkpoint")?;
    write_file(path, &sealed(&json))
}

fn load_checkpoint(path: &Path) -> anyhow::Result<Progress> {
    let bytes = fs::read(path)
        .with_context(|| format!("--resume: no checkpoint {}", path.display()))
        .or_exit(Exit::Usage)?;
    let damaged = || format!("checkpoint {} is damaged; train without --resume", path.display());
    let json = unsealed(&bytes).with_context(damaged).or_exit(Exit::Usage)?;
    serde_json::from_slice(json).with_context(damaged).or_exit(Exit::Usage)
}

/// A checkpoint's bytes: the SHA-256 of its content on a line of its own, then the content.
fn sealed(content: &[u8]) -> Vec<u8> {
    let mut bytes = sha256(content).into_bytes();
    bytes.push(b'\n');
    bytes.extend_from_slice(content);
    bytes
}

/// The content of a checkpoint's bytes, if their hash is right.
fn unsealed(bytes: &[u8]) -> anyhow::Result<&[u8]> {
    let end = bytes.iter().position(|byte| *byte == b'\n').context("it has no seal")?;
    let (stated, content) = (&bytes[..end], &bytes[end + 1..]);
    if stated != sha256(content).as_bytes() {
        return Err(anyhow!("its content does not match its checksum"));
    }
    Ok(content)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checkpoint_with_a_flipped_bit_is_rejected() {
        let bytes = sealed(b"{\"weights\":[1,2]}");
        assert_eq!(unsealed(&bytes).expect("whole"), b"{\"weights\":[1,2]}");
        for at in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[at] ^= 1;
            assert!(unsealed(&changed).is_err(), "byte {at}");
        }
        assert!(unsealed(&bytes[..bytes.len() - 1]).is_err());
        assert!(unsealed(b"").is_err());
    }
}
