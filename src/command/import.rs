//! `downwash log import`: any flight log as one of the project's own.

use std::path::Path;

use schemars::JsonSchema;
use serde::Serialize;

use super::output::check_output;
use super::{Exit, ExitContext, print_json, print_status, print_text};
use crate::audit::{Channels, Tier};
use crate::log::import::{
    self, Choice, Clock, Flight, MotorSource, MotorUnit, SetpointSource, Stream, VehicleFacts,
};

/// The JSON of `log import`.
#[derive(JsonSchema, Serialize)]
pub(super) struct Summary {
    schema: &'static str,
    schema_version: u32,
    file: String,
    run: String,
    format: &'static str,
    sha256: String,
    clock: &'static str,
    /// The assumed least delay of the downlink, s.
    clock_delay_s: Option<f64>,
    motor_unit: &'static str,
    motor_source: &'static str,
    setpoint_source: &'static str,
    /// `T0` to `T3`; null without a pose.
    tier: Option<Tier>,
    has_vehicle_file: bool,
    vehicle: VehicleFacts,
    streams: Vec<StreamSummary>,
    left_out: Vec<LeftOut>,
    out: String,
    messages: u64,
}

#[derive(JsonSchema, Serialize)]
struct StreamSummary {
    stream: &'static str,
    samples: usize,
    rate_hz: Option<f64>,
    start_s: Option<f64>,
    end_s: Option<f64>,
    longest_gap_s: Option<f64>,
}

#[derive(JsonSchema, Serialize)]
struct LeftOut {
    what: String,
    count: u64,
}

impl StreamSummary {
    fn new<T>(name: &'static str, stream: &Stream<T>) -> Self {
        let times = stream.times();
        let gaps = times.windows(2).map(|pair| pair[1] - pair[0]);
        Self {
            stream: name,
            samples: stream.len(),
            rate_hz: (stream.len() > 1).then(|| stream.rate()),
            start_s: times.first().copied(),
            end_s: times.last().copied(),
            longest_gap_s: gaps.reduce(f64::max),
        }
    }
}

/// The file to import, and how.
pub(super) struct Import<'a> {
    pub file: &'a Path,
    pub choice: Choice<'a>,
    /// Without an output, only a mapping file is printed.
    pub out: Option<&'a Path>,
    pub json: bool,
}

pub(super) fn run(import: Import<'_>) -> anyhow::Result<Exit> {
    let Import { file, choice, out, json } = import;
    let Some(out) = out else {
        print_text(&import::propose(file).or_exit(Exit::Usage)?)?;
        return Ok(Exit::Ok);
    };
    check_output(out, std::iter::once(file).chain(choice.mapping))?;
    let flight = import::open_chosen(file, choice).or_exit(Exit::Usage)?;
    print_losses(&flight);
    let messages = import::write(&flight, out)?;
    let summary = summary(&flight, out, messages);
    if json {
        print_json(&summary)?;
    } else {
        print_text(&text(&summary))?;
    }
    Ok(Exit::Ok)
}

/// Reports on stderr what damage destroyed of the file, and what is left.
fn print_losses(flight: &Flight) {
    let file = flight.origin.path.display();
    for loss in &flight.losses {
        print_status(format_args!("{file}: damaged: {loss}"));
    }
    if let (false, Some((start, end))) = (flight.losses.is_empty(), flight.span()) {
        print_status(format_args!("{file}: the readable part goes from {start:.3} to {end:.3} s"));
    }
}

