//! The report on one flight, read from its log.

use std::collections::BTreeMap;
use std::io::Read;

use schemars::JsonSchema;
use serde::Serialize;

use super::histogram::quantile;
use super::limited::LimitedTicks;
use super::recording::Recording;
use crate::log::LogReader;
use crate::log::import::Flight;
use crate::log::info::{LogInfo, PhaseInfo, TrackingInfo, is_tracking};
use crate::log::reader::{Message, ReadError};
use crate::log::schema::{
    ControlMessage, LinkStatsMessage, ReferenceMessage, SetpointMessage, StateMessage,
};

/// An interval this many times the usual one means that ticks are missing.
const MISSED_FROM: f64 = 1.5;
/// Intervals whose mean tells the rate of a moment: a second at 100 Hz.
const RUN: usize = 100;

/// One control tick, as far as it was logged.
#[derive(Clone, Debug)]
pub(super) struct Row {
    pub log_ns: u64,
    pub state: StateMessage,
    pub reference: Option<ReferenceMessage>,
    pub setpoint: Option<SetpointMessage>,
    pub control: Option<ControlMessage>,
}

/// The report on one flight.
#[derive(Clone, Debug)]
pub struct FlightReport {
    pub(super) info: LogInfo,
    pub(super) rows: Vec<Row>,
    pub(super) link: Vec<(u64, LinkStatsMessage)>,
    pub(super) recording: Option<Recording>,
    summary: FlightSummary,
}

/// The numbers of a flight, and the JSON beside the report.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct FlightSummary {
    /// `downwash.report.flight`.
    pub schema: &'static str,
    /// Version of this JSON.
    pub schema_version: u32,
    /// Facts about the run.
    pub run: BTreeMap<String, String>,
    /// Whether the log was closed properly.
    pub log_finished: bool,
    /// Damaged parts of the log that were left out.
    pub log_damaged: u64,
    /// Length of the log, s.
    pub duration_s: f64,
    /// Flight states in their order.
    pub phases: Vec<PhaseInfo>,
    /// How well the trajectory was tracked, if one was flown.
    pub tracking: Option<TrackingInfo>,
    /// The control loop.
    pub control: ControlSummary,
    /// Counters of the link at the end, if it reported any.
    pub link: Option<LinkSummary>,
    /// Events by level.
    pub events: BTreeMap<&'static str, u64>,
}

/// The control loop's timing and limits.
#[derive(Clone, Debug, Default, JsonSchema, Serialize)]
pub struct ControlSummary {
    /// Control ticks.
    pub ticks: u64,
    /// Mean rate without pauses, 1/s.
    pub rate_hz: Option<f64>,
    /// Ticks missing in pauses of more than 1.5 usual intervals.
    pub missed_ticks: u64,
    /// 99th percentile of |interval - usual interval|, s.
    pub jitter_p99_s: Option<f64>,
    /// Median age of the state's sample at the tick, s.
    pub sample_age_p50_s: Option<f64>,
    /// 99th percentile of that age, s.
    pub sample_age_p99_s: Option<f64>,
    /// Largest age, s.
    pub sample_age_max_s: Option<f64>,
    /// How long a trajectory was tracked, s.
    pub tracked_s: f64,
    /// Setpoints sent.
    pub setpoints: u64,
    /// Ticks in which a limit cut the setpoint, on the ground too, where thrust always is.
    pub limited_ticks: u64,
    /// Those along the trajectory, by limit.
    pub limited: LimitedTicks,
}

