//! `downwash inspect`: the messages on a link, with rate, size, age and last value.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{self, IsTerminal};
use std::time::Duration;

use schemars::JsonSchema;
use serde::Serialize;
use wire::{Frame, message_name};

use super::listen::Listener;
use super::{Exit, print_json, print_status, print_text};
use crate::cli::ListenArgs;
use crate::clock::HostTime;
use crate::link::session::Delivery;

/// Listening time without a terminal, s.
const SECONDS: f64 = 8.0;
/// Period at which the table is drawn.
const REDRAW: Duration = Duration::from_millis(500);
/// Longest time over which rates are averaged, s.
const RATE_SPAN_S: f64 = 4.0;
/// Longest value in the table, characters.
const VALUE_WIDTH: usize = 100;

/// The JSON of `inspect`.
#[derive(JsonSchema, Serialize)]
pub(super) struct Report {
    schema: &'static str,
    schema_version: u32,
    seconds: f64,
    messages: Vec<Row>,
}

/// One message of one sender.
#[derive(Clone, JsonSchema, Serialize)]
struct Row {
    system: u32,
    component: u8,
    id: u32,
    name: String,
    count: u64,
    rate_hz: f64,
    /// Size of the newest frame on the wire, bytes.
    frame_bytes: usize,
    age_s: f64,
    value: String,
}

/// The arrivals of one message.
struct Seen {
    count: u64,
    /// Arrivals within the averaging time.
    arrivals: Vec<HostTime>,
    frame: Vec<u8>,
}

type Table = BTreeMap<(u32, u8, u32), Seen>;

pub(super) fn run(args: &ListenArgs) -> anyhow::Result<Exit> {
    let is_live = io::stdout().is_terminal() && !args.json;
    let limit_s = args.seconds.or((!is_live).then_some(SECONDS));
    let mut listener = Listener::open(args, false)?;
    match limit_s {
        Some(limit) => {
            print_status(format_args!("listening on {} for {limit} s", listener.endpoint))
        }
        None => print_status(format_args!("listening on {} until Ctrl-C", listener.endpoint)),
    }
    let started = listener.clock.now();
    let mut table = Table::new();
    loop {
        let now = listener.clock.now();
        let passed_s = now.since(started).as_secs_f64();
        let left_s = limit_s.map_or(f64::INFINITY, |limit| limit - passed_s);
        let rows = rows(&table, now, started);
        if left_s <= 0.0 {
            let is_silent = rows.is_empty();
            if args.json {
                let schema = "downwash.inspect";
                print_json(&Report {
                    schema,
                    schema_version: 1,
                    seconds: passed_s,
                    messages: rows,
                })?;
            } else {
                print_text(&text(&rows))?;
            }
            return Ok(if is_silent { Exit::Link } else { Exit::Ok });
        }
        if is_live {
            // Draws from the top, over the last table.
            print_text(&format!("\x1b[H\x1b[2J{}{}\n", text(&rows), listener.endpoint))?;
        }
        let step = if is_live { REDRAW } else { Duration::from_secs_f64(left_s) };
        listener.listen(step.min(Duration::from_secs_f64(left_s.min(60.0))), |now, delivery| {
            if let Delivery::Frame { bytes, .. } = delivery {
                count(&mut table, now, bytes);
            }
        });
    }
}

fn count(table: &mut Table, now: HostTime, bytes: &[u8]) {
    let Some(frame) = Frame::parse(bytes) else { return };
    let key = (frame.system(), frame.component(), frame.id());
    let seen = table.entry(key).or_insert_with(|| Seen {
        count: 0,
        arrivals: Vec::new(),
        frame: Vec::new(),
    });
    seen.count += 1;
    seen.arrivals.retain(|at| now.since(*at).as_secs_f64() < RATE_SPAN_S);
    seen.arrivals.push(now);
    seen.frame = bytes.to_vec();
}

fn rows(table: &Table, now: HostTime, started: HostTime) -> Vec<Row> {
    let span_s = now.since(started).as_secs_f64().clamp(1e-3, RATE_SPAN_S);
    let row = |(&(system, component, id), seen): (&(u32, u8, u32), &Seen)| {
        let is_recent = |at: &&HostTime| now.since(**at).as_secs_f64() < RATE_SPAN_S;
        let message = Frame::parse(&seen.frame).map(|frame| frame.message());
        Row {
            system,
            component,
            id,
            name: message_name(id),
            count: seen.count,
            rate_hz: seen.arrivals.iter().filter(is_recent).count() as f64 / span_s,
            frame_bytes: seen.frame.len(),
            age_s: seen.arrivals.last().map_or(f64::NAN, |at| now.since(*at).as_secs_f64()),
            value: match message {
                Some(Ok(message)) => value(&format!("{message:?}")),
                _ => "a payload that does not fit the message".to_owned(),
            },
        }
    };
    table.iter().map(row).collect()
}

/// The fields of a message in `Debug`'s form, without its name twice.
fn value(debug: &str) -> String {
    let fields = debug.split_once("{ ").map_or(debug, |(_, fields)| fields);
    fields.trim_end_matches([')', '}', ' ']).to_owned()
}

fn text(rows: &[Row]) -> String {
    if rows.is_empty() {
        return "nothing received\n".to_owned();
    }
    let mut text = format!(
        "{:>3} {:>4} {:>5} {:<28} {:>8} {:>6} {:>7}  value\n",
        "sys", "comp", "id", "message", "Hz", "bytes", "age s"
    );
    for row in rows {
        let value: String = row.value.chars().take(VALUE_WIDTH).collect();
        let _ = writeln!(
            text,
            "{:>3} {:>4} {:>5} {:<28} {:>8.1} {:>6} {:>7.2}  {value}",
            row.system, row.component, row.id, row.name, row.rate_hz, row.frame_bytes, row.age_s
        );
    }
    text
}
