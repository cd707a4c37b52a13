//! The page of a flight's report.

use vehicle::frame::Ned;

use super::axis::{range_of, significant};
use super::chart::{Band, Chart, Curve, Mark, Panel, Style};
use super::flight::{FlightReport, Row};
use super::histogram::Histogram;
use super::page::{Mood, Page};
use super::recording_page::{self, TIME, Timeline};
use super::scene::Scene;
use super::table::{Cell, Table, definitions};
use super::text::length;
use crate::log::info::EventInfo;
use crate::log::schema::{
    ControlMessage, LinkStatsMessage, ReferenceMessage, SetpointMessage, StateMessage,
};
use crate::plan::outline;

/// Events that the page lists.
const EVENTS_LISTED: usize = 200;

impl FlightReport {
    /// The page.
    pub fn to_html(&self) -> String {
        html(self)
    }
}

fn html(report: &FlightReport) -> String {
    let run = |key: &str| report.info.run.get(key).map_or("unknown", String::as_str);
    let mut page = Page::new(
        &format!("Flight report: {}", run("run")),
        &format!(
            "{}, {}, recorded by downwash {}",
            run("vehicle"),
            // Over a link a simulated vehicle looks like a real one.
            if run("source") == "sim" { "simulated in lockstep" } else { "flown over a link" },
            run("tool_version")
        ),
    );
    let figure = Figure::new(report);
    verdict(report, &mut page);
    key_figures(report, &mut page);
    page.section(
        "Path",
        "The flown path against the desired one, to scale, seen from the south-west.",
        &path(report),
    );
    if report.info.tracking.is_some() {
        let explanation = "State minus reference, at every tick that sent a setpoint; the \
                           autopilot lands by itself.";
        let html = biases(report) + &figure.tracking_error();
        page.section("Tracking error", explanation, &html);
    }
    let explanation =
        "World axes: north, east, down. There is no desired state while no setpoints are sent.";
    page.section("Desired and flown", explanation, &figure.states());
    let explanation =
        "The setpoints sent, and the feed-forward's share of them; the rest is feedback.";
    page.section("Setpoints", explanation, &figure.setpoints());
    if let Some((recording, shift_s)) = report.recording.as_ref().zip(report.vehicle_shift_s()) {
        let timeline = Timeline {
            shift_s,
            bands: &figure.bands,
            marks: &figure.marks,
            span: (0.0, report.info.duration_s),
            anchor: "desired-and-flown",
        };
        recording_page::sections(recording, &timeline, &mut page);
    }
    page.section("Timing", "", &timing(report));
    if !report.link.is_empty() {
        page.section("Link", "", &link(report, &figure));
    }
    page.section("Events", "", &events(report));
    page.section("How this was computed", "", &provenance(report));
    page.into_html()
}

fn verdict(report: &FlightReport, page: &mut Page) {
    let summary = report.summary();
    let count = |level: &str| summary.events.get(level).copied().unwrap_or(0);
    let severe = count("error") + count("fatal");
    let mut reasons = Vec::new();
    let mut note = |amount: u64, one: &str, several: &str| match amount {
        0 => {}
        1 => reasons.push(format!("1 {one}")),
        _ => reasons.push(format!("{amount} {several}")),
    };
    note(severe, "event of level error or worse", "events of level error or worse");
    note(count("warning"), "warning", "warnings");
    note(summary.control.missed_ticks, "missed control tick", "missed control ticks");
    note(
        summary.log_damaged,
        "damaged part of the log left out",
        "damaged parts of the log left out",
    );
    if !summary.log_finished {
        reasons.push(format!("the log is unfinished: {} messages", report.info.messages));
    }
    let sentence = match &summary.tracking {
        Some(t) => format!(
            "Tracked for {:.1} s with {} RMS position error, {} at most.",
            summary.control.tracked_s,
            length(t.rmse_3d_m),
            length(t.max_3d_m)
        ),
        None => "No trajectory was flown in this log.".into(),
    };
    let mood = match (severe, reasons.is_empty(), summary.tracking.is_some()) {
        (1.., ..) => Mood::Bad,
        (0, false, _) => Mood::Warning,
        (0, true, true) => Mood::Good,
        (0, true, false) => Mood::Plain,
    };
    page.verdict(mood, &sentence, &reasons);
}