/// The link's counters.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct LinkSummary {
    /// Mean rate of received frames, 1/s.
    pub rx_frames_hz: f64,
    /// Mean rate of sent frames, 1/s.
    pub tx_frames_hz: f64,
    /// Frames with a wrong checksum.
    pub crc_errors: u64,
    /// Frames missing from the vehicle's sequence.
    pub lost_frames: u64,
    /// Frames of messages that the dialect does not have.
    pub unknown_frames: u64,
    /// Bytes that belonged to no frame.
    pub unframed_bytes: u64,
    /// Frames of other systems and components.
    pub foreign_frames: u64,
    /// Frames with the vehicle's ids that came another way than the vehicle's.
    pub stray_frames: u64,
    /// Frames of the vehicle whose content could not be true.
    pub refused_frames: u64,
    /// Frames that did not leave, because the transport did not take them.
    pub dropped_frames: u64,
    /// Times the link was opened again.
    pub reconnects: u64,
    /// Largest round trip, s.
    pub rtt_max_s: Option<f64>,
}

impl Row {
    /// What the tick followed, if it sent a setpoint: without one nothing is controlled, and what
    /// the reference says then is not what the vehicle is to do.
    pub fn followed(&self) -> Option<&ReferenceMessage> {
        self.reference.as_ref().filter(|_| self.setpoint.is_some())
    }

    /// How the tick's setpoint came about, if it sent one.
    pub fn share(&self) -> Option<&ControlMessage> {
        self.control.as_ref().filter(|_| self.setpoint.is_some())
    }
}

impl FlightReport {
    /// Reads the rest of a flight's log.
    ///
    /// # Errors
    /// [`ReadError::Io`]; an unfinished or damaged log gives a report on what is there.
    pub fn read<R: Read>(reader: &mut LogReader<R>) -> Result<Self, ReadError> {
        let (mut rows, mut link) = (Vec::new(), Vec::new());
        let info = LogInfo::read_with(reader, |message| collect(message, &mut rows, &mut link))?;
        let summary = summarise(&info, &rows, &link);
        Ok(Self { info, rows, link, recording: None, summary })
    }

    /// The same with what the vehicle's own messages show, as read from the same log.
    pub fn with_recording(self, flight: Flight) -> Self {
        Self { recording: Some(Recording::new(flight)), ..self }
    }

    /// Added to the vehicle's clock, s, makes it time since the log's start.
    pub(super) fn vehicle_shift_s(&self) -> Option<f64> {
        let shift = |row: &Row| {
            let log_s = row.log_ns.saturating_sub(self.info.start_ns) as f64 * 1e-9;
            log_s - row.state.vehicle_time_us as f64 * 1e-6
        };
        quantile(&sorted(self.rows.iter().map(shift)), 0.5)
    }

    /// The numbers.
    pub fn summary(&self) -> &FlightSummary {
        &self.summary
    }

    /// Whether the log held nothing to report on: no tick, no link, no event.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty() && self.link.is_empty() && self.info.events_total == 0
    }

    /// Intervals between ticks, s.
    pub(super) fn intervals(&self) -> Vec<f64> {
        intervals(&self.rows)
    }

    /// Ages of the state's samples, s.
    pub(super) fn sample_ages(&self) -> Vec<f64> {
        sample_ages(&self.rows).collect()
    }
}

/// Joins a tick's messages, which share their `log_time`, into one row.
fn collect(message: &Message<'_>, rows: &mut Vec<Row>, link: &mut Vec<(u64, LinkStatsMessage)>) {
    let log_ns = message.log_time.as_ns();
    if let Some(state) = message.decode::<StateMessage>() {
        rows.push(Row { log_ns, state, reference: None, setpoint: None, control: None });
        return;
    }
    if let Some(stats) = message.decode::<LinkStatsMessage>() {
        link.push((log_ns, stats));
        return;
    }
    let Some(row) = rows.last_mut().filter(|row| row.log_ns == log_ns) else { return };
    if let Some(reference) = message.decode::<ReferenceMessage>() {
        row.reference = Some(reference);
    } else if let Some(setpoint) = message.decode::<SetpointMessage>() {
        row.setpoint = Some(setpoint);
    } else if let Some(control) = message.decode::<ControlMessage>() {
        // The phases are known from the log's summary.
        row.control = Some(ControlMessage { phase: String::new(), ..control });
    }
}

