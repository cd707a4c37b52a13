//! The programme flown by a vehicle on a link.

use std::path::Path;
use std::time::Duration;

use anyhow::anyhow;

use super::FlightRow;
use super::kept::{LogOf, metadata};
use crate::command::audience::Audience;
use crate::command::course::Course;
use crate::command::fly::{Flown, Run};
use crate::command::setup::endpoint;
use crate::command::setup::{required, run_info, station_settings};
use crate::command::signing_state::SigningState;
use crate::command::stop::StopSignals;
use crate::command::vehicle_file::VehicleFile;
use crate::command::{Exit, print_status};
use crate::config::Config;
use crate::plan::programme::ProgrammeFlight;
use crate::supervisor::EngagePolicy;

/// Wait for a signal before each flight.
const BETWEEN_FLIGHTS: Duration = Duration::from_millis(1);

/// Flies a vehicle on a link, one flight after the other. A flight that does not end as planned
/// ends the programme, because someone must check the vehicle first.
pub(super) fn fly_vehicle(
    folder: &Path,
    config: &Config,
    vehicle: &VehicleFile,
    flights: &[ProgrammeFlight],
    ahead: &[(usize, String)],
    signals: &mut StopSignals,
) -> anyhow::Result<Vec<(usize, FlightRow)>> {
    let url = required(&config.settings.connect, "--connect", "connect")?;
    let mut rows = Vec::new();
    for (turn, (index, fingerprint)) in ahead.iter().enumerate() {
        let flight = &flights[*index];
        // A request that came at the end of the last flight, or after it.
        signals.wait(BETWEEN_FLIGHTS);
        if signals.first().is_some() {
            let row = FlightRow::planned(flight);
            rows.push((*index, FlightRow { exit: Exit::Interrupted, ..row }));
            break;
        }
        print_status(format_args!("flight {} of {}: {}", turn + 1, ahead.len(), flight.name));
        let endpoint = endpoint(&url)?;
        let mut settings = station_settings(
            config,
            vehicle,
            &Course::Desired(flight.trajectory.clone()),
            EngagePolicy::Command,
            Some(&endpoint),
        )?;
        let signing = SigningState::open(&config.settings.link.signing)?;
        settings.session.signing = signing.as_ref().map(SigningState::settings);
        let mut info = run_info(config, vehicle, &flight.name, false, None);
        info.extra = metadata(flight, fingerprint);
        let run = Run { settings, endpoint, tee: None, audience: Audience::default() };
        let Flown { end, exit, log } = run.fly(folder, &info, signals)?;
        let log = log.as_deref().map(LogOf::read).transpose()?.map(|(_, log)| log);
        let log = log.ok_or_else(|| anyhow!("{}: its log was not written", flight.name))?;
        rows.push((*index, FlightRow::flown(flight, &end, exit, Some(&log))));
        if exit != Exit::Ok {
            print_status(format_args!(
                "flight {}: {end}; run the command again to continue",
                flight.name
            ));
            break;
        }
    }
    Ok(rows)
}
