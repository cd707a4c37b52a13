//! One flight of the simulated vehicle, in lockstep, into a log.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use sitl::autopilot::Vehicle;
use sitl::config::SitlConfig;
use vehicle::VehicleParams;
use vehicle::effects::{EffectSet, Onset, Schedule};
use vehicle::physics::Physics;

use super::course::Course;
use super::setup::{run_info, station_settings};
use super::vehicle_file::VehicleFile;
use super::{Exit, ExitContext};
use crate::cli::SimulationArgs;
use crate::config::Config;
use crate::lockstep;
use crate::log::LogWriter;
use crate::log::record::Record;
use crate::station::{End, Station, Status};
use crate::supervisor::EngagePolicy;

/// Simulated time for connecting, take-off, the approach and landing, besides the trajectory, s.
const AROUND_S: f64 = 180.0;

/// The properties of the simulated vehicle that the vehicle file does not state.
#[derive(Clone, Debug, Default)]
pub struct Truth {
    /// Sensors, battery, start.
    pub config: SitlConfig,
    /// Beyond the vehicle file's modelled effects.
    pub effects: EffectSet,
    /// Effects that set in later.
    pub onsets: Vec<Onset>,
}

/// The effects of the flags; `--effect` overrides the file of `--effects`. Reports the numbers of an
/// effect that is given without any.
pub(super) fn requested_effects(args: &SimulationArgs) -> anyhow::Result<Schedule> {
    let schedule =
        Schedule::requested(args.effects.as_deref(), &args.effect).or_exit(Exit::Usage)?;
    for line in Schedule::defaults_taken(&args.effect) {
        tracing::warn!("{line}");
    }
    Ok(schedule)
}

impl Truth {
    /// From flags; `--effect` overrides the file of `--effects`.
    pub(super) fn load(args: &SimulationArgs, vehicle: &VehicleParams) -> anyhow::Result<Self> {
        let config = match &args.sitl_config {
            Some(path) => SitlConfig::load(path).or_exit(Exit::Usage)?,
            None => SitlConfig::default(),
        };
        let Schedule { effects, onsets } = requested_effects(args)?;
        let truth = Self { config, effects, onsets };
        truth.warn(vehicle);
        Ok(truth)
    }

    /// Warns of effects that do nothing to `vehicle`. The flight reports an effect that the physics
    /// refuses.
    pub(super) fn warn(&self, vehicle: &VehicleParams) {
        let physics = Physics::new(vehicle, &self.effects).ok();
        if let Some(remark) = physics.and_then(|physics| physics.unfelt(&self.effects)) {
            tracing::warn!("{remark}");
        }
    }

    /// The effects that set in later, on one line; empty without any.
    pub(super) fn onsets_text(&self) -> anyhow::Result<String> {
        if self.onsets.is_empty() {
            return Ok(String::new());
        }
        serde_json::to_string(&self.onsets).context("the onsets")
    }

    /// The effects as they are written in a file, on one line.
    pub(super) fn effects_text(&self) -> anyhow::Result<String> {
        serde_json::to_string(&self.effects).context("the effects")
    }
}

/// One flight to simulate.
pub(super) struct SimulatedFlight<'a> {
    pub config: &'a Config,
    /// The vehicle as the daemon assumes it.
    pub vehicle: &'a VehicleFile,
    /// The vehicle as its firmware assumes it; the truth is added to it.
    pub airframe: &'a VehicleParams,
    pub truth: &'a Truth,
    pub course: &'a Course,
    /// The name of the run, in the log and in its file name.
    pub run: &'a str,
    pub seed: u64,
    /// More for the log's metadata.
    pub extra: BTreeMap<String, String>,
}

/// The result of a simulated flight.
pub(super) struct Simulated {
    pub end: End,
    pub log: PathBuf,
    pub simulated_s: f64,
}

impl SimulatedFlight<'_> {
    /// Flies from connecting to disarming, and writes a log into `folder`. `watch` sees the status
    /// about every 10 ms of simulated time.
    pub fn fly(self, folder: &Path, watch: impl FnMut(&Status)) -> anyhow::Result<Simulated> {
        self.fly_logged(folder, |_| None, watch)
    }

    /// As [`fly`](Self::fly); `record` receives each logged record and may add one after it.
    pub fn fly_logged(
        self,
        folder: &Path,
        mut record: impl FnMut(&Record) -> Option<Record>,
        watch: impl FnMut(&Status),
    ) -> anyhow::Result<Simulated> {
        let mut info = run_info(self.config, self.vehicle, self.run, true, Some(self.seed));
        info.extra.clone_from(&self.extra);
        info.extra.insert("effects".to_owned(), self.truth.effects_text()?);
        let onsets = self.truth.onsets_text()?;
        if !onsets.is_empty() {
            info.extra.insert("onsets".to_owned(), onsets);
        }
        let start = lockstep::host_time(0);
        // Never synced on the way, which would cut chunks by the wall clock: the same seed gives
        // the same bytes, and a flight that a crash cuts short is flown again.
        let mut writer = LogWriter::create(folder, &info, start, Instant::now())?;
        let mut failure = None;
        let log = writer.path().to_owned();
        let flown = self.fly_unlogged(
            |next| {
                let mut next = Some(next);
                while let Some(written) = next {
                    next = record(&written);
                    if failure.is_none() {
                        failure = writer.write(&written).err();
                    }
                }
            },
            watch,
        );
        failure.map_or(Ok(()), Err)?;
        writer.finish()?;
        let (end, simulated_s) = flown?;
        Ok(Simulated { end, log, simulated_s })
    }

    /// Flies without a log; `record` receives what a log would hold. Returns how the flight ended,
    /// and the simulated time, s.
    pub fn fly_unlogged(
        &self,
        record: impl FnMut(Record),
        mut watch: impl FnMut(&Status),
    ) -> anyhow::Result<(End, f64)> {
        let limit_s = self.course.duration() + AROUND_S;
        let params = self.airframe.clone();
        let truth = self.truth.clone();
        let schedule = Schedule { effects: truth.effects, onsets: truth.onsets };
        let mut vehicle =
            Vehicle::scheduled(params, schedule, truth.config, self.seed).or_exit(Exit::Usage)?;
        let policy = EngagePolicy::Command;
        let settings = station_settings(self.config, self.vehicle, self.course, policy, None)?;
        let mut station = Station::new(settings, lockstep::host_time(0));
        let end = lockstep::fly(&mut vehicle, &mut station, limit_s, record, |station, _| {
            watch(&station.status());
        })?;
        Ok((end, vehicle.now_us() as f64 * 1e-6))
    }
}
