//! Prepares flights: streams as plain numbers, and the blocks of airborne time.

use std::borrow::Cow;
use std::ops::Range;

use sitl::autopilot::offboard::AttitudeSetpoint as OnboardSetpoint;
use vehicle::VehicleParams;
use vehicle::frame::Attitude;

use crate::diagnose::flights::series::{Series, next_to};
use crate::diagnose::flights::setpoints::as_onboard;
use crate::diagnose::flights::setpoints::{Inferred, completed};
use crate::diagnose::flights::spectrum::{BLOCK_MAX, BLOCK_MIN, CELL_S};
use crate::learn::commands::CommandSource;
use crate::learn::gaps::{intersection, length};
use crate::learn::segments::Segments;
use crate::log::import::{
    AttitudeSetpoint, Flight, MotorSource, SetpointSource, Stream, UnitUnknown,
};
use crate::setpoint::Reference;

/// Share of the hover output above which a vehicle that does not report its state is in the air.
const AIRBORNE_OUTPUT_SHARE: f64 = 0.5;
/// Shorter drops of the output are manoeuvres, s.
const DROP_MAX_S: f64 = 0.7;
/// Least share of the usable time with setpoints over the link without a pause. With more, the
/// diagnosis uses the setpoints and leaves out the rest of the time, so at most half of a flight is
/// lost.
const SETPOINT_SHARE_MIN: f64 = 0.5;
/// Complete setpoints that a log must exceed for its setpoints to be used.
const SETPOINTS_MIN: usize = 10;
/// Time before a block over which rotors and delays act on it, s.
const MARGIN_S: f64 = 0.35;

/// Airborne time that is transformed as a whole: `cells` of [`CELL_S`] from `start`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// Start of the first cell, s.
    pub start: f64,
    /// Number of cells, a power of two.
    pub cells: usize,
}

impl Block {
    /// Time of the edge before cell `index`, s.
    pub fn edge(&self, index: usize) -> f64 {
        self.start + index as f64 * CELL_S
    }

    /// Time of the middle of cell `index`, s.
    pub fn middle(&self, index: usize) -> f64 {
        self.start + (index as f64 + 0.5) * CELL_S
    }

    /// Time of the block's end, s.
    pub fn end(&self) -> f64 {
        self.edge(self.cells)
    }
}

/// The channels that a flight's log holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, schemars::JsonSchema, serde::Serialize)]
pub struct Channels {
    /// Position and velocity.
    pub velocity: bool,
    /// Attitude.
    pub attitude: bool,
    /// Body rate.
    pub body_rate: bool,
    /// Specific force.
    pub specific_force: bool,
    /// Motor outputs.
    pub outputs: bool,
    /// Setpoints with attitude and thrust over most of the flight, where the on-board law is known.
    pub setpoint: bool,
    /// Pack voltage.
    pub voltage: bool,
    /// Rotor speeds.
    pub rotor_speed: bool,
}

impl Channels {
    /// Whether the log holds what the rotors were sent, or did.
    pub fn shows_rotors(&self) -> bool {
        self.outputs || self.rotor_speed
    }

    /// Whether the log shows the way from setpoint to output. Outputs that were computed from the
    /// setpoints show nothing of it.
    pub fn shows_loop(&self) -> bool {
        self.setpoint && self.shows_rotors()
    }
}

/// A flight that is ready for the diagnosis.
#[derive(Clone, Debug)]
pub struct PreparedFlight {
    /// File name without extension; the end of the path if another log has that name.
    pub name: String,
    /// The channels of its log.
    pub channels: Channels,
    /// Position, m, NED.
    pub position: Series<3>,
    /// Velocity, m/s, NED.
    pub velocity: Series<3>,
    /// Attitude as quaternions w, x, y, z without sign flips.
    pub attitude: Series<4>,
    /// Body rate about front, right, down, rad/s.
    pub body_rate: Series<3>,
    /// Specific force in body axes, m/s^2.
    pub specific_force: Series<3>,
    /// Motor outputs, 0..1; without any, squared rotor speeds relative to the maximum.
    pub outputs: Series<4>,
    /// Pack voltage, V.
    pub voltage: Series<1>,
    /// Setpoints as sent, completed with those that the log lacks.
    pub setpoint: Stream<AttitudeSetpoint>,
    /// The setpoints as inputs of the on-board loop.
    onboard_setpoints: Vec<Option<OnboardSetpoint>>,
    /// The setpoints that the log lacks.
    pub inferred: Inferred,
    /// The tracked reference, where the log holds it.
    pub reference: Stream<Reference>,
    /// Airborne time without gaps, s.
    pub spans: Vec<Range<f64>>,
    /// The same time as blocks.
    pub blocks: Vec<Block>,
}

