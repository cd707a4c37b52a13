//! Sections on a recorded flight, and the page of a log that another program wrote.

mod motion;

use vehicle::frame::Ned;

use self::motion::{errors, motion, with_unit};
use super::axis::significant;
use super::chart::{Band, Chart, Curve, Mark, Panel, Style};
use super::page::{Mood, Page};
use super::power::Spectrum;
use super::recording::{Recording, load_factor, streams, vibration};
use super::scene::Scene;
use super::table::{Cell, Table, definitions};
use super::text::length;
use crate::log::import::{Clock, MotorUnit, SetpointSource, Stream};

pub(super) const TIME: &str = "time since the start of the log (s)";
/// Jumps and texts that a page lists.
const LISTED: usize = 60;
/// Below this, motion is in the spectrum, Hz.
const MOTION_HZ: f64 = 10.0;
/// Samples of a stream in so long make its rate, s.
const RATE_WINDOW_S: f64 = 1.0;
const AXES: [&str; 3] = ["roll", "pitch", "yaw"];

/// Where the vehicle's times stand on the page's axis, and what stands behind the curves.
#[derive(Clone, Debug)]
pub(super) struct Timeline<'a> {
    /// Added to a time of the vehicle's clock, s.
    pub shift_s: f64,
    pub bands: &'a [Band],
    pub marks: &'a [Mark],
    /// The part of the axis that every chart shows.
    pub span: (f64, f64),
    /// The section that events lead to.
    pub anchor: &'a str,
}

impl Timeline<'_> {
    fn times(&self, times: &[f64]) -> Vec<f64> {
        times.iter().map(|time| time + self.shift_s).collect()
    }

    fn chart(&self, times: &[f64], height: f64, panels: Vec<Panel>) -> String {
        self.over(&self.times(times), height, panels).to_html()
    }

    fn over<'a>(&'a self, times: &'a [f64], height: f64, panels: Vec<Panel>) -> Chart<'a> {
        let Self { bands, marks, span, .. } = self;
        let span = Some(*span).filter(|(from, to)| to > from);
        Chart { bands, marks, span, ..Chart::new(TIME, times, height, panels) }
    }
}

fn panel(name: &str, curves: Vec<Curve>) -> Panel {
    Panel { name: name.to_owned(), curves }
}

fn curve(name: &str, colour: u8, y: Vec<f64>) -> Curve {
    Curve { name: name.to_owned(), style: Style::Colour(colour), y }
}

/// One panel an axis, of a stream of three numbers.
fn axes<T>(
    stream: &Stream<T>,
    names: [&str; 3],
    value: impl Fn(&T) -> [f64; 3],
    scale: f64,
) -> Vec<Panel> {
    let column = |axis: usize| stream.values().iter().map(|v| scale * value(v)[axis]).collect();
    names
        .iter()
        .enumerate()
        .map(|(i, name)| panel(name, vec![curve("flown", 1, column(i))]))
        .collect()
}

/// What there is beside path and control: motors, pack, vibration, jumps, rates.
pub(super) fn sections(recording: &Recording, timeline: &Timeline<'_>, page: &mut Page) {
    if !recording.flight.outputs.is_empty() {
        page.section(
            "Motors",
            "Outputs as shares of full thrust where the log states their range. Headroom is the \
             margin between the strongest motor and full thrust: at 0 the vehicle can do no more.",
            &motors(recording, timeline),
        );
    }
    let hover = thrust(recording, timeline);
    if !hover.is_empty() {
        page.section(
            "Thrust against hover",
            "Mean motor output over its median in flight, and the accelerometer's thrust over \
             weight: both are 1 in hover. Where they diverge, thrust does not follow the outputs.",
            &hover,
        );
    }
    if !recording.flight.voltage.is_empty() {
        page.section("Battery", "", &battery(recording, timeline));
    }
    let shaken = vibration(recording, timeline);
    if !shaken.is_empty() {
        page.section(
            "Vibration",
            "Root mean square of everything above 10 Hz, over half seconds; below, the spectral \
             density of the gyro, as far as the log's rate shows it.",
            &shaken,
        );
    }
    page.section(
        "Estimate",
        "Steps of position and attitude between samples that velocity and body rate do not explain.",
        &jumps(recording, timeline),
    );
    page.section(
        "Streams",
        "The log's content, and samples in each second.",
        &rates(recording, timeline),
    );
}