fn intervals(rows: &[Row]) -> Vec<f64> {
    rows.windows(2).map(|w| w[1].log_ns.saturating_sub(w[0].log_ns) as f64 * 1e-9).collect()
}

/// The usual interval, s: the median over runs of [`RUN`] intervals, each by its mean. Intervals of
/// two lengths that take turns, and samples that a busy machine reads in bursts, make together what
/// no quantile of single intervals is; a pause is one run of many.
fn usual(intervals: &[f64]) -> Option<f64> {
    let run = RUN.min(intervals.len()).max(1);
    let means =
        sorted(intervals.windows(run).map(|run| run.iter().sum::<f64>() / run.len() as f64));
    quantile(&means, 0.5).filter(|usual| *usual > 0.0)
}

/// How many ticks are missing at a `usual` interval, s: those that intervals are too long by, less
/// those that came late, one upon the other.
fn missed(intervals: &[f64], usual: f64) -> f64 {
    let missing = intervals.iter().filter(|interval| **interval > MISSED_FROM * usual);
    let late = intervals.iter().filter(|interval| MISSED_FROM * **interval < usual);
    let off = |interval: &f64| interval / usual - 1.0;
    (missing.map(off).sum::<f64>() + late.map(off).sum::<f64>()).round().max(0.0)
}

/// How long the ticks of a trajectory lasted, s: each until the next tick, pauses left out.
fn tracked_s(rows: &[Row], usual: Option<f64>) -> f64 {
    let Some(usual) = usual else { return 0.0 };
    let is_tracking = |row: &Row| row.control.as_ref().is_some_and(is_tracking);
    let lasted = |pair: &[Row]| pair[1].log_ns.saturating_sub(pair[0].log_ns) as f64 * 1e-9;
    let lasting = rows.windows(2).filter(|pair| is_tracking(&pair[0])).map(lasted);
    let last = rows.last().filter(|row| is_tracking(row)).map_or(0.0, |_| usual);
    lasting.map(|lasted| if lasted > MISSED_FROM * usual { usual } else { lasted }).sum::<f64>()
        + last
}