fn key_figures(report: &FlightReport, page: &mut Page) {
    let summary = report.summary();
    let control = &summary.control;
    let mut figures = Vec::new();
    if let Some(t) = &summary.tracking {
        figures.extend([
            ("RMS error, 3D", length(t.rmse_3d_m), Mood::Plain),
            ("RMS error, north", length(t.rmse_n_m), Mood::Plain),
            ("RMS error, east", length(t.rmse_e_m), Mood::Plain),
            ("RMS error, down", length(t.rmse_d_m), Mood::Plain),
            ("largest error, 3D", length(t.max_3d_m), Mood::Plain),
        ]);
    }
    let missed = if control.missed_ticks == 0 { Mood::Good } else { Mood::Warning };
    let rate = control.rate_hz.map_or("unknown".into(), |r| format!("{r:.1} Hz"));
    figures.extend([
        ("log", format!("{:.1} s", summary.duration_s), Mood::Plain),
        ("control rate", rate, Mood::Plain),
        ("missed ticks", control.missed_ticks.to_string(), missed),
        ("ticks at a limit", control.limited_ticks.to_string(), Mood::Plain),
        ("sample age, 99 %", duration(control.sample_age_p99_s), Mood::Plain),
    ]);
    page.figures(&figures);
}

fn path(report: &FlightReport) -> String {
    let flown = |r: &Row| Ned::new(r.state.p_n_m, r.state.p_e_m, r.state.p_d_m);
    let desired = |r: &Row| match r.followed() {
        Some(r) => Ned::new(r.p_n_m, r.p_e_m, r.p_d_m),
        None => Ned::new(f64::NAN, f64::NAN, f64::NAN),
    };
    let flown: Vec<Ned> = report.rows.iter().map(flown).collect();
    let (ways, radii): (Vec<Ned>, Vec<f64>) =
        report.rows.iter().filter_map(|row| Some((desired(row), tube_radius_m(row)?))).unzip();
    let around = outline(&ways, &radii);
    let mut paths: Vec<(&str, &[Ned])> = vec![("flown", &flown)];
    if !around.is_empty() {
        paths.push(("tube", &around));
    }
    let desired: Vec<Ned> = report.rows.iter().map(desired).collect();
    Scene { paths: &paths, desired: &desired }.to_html()
}

/// Radius of the tube around the reference of a tick, m; `None` without a tube.
fn tube_radius_m(row: &Row) -> Option<f64> {
    row.followed().map(|reference| reference.tube_radius_m).filter(|radius| *radius > 0.0)
}

/// What the charts over time share.
struct Figure<'a> {
    report: &'a FlightReport,
    time: Vec<f64>,
    bands: Vec<Band>,
    marks: Vec<Mark>,
}

impl<'a> Figure<'a> {
    fn new(report: &'a FlightReport) -> Self {
        let time = report.rows.iter().map(|r| seconds(report, r.log_ns)).collect();
        let band = |phase: &crate::log::info::PhaseInfo| Band {
            from: phase.start_s,
            to: phase.start_s + phase.duration_s,
            name: phase.name.replace('_', " "),
        };
        let troubles = report.info.events.iter().filter(|event| event_mood(event) != Mood::Plain);
        let mark = |event: &EventInfo| Mark {
            at: event.time_s,
            text: event.text.clone(),
            bad: event_mood(event) == Mood::Bad,
        };
        let marks = troubles.take(EVENTS_LISTED).map(mark).collect();
        Self { report, time, bands: report.info.phases.iter().map(band).collect(), marks }
    }

    fn chart(&self, height: f64, panels: Vec<Panel>) -> String {
        self.over(&self.time, height, panels)
    }

    /// Panels over other times of the same axis.
    fn over(&self, time: &[f64], height: f64, panels: Vec<Panel>) -> String {
        let (bands, marks) = (&self.bands[..], &self.marks[..]);
        let span = Some((0.0, self.report.info.duration_s)).filter(|(from, to)| to > from);
        Chart { bands, marks, span, ..Chart::new(TIME, time, height, panels) }.to_html()
    }

    fn curve(&self, name: &str, style: Style, value: impl Fn(&Row) -> f64) -> Curve {
        Curve { name: name.into(), style, y: self.report.rows.iter().map(value).collect() }
    }