fn motors(recording: &Recording, timeline: &Timeline<'_>) -> String {
    let outputs = &recording.flight.outputs;
    let column = |i: usize| outputs.values().iter().map(|u| u[i]).collect();
    let names = ["motor 1", "motor 2", "motor 3", "motor 4"];
    let each = names.iter().enumerate().map(|(i, name)| curve(name, i as u8 + 1, column(i)));
    let unit = match (recording.has_range, recording.flight.motor_unit) {
        (true, _) => "output (0..1)",
        (false, MotorUnit::Newton) => "output (N)",
        (false, _) => "output (as logged)",
    };
    let mut panels = vec![panel(unit, each.collect())];
    if recording.has_range {
        let room = |u: &[f64; 4]| 1.0 - u.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let room = outputs.values().iter().map(room).collect();
        panels.push(panel(
            "headroom of the strongest motor (0..1)",
            vec![curve("headroom", 1, room)],
        ));
    }
    let mut html = timeline.chart(outputs.times(), 130.0, panels);
    if let Some(motors) = &recording.summary().motors {
        let mut table = Table::new(&[
            ("", false),
            ("motor 1", true),
            ("motor 2", true),
            ("motor 3", true),
            ("motor 4", true),
        ]);
        for (name, values) in [("mean in flight", motors.mean), ("greatest", motors.max)] {
            let mut cells = vec![name.to_owned()];
            cells.extend(values.map(|v| format!("{v:.3}")));
            table.row(Mood::Plain, &cells);
        }
        html += &table.into_html();
        html += &format!(
            "<p class=\"note\">Hover takes {:.0} % of full. The least headroom is {:.0} %; a motor is at its limit for {:.1} % of the flight.</p>",
            100.0 * motors.hover,
            100.0 * motors.headroom_min,
            100.0 * motors.full_share
        );
    }
    html
}

fn thrust(recording: &Recording, timeline: &Timeline<'_>) -> String {
    let mut html = String::new();
    if let (Some(motors), true) = (&recording.summary().motors, recording.has_range) {
        let outputs = &recording.flight.outputs;
        let over = |u: &[f64; 4]| u.iter().sum::<f64>() / 4.0 / motors.hover;
        let over = outputs.values().iter().map(over).collect();
        let panels =
            vec![panel("motor outputs, mean over that of hover", vec![curve("outputs", 1, over)])];
        html += &timeline.chart(outputs.times(), 100.0, panels);
    }
    let (time, load) = load_factor(&recording.flight);
    if !time.is_empty() {
        let panels =
            vec![panel("accelerometer, thrust over weight", vec![curve("accelerometer", 2, load)])];
        html += &timeline.chart(&time, 100.0, panels);
    }
    html
}

fn battery(recording: &Recording, timeline: &Timeline<'_>) -> String {
    let voltage = &recording.flight.voltage;
    let panels = vec![panel("voltage (V)", vec![curve("voltage", 1, voltage.values().to_vec())])];
    let mut html = timeline.chart(voltage.times(), 100.0, panels);
    if let Some(pack) = recording.summary().battery {
        html += &format!(
            "<p class=\"note\">From {:.2} V to {:.2} V; minimum {:.2} V.</p>",
            pack.first_v, pack.last_v, pack.min_v
        );
    }
    html
}

