//! Reads flight logs for learning: many files, each used or refused with a reason.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context, anyhow, bail};
use rayon::prelude::*;
use vehicle::VehicleParams;

use super::{Exit, ExitContext, error_text, print_status};
use crate::audit::Audit;
use crate::learn::commands::Onboard;
use crate::learn::dataset::{ObservedFlight, WindowSettings};
use crate::learn::summary::RefusedLog;
use crate::log::import::mapping::Mapping;
use crate::log::import::{self, Choice, Flight, ImportError, RotorFact};

/// Flights to learn from, in the order of their names, and logs that were refused.
pub(super) struct Logs {
    pub flights: Vec<ObservedFlight>,
    pub refused: Vec<RefusedLog>,
}

impl Logs {
    /// Reads and observes logs of `vehicle`, several at a time; `step` is called for each file.
    pub fn read(
        paths: &[PathBuf],
        mapping: Option<&Path>,
        vehicle: &VehicleParams,
        onboard: &Onboard,
        windows: &WindowSettings,
        step: impl FnMut(&Path) + Send,
    ) -> Self {
        // In one order, whatever the order of the arguments: flights of one kind follow one
        // another, and the first of two identical logs is used.
        let mut paths: Vec<&PathBuf> = paths.iter().collect();
        paths.sort_by_key(|path| (path.file_stem(), *path));
        let step = Mutex::new(step);
        let read: Vec<anyhow::Result<ObservedFlight>> = paths
            .par_iter()
            .map(|path| {
                let observed = observe(path, mapping, vehicle, onboard, windows);
                if let Ok(mut step) = step.lock() {
                    step(path);
                }
                observed
            })
            .collect();
        let mut logs = Self { flights: Vec::new(), refused: Vec::new() };
        let mut seen: BTreeMap<String, &Path> = BTreeMap::new();
        for (path, observed) in paths.iter().zip(read) {
            let kept = observed.and_then(|flight| {
                match seen.insert(flight.flight.origin.sha256.clone(), path) {
                    Some(twin) => Err(anyhow!("the same file as {}", twin.display())),
                    None => Ok(flight),
                }
            });
            match kept {
                Ok(flight) => logs.flights.push(flight),
                Err(error) => {
                    let reason = error_text(&error);
                    print_status(format_args!("{}: left out: {reason}", path.display()));
                    logs.refused.push(RefusedLog { path: path.to_path_buf(), reason });
                }
            }
        }
        let origins = logs.flights.iter_mut().map(|flight| &mut flight.flight.origin);
        import::tell_apart(origins.map(|origin| (&mut origin.run, origin.path.as_path())));
        logs
    }

    /// Observes the flights by other windows; `step` is called for each file. Reads nothing again.
    /// What the first windows left out stays left out.
    pub fn observe(
        &mut self,
        vehicle: &VehicleParams,
        windows: &WindowSettings,
        step: impl FnMut(&Path) + Send,
    ) {
        let step = Mutex::new(step);
        self.flights.par_iter_mut().for_each(|flight| {
            flight.observe(vehicle, windows);
            if let Ok(mut step) = step.lock() {
                step(&flight.flight.origin.path);
            }
        });
    }
}

/// Refuses a log that cannot be opened, and a mapping file that is none: the user names them, so
/// leaving them out would give the answer to another question. A log that opens but cannot be used
/// is left out by the command, with the reason.
pub(super) fn check_named<'a>(
    logs: impl IntoIterator<Item = &'a PathBuf>,
    mapping: Option<&Path>,
) -> anyhow::Result<()> {
    for log in logs {
        let read = || format!("cannot read {}", log.display());
        check_opens(log).with_context(read).or_exit(Exit::Usage)?;
    }
    mapping.map_or(Ok(()), |file| Mapping::load(file).map(drop)).or_exit(Exit::Usage)
}

