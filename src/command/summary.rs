//! How a flight ended, for people.

use std::path::Path;

use super::Exit;
use super::stop::Stop;
use crate::log::{LogReader, import};
use crate::report::flight::{FlightReport, FlightSummary};
use crate::station::End;

/// The end in words, and its exit code. `stop`, a request of the user, decides only where the
/// station gives no end: a lost link or a takeover meanwhile keeps its own code.
pub(super) fn end_text(end: Option<&End>, stop: Option<Stop>) -> (String, Exit) {
    match end {
        Some(End::Done) => ("done".to_owned(), Exit::Ok),
        Some(End::Checked) => ("preflight checks passed".to_owned(), Exit::Ok),
        Some(End::NoVehicle) => ("no vehicle was found".to_owned(), Exit::Link),
        Some(End::Refused(why)) => (format!("refused: {why}"), Exit::Refused),
        Some(End::Aborted(why)) => (format!("ended early: {why}"), Exit::Aborted),
        Some(End::LinkLost(why)) => (format!("link lost: {why}"), Exit::Link),
        Some(End::PilotTookOver) => ("the pilot took over".to_owned(), Exit::Aborted),
        Some(End::Stopped) => ("interrupted".to_owned(), Exit::Interrupted),
        // The stream ended without a landing.
        None if stop.is_some() => ("interrupted".to_owned(), Exit::Interrupted),
        None => ("stopped".to_owned(), Exit::Failure),
    }
}

/// The report on a log.
pub(super) fn report_on(log: &Path) -> anyhow::Result<FlightReport> {
    let mut reader = LogReader::open(log)?;
    let report = FlightReport::read(&mut reader)?;
    Ok(with_recording(report, log))
}

/// The report, with the contents of the vehicle's own messages in the log; a truncated log may hold
/// none.
pub(super) fn with_recording(report: FlightReport, log: &Path) -> FlightReport {
    match import::open(log, None) {
        Ok(flight) => report.with_recording(flight),
        Err(_) => report,
    }
}

/// The table that a flight prints on stdout.
pub(super) fn flight_table(flight: &FlightSummary, end: &str) -> String {
    let mut table = format!("flight  {end}\n");
    if let Some(t) = &flight.tracking {
        let heads = ["north", "east", "down", "3D", "max"].map(|head| format!("{head:>9}"));
        let values = [t.rmse_n_m, t.rmse_e_m, t.rmse_d_m, t.rmse_3d_m, t.max_3d_m];
        let values = values.map(|value| format!("{value:9.3}"));
        table += &format!("{:18}{}\n", "", heads.concat());
        table += &format!("{:18}{}\n", "position RMSE / m", values.concat());
    }
    let control = &flight.control;
    table += &format!(
        "control ticks {}, missed {}, setpoints {}, limited {}\n",
        control.ticks, control.missed_ticks, control.setpoints, control.limited_ticks
    );
    if let Some(often) = control.limited.often() {
        table += &format!("note    {often}\n");
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interrupt_is_the_exit_only_without_another_end() {
        let exit = |end: Option<End>| end_text(end.as_ref(), Some(Stop::Interrupt)).1;
        assert_eq!(exit(Some(End::Stopped)), Exit::Interrupted);
        assert_eq!(exit(None), Exit::Interrupted);
        assert_eq!(exit(Some(End::LinkLost("silent".to_owned()))), Exit::Link);
        assert_eq!(exit(Some(End::Aborted("tilted".to_owned()))), Exit::Aborted);
        assert_eq!(exit(Some(End::PilotTookOver)), Exit::Aborted);
        assert_eq!(exit(Some(End::Done)), Exit::Ok);
        assert_eq!(end_text(None, None).1, Exit::Failure);
    }
}