    /// A curve of angles in degrees, broken where it wraps.
    fn angle(&self, name: &str, style: Style, value: impl Fn(&Row) -> f64) -> Curve {
        let mut curve = self.curve(name, style, |r| value(r).to_degrees());
        for i in (1..curve.y.len()).rev() {
            if (curve.y[i] - curve.y[i - 1]).abs() > 180.0 {
                curve.y[i] = f64::NAN;
            }
        }
        curve
    }

    fn tracking_error(&self) -> String {
        let axis =
            |name: &str, colour, value: fn(&ControlMessage) -> f64| Panel {
                name: name.into(),
                curves: vec![self.curve("error", Style::Colour(colour), move |r| {
                    r.share().map_or(f64::NAN, value)
                })],
            };
        let mut panels = vec![
            axis("north (m)", 1, |c| c.error_n_m),
            axis("east (m)", 1, |c| c.error_e_m),
            axis("down (m)", 1, |c| c.error_d_m),
            axis("distance (m)", 1, |c| c.error_3d_m),
        ];
        if self.report.rows.iter().any(|row| tube_radius_m(row).is_some()) {
            let radius = |row: &Row| tube_radius_m(row).unwrap_or(f64::NAN);
            panels[3].curves.push(self.curve("tube", Style::Reference, radius));
        }
        let yaw = self
            .angle("error", Style::Colour(1), |r| r.share().map_or(f64::NAN, |c| c.error_yaw_rad));
        panels.push(Panel { name: "yaw (deg)".into(), curves: vec![yaw] });
        self.chart(92.0, panels)
    }

    fn states(&self) -> String {
        type Get<M> = fn(&M) -> f64;
        let linear = |name: &str, flown: Get<StateMessage>, desired: Get<ReferenceMessage>| Panel {
            name: name.into(),
            curves: vec![
                self.curve("flown", Style::Colour(1), move |r| flown(&r.state)),
                self.curve("desired", Style::Reference, move |r| {
                    r.followed().map_or(f64::NAN, desired)
                }),
            ],
        };
        let angular =
            |name: &str, flown: Get<StateMessage>, desired: Get<ReferenceMessage>| Panel {
                name: name.into(),
                curves: vec![
                    self.angle("flown", Style::Colour(1), move |r| flown(&r.state)),
                    self.angle("desired", Style::Reference, move |r| {
                        r.followed().map_or(f64::NAN, desired)
                    }),
                ],
            };
        let position = vec![
            linear("north (m)", |s| s.p_n_m, |r| r.p_n_m),
            linear("east (m)", |s| s.p_e_m, |r| r.p_e_m),
            linear("down (m)", |s| s.p_d_m, |r| r.p_d_m),
        ];
        let velocity = vec![
            linear("north (m/s)", |s| s.v_n_mps, |r| r.v_n_mps),
            linear("east (m/s)", |s| s.v_e_mps, |r| r.v_e_mps),
            linear("down (m/s)", |s| s.v_d_mps, |r| r.v_d_mps),
        ];
        let attitude = vec![
            angular("roll (deg)", |s| s.roll_rad, |r| r.roll_rad),
            angular("pitch (deg)", |s| s.pitch_rad, |r| r.pitch_rad),
            angular("yaw (deg)", |s| s.yaw_rad, |r| r.yaw_rad),
        ];
        let rate = vec![
            angular("roll rate (deg/s)", |s| s.p_radps, |r| r.p_radps),
            angular("pitch rate (deg/s)", |s| s.q_radps, |r| r.q_radps),
            angular("yaw rate (deg/s)", |s| s.r_radps, |r| r.r_radps),
        ];
        let all = [
            ("Position", position),
            ("Velocity", velocity),
            ("Attitude", attitude),
            ("Body rate", rate),
        ];
        all.map(|(heading, panels)| format!("<h3>{heading}</h3>{}", self.chart(104.0, panels)))
            .concat()
    }

