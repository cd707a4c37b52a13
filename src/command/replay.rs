//! `downwash replay`: plays a flight log to viewers.

use std::io::Cursor;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, anyhow};

use super::audience::print_address;
use super::logs::check_own;
use super::stop::{Stop, StopSignals};
use super::{Exit, ExitContext, Interruption, print_status};
use crate::cli::ReplayArgs;
use crate::log::LogReader;
use crate::log::import::{self, Choice};
use crate::log::reader::ReadError;
use crate::view::{Playback, Recording, ViewSettings};

/// Period of checks for signals.
const WATCH_PERIOD: Duration = Duration::from_millis(200);

pub(super) fn run(args: &ReplayArgs, preparation: Interruption) -> anyhow::Result<Exit> {
    let mut signals = StopSignals::after(Some(preparation))?;
    let recording = read(&args.log, args.mapping.as_deref())?;
    let (first, last) = recording
        .span()
        .ok_or_else(|| anyhow!("{}: it holds no messages to play", args.log.display()))
        .or_exit(Exit::Usage)?;
    for damage in &recording.damages {
        print_status(format_args!("{}: left out: {damage}", args.log.display()));
    }
    let name = args.log.file_name().unwrap_or_default().to_string_lossy();
    let settings = ViewSettings {
        address: args.view.clone(),
        name: format!("downwash: {name}"),
        ..ViewSettings::default()
    };
    let playback = Playback::start(settings, recording, args.paused).or_exit(Exit::Usage)?;
    print_status(format_args!("{}: {:.1} s", args.log.display(), last.since(first).as_secs_f64()));
    print_address(playback.address());
    loop {
        match signals.wait(WATCH_PERIOD) {
            Some(Stop::Interrupt) => return Ok(Exit::Interrupted),
            Some(Stop::Terminate) => return Ok(Exit::Ok),
            None => {}
        }
    }
}

/// A log of this program as it is, or another one as `log import` would write it.
fn read(path: &Path, mapping: Option<&Path>) -> anyhow::Result<Recording> {
    let named = || path.display().to_string();
    let foreign = match LogReader::open(path) {
        Ok(reader) => {
            check_own(path, Choice { mapping, ..Choice::default() }).or_exit(Exit::Usage)?;
            return Recording::read(reader).with_context(named);
        }
        Err(ReadError::NotMcap { .. }) => import::open(path, mapping).or_exit(Exit::Usage)?,
        Err(error) => return Err(error).or_exit(Exit::Usage),
    };
    let bytes = import::to_bytes(&foreign).with_context(named)?;
    Recording::read(LogReader::new(Cursor::new(bytes))?).with_context(named)
}
