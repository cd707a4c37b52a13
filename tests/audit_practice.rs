//! The audit on flights by others, intact or with one fault put in on purpose: a label that every
//! sound log has.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::audit_corrupted::{outcome, print, rates};
use downwash::audit::Audit;
use downwash::diagnose::flights::rotor_order;
use downwash::exam::interval::Rate;
use downwash::log::import::{Flight, open};
use rayon::prelude::*;
use vehicle::VehicleParams;

/// A vehicle's file and its flights.
pub struct Case {
    pub name: String,
    pub vehicle_file: PathBuf,
    pub vehicle: VehicleParams,
    pub flights: Vec<Flight>,
}

fn sorted(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.sort();
    paths
}

/// The practice flights of real vehicles and of PX4 and ArduCopter, if they are beside the repository.
pub fn cases() -> Vec<Case> {
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared");
    let sets = ["practice-autopilot", "practice-real", "practice-real-2"];
    let folders = sets.iter().flat_map(|set| sorted(&shared.join(set)));
    let case = |folder: PathBuf| {
        let logs = sorted(&folder).into_iter();
        let logs = logs.filter(|path| path.extension().is_some_and(|name| name == "tlog"));
        let vehicle_file = folder.join("vehicle.json");
        Some(Case {
            name: folder.file_name()?.to_string_lossy().into_owned(),
            vehicle: VehicleParams::load(&vehicle_file).ok()?,
            vehicle_file,
            flights: logs.map(|log| open(&log, None).expect("a flight")).collect(),
        })
    };
    folders.filter_map(case).collect()
}

/// Whether the audit finds that the outputs of flights, read in the order `order`, drive other
/// rotors than the vehicle file's.
fn is_order_wrong(case: &Case, order: [usize; 4]) -> bool {
    let mut flights = case.flights.clone();
    for flight in &mut flights {
        flight.outputs = flight.outputs.map(|u| order.map(|output| u[output]));
        flight.facts.rotors.clear();
    }
    let mut audits = Audit::of_all(&flights);
    rotor_order::check(&mut audits, &case.vehicle);
    audits.iter().any(|audit| audit.findings.iter().any(|finding| finding.check == "motor_order"))
}

#[test]
#[ignore = "minutes; prints rates on the practice flights, if they are there: tests/run --all"]
fn corrupted_flights_of_others_are_found() {
    let cases = cases();
    let flights: Vec<(String, &Flight)> = cases
        .iter()
        .flat_map(|case| {
            let flights = case.flights.iter();
            flights.map(|flight| (format!("{} {}", case.name, flight.origin.run), flight))
        })
        .collect();
    let outcomes: Vec<_> =
        flights.into_par_iter().map(|(name, flight)| (name, outcome(flight))).collect();
    let (found, alarms, notes) = rates(&outcomes);
    println!("{notes}");
    print(&found);
    println!("faults of whole flights: {} of {}", alarms.count, alarms.of);

    // Vehicles whose logs hold outputs and the rotation that they cause.
    let turning = cases.iter().filter(|case| {
        case.flights.iter().any(|flight| !flight.outputs.is_empty() && !flight.body_rate.is_empty())
    });
    let turning: Vec<&Case> = turning.collect();
    let orders = [
        ("outputs as logged", [0, 1, 2, 3]),
        ("outputs 1 and 2 swapped", [1, 0, 2, 3]),
        ("outputs shifted by one", [1, 2, 3, 0]),
    ];
    let orders: BTreeMap<&str, Rate> = orders
        .into_iter()
        .map(|(name, order)| {
            (
                name,
                Rate::of(
                    turning.par_iter().map(|case| is_order_wrong(case, order)).collect::<Vec<_>>(),
                ),
            )
        })
        .collect();
    print(&orders);
    assert_eq!(orders["outputs as logged"].count, 0);
    if !cases.is_empty() {
        assert!(found["velocity in body axes"].rate.is_some_and(|rate| rate > 0.8));
    }
}