    fn setpoints(&self) -> String {
        type Get<M> = fn(&M) -> f64;
        let sent =
            |get: Get<SetpointMessage>| move |r: &Row| r.setpoint.as_ref().map_or(f64::NAN, get);
        let share = |get: Get<ControlMessage>| move |r: &Row| r.share().map_or(f64::NAN, get);
        let angular = |name: &str, total: Get<SetpointMessage>, ff: Get<ControlMessage>| Panel {
            name: name.into(),
            curves: vec![
                self.angle("sent", Style::Colour(1), sent(total)),
                self.angle("feed-forward", Style::Colour(2), share(ff)),
            ],
        };
        let thrust = Panel {
            name: "thrust (N)".into(),
            curves: vec![
                self.curve("sent", Style::Colour(1), sent(|s| s.thrust_n)),
                self.curve("feed-forward", Style::Colour(2), share(|c| c.ff_thrust_n)),
            ],
        };
        self.chart(
            92.0,
            vec![
                thrust,
                angular("roll (deg)", |s| s.roll_rad, |c| c.ff_roll_rad),
                angular("pitch (deg)", |s| s.pitch_rad, |c| c.ff_pitch_rad),
                angular("yaw (deg)", |s| s.yaw_rad, |c| c.ff_yaw_rad),
                angular("roll rate (deg/s)", |s| s.p_radps, |c| c.ff_p_radps),
                angular("pitch rate (deg/s)", |s| s.q_radps, |c| c.ff_q_radps),
                angular("yaw rate (deg/s)", |s| s.r_radps, |c| c.ff_r_radps),
            ],
        )
    }
}

/// The signed errors in numbers.
fn biases(report: &FlightReport) -> String {
    type Get = fn(&ControlMessage) -> f64;
    let mut table = Table::new(&[
        ("", false),
        ("bias", true),
        ("standard deviation", true),
        ("least", true),
        ("greatest", true),
    ]);
    let axes: [(&str, Get); 4] = [
        ("north (m)", |c| c.error_n_m),
        ("east (m)", |c| c.error_e_m),
        ("down (m)", |c| c.error_d_m),
        ("yaw (deg)", |c| c.error_yaw_rad.to_degrees()),
    ];
    let tracks = |c: &&ControlMessage| c.trajectory_time_s.is_finite();
    for (name, get) in axes {
        let controls = report.rows.iter().filter_map(Row::share).filter(tracks);
        let errors: Vec<f64> = controls.map(get).filter(|e| e.is_finite()).collect();
        let n = errors.len().max(1) as f64;
        let bias = errors.iter().sum::<f64>() / n;
        let deviation = (errors.iter().map(|e| (e - bias).powi(2)).sum::<f64>() / n).sqrt();
        let Some((least, most)) = range_of(errors.iter().copied()) else { continue };
        let mut cells = vec![name.to_owned()];
        cells.extend([bias, deviation, least, most].map(|v| format!("{v:.4}")));
        table.row(Mood::Plain, &cells);
    }
    table.into_html()
}

fn timing(report: &FlightReport) -> String {
    let milliseconds = |values: Vec<f64>| values.into_iter().map(|v| v * 1e3).collect::<Vec<_>>();
    let ages = milliseconds(report.sample_ages());
    let intervals = milliseconds(report.intervals());
    let age = Histogram {
        name: "Age of the state's sample at the tick",
        x_label: "age (ms)",
        values: &ages,
        bars: 60,
    };
    let interval = Histogram {
        name: "Interval between ticks",
        x_label: "interval (ms)",
        values: &intervals,
        bars: 60,
    };
    let control = &report.summary().control;
    let mut table = Table::new(&[("", false), ("50 %", true), ("99 %", true), ("largest", true)]);
    let age_row = [control.sample_age_p50_s, control.sample_age_p99_s, control.sample_age_max_s];
    let mut cells = vec!["sample age".to_owned()];
    cells.extend(age_row.map(duration));
    table.row(Mood::Plain, &cells);
    let cells = ["deviation from the usual interval".into(), String::new()];
    table
        .row(Mood::Plain, &[&cells[..], &[duration(control.jitter_p99_s), String::new()]].concat());
    format!("{}{}{}", table.into_html(), age.to_html(), interval.to_html())
}

