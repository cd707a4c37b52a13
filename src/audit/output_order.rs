//! Finds which output drives which rotor, and whether the outputs were logged late.
//!
//! An output that rolls the vehicle to the left drives a rotor on the right, one that pitches it up
//! a rotor in front, and one that yaws it right a rotor whose drag turns the body right. Rotors at
//! known places therefore predict the rotation up to one scale an axis, the inertia's. Every order
//! of the outputs, with either direction of rotation, is a reading of the log; another one must
//! leave certainly less of the rotation unexplained than the stated one. The order belongs to the
//! vehicle, so the flights of one vehicle decide together.

use std::ops::Range;

use nalgebra::{Matrix4, SMatrix, Vector3, Vector4};

use super::contrast::{Misfits, certain_contrast};
use super::rotors::{DelayedResponse, Responses};
use super::weak::{blocks, span_s};
use super::{Finding, Severity};
use crate::log::import::RotorFact;

/// Name of the check of the outputs' order.
pub(super) const MOTOR_ORDER: &str = "motor_order";

/// An assignment of outputs to rotors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Reading {
    /// The output that drives each rotor.
    outputs: [usize; 4],
    /// Whether all rotors turn the other way.
    is_reversed: bool,
}

impl Reading {
    const STATED: Self = Self { outputs: [0, 1, 2, 3], is_reversed: false };

    /// All readings.
    fn all() -> impl Iterator<Item = Self> {
        let orders = (0..256_usize).map(|code| [code & 3, code >> 2 & 3, code >> 4 & 3, code >> 6]);
        let orders = orders.filter(|order| (0..4).all(|output| order.contains(&output)));
        orders.flat_map(|outputs| [false, true].map(|is_reversed| Self { outputs, is_reversed }))
    }

    /// The moment of each output about front, right and down, up to a scale for each axis.
    fn moments(&self, rotors: &[RotorFact; 4]) -> [Vector4<f64>; 3] {
        let mut moments = [Vector4::zeros(); 3];
        for (rotor, output) in rotors.iter().zip(self.outputs) {
            let spin = f64::from(rotor.spin) * if self.is_reversed { -1.0 } else { 1.0 };
            for (axis, moment) in [-rotor.right, rotor.front, spin].into_iter().enumerate() {
                moments[axis][output] = moment;
            }
        }
        moments
    }

    /// The reading in words: what outputs would fit rotors `whose`.
    fn description(&self, whose: &str) -> String {
        let [a, b, c, d] = self.outputs.map(|output| output + 1);
        let order = match *self {
            Self { outputs: [0, 1, 2, 3], .. } => String::new(),
            _ => format!(" in the order {a}, {b}, {c}, {d}"),
        };
        let reversed =
            if self.is_reversed { " with the opposite directions of rotation" } else { "" };
        format!("do not turn the vehicle as {whose} would, but{order}{reversed} they do")
    }
}

/// Second moments of the rotation and of the outputs before it.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    /// Power of the rotation about each axis.
    turning: [f64; 3],
    /// Product of each output with the rotation about each axis.
    cross: SMatrix<f64, 4, 3>,
    /// Product of each two outputs.
    outputs: Matrix4<f64>,
}

impl Moments {
    fn of(pairs: &[(Vector3<f64>, Vector4<f64>)]) -> Self {
        pairs.iter().fold(Self::default(), |mut sum, (turning, outputs)| {
            for axis in 0..3 {
                sum.turning[axis] += turning[axis] * turning[axis];
            }
            sum.cross += outputs * turning.transpose();
            sum.outputs += outputs * outputs.transpose();
            sum
        })
    }

    fn plus(mut self, other: &Self) -> Self {
        for (sum, other) in self.turning.iter_mut().zip(other.turning) {
            *sum += other;
        }
        self.cross += other.cross;
        self.outputs += other.outputs;
        self
    }

    /// What `scale` times the moment of the outputs leaves of the rotation about an axis.
    fn misfit(&self, axis: usize, moment: &Vector4<f64>, scale: f64) -> f64 {
        self.turning[axis] - 2.0 * scale * moment.dot(&self.cross.column(axis))
            + scale * scale * moment.dot(&(self.outputs * moment))
    }

