//! Finds the axes of a velocity that does not change as the force on the vehicle says, such as
//! east, north, up.

use nalgebra::{Matrix3, Vector3};

use super::contrast::{Misfits, by_block, certain_contrast};
use super::initial_fit::{BUMPS_MIN, InitialFit, Moment, means};
use super::kinematics::VelocityAndForce;
use super::pair::Pair;
use super::timing::is_logged;
use super::{Audit, Finding, Severity};
use crate::log::import::Flight;

/// Step of the delays of the velocity that are tried, s, and their number in either direction.
const DELAY_STEP_S: f64 = 0.05;
const DELAYS: i32 = 2;

/// Where each axis of the velocity comes from: an axis of the world, with a sign.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Axes([(usize, f64); 3]);

impl Axes {
    const STATED: Self = Self([(0, 1.0), (1, 1.0), (2, 1.0)]);

    /// Every order and direction; only of the horizontal axes if the vertical one is not compared.
    fn all(is_level: bool) -> impl Iterator<Item = Self> {
        let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let axes = orders.into_iter().flat_map(|order| {
            (0..8_u8).map(move |signs| {
                let sign = |axis: usize| if signs >> axis & 1 == 1 { -1.0 } else { 1.0 };
                Self(std::array::from_fn(|axis| (order[axis], sign(axis))))
            })
        });
        axes.filter(move |axes| !is_level || axes.0[2] == (2, 1.0))
    }

    fn map(&self) -> Matrix3<f64> {
        let mut map = Matrix3::zeros();
        for (row, (column, sign)) in self.0.into_iter().enumerate() {
            map[(row, column)] = sign;
        }
        map
    }

    fn names(&self) -> String {
        let name = |(axis, sign): (usize, f64)| {
            format!("{}{}", if sign < 0.0 { "-" } else { "" }, ["north", "east", "down"][axis])
        };
        self.0.map(name).join(", ")
    }
}

/// Reports a velocity in other axes, where the motion does not fit the stated ones. The force is the
/// accelerometer's, or the thrust that holds the height.
pub(super) fn check(flight: &Flight, audit: &mut Audit) {
    let has_force = is_logged(&flight.specific_force);
    let agreement = if has_force { audit.kinematics.velocity } else { audit.kinematics.lean };
    if agreement.is_some() || !is_logged(&flight.velocity) || !is_logged(&flight.attitude) {
        return;
    }
    let pair = if has_force {
        VelocityAndForce::by_accelerometer(flight, &flight.specific_force, 0.0, [0.0; 3])
    } else {
        VelocityAndForce::by_lean(flight)
    };
    let Some((axes, found)) = better_axes(&pair, !has_force) else { return };
    let other = if has_force { "the accelerometer" } else { "the lean" };
    audit.findings.push(Finding {
        severity: Severity::Fault,
        check: "axes",
        stream: Some("velocity"),
        found,
        expected: 0.0,
        unit: "",
        what: format!(
            "does not change as {other} says, except if its axes are {} instead of {}",
            axes.names(),
            Axes::STATED.names()
        ),
        advice: "check the frames stated for the log",
    });
}

/// The other axes that certainly leave less of the velocity's changes than the stated ones, if there
/// are any, and their contrast. Too few bumps show nothing.
fn better_axes(pair: &impl Pair, is_level: bool) -> Option<(Axes, f64)> {
    let moments = InitialFit::bumps(pair).into_iter();
    let moments: Vec<Moment> = moments
        .filter_map(|bump| Moment::of(pair, bump, DELAY_STEP_S, DELAYS))
        .filter(|moment| (-DELAYS..=DELAYS).all(|delay| moment.at(delay).is_some()))
        .collect();
    if moments.len() < BUMPS_MIN {
        return None;
    }
    let times: Vec<f64> = moments.iter().map(|moment| moment.centre).collect();
    let at_delay = |delay: i32| {
        let pairs = moments.iter().filter_map(|m| Some((m.measured, m.at(delay)?)));
        let mut pairs: Vec<(Vector3<f64>, Vector3<f64>)> = pairs.collect();
        let (y, x) = means(&pairs);
        pairs.iter_mut().for_each(|pair| *pair = (pair.0 - y, pair.1 - x));
        pairs
    };
    let delayed: Vec<_> = (-DELAYS..=DELAYS).map(at_delay).collect();
    // What is left under each bump at the best delay and scale.
    let misfits = |axes: &Axes| -> Vec<f64> {
        let map = axes.map();
        let of_one = |pairs: &Vec<(Vector3<f64>, Vector3<f64>)>| -> Vec<f64> {
            let power: f64 = pairs.iter().map(|(_, x)| x.norm_squared()).sum();
            let shared: f64 = pairs.iter().map(|(y, x)| y.dot(&(map * x))).sum();
            let scale = if power > 0.0 { (shared / power).max(0.0) } else { 0.0 };
            pairs.iter().map(|(y, x)| (y - map * x * scale).norm_squared()).collect()
        };
        let left = |misfits: &Vec<f64>| misfits.iter().sum::<f64>();
        let best = delayed.iter().map(of_one).min_by(|a, b| left(a).total_cmp(&left(b)));
        best.unwrap_or_default()
    };
    let stated = misfits(&Axes::STATED);
    let better = |axes: Axes| {
        let misfits = Misfits::of_each(&stated, &misfits(&axes));
        Some((axes, certain_contrast(&by_block(&times, &misfits))?))
    };
    let others = Axes::all(is_level).filter(|axes| *axes != Axes::STATED);
    others.filter_map(better).max_by(|a, b| a.1.total_cmp(&b.1))
}