fn vibration(recording: &Recording, timeline: &Timeline<'_>) -> String {
    let flight = &recording.flight;
    let force = flight.specific_force.map(|f| f.to_array());
    let rate = flight.body_rate.map(|w| w.to_array().map(f64::to_degrees));
    let mut html = String::new();
    let kinds = [
        (&force, "specific force above 10 Hz (m/s\u{b2})", ["front", "right", "down"]),
        (&rate, "body rate above 10 Hz (deg/s)", AXES),
    ];
    for (stream, name, axes) in kinds {
        let (time, rms) = vibration::over_time(stream);
        if time.is_empty() {
            continue;
        }
        let curves =
            rms.into_iter().zip(axes).zip(1..).map(|((y, axis), colour)| curve(axis, colour, y));
        html += &timeline.chart(&time, 110.0, vec![panel(name, curves.collect())]);
    }
    if let Some(spectrum) = Spectrum::of(&rate) {
        let log = |p: &f64| 0.5 * p.max(1e-30).log10();
        let curves: Vec<Curve> = (0..3)
            .map(|i| curve(AXES[i], i as u8 + 1, spectrum.density[i].iter().map(log).collect()))
            .collect();
        let panels = vec![panel("gyro, log10 of its density (deg/s per \u{221a}Hz)", curves)];
        html += &Chart::new("frequency (Hz)", &spectrum.frequency_hz, 150.0, panels).to_html();
        let peaks: Vec<String> = (0..3)
            .filter_map(|axis| {
                let (at, above) = spectrum.peak(axis, MOTION_HZ)?;
                Some(format!(
                    "{} at {at:.0} Hz, {} times the median",
                    AXES[axis],
                    significant(above.sqrt())
                ))
            })
            .collect();
        if !peaks.is_empty() {
            html += &format!("<p class=\"note\">Strongest above 10 Hz: {}.</p>", peaks.join("; "));
        }
    } else if !html.is_empty() {
        html += "<p class=\"note\">The gyro was logged too slowly, or too unevenly, for a spectrum.</p>";
    }
    html
}

fn jumps(recording: &Recording, timeline: &Timeline<'_>) -> String {
    let jumps = &recording.summary().jumps;
    let flight = &recording.flight;
    if flight.position.len() < 2 && flight.attitude.len() < 2 {
        return "<p class=\"note\">The log holds neither position nor attitude.</p>".into();
    }
    if jumps.is_empty() {
        return "<p class=\"note\">None.</p>".into();
    }
    let mut table = Table::new(&[("time (s)", true), ("of", false), ("size", true)]);
    for jump in jumps.iter().take(LISTED) {
        let size = match jump.of {
            "position" => length(jump.size),
            _ => format!("{:.1} deg", jump.size.to_degrees()),
        };
        let time = jump.time_s + recording.span.0 + timeline.shift_s;
        let cells = [Cell::instant(time, timeline.anchor), jump.of.into(), size.as_str().into()];
        table.cells(Mood::Plain, &cells);
    }
    let more = jumps.len().saturating_sub(LISTED);
    let more =
        if more > 0 { format!("<p class=\"note\">And {more} more.</p>") } else { String::new() };
    table.into_html() + &more
}

fn rates(recording: &Recording, timeline: &Timeline<'_>) -> String {
    let mut table = Table::new(&[
        ("stream", false),
        ("samples", true),
        ("rate (Hz)", true),
        ("longest gap (s)", true),
    ]);
    for stream in &recording.summary().streams {
        let usual = if stream.rate_hz > 0.0 { 1.0 / stream.rate_hz } else { f64::INFINITY };
        let mood = if stream.longest_gap_s > (20.0 * usual).max(1.0) {
            Mood::Warning
        } else {
            Mood::Plain
        };
        table.row(
            mood,
            &[
                stream.stream.to_owned(),
                stream.samples.to_string(),
                format!("{:.1}", stream.rate_hz),
                format!("{:.3}", stream.longest_gap_s),
            ],
        );
    }
    let (from, to) = recording.span;
    let windows = ((to - from) / RATE_WINDOW_S).floor();
    if !(2.0..1e5).contains(&windows) {
        return table.into_html();
    }
    let windows = windows as usize;
    let middles: Vec<f64> = (0..windows).map(|k| from + (k as f64 + 0.5) * RATE_WINDOW_S).collect();
    let panels = streams(&recording.flight).into_iter().map(|(name, times)| {
        let mut counts = vec![0.0; windows];
        for time in times {
            if let Some(count) = counts.get_mut(((time - from) / RATE_WINDOW_S) as usize) {
                *count += 1.0 / RATE_WINDOW_S;
            }
        }
        panel(&format!("{name} (1/s)"), vec![curve("samples", 1, counts)])
    });
    let middles = timeline.times(&middles);
    let chart = Chart { from_zero: true, ..timeline.over(&middles, 52.0, panels.collect()) };
    table.into_html() + &chart.to_html()
}