/// Why a flight cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotPrepared {
    /// The recording never began, or no vehicle was received.
    #[error("the log has neither velocity, specific force, body rate nor motor outputs")]
    Empty,
    /// No input of the plant is logged.
    #[error(
        "the log has no motor outputs to drive the model (and neither rotor speeds with \
         rotor_max_rpm nor setpoints with attitude and thrust for the attitude_pd of the vehicle \
         file)"
    )]
    NoOutputs,
    /// No response of the vehicle is logged.
    #[error("the log has neither velocity nor specific force nor body rate")]
    NoMotion,
    /// The unit of its motor outputs is unknown.
    #[error(transparent)]
    Unit(#[from] UnitUnknown),
    /// Its airborne time is too short.
    #[error("only {0:.1} s of the log is airborne and free of gaps; at least {min:.1} s is needed", min = BLOCK_MIN as f64 * CELL_S)]
    TooShort(f64),
}

/// Whether setpoints came over the link rather than from the autopilot itself, and the on-board
/// loop can follow most of them.
fn has_setpoints(flight: &Flight) -> bool {
    let is_complete = |s: &&AttitudeSetpoint| {
        s.thrust.is_some() && (s.attitude.is_some() || s.body_rate.is_some())
    };
    let complete = flight.setpoint.values().iter().filter(is_complete).count();
    let least = SETPOINTS_MIN.max(flight.setpoint.len() / 2);
    flight.setpoint_source == SetpointSource::Ground && complete > least
}

/// Attitudes as quaternions, each with the sign nearer to the one before.
fn continuous(attitude: &Stream<Attitude>) -> Series<4> {
    let mut last: Option<[f64; 4]> = None;
    let quaternions = attitude.values().iter().map(|Attitude { w, x, y, z }| {
        let q = next_to(last, [*w, *x, *y, *z]);
        last = Some(q);
        q
    });
    let quaternions = quaternions.collect();
    Series::new(attitude.times().to_vec(), quaternions)
}

