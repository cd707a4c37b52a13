//! The programme flown by the simulated vehicle, several flights at a time.

use std::io::{self, IsTerminal};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Context;
use indicatif::ProgressBar;

use super::FlightRow;
use super::kept::{LogOf, metadata};
use crate::command::course::Course;
use crate::command::interruption::{GRACE, end};
use crate::command::simulation::{SimulatedFlight, Truth};
use crate::command::stop::StopSignals;
use crate::command::vehicle_file::VehicleFile;
use crate::command::{Exit, print_status, summary};
use crate::config::Config;
use crate::plan::programme::ProgrammeFlight;

/// Charge of the simulated battery at the start of each flight, over the configured charge. Varying
/// it shows the battery's sag from full to half empty.
const CHARGES: [f64; 4] = [1.0, 0.7, 0.85, 0.55];
/// Period of checks for signals while flights are simulated.
const WATCH_PERIOD: Duration = Duration::from_millis(50);

/// Flies the simulated vehicle.
pub(super) struct Simulator<'a> {
    pub config: &'a Config,
    pub vehicle: &'a VehicleFile,
    pub truth: &'a Truth,
    pub folder: &'a Path,
    pub progress: ProgressBar,
    /// No other flight begins.
    pub stopping: AtomicBool,
}

impl Simulator<'_> {
    /// Flies in `jobs` threads until all flights are flown or a signal arrives; flights in the air
    /// are then completed. Each row comes with its flight's index.
    pub fn fly_all(
        &self,
        flights: &[ProgrammeFlight],
        ahead: &[(usize, String)],
        jobs: usize,
        signals: &mut StopSignals,
    ) -> anyhow::Result<Vec<(usize, FlightRow)>> {
        // A bar shows only on a terminal.
        if !io::stderr().is_terminal() && !ahead.is_empty() {
            print_status(format_args!("... flying {} flights", ahead.len()));
        }
        let next = AtomicUsize::new(0);
        let rows = Mutex::new(Vec::new());
        let worker = || -> anyhow::Result<()> {
            while !self.stopping.load(Ordering::Acquire) {
                let turn = next.fetch_add(1, Ordering::Relaxed);
                let Some((index, fingerprint)) = ahead.get(turn) else { break };
                let row = self.fly(&flights[*index], *index, fingerprint)?;
                if let Ok(mut rows) = rows.lock() {
                    rows.push((*index, row));
                }
            }
            Ok(())
        };
        thread::scope(|scope| {
            let workers: Vec<_> = (0..jobs.min(ahead.len())).map(|_| scope.spawn(worker)).collect();
            let mut stopped: Option<Instant> = None;
            while !workers.iter().all(|worker| worker.is_finished()) {
                if signals.wait(WATCH_PERIOD).is_some()
                    && !self.stopping.swap(true, Ordering::AcqRel)
                {
                    stopped = Some(Instant::now());
                    print_status(format_args!(
                        "stopping: flights that are still in the air are flown again by the same \
                         command"
                    ));
                }
                if stopped.is_some_and(|at| at.elapsed() > GRACE) {
                    end();
                }
            }
            for worker in workers {
                match worker.join() {
                    Ok(result) => result?,
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
            Ok::<_, anyhow::Error>(())
        })?;
        let mut rows = rows.into_inner().unwrap_or_default();
        rows.sort_by_key(|(index, _)| *index);
        if signals.first().is_some() {
            let flown: Vec<usize> = rows.iter().map(|(index, _)| *index).collect();
            for (index, _) in ahead.iter().filter(|(index, _)| !flown.contains(index)) {
                let row = FlightRow::planned(&flights[*index]);
                rows.push((*index, FlightRow { exit: Exit::Interrupted, ..row }));
            }
        }
        Ok(rows)
    }

    fn fly(
        &self,
        flight: &ProgrammeFlight,
        index: usize,
        fingerprint: &str,
    ) -> anyhow::Result<FlightRow> {
        let mut truth = self.truth.clone();
        truth.config.battery.charge *= CHARGES[index % CHARGES.len()];
        let mut extra = metadata(flight, fingerprint);
        extra.insert("battery_charge".to_owned(), truth.config.battery.charge.to_string());
        let simulated = SimulatedFlight {
            config: self.config,
            vehicle: self.vehicle,
            airframe: &self.vehicle.params,
            truth: &truth,
            course: &Course::Desired(flight.trajectory.clone()),
            run: &flight.name,
            seed: flight.seed,
            extra,
        };
        let mut shown = 0;
        let flown = simulated.fly(self.folder, |status| {
            let tenths = (status.progress.map_or(0.0, |(t, _)| t) * 10.0) as u64;
            self.progress.inc(tenths.saturating_sub(shown));
            shown = shown.max(tenths);
        });
        let flown = flown.with_context(|| flight.name.clone())?;
        self.progress.set_message(flight.name.clone());
        let (end, exit) = summary::end_text(Some(&flown.end), None);
        let (_, log) = LogOf::read(&flown.log)?;
        Ok(FlightRow::flown(flight, &end, exit, Some(&log)))
    }
}