impl Recording {
    /// The page of a log that this program did not fly.
    pub fn to_html(&self) -> String {
        let flight = &self.flight;
        let facts = &flight.facts;
        let of = facts.autopilot.clone().unwrap_or_else(|| "vehicle unknown".to_owned());
        let subtitle = format!("{of}, read from a {} log", flight.origin.format);
        let mut page = Page::new(&format!("Flight report: {}", flight.origin.run), &subtitle);
        let texts = texts(&facts.texts, self.span.0);
        let marks: Vec<Mark> = Vec::new();
        let bands = in_air(self);
        let timeline = Timeline {
            shift_s: -self.span.0,
            bands: &bands,
            marks: &marks,
            span: (0.0, self.span.1 - self.span.0),
            anchor: "motion",
        };
        verdict(self, &mut page);
        if !flight.position.is_empty() {
            let flown: Vec<Ned> = flight.position.values().to_vec();
            let desired: Vec<Ned> = flight.reference.values().iter().map(|r| r.position).collect();
            let path = Scene { paths: &[("flown", &flown)], desired: &desired };
            page.section("Path", "To scale, seen from the south-west.", &path.to_html());
        }
        let tracked = self.tracked();
        if !tracked.is_empty() {
            let by = match flight.setpoint_source {
                SetpointSource::Ground => "setpoints as the ground sent them",
                SetpointSource::Onboard => "setpoints as the autopilot followed them",
            };
            let explanation = format!("Signed error, reported minus setpoint; {by}.");
            page.section("Errors", &explanation, &errors(self, &tracked, &timeline));
        }
        page.section(
            "Motion",
            "World axes: north, east, down. Body: front, right, down.",
            &motion(self, &tracked, &timeline),
        );
        sections(self, &timeline, &mut page);
        if !texts.is_empty() {
            page.section("Texts", "Messages from the vehicle.", &texts_table(&texts));
        }
        page.section("How this was computed", "", &provenance(self));
        page.into_html()
    }
}

fn verdict(recording: &Recording, page: &mut Page) {
    let summary = recording.summary();
    let mut reasons = Vec::new();
    if let Some(stated) = recording.flight.facts.stated_otherwise() {
        reasons.push(format!("the log states that this is not a multirotor: {}", stated.kind));
    }
    if let Some(motors) = summary.motors.as_ref().filter(|motors| motors.full_share > 0.01) {
        let share = 100.0 * motors.full_share;
        reasons.push(format!("a motor is at its limit for {share:.1} % of the flight"));
    }
    match summary.jumps.len() {
        0 => {}
        1 => reasons.push("the estimate jumps once".to_owned()),
        n => reasons.push(format!("the estimate jumps {n} times")),
    }
    let sentence = match summary.errors.as_slice() {
        [] => format!("{:.1} s were recorded, without setpoints.", summary.duration_s),
        errors => {
            let largest: Vec<String> = errors
                .iter()
                .take(3)
                .map(|error| format!("{} {}", error.axis, with_unit(error.rms, error.unit)))
                .collect();
            format!(
                "{:.1} s were recorded; RMS errors: {}.",
                summary.duration_s,
                largest.join(", ")
            )
        }
    };
    let mood = if reasons.is_empty() { Mood::Plain } else { Mood::Warning };
    page.verdict(mood, &sentence, &reasons);
    let mut figures = vec![("log", format!("{:.1} s", summary.duration_s), Mood::Plain)];
    if let Some(motors) = &summary.motors {
        figures.push((
            "hover, of full thrust",
            format!("{:.0} %", 100.0 * motors.hover),
            Mood::Plain,
        ));
        let mood = if motors.headroom_min < 0.02 { Mood::Warning } else { Mood::Plain };
        figures.push(("least headroom", format!("{:.0} %", 100.0 * motors.headroom_min), mood));
    }
    if let Some(pack) = summary.battery {
        figures.push(("least voltage", format!("{:.2} V", pack.min_v), Mood::Plain));
    }
    if let Some([x, y, z]) = summary.vibration_m_s2 {
        let all = (x * x + y * y + z * z).sqrt();
        figures.push(("vibration, RMS", format!("{} m/s\u{b2}", significant(all)), Mood::Plain));
    }
    let mood = if summary.jumps.is_empty() { Mood::Good } else { Mood::Warning };
    figures.push(("jumps of the estimate", summary.jumps.len().to_string(), mood));
    page.figures(&figures);
}

