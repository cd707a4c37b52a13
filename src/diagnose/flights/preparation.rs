//! Flights made ready: streams as plain numbers, and the blocks of airborne time to look at.

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

/// Share of the hover output above which a vehicle without a word on it is in the air.
const LIFTS: f64 = 0.5;
/// Shorter drops of the output are manoeuvres, s.
const DROP_MAX_S: f64 = 0.7;
/// Least share of the usable time in which setpoints came over the link without a pause, for
/// these to be used: the rest is left out then, and no more than half of a flight is given for
/// them.
const LED_MIN: f64 = 0.5;
/// Time before a block from which rotors and delays reach into it, s.
const MARGIN_S: f64 = 0.35;

/// Airborne time that is analysed as one: `cells` of [`CELL_S`] from `start`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// Start of the first cell, s.
    pub start: f64,
    /// Number of cells, a power of two.
    pub cells: usize,
}

impl Block {
    /// The edge before cell `index`.
    pub fn edge(&self, index: usize) -> f64 {
        self.start + index as f64 * CELL_S
    }

    /// The middle of cell `index`.
    pub fn middle(&self, index: usize) -> f64 {
        self.start + (index as f64 + 0.5) * CELL_S
    }

    /// The block's end.
    pub fn end(&self) -> f64 {
        self.edge(self.cells)
    }
}

/// What a flight's log holds.
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

/// A flight ready for the diagnosis.
#[derive(Clone, Debug)]
pub struct PreparedFlight {
    /// File name without extension.
    pub name: String,
    /// What its log holds.
    pub channels: Channels,
    /// Position, m, NED.
    pub position: Series<3>,
    /// Velocity, m/s, NED.
    pub velocity: Series<3>,
    /// Attitude as a quaternion whose sign does not jump.
    pub attitude: Series<4>,
    /// Body rate, rad/s.
    pub body_rate: Series<3>,
    /// Specific force, m/s^2.
    pub specific_force: Series<3>,
    /// Motor outputs, 0..1.
    pub outputs: Series<4>,
    /// Pack voltage, V.
    pub voltage: Series<1>,
    /// Setpoints as sent, with those between that the log lacks.
    pub setpoint: Stream<AttitudeSetpoint>,
    /// The same as the on-board loop takes them.
    asked: Vec<Option<OnboardSetpoint>>,
    /// Those that the log lacks.
    pub inferred: Inferred,
    /// What was tracked, where the log holds it.
    pub reference: Stream<Reference>,
    /// Airborne time without gaps, s.
    pub spans: Vec<Range<f64>>,
    /// The same as blocks.
    pub blocks: Vec<Block>,
}

/// Why a flight cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotPrepared {
    /// A recording that never began, or in which no vehicle was heard.
    #[error("neither velocity, specific force or body rate nor motor outputs are recorded in it")]
    Empty,
    /// Nothing drives the plant.
    #[error(
        "the log has no motor outputs (and no rotor speeds with rotor_max_rpm, and no setpoints \
         with attitude and thrust for the attitude_pd of the vehicle file), which drive the model"
    )]
    NoOutputs,
    /// Nothing answers.
    #[error("the log has neither velocity nor specific force nor body rate")]
    NoMotion,
    /// Its motor outputs mean nothing.
    #[error(transparent)]
    Unit(#[from] UnitUnknown),
    /// It hardly flies.
    #[error("only {0:.1} s of it are in the air without gaps; at least {min:.1} s are needed", min = BLOCK_MIN as f64 * CELL_S)]
    TooShort(f64),
}

/// No more setpoints than these lead no flight.
const SETPOINTS_MIN: usize = 10;

/// Whether setpoints came over the link, unlike an autopilot's own, most of which the on-board loop
/// can follow.
fn has_setpoints(flight: &Flight) -> bool {
    let is_complete = |s: &&AttitudeSetpoint| {
        s.thrust.is_some() && (s.attitude.is_some() || s.body_rate.is_some())
    };
    let complete = flight.setpoint.values().iter().filter(is_complete).count();
    let least = SETPOINTS_MIN.max(flight.setpoint.len() / 2);
    flight.setpoint_source == SetpointSource::Ground && complete > least
}

/// Attitudes as quaternions without jumps between the two that stand for each.
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
    /// Makes `flight` of `vehicle` ready.
    ///
    /// # Errors
    /// [`NotPrepared`].
    pub fn new(mut flight: Flight, vehicle: &VehicleParams) -> Result<Self, NotPrepared> {
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
            // Before and after, as in a landing, the vehicle leads itself by laws of its own.
            let led = intersection(&spans, &CommandSource::OnboardLaw.unbroken(&flight));
            let of_led = self::blocks(&led);
            channels.setpoint = cells(&of_led) > LED_MIN * cells(&blocks);
            if channels.setpoint {
                (spans, blocks) = (led, of_led);
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
            asked: setpoint.values().iter().map(as_onboard).collect(),
            setpoint,
            inferred,
            reference: flight.reference,
            spans,
            blocks,
        })
    }

    /// What the on-board loop is asked by setpoint number `index`; `None` where the setpoint does
    /// not say how much thrust.
    pub fn asked(&self, index: usize) -> Option<OnboardSetpoint> {
        self.asked.get(index).copied().flatten()
    }

    /// Sends other setpoints at the same times.
    pub(in crate::diagnose) fn send(&mut self, setpoints: Vec<AttitudeSetpoint>) {
        self.asked = setpoints.iter().map(as_onboard).collect();
        self.setpoint = self.setpoint.with_values(setpoints);
    }

    /// The flight without the given times, s.
    ///
    /// # Errors
    /// [`NotPrepared::TooShort`] where too little is left.
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

    /// Time used, s.
    pub fn seconds(&self) -> f64 {
        self.blocks.iter().map(|block| block.cells as f64 * CELL_S).sum()
    }

    /// The first and the last half of the airborne time, `guard_s` apart; `None` where either has
    /// no block.
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

/// When the vehicle flew and every stream that it has goes on.
fn airborne(flight: &Flight, outputs: &Series<4>, vehicle: &VehicleParams) -> Vec<Range<f64>> {
    // Where the vehicle says it, and the log has a pose, learning's own rules hold.
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
    // The hover output in u: the share of thrust, bent by the curve that the file models.
    let hover = vehicle.hover_thrust;
    let mut spans: Vec<Range<f64>> = Vec::new();
    for (time, u) in outputs.times().iter().zip(outputs.values()) {
        if u.iter().sum::<f64>() < 4.0 * LIFTS * hover || !range.contains(time) {
            continue;
        }
        match spans.last_mut() {
            Some(span) if time - span.end < DROP_MAX_S => span.end = *time,
            _ => spans.push(*time..*time),
        }
    }
    spans
}

fn ends(times: &[f64]) -> Option<[f64; 2]> {
    Some([*times.first()?, *times.last()?])
}

/// Cells of blocks.
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
    /// A flight of which only the airborne time is known.
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
            asked: Vec::new(),
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
    fn times_that_are_cut_out_are_in_no_span() {
        let flight = PreparedFlight::of_spans(vec![0.0..10.0, 12.0..20.0]);
        let cut = flight.clone().excluding(&[4.0..5.0, 9.0..13.0, 15.0..15.0]).unwrap();
        assert_eq!(cut.spans, [0.0..4.0, 5.0..9.0, 13.0..15.0, 15.0..20.0]);
        assert_eq!(
            flight.excluding(&[0.0..20.0]).map(|flight| flight.spans),
            Err(NotPrepared::TooShort(0.0))
        );
    }
}