impl PreparedFlight {
    /// Prepares a flight of `vehicle`.
    ///
    /// # Errors
    /// [`NotPrepared`].
    pub fn new(mut flight: Flight, vehicle: &VehicleParams) -> Result<Self, NotPrepared> {
        if let Cow::Owned(fresh) = flight.without_repeats() {
            flight = fresh;
        }
        flight.normalise_outputs(vehicle)?;
        let mut outputs = Series::of(&flight.outputs, |u: &[f64; 4]| *u);
        if outputs.is_empty()
            && let Some(rpm) = vehicle.rotor_max_rpm
        {
            let most = rpm * std::f64::consts::TAU / 60.0;
            outputs = Series::of(&flight.rotor_speed, |w: &[f64; 4]| w.map(|w| (w / most).powi(2)));
        }
        let velocity = Series::of(&flight.velocity, |v| v.to_array());
        let specific_force = Series::of(&flight.specific_force, |f| f.to_array());
        let body_rate = Series::of(&flight.body_rate, |w| w.to_array());
        let moves = !(velocity.is_empty() && specific_force.is_empty() && body_rate.is_empty());
        match (outputs.is_empty(), moves) {
            (false, true) => {}
            (true, true) => return Err(NotPrepared::NoOutputs),
            (false, false) => return Err(NotPrepared::NoMotion),
            (true, false) => return Err(NotPrepared::Empty),
        }
        let attitude = continuous(&flight.attitude);
        let mut channels = Channels {
            velocity: !velocity.is_empty(),
            attitude: !attitude.is_empty(),
            body_rate: !body_rate.is_empty(),
            specific_force: !specific_force.is_empty(),
            outputs: !flight.outputs.is_empty() && flight.motor_source != MotorSource::OnboardLaw,
            setpoint: vehicle.attitude_pd.is_some()
                && !attitude.is_empty()
                && !body_rate.is_empty()
                && has_setpoints(&flight),
            voltage: !flight.voltage.is_empty(),
            rotor_speed: !flight.rotor_speed.is_empty(),
        };
        let (setpoint, inferred) = completed(&flight.setpoint, &flight.setpoints_missing);
        let mut spans = airborne(&flight, &outputs, vehicle);
        let mut blocks = blocks(&spans);
        if channels.setpoint {
            // Outside that time, as in a landing, the vehicle follows laws of its own.
            let commanded = intersection(&spans, &CommandSource::OnboardLaw.unbroken(&flight));
            let of_setpoints = self::blocks(&commanded);
            channels.setpoint = cells(&of_setpoints) > SETPOINT_SHARE_MIN * cells(&blocks);
            if channels.setpoint {
                (spans, blocks) = (commanded, of_setpoints);
            }
        }
        if blocks.is_empty() {
            return Err(NotPrepared::TooShort(length(&spans)));
        }
        Ok(Self {
            name: flight.origin.run.clone(),
            channels,
            position: Series::of(&flight.position, |p| p.to_array()),
            velocity,
            attitude,
            body_rate,
            specific_force,
            outputs,
            voltage: Series::of(&flight.voltage, |v| [*v]),
            onboard_setpoints: setpoint.values().iter().map(as_onboard).collect(),
            setpoint,
            inferred,
            reference: flight.reference,
            spans,
            blocks,
        })
    }

    /// The input of the on-board loop from setpoint number `index`; `None` for a setpoint without
    /// thrust.
    pub fn onboard_setpoint(&self, index: usize) -> Option<OnboardSetpoint> {
        self.onboard_setpoints.get(index).copied().flatten()
    }

    /// Replaces the setpoints, at the same times.
    pub(in crate::diagnose) fn replace_setpoints(&mut self, setpoints: Vec<AttitudeSetpoint>) {
        self.onboard_setpoints = setpoints.iter().map(as_onboard).collect();
        self.setpoint = self.setpoint.with_values(setpoints);
    }

    /// The flight without the given times, s.
    ///
    /// # Errors
    /// [`NotPrepared::TooShort`] if too little time remains.
    pub fn excluding(mut self, times: &[Range<f64>]) -> Result<Self, NotPrepared> {
        for cut in times {
            let spans = std::mem::take(&mut self.spans);
            for span in spans {
                let parts =
                    [span.start..cut.start.min(span.end), cut.end.max(span.start)..span.end];
                self.spans.extend(parts.into_iter().filter(|part| part.start < part.end));
            }
        }
        self.blocks = blocks(&self.spans);
        if self.blocks.is_empty() {
            return Err(NotPrepared::TooShort(length(&self.spans)));
        }
        Ok(self)
    }

    /// Airborne time in use, s.
    pub fn seconds(&self) -> f64 {
        self.blocks.iter().map(|block| block.cells as f64 * CELL_S).sum()
    }

    /// The first and the last half of the airborne time, `guard_s` apart; `None` if either has no
    /// block.
    pub fn split(&self, guard_s: f64) -> Option<(Self, Self)> {
        let (first, last) = (self.spans.first()?.start, self.spans.last()?.end);
        let half = 0.5 * (first + last);
        let part = |range: Range<f64>, name: &str| -> Option<Self> {
            let spans = intersection(&self.spans, &[range]);
            let blocks = blocks(&spans);
            let name = format!("{} ({name} half)", self.name);
            (!blocks.is_empty()).then(|| Self { name, spans, blocks, ..self.clone() })
        };
        Some((
            part(first..half - 0.5 * guard_s, "first")?,
            part(half + 0.5 * guard_s..last, "second")?,
        ))
    }
}