    /// The scale that leaves least; a negative one would reverse the rotors.
    fn scale(&self, axis: usize, moment: &Vector4<f64>) -> f64 {
        let power = moment.dot(&(self.outputs * moment));
        if power > 0.0 { (moment.dot(&self.cross.column(axis)) / power).max(0.0) } else { 0.0 }
    }
}

/// The rotation of a flight and the outputs at each delay, as second moments over blocks of time.
#[derive(Clone, Debug)]
pub(super) struct OutputMoments {
    /// Time from an output to its effect, s, and the moments of each block.
    delayed: Vec<(f64, Vec<Moments>)>,
}

impl OutputMoments {
    pub fn of(responses: &Responses) -> Self {
        let blocks = blocks(span_s(&responses.times), responses.times.len());
        let of_one = |DelayedResponse { delay_s, pairs }: &DelayedResponse| {
            (*delay_s, blocks.iter().map(|block| Moments::of(&pairs[block.clone()])).collect())
        };
        Self { delayed: responses.delayed.iter().map(of_one).collect() }
    }

    /// What a reading leaves of the rotation in each block, as a share of the whole about each
    /// axis, at the best of `delays` (s).
    fn misfits(&self, rotors: &[RotorFact; 4], reading: &Reading, delays: Range<f64>) -> Vec<f64> {
        let moments = reading.moments(rotors);
        let of_one = |blocks: &Vec<Moments>| -> Vec<f64> {
            let total = blocks.iter().fold(Moments::default(), Moments::plus);
            let share = |block: &Moments| -> f64 {
                let of_axis = |axis: usize| {
                    let scale = total.scale(axis, &moments[axis]);
                    let power = total.turning[axis];
                    let left = block.misfit(axis, &moments[axis], scale);
                    if power > 0.0 { left / power } else { 0.0 }
                };
                (0..3).map(of_axis).sum()
            };
            blocks.iter().map(share).collect()
        };
        let tried = self.delayed.iter().filter(|(delay, _)| delays.contains(delay));
        let left = |misfits: &[f64]| misfits.iter().sum::<f64>();
        let best = tried.map(|(_, blocks)| of_one(blocks));
        best.min_by(|a, b| left(a).total_cmp(&left(b))).unwrap_or_default()
    }
}

/// Outputs act after they are logged.
const AFTER: Range<f64> = 0.0..f64::INFINITY;
const BEFORE: Range<f64> = f64::NEG_INFINITY..0.0;

/// The fault of outputs that do not turn a vehicle as rotors at `rotors` would, or that follow its
/// rotation, from all of its flights. `whose` says where those places come from.
pub(super) fn fault(
    flights: &[&OutputMoments],
    rotors: &[RotorFact; 4],
    whose: &str,
) -> Option<Finding> {
    let misfits = |reading: &Reading, delays: Range<f64>| -> Vec<f64> {
        let of_one = |flight: &&OutputMoments| flight.misfits(rotors, reading, delays.clone());
        flights.iter().flat_map(of_one).collect()
    };
    let stated = misfits(&Reading::STATED, AFTER);
    let against = |other: Vec<f64>| certain_contrast(&Misfits::of_each(&stated, &other));
    let others = Reading::all().filter(|reading| *reading != Reading::STATED);
    let best = others
        .filter_map(|reading| Some((against(misfits(&reading, AFTER))?, reading)))
        .max_by(|a, b| a.0.total_cmp(&b.0));
    let fault = |check, found, what, advice| Finding {
        severity: Severity::Fault,
        check,
        stream: Some("outputs"),
        found,
        expected: 0.0,
        unit: "",
        what,
        advice,
    };
    if let Some((found, reading)) = best {
        let advice = "check the order of the outputs and the direction of rotation";
        return Some(fault(MOTOR_ORDER, found, reading.description(whose), advice));
    }
    let found = against(misfits(&Reading::STATED, BEFORE))?;
    let what = "the vehicle turns before them: they were logged late".to_owned();
    Some(fault("delay", found, what, "put outputs and body rates on one clock"))
}