fn link(report: &FlightReport, figure: &Figure<'_>) -> String {
    type Get = fn(&LinkStatsMessage) -> f64;
    let time: Vec<f64> = report.link.iter().map(|(ns, _)| seconds(report, *ns)).collect();
    let curve = |name: &str, colour, get: Get| Curve {
        name: name.into(),
        style: Style::Colour(colour),
        y: report.link.iter().map(|(_, s)| get(s)).collect(),
    };
    let panels = vec![
        Panel {
            name: "rates (1/s)".into(),
            curves: vec![
                curve("frames received", 1, |s| s.rx_frames_hz),
                curve("frames sent", 2, |s| s.tx_frames_hz),
                curve("attitude", 3, |s| s.attitude_hz),
                curve("position", 4, |s| s.position_hz),
            ],
        },
        Panel {
            name: "round trip (ms)".into(),
            curves: vec![curve("round trip", 1, |s| s.rtt_s * 1e3)],
        },
    ];
    let chart = figure.over(&time, 92.0, panels);
    let mut table = Table::new(&[("counter", false), ("value", true)]);
    if let Some(link) = &report.summary().link {
        let mood = |count: u64| if count == 0 { Mood::Plain } else { Mood::Warning };
        let mut count = |name: &str, count: u64| {
            table.row(mood(count), &[name.into(), count.to_string()]);
        };
        count("frames with a wrong checksum", link.crc_errors);
        count("frames missing from the vehicle's sequence", link.lost_frames);
        count("frames with the vehicle's ids from another sender", link.stray_frames);
        count("frames with implausible content", link.refused_frames);
        count("frames that could not be sent", link.dropped_frames);
        count("reconnects", link.reconnects);
        // A ground station on the same link is no trouble.
        let foreign = "frames of other systems and components".into();
        table.row(Mood::Plain, &[foreign, link.foreign_frames.to_string()]);
        table.row(Mood::Plain, &["longest round trip".into(), duration(link.rtt_max_s)]);
    }
    format!("{chart}{}", table.into_html())
}

fn event_mood(event: &EventInfo) -> Mood {
    match event.level {
        "warning" => Mood::Warning,
        "error" | "fatal" => Mood::Bad,
        _ => Mood::Plain,
    }
}

fn events(report: &FlightReport) -> String {
    let events = &report.info.events;
    if events.is_empty() {
        return "<p class=\"note\">None.</p>".into();
    }
    let mut table =
        Table::new(&[("level", false), ("time (s)", true), ("from", false), ("text", false)]);
    for event in events.iter().take(EVENTS_LISTED) {
        let cells = [
            Cell::from(event.level),
            Cell::instant(event.time_s, "desired-and-flown"),
            Cell::from(event.source.as_str()),
            Cell::from(event.text.as_str()),
        ];
        table.cells(event_mood(event), &cells);
    }
    let left = report.info.events_total.saturating_sub(EVENTS_LISTED as u64);
    let more = match left {
        0 => String::new(),
        n => format!("<p class=\"note\">and {n} more, in the log.</p>"),
    };
    format!("{}{more}", table.into_html())
}

fn provenance(report: &FlightReport) -> String {
    let text = [
        (
            "errors",
            "state minus reference; RMS over the ticks with a trajectory, without take-off, hold \
             and landing",
        ),
        ("frames", "world north, east, down; body front, right, down; yaw from north towards east"),
        (
            "missed ticks",
            "pauses of more than 1.5 usual intervals, each counted as the number of missing ticks; \
             usual is the mean interval without these pauses, whose inverse is the control rate",
        ),
        (
            "sample age",
            "host time of the tick minus the sample's time on the vehicle, mapped by TIMESYNC where the vehicle stamps it",
        ),
        (
            "drawing",
            "long flights show the smallest and the largest value of each step along the time \
             axis; tables use every value",
        ),
    ];
    let run = report.info.run.iter().map(|(key, value)| (key.as_str(), value.as_str()));
    format!("{}<h3>The run, according to the log</h3>{}", definitions(text), definitions(run))
}

/// Seconds since the log's start.
fn seconds(report: &FlightReport, log_ns: u64) -> f64 {
    log_ns.saturating_sub(report.info.start_ns) as f64 * 1e-9
}

/// A short duration for people.
fn duration(seconds: Option<f64>) -> String {
    seconds.map_or("unknown".into(), |s| format!("{} ms", significant(s * 1e3)))
}