/// Where the vehicle says that it is in the air.
fn in_air(recording: &Recording) -> Vec<Band> {
    let (start, end) = recording.span;
    let mut bands: Vec<Band> = Vec::new();
    for (time, is_up) in recording.flight.in_air.iter() {
        let name = if *is_up { "in the air" } else { "on the ground" };
        let from = time - start;
        match bands.last_mut() {
            Some(last) if last.name == name => {}
            last => {
                if let Some(last) = last {
                    last.to = from;
                }
                bands.push(Band { from, to: end - start, name: name.to_owned() });
            }
        }
    }
    bands
}

/// Texts with the times that stand before them, since the log's start.
fn texts(texts: &[String], start: f64) -> Vec<(Option<f64>, String)> {
    let timed = |text: &String| {
        let (time, rest) = text.split_once(" s: ")?;
        Some((Some(time.parse::<f64>().ok()? - start), rest.to_owned()))
    };
    texts.iter().map(|text| timed(text).unwrap_or((None, text.clone()))).collect()
}

fn texts_table(texts: &[(Option<f64>, String)]) -> String {
    let mut table = Table::new(&[("time (s)", true), ("text", false)]);
    for (time, text) in texts.iter().take(LISTED) {
        let time = time.map_or_else(|| Cell::from("-"), |time| Cell::instant(time, "motion"));
        table.cells(Mood::Plain, &[time, text.as_str().into()]);
    }
    table.into_html()
}

fn provenance(recording: &Recording) -> String {
    let flight = &recording.flight;
    let clock = match flight.clock {
        Clock::Single => "this log has a single clock".to_owned(),
        Clock::Synchronised => "ground and vehicle were synchronised".to_owned(),
        Clock::LeastDelay { assumed_s } => {
            format!(
                "the ground's clock by the least delay, assumed to be {:.1} ms",
                1e3 * assumed_s
            )
        }
    };
    let left_out: Vec<String> =
        flight.left_out.iter().map(|(what, count)| format!("{count} x {what}")).collect();
    let left_out = if left_out.is_empty() { "nothing".to_owned() } else { left_out.join("; ") };
    let notes = flight.facts.notes.join("; ");
    let vehicle =
        recording.vehicle.as_ref().map_or("not in the log", |vehicle| vehicle.name.as_str());
    let mut entries = vec![
        ("log", format!("{}, SHA-256 {}", flight.origin.format, flight.origin.sha256)),
        ("clock", clock),
        ("vehicle file", vehicle.to_owned()),
        ("left out of the file", left_out),
        (
            "jumps",
            "steps of more than 0.08 m or 4 deg that are more than 12 times the median step, where velocity and body rate are logged too".to_owned(),
        ),
        (
            "drawing",
            "long flights show the smallest and the largest value of each step along the time \
             axis; tables use every value"
                .to_owned(),
        ),
    ];
    if !notes.is_empty() {
        entries.insert(2, ("streams", notes));
    }
    definitions(entries.iter().map(|(term, value)| (*term, value.as_str())))
}
