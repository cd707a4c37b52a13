//! The layout of the terminal view.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Gauge, Paragraph};

use super::screen_content::ScreenContent;
use crate::station::Status;

const GOOD: Color = Color::Green;
const BAD: Color = Color::Red;

/// Share of charge below which the battery is shown as a warning.
const LOW_CHARGE: f64 = 0.2;

pub(super) fn draw(frame: &mut Frame<'_>, title: &str, status: &Status, content: &ScreenContent) {
    let heights = [1, 1, 1, 1, 1, 1, 1, 1];
    let rows = heights.map(Constraint::Length).into_iter();
    let rows = rows.chain([Constraint::Min(3), Constraint::Length(1)]);
    let areas = Layout::vertical(rows).split(frame.area());
    let lines = [
        Line::styled(title, Style::new().add_modifier(Modifier::BOLD)),
        flight(status),
        link(status, content),
        position(status, content),
        attitude(content),
        rates(status, content),
    ];
    for (line, area) in lines.into_iter().zip(areas.iter()) {
        frame.render_widget(Paragraph::new(line), *area);
    }
    let [.., progress, battery, messages, keys] = &*areas else { return };
    draw_progress(frame, *progress, status);
    draw_battery(frame, *battery, status, content);
    draw_messages(frame, *messages, content);
    let text =
        "q or Ctrl-C: land and stop; again: stop sending at once    Up, Down, PgUp, PgDn: events";
    frame
        .render_widget(Paragraph::new(Line::styled(text, Style::new().fg(Color::DarkGray))), *keys);
}

/// A name and its value.
fn item<'a>(name: &'a str, value: String, style: Style) -> [Span<'a>; 3] {
    let dim = Style::new().fg(Color::DarkGray);
    [Span::styled(name, dim), Span::styled(format!(" {value}"), style), Span::raw("   ")]
}

fn plain<'a>(name: &'a str, value: String) -> [Span<'a>; 3] {
    item(name, value, Style::new())
}

fn line<'a, const N: usize>(items: [[Span<'a>; 3]; N]) -> Line<'a> {
    Line::from_iter(items.into_iter().flatten())
}

/// The value, or a dash where there is none.
fn known(value: Option<f64>, digits: usize, unit: &str) -> String {
    match value.filter(|value| value.is_finite()) {
        Some(value) => format!("{value:.digits$} {unit}"),
        None => "-".to_owned(),
    }
}

fn flight(status: &Status) -> Line<'_> {
    let state = status.phase.map_or("connect", |phase| phase.name());
    let mode = match (status.mode_name, status.mode) {
        (Some(name), _) => name.to_owned(),
        (None, Some(mode)) => format!("{mode:#010x}"),
        (None, None) => "-".to_owned(),
    };
    let armed = match status.armed {
        Some(true) => item("motors", "armed".to_owned(), Style::new().fg(Color::Yellow)),
        Some(false) => plain("motors", "disarmed".to_owned()),
        None => plain("motors", "-".to_owned()),
    };
    let bold = Style::new().add_modifier(Modifier::BOLD);
    let vehicle = status.vehicle.unwrap_or("-").to_owned();
    line([
        item("state", state.to_owned(), bold),
        item("mode", mode, bold),
        armed,
        plain("vehicle", vehicle),
    ])
}

fn link<'a>(status: &Status, content: &ScreenContent) -> Line<'a> {
    let colour = if status.link == "connected" { GOOD } else { BAD };
    let stats = content.link.as_ref();
    let lost = stats.map_or("-".to_owned(), |stats| stats.lost_frames.to_string());
    line([
        item("link", status.link.to_owned(), Style::new().fg(colour)),
        plain("round trip", known(status.round_trip_s.map(|s| 1e3 * s), 1, "ms")),
        plain("frames lost", lost),
        plain("setpoints sent", status.setpoints.to_string()),
    ])
}

fn position<'a>(status: &Status, content: &ScreenContent) -> Line<'a> {
    let p = status.position;
    let place = match status.tick_rate_hz > 0.0 {
        true => format!("n {:+.2} e {:+.2} d {:+.2} m", p.north(), p.east(), p.down()),
        false => "-".to_owned(),
    };
    let error = content.tick.and_then(|tick| {
        let desired = tick.desired.or(tick.reference.map(|reference| reference.position))?;
        Some(tick.state.position - desired)
    });
    let error = error.map_or("-".to_owned(), |e| {
        let (n, e, d, all) = (e.north(), e.east(), e.down(), e.norm());
        format!("n {n:+.3} e {e:+.3} d {d:+.3}, {all:.3} m")
    });
    line([plain("position", place), plain("error", error)])
}

fn attitude<'a>(content: &ScreenContent) -> Line<'a> {
    let Some(tick) = content.tick else {
        return line([plain("attitude", "-".to_owned()), plain("rates", "-".to_owned())]);
    };
    let euler = tick.state.attitude.euler();
    let [roll, pitch, yaw] = [euler.roll, euler.pitch, euler.yaw].map(f64::to_degrees);
    let [p, q, r] = tick.state.body_rate.to_array().map(f64::to_degrees);
    line([
        plain("attitude", format!("roll {roll:+.1} pitch {pitch:+.1} yaw {yaw:+.1} deg")),
        plain("rates", format!("{p:+.0} {q:+.0} {r:+.0} deg/s")),
    ])
}

fn rates<'a>(status: &Status, content: &ScreenContent) -> Line<'a> {
    let stats = content.link.as_ref();
    line([
        plain("control", known(Some(status.tick_rate_hz), 0, "Hz")),
        plain("attitude", known(stats.map(|s| s.attitude_hz), 0, "Hz")),
        plain("position", known(stats.map(|s| s.position_hz), 0, "Hz")),
        plain("odometry", known(stats.map(|s| s.odometry_hz), 0, "Hz")),
    ])
}

fn draw_gauge(frame: &mut Frame<'_>, area: Rect, ratio: f64, label: String, colour: Color) {
    let ratio = if ratio.is_finite() { ratio.clamp(0.0, 1.0) } else { 0.0 };
    let gauge = Gauge::default().ratio(ratio).label(label).gauge_style(Style::new().fg(colour));
    frame.render_widget(gauge, area);
}

fn draw_progress(frame: &mut Frame<'_>, area: Rect, status: &Status) {
    let (ratio, label) = match status.progress {
        Some((time, length)) => (time / length, format!("trajectory {time:.1} of {length:.1} s")),
        None => (0.0, "trajectory not started".to_owned()),
    };
    draw_gauge(frame, area, ratio, label, Color::Blue);
}

fn draw_battery(frame: &mut Frame<'_>, area: Rect, status: &Status, content: &ScreenContent) {
    let share = known(status.battery.map(|share| 100.0 * share), 0, "%");
    let label = format!(
        "battery {share}, {}, {}",
        known(content.voltage, 2, "V"),
        known(content.current, 1, "A")
    );
    let colour = if status.battery.is_some_and(|left| left < LOW_CHARGE) { BAD } else { GOOD };
    draw_gauge(frame, area, status.battery.unwrap_or(0.0), label, colour);
}

/// The newest message is at the bottom.
fn draw_messages(frame: &mut Frame<'_>, area: Rect, content: &ScreenContent) {
    let block = Block::bordered().title("events");
    let height = usize::from(block.inner(area).height);
    let end = content.messages.len().saturating_sub(content.scrolled);
    let begin = end.saturating_sub(height);
    let shown = content.messages.range(begin..end).map(|message| Line::raw(message.as_str()));
    frame.render_widget(Paragraph::new(Vec::from_iter(shown)).block(block), area);
}