fn summary(flight: &Flight, out: &Path, messages: u64) -> Summary {
    let (clock, clock_delay_s) = match flight.clock {
        Clock::Single => ("one clock", None),
        Clock::Synchronised => ("ground's clock tied by TIMESYNC", None),
        Clock::LeastDelay { assumed_s } => {
            ("ground's clock tied by the least delay", Some(assumed_s))
        }
    };
    let motor_unit = match flight.motor_unit {
        MotorUnit::ThrustFraction => "thrust fraction",
        MotorUnit::VehicleFile => "as the vehicle file's motor_output says",
        MotorUnit::Newton => "N",
    };
    let motor_source = match flight.motor_source {
        MotorSource::ActuatorOutputStatus => "ACTUATOR_OUTPUT_STATUS",
        MotorSource::ServoOutputRaw => "SERVO_OUTPUT_RAW",
        MotorSource::ActuatorMotors => "actuator_motors",
        MotorSource::ActuatorOutputs => "actuator_outputs",
        MotorSource::Rcou => "RCOU",
        MotorSource::OnboardLaw => "on-board law",
        MotorSource::Table => "table",
    };
    let streams = vec![
        StreamSummary::new("attitude", &flight.attitude),
        StreamSummary::new("position", &flight.position),
        StreamSummary::new("velocity", &flight.velocity),
        StreamSummary::new("body_rate", &flight.body_rate),
        StreamSummary::new("specific_force", &flight.specific_force),
        StreamSummary::new("outputs", &flight.outputs),
        StreamSummary::new("rotor_speed", &flight.rotor_speed),
        StreamSummary::new("setpoint", &flight.setpoint),
        StreamSummary::new("voltage", &flight.voltage),
        StreamSummary::new("in_air", &flight.in_air),
        StreamSummary::new("truth", &flight.truth),
    ];
    let left_out = flight.left_out.iter();
    Summary {
        schema: "downwash.log.import",
        schema_version: 1,
        file: flight.origin.path.display().to_string(),
        run: flight.origin.run.clone(),
        format: flight.origin.format,
        sha256: flight.origin.sha256.clone(),
        clock,
        clock_delay_s,
        motor_unit,
        motor_source,
        setpoint_source: match flight.setpoint_source {
            SetpointSource::Ground => "ground",
            SetpointSource::Onboard => "autopilot",
        },
        tier: Tier::of(&Channels::of(flight)),
        vehicle: flight.facts.clone(),
        has_vehicle_file: flight.vehicle_file.is_some(),
        streams,
        left_out: left_out
            .map(|(what, count)| LeftOut { what: what.clone(), count: *count })
            .collect(),
        out: out.display().to_string(),
        messages,
    }
}

fn text(summary: &Summary) -> String {
    let mut lines = vec![format!("{}: {} log", summary.file, summary.format)];
    lines.push(format!(
        "  {:<16} {:>9} {:>9}  span and longest gap",
        "stream", "samples", "rate/Hz"
    ));
    for stream in &summary.streams {
        let StreamSummary { stream, samples, rate_hz, start_s, end_s, longest_gap_s } = stream;
        if let (Some(start), Some(end)) = (start_s, end_s) {
            let rate = rate_hz.map_or("-".to_owned(), |rate| format!("{rate:.1}"));
            let gap = longest_gap_s.unwrap_or(0.0);
            lines.push(format!(
                "  {stream:<16} {samples:>9} {rate:>9}  {start:.3} to {end:.3} s, {gap:.3} s"
            ));
        }
    }
    let missing: Vec<_> =
        summary.streams.iter().filter(|s| s.samples == 0).map(|s| s.stream).collect();
    if !missing.is_empty() {
        lines.push(format!("  not logged: {}", missing.join(", ")));
    }
    let delay = summary.clock_delay_s.map_or(String::new(), |s| format!(" ({:.1} ms)", s * 1e3));
    lines.push(format!("  clocks: {}{delay}", summary.clock));
    if summary.streams.iter().any(|stream| stream.stream == "outputs" && stream.samples > 0) {
        let (unit, source) = (summary.motor_unit, summary.motor_source);
        lines.push(format!("  motor outputs: {unit}, from {source}"));
    }
    let tier = summary
        .tier
        .map_or("none: position, velocity and attitude are not all logged".to_owned(), |tier| {
            tier.to_string()
        });
    lines.push(format!("  tier: {tier}"));
    lines.extend(vehicle(&summary.vehicle));
    for LeftOut { what, count } in &summary.left_out {
        lines.push(format!("  left out: {count} x {what}"));
    }
    lines.push(format!("{}: {} messages", summary.out, summary.messages));
    lines.join("\n") + "\n"
}

/// What the log states about its vehicle.
fn vehicle(facts: &VehicleFacts) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some(autopilot) = &facts.autopilot {
        lines.push(format!("  autopilot: {autopilot}"));
    }
    for stated in &facts.kinds {
        lines.push(format!("  vehicle: {}, as {}", stated.kind, stated.by));
    }
    let motors = facts.motors.map(|motors| format!("{motors} motors"));
    let frame: Vec<String> = [facts.frame.clone(), motors].into_iter().flatten().collect();
    if !frame.is_empty() {
        lines.push(format!("  frame: {}", frame.join(", ")));
    }
    let spin = |spin: i8| if spin > 0 { "turning the body right" } else { "turning the body left" };
    for (motor, rotor) in facts.rotors.iter().enumerate() {
        let (front, right) = (rotor.front, rotor.right);
        let spin = spin(rotor.spin);
        lines.push(format!("  motor {}: front {front:.2}, right {right:.2}, {spin}", motor + 1));
    }
    lines.extend(facts.notes.iter().map(|note| format!("  {note}")));
    lines
}