/// Refuses a choice that a log of this program leaves no room for: it states its columns, and holds
/// one boot.
pub(super) fn check_own(log: &Path, choice: Choice<'_>) -> Result<(), ImportError> {
    match choice {
        Choice { mapping: Some(_), .. } => {
            Err(ImportError::NotATable { path: log.to_owned(), format: "mcap" })
        }
        Choice { boot: Some(boot), .. } if boot != 1 => {
            Err(ImportError::NoBoot { path: log.to_owned(), boot, boots: 1 })
        }
        Choice { system: Some(system), .. } => {
            let found = "a flight of this program has one vehicle, without an id".to_owned();
            Err(ImportError::NoSystem { path: log.to_owned(), system, found })
        }
        Choice { .. } => Ok(()),
    }
}

fn check_opens(log: &Path) -> anyhow::Result<()> {
    let kind = fs::metadata(log)?.file_type();
    if kind.is_dir() {
        bail!("expected a file, found a folder");
    }
    // Opening a pipe would wait for its writer, and read its first bytes in vain.
    if kind.is_file() {
        File::open(log)?;
    }
    Ok(())
}

/// Reads a flight, by the mapping if it is a table. Refuses a log whose embedded vehicle file is of
/// another vehicle.
pub(super) fn open_for(
    path: &Path,
    mapping: Option<&Path>,
    vehicle: &VehicleParams,
) -> anyhow::Result<Flight> {
    let flight = import::open_among(path, mapping)?;
    if let Some(text) = &flight.vehicle_file {
        let own = if text.trim_start().starts_with('{') {
            VehicleParams::from_json_str(text)
        } else {
            VehicleParams::from_toml_str(text)
        };
        let own = own.context("the vehicle file inside the log")?;
        if let Some(difference) = vehicle.difference(&own) {
            anyhow::bail!("it is from another vehicle: {difference}");
        }
    }
    check_rotor_order(&flight, vehicle)?;
    Ok(flight)
}

/// Refuses a log whose autopilot states another order of motors than the vehicle file.
fn check_rotor_order(flight: &Flight, vehicle: &VehicleParams) -> anyhow::Result<()> {
    let Ok(stated) = <[RotorFact; 4]>::try_from(flight.facts.rotors.clone()) else {
        return Ok(());
    };
    let file = vehicle.rotors.map(|rotor| RotorFact {
        front: rotor.position_m[0],
        right: rotor.position_m[1],
        spin: rotor.spin,
    });
    let [stated, file] = [stated, file].map(|rotors| RotorFact::descriptions(&rotors));
    if stated == file {
        return Ok(());
    }
    anyhow::bail!(
        "the vehicle file's [[rotors]] are not in the order of its motors: the log states {}; the file has {}; \
         put the file's into the log's order",
        stated.join(", "),
        file.join(", ")
    )
}

/// Reads and observes a flight. Refuses one with faulty data, and cuts out the times that the audit
/// calls unusable.
fn observe(
    path: &Path,
    mapping: Option<&Path>,
    vehicle: &VehicleParams,
    onboard: &Onboard,
    windows: &WindowSettings,
) -> anyhow::Result<ObservedFlight> {
    let flight = open_for(path, mapping, vehicle)?;
    let audit = Audit::of(&flight);
    // Too little data is reported before what may be wrong with it.
    let observed = ObservedFlight::new(flight, vehicle, onboard, windows, &audit.cuts())?;
    if let Some(fault) = audit.fault_of_data() {
        return Err(anyhow!("{fault}"));
    }
    observed.check_vehicle(vehicle, onboard)?;
    Ok(observed)
}

/// The names of files for an error: the first few, and the number of the others.
pub(super) fn listed(files: &[PathBuf]) -> String {
    const NAMED: usize = 3;
    let named: Vec<String> =
        files.iter().take(NAMED).map(|file| file.display().to_string()).collect();
    match files.len().saturating_sub(NAMED) {
        0 => named.join(", "),
        more => format!("{} and {more} more", named.join(", ")),
    }
}