/// Airborne time in which every logged stream continues.
fn airborne(flight: &Flight, outputs: &Series<4>, vehicle: &VehicleParams) -> Vec<Range<f64>> {
    // Where the vehicle reports its state and the log has a pose, the rules of learning apply.
    if !flight.in_air.is_empty()
        && let Ok(segments) = Segments::of(flight, vehicle.hover_share())
    {
        return segments.spans;
    }
    let (Some(first), Some(last)) = (outputs.times().first(), outputs.times().last()) else {
        return Vec::new();
    };
    let mut range = *first..*last;
    for [start, end] in [
        ends(flight.velocity.times()),
        ends(flight.attitude.times()),
        ends(flight.body_rate.times()),
        ends(flight.specific_force.times()),
    ]
    .into_iter()
    .flatten()
    {
        range = range.start.max(start)..range.end.min(end);
    }
    // The hover output in u: the share of thrust through the file's thrust curve.
    let hover = vehicle.hover_thrust;
    let mut spans: Vec<Range<f64>> = Vec::new();
    for (time, u) in outputs.times().iter().zip(outputs.values()) {
        if u.iter().sum::<f64>() < 4.0 * AIRBORNE_OUTPUT_SHARE * hover || !range.contains(time) {
            continue;
        }
        match spans.last_mut() {
            Some(span) if time - span.end < DROP_MAX_S => span.end = *time,
            _ => spans.push(*time..*time),
        }
    }
    spans
}

/// First and last time.
fn ends(times: &[f64]) -> Option<[f64; 2]> {
    Some([*times.first()?, *times.last()?])
}

/// Total cells of blocks.
fn cells(blocks: &[Block]) -> f64 {
    blocks.iter().map(|block| block.cells as f64).sum()
}

/// The longest blocks that fit, one after another.
fn blocks(spans: &[Range<f64>]) -> Vec<Block> {
    let mut found = Vec::new();
    for span in spans {
        let mut start = span.start + MARGIN_S;
        let end = span.end - MARGIN_S;
        let mut cells = BLOCK_MAX;
        while cells >= BLOCK_MIN {
            if start + cells as f64 * CELL_S <= end {
                found.push(Block { start, cells });
                start += cells as f64 * CELL_S;
            } else {
                cells /= 2;
            }
        }
    }
    found
}

#[cfg(test)]
impl PreparedFlight {
    /// A flight with nothing but its airborne time.
    pub(in crate::diagnose) fn of_spans(spans: Vec<Range<f64>>) -> Self {
        Self {
            name: String::new(),
            channels: Channels::default(),
            position: Series::default(),
            velocity: Series::default(),
            attitude: Series::default(),
            body_rate: Series::default(),
            specific_force: Series::default(),
            outputs: Series::default(),
            voltage: Series::default(),
            reference: Stream::default(),
            setpoint: Stream::default(),
            onboard_setpoints: Vec::new(),
            inferred: Inferred::default(),
            blocks: blocks(&spans),
            spans,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_fill_a_span_without_overlap() {
        let found = blocks(&[0.0..22.5]);
        let cells: Vec<_> = found.iter().map(|block| block.cells).collect();
        assert_eq!(cells, [1024, 1024, 128]);
        for pair in found.windows(2) {
            assert!((pair[0].end() - pair[1].start).abs() < 1e-9);
        }
        assert!(blocks(&[0.0..1.5]).is_empty());
    }

    #[test]
    fn excluded_times_are_in_no_span() {
        let flight = PreparedFlight::of_spans(vec![0.0..10.0, 12.0..20.0]);
        let cut = flight.clone().excluding(&[4.0..5.0, 9.0..13.0, 15.0..15.0]).unwrap();
        assert_eq!(cut.spans, [0.0..4.0, 5.0..9.0, 13.0..15.0, 15.0..20.0]);
        assert_eq!(
            flight.excluding(&[0.0..20.0]).map(|flight| flight.spans),
            Err(NotPrepared::TooShort(0.0))
        );
    }
}