fn sample_ages(rows: &[Row]) -> impl Iterator<Item = f64> {
    rows.iter().filter_map(|r| r.control.as_ref()).map(|c| c.sample_age_s).filter(|a| a.is_finite())
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

fn summarise(info: &LogInfo, rows: &[Row], link: &[(u64, LinkStatsMessage)]) -> FlightSummary {
    FlightSummary {
        schema: "downwash.report.flight",
        schema_version: 1,
        run: info.run.clone(),
        log_finished: info.finished,
        log_damaged: info.damaged,
        duration_s: info.duration_s,
        phases: info.phases.clone(),
        tracking: info.tracking,
        control: control_summary(rows),
        link: link_summary(link),
        events: info.events_by_level.clone(),
    }
}

fn control_summary(rows: &[Row]) -> ControlSummary {
    let intervals = intervals(rows);
    let usual = usual(&intervals);
    let missed = usual.map_or(0.0, |usual| missed(&intervals, usual));
    let jitter = usual.map(|usual| sorted(intervals.iter().map(|i| (i - usual).abs())));
    let ages = sorted(sample_ages(rows));
    let tracking = rows.iter().filter_map(|row| row.control.as_ref()).filter(|c| is_tracking(c));
    let limited = |row: &&Row| row.control.as_ref().is_some_and(|c| c.saturation != 0);
    ControlSummary {
        ticks: rows.len() as u64,
        rate_hz: usual.map(|usual| 1.0 / usual),
        missed_ticks: missed as u64,
        jitter_p99_s: jitter.and_then(|j| quantile(&j, 0.99)),
        sample_age_p50_s: quantile(&ages, 0.5),
        sample_age_p99_s: quantile(&ages, 0.99),
        sample_age_max_s: ages.last().copied(),
        tracked_s: tracked_s(rows, usual),
        setpoints: rows.iter().filter(|r| r.setpoint.is_some()).count() as u64,
        limited_ticks: rows.iter().filter(limited).count() as u64,
        limited: LimitedTicks::count(tracking.map(|c| c.saturation)),
    }
}

fn link_summary(link: &[(u64, LinkStatsMessage)]) -> Option<LinkSummary> {
    let (_, last) = link.last()?;
    let mean = |value: fn(&LinkStatsMessage) -> f64| {
        link.iter().map(|(_, s)| value(s)).sum::<f64>() / link.len() as f64
    };
    let rtts = link.iter().map(|(_, s)| s.rtt_s).filter(|r| r.is_finite());
    Some(LinkSummary {
        rx_frames_hz: mean(|s| s.rx_frames_hz),
        tx_frames_hz: mean(|s| s.tx_frames_hz),
        crc_errors: last.crc_errors,
        lost_frames: last.lost_frames,
        unknown_frames: last.unknown_frames,
        unframed_bytes: last.unframed_bytes,
        foreign_frames: last.foreign_frames,
        stray_frames: last.stray_frames,
        refused_frames: last.refused_frames,
        dropped_frames: last.dropped_frames,
        reconnects: last.reconnects,
        rtt_max_s: rtts.reduce(f64::max),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ticks at these times, s, which track from 0 on.
    fn ticks(times: &[f64]) -> Vec<Row> {
        let row = |time: &f64| Row {
            log_ns: ((time + 10.0) * 1e9).round() as u64,
            state: StateMessage::default(),
            reference: None,
            setpoint: None,
            control: Some(ControlMessage {
                trajectory_time_s: if *time < 0.0 { f64::NAN } else { *time },
                ..ControlMessage::default()
            }),
        };
        times.iter().map(row).collect()
    }

    #[test]
    fn alternating_intervals_give_the_mean_rate() {
        // 26 s at 100 Hz after 5 s of take-off; every tick is now 2 ms early, now 2 ms late.
        let times: Vec<f64> = (-500..2600)
            .map(|k| 0.01 * f64::from(k) + if k % 2 == 0 { 2e-3 } else { -2e-3 })
            .collect();
        let summary = control_summary(&ticks(&times));
        assert!((summary.rate_hz.expect("a rate") - 100.0).abs() < 0.1, "{summary:?}");
        assert!((summary.tracked_s - 26.0).abs() < 0.02, "{summary:?}");
        assert_eq!(summary.missed_ticks, 0);
    }

    #[test]
    fn pause_is_excluded_from_rate_and_tracked_time() {
        let times: Vec<f64> =
            (0..1000).map(|k| 0.01 * f64::from(k) + if k < 500 { 0.0 } else { 60.0 }).collect();
        let summary = control_summary(&ticks(&times));
        assert!((summary.rate_hz.expect("a rate") - 100.0).abs() < 1e-3, "{summary:?}");
        assert!((summary.tracked_s - 10.0).abs() < 0.02, "{summary:?}");
        assert_eq!(summary.missed_ticks, 6000);
    }

    #[test]
    fn bursty_ticks_count_as_late_not_missing() {
        // Of every four ticks at 100 Hz one is in time and three are read with it, a while later.
        let times: Vec<f64> =
            (0..2000).map(|k| 0.04 * f64::from(k / 4) + 1e-5 * f64::from(k % 4)).collect();
        let summary = control_summary(&ticks(&times));
        assert!((summary.rate_hz.expect("a rate") - 100.0).abs() < 5.0, "{summary:?}");
        assert!(summary.missed_ticks <= 1, "{summary:?}");
    }

    #[test]
    fn no_ticks_give_no_rate() {
        let summary = control_summary(&[]);
        assert_eq!((summary.rate_hz, summary.tracked_s), (None, 0.0));
        // All at one time, as in a damaged log.
        assert_eq!(control_summary(&ticks(&[1.0, 1.0, 1.0])).rate_hz, None);
    }
}
