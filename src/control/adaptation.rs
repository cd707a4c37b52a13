//! In-flight adaptation of the physics' few parameters.
//!
//! # Design
//!
//! There is one estimator, [`DisturbanceObserver`](super::DisturbanceObserver). It predicts how the
//! sent setpoints move the vehicle, compares the prediction with the motion, and moves the
//! reference to the resulting equilibrium. The comparison has two forms. On its own, the observer
//! learns constant disturbances, each with a fixed time constant. With an [`Adaptation`], the same
//! prediction is a regression on the parameters of the physics, which include the constant
//! disturbances:
//!
//! ```text
//! dv/dt = g e3 - (1 + s + k (T/T_h - 1)) (T/m) R e3 - c v + w + R(psi) b + expected
//! zeta  = loop(sent) + a + expected
//! ```
//!
//! s: relative excess of thrust over mass (a payload, a sagging pack, a weak rotor: from `s` alone
//! no flight distinguishes them); k: bend of the thrust map; c: drag; w: a push fixed in the world;
//! b: a push that turns with the vehicle; a: the offset of the attitude from the one sent, which a
//! moment holds against the loop. `T` is the thrust sent, within limits, after delay and lag.
//!
//! Data flow of a tick: state and sent setpoint -> prediction (observer) -> [`Watch`] (is the data
//! sound?) -> [`Recursion`] and the attitude's trims -> [`Parameters`] -> the observer's shift of
//! the reference, and thrust through the inverse of its map, around any law -> limits, guard and
//! supervisor, unchanged. Once distrusted, adaptation stays off until the next flight: the learned
//! values fade, and the feedback becomes what it is without adaptation.

mod event;
mod recursion;
mod surprise;
mod watch;

use nalgebra::SVector;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::frame::{Attitude, Frd, Ned, wrap_angle};

pub use self::event::{AdaptationEvent, ParameterChange};
use self::recursion::{
    DRAG, EAST, FRONT, Learned, NORTH, PARAMETERS, RIGHT, Recursion, Regressor, THRUST_BEND,
    THRUST_SHARE,
};
use self::surprise::Surprise;
pub use self::watch::Distrust;
use self::watch::Watch;
use crate::clock::VehicleTime;
use crate::setpoint::State;

/// Speed and bounds of the adaptation.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AdaptationSettings {
    /// Memory of the estimate while nothing changes, s. A detected change clears it at once.
    pub forgetting_s: f64,
    /// Largest relative deviation of thrust over mass.
    pub thrust_share_max: f64,
    /// Largest bend of the thrust map.
    pub thrust_bend_max: f64,
    /// Largest drag over mass, 1/s.
    pub drag_max_per_s: f64,
    /// Largest push in one direction, m/s^2.
    pub acceleration_max_m_s2: f64,
    /// Largest offset of the attitude from the one sent, rad.
    pub attitude_max_rad: f64,
    /// Trust region: how many of its prior standard deviations a parameter may move in a second.
    pub trust_per_s: f64,
}

impl Default for AdaptationSettings {
    fn default() -> Self {
        Self {
            forgetting_s: 4.0,
            thrust_share_max: 0.5,
            thrust_bend_max: 0.3,
            drag_max_per_s: 2.0,
            acceleration_max_m_s2: 6.0,
            attitude_max_rad: 0.3,
            trust_per_s: 20.0,
        }
    }
}

/// Prior standard deviations: s, k, c [1/s], w and b (m/s^2).
const PRIOR: [f64; PARAMETERS] = [0.3, 0.1, 0.3, 1.5, 1.5, 0.5, 0.5];
/// Prior standard deviation of an attitude offset, rad.
const TRIM_PRIOR_RAD: f64 = 0.1;
/// Error of the loop's model of the attitude, rad.
const TRIM_NOISE_RAD: f64 = 0.01;
/// Unexplained attitude that counts as a change, in standard deviations of its mean.
const TRIM_SURPRISE_MIN: f64 = 5.0;
/// An innovation of the velocity beyond this is a jump, not motion, m/s.
const JUMP_M_S: f64 = 1.0;
/// Time constant with which distrusted estimates fade, s.
const FADE_S: f64 = 0.5;
/// Time after a change until its size is known well enough to act on it, s.
const SIZED_AFTER_S: f64 = 0.2;
/// Delay of the report of a change, until its size is known, s.
const REPORT_DELAY_S: f64 = 0.8;
/// Smallest changes that are reported: of thrust over mass, of a push in m/s^2, of an attitude in
/// rad.
const REPORTED_SHARE_MIN: f64 = 0.05;
const REPORTED_PUSH_MIN_M_S2: f64 = 0.4;
const REPORTED_ATTITUDE_MIN_RAD: f64 = 0.03;

/// Estimated deviations of the vehicle from its file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Parameters {
    /// s: relative excess of thrust over mass.
    pub thrust_share: f64,
    /// k: further excess per hover thrust beyond the first.
    pub thrust_bend: f64,
    /// c: horizontal drag over speed and mass, at least 0, 1/s.
    pub drag_per_s: f64,
    /// w: push north and east, m/s^2.
    pub world: [f64; 2],
    /// b: push front and right in axes that turn with yaw, m/s^2.
    pub body: [f64; 2],
    /// a: offset of roll, pitch and yaw from the ones sent, rad.
    pub attitude: [f64; 3],
}

/// How the vehicle moved from one sample to the next, and the model's prediction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moved {
    pub at: VehicleTime,
    pub dt: f64,
    /// Attitude half way between the samples.
    pub attitude: Attitude,
    /// Horizontal velocity, taken as the flow of air past the vehicle, m/s.
    pub flow: Ned,
    /// Thrust over the file's mass, m/s^2, and over hover thrust.
    pub thrust_m_s2: f64,
    pub thrust_over_hover: f64,
    /// Acceleration that no parameter affects, m/s^2.
    pub known: Ned,
    /// Velocity at the end.
    pub velocity: Ned,
    /// Attitude less that of the loop's model, rad.
    pub unexplained: [f64; 3],
}

/// Adapts the physics' parameters to the vehicle's motion.
#[derive(Clone, Debug)]
pub struct Adaptation {
    settings: AdaptationSettings,
    recursion: Recursion,
    trims: [Trim; 3],
    watch: Watch,
    is_limited: bool,
    /// Whether the next sample restarts the comparison.
    is_cut: bool,
    distrust: Option<Distrust>,
    changed: Option<VehicleTime>,
    /// The last change, until its size is known.
    sized: Option<VehicleTime>,
    is_sized: bool,
    /// Time of the first sample learned from.
    began: Option<VehicleTime>,
    reported: Reported,
    event: Option<AdaptationEvent>,
}

/// The estimates when a change was last reported.
#[derive(Clone, Copy, Debug, Default)]
struct Reported {
    thrust_share: f64,
    /// Acceleration north and east, m/s^2.
    push: [f64; 2],
    /// Roll, pitch, yaw, rad.
    attitude: [f64; 3],
}

impl Adaptation {
    /// An adaptation with no learned values.
    pub fn new(settings: AdaptationSettings) -> Self {
        let push = settings.acceleration_max_m_s2;
        let bound = [
            settings.thrust_share_max,
            settings.thrust_bend_max,
            settings.drag_max_per_s,
            push,
            push,
            push,
            push,
        ];
        Self {
            recursion: Recursion::new(PRIOR, bound, settings.forgetting_s, settings.trust_per_s),
            trims: [Trim::default(); 3],
            watch: Watch::default(),
            is_limited: false,
            is_cut: true,
            distrust: None,
            changed: None,
            sized: None,
            is_sized: false,
            began: None,
            reported: Reported::default(),
            event: None,
            settings,
        }
    }

    /// Discards everything learned and restores trust; keeps a pending event.
    pub(super) fn reset(&mut self) {
        let event = self.event;
        *self = Self::new(self.settings);
        self.event = event;
    }

    /// Whether adaptation is still trusted.
    pub fn is_on(&self) -> bool {
        self.distrust.is_none()
    }

    /// Takes the pending event.
    pub(super) fn take_event(&mut self) -> Option<AdaptationEvent> {
        self.event.take()
    }

    /// The present estimates.
    pub fn parameters(&self) -> Parameters {
        let [thrust_share, thrust_bend, drag_per_s, north, east, front, right] =
            self.recursion.theta();
        Parameters {
            thrust_share,
            thrust_bend,
            drag_per_s,
            world: [north, east],
            body: [front, right],
            attitude: self.trims.map(|trim| trim.value),
        }
    }

    /// The filtered velocity, m/s: less noisy than the measured one, and delayed only by what the
    /// model does not know.
    pub(super) fn velocity(&self) -> Ned {
        self.recursion.velocity()
    }

    /// Share of the learned values that is left after `dt` seconds of distrust.
    pub(super) fn fading(dt: f64) -> f64 {
        (-dt / FADE_S).exp()
    }

    /// Records whether the last setpoint met a limit of thrust or tilt.
    pub(super) fn limited(&mut self, is_limited: bool) {
        self.is_limited = is_limited;
    }

    /// Whether the size of a change has become known; true once for each change.
    pub(super) fn take_change(&mut self) -> bool {
        std::mem::take(&mut self.is_sized)
    }

    /// Restarts the comparison at the next sample.
    pub(super) fn pause(&mut self) {
        self.is_cut = true;
    }

    /// Records a jump of the estimate.
    pub(super) fn jumped(&mut self) {
        self.is_cut = true;
        let distrust = self.watch.jumped();
        self.suspect(distrust);
    }

    /// Checks a state before use; returns whether it may be learned from.
    pub(super) fn sees(&mut self, state: &State, dt: f64) -> bool {
        let distrust = self.watch.sees(state, self.is_limited, dt);
        self.suspect(distrust);
        self.is_on()
    }

    /// Corrects the estimates for a new leading model, which expects this much more acceleration
    /// (m/s^2) and attitude (rad).
    pub(super) fn expect_anew(&mut self, acceleration: Ned, attitude: [f64; 3], gravity: f64) {
        self.recursion.shift(THRUST_SHARE, acceleration.down() / gravity);
        self.recursion.shift(NORTH, -acceleration.north());
        self.recursion.shift(EAST, -acceleration.east());
        for (trim, expected) in self.trims.iter_mut().zip(attitude) {
            trim.value -= expected;
        }
    }

    /// Updates the estimates with a motion.
    pub(super) fn learn(&mut self, moved: &Moved) {
        if std::mem::take(&mut self.is_cut) {
            self.recursion.restart(moved.velocity);
            return;
        }
        let foreseen = self.recursion.foreseen(&regressor(moved), moved.known, moved.dt);
        let jump_m_s = (moved.velocity - foreseen).norm();
        if jump_m_s.is_nan() || jump_m_s >= JUMP_M_S {
            self.recursion.restart(moved.velocity);
            let distrust = self.watch.jumped();
            return self.suspect(distrust);
        }
        let Learned { is_change, at_bound } =
            self.recursion.learn(&regressor(moved), moved.known, moved.velocity, moved.dt);
        let mut is_turned = false;
        let bound = self.settings.attitude_max_rad;
        for (trim, unexplained) in self.trims.iter_mut().zip(moved.unexplained) {
            is_turned |= trim.learn(unexplained, bound, self.settings.forgetting_s, moved.dt);
        }
        if !self.recursion.is_finite() || !self.trims.iter().all(|trim| trim.value.is_finite()) {
            return self.suspect(Some(Distrust::NotFinite));
        }
        let distrust = self.watch.learned(is_change, at_bound, moved.dt);
        self.suspect(distrust);
        if is_change || is_turned {
            self.changed.get_or_insert(moved.at);
            self.sized = Some(moved.at);
        }
        if self.sized.is_some_and(|changed| moved.at.seconds_since(changed) >= SIZED_AFTER_S) {
            (self.sized, self.is_sized) = (None, true);
        }
        self.explain(moved);
    }

    fn suspect(&mut self, distrust: Option<Distrust>) {
        if self.distrust.is_none() && distrust.is_some() {
            self.distrust = distrust;
            self.event = distrust.map(AdaptationEvent::SwitchedOff);
        }
    }

    /// Reports what changed, once its size is known.
    fn explain(&mut self, moved: &Moved) {
        let began = *self.began.get_or_insert(moved.at);
        if moved.at.seconds_since(began) < REPORT_DELAY_S {
            return;
        }
        let began_s_ago = self.changed.map_or(0.0, |changed| moved.at.seconds_since(changed));
        if self.changed.is_some() && began_s_ago < REPORT_DELAY_S {
            return;
        }
        self.changed = None;
        let Parameters { thrust_share, world: [north, east], body: [front, right], .. } =
            self.parameters();
        let (sin, cos) = moved.attitude.yaw().sin_cos();
        let push = [north + cos * front - sin * right, east + sin * front + cos * right];
        let attitude = self.trims.map(|trim| trim.value);
        let reported = &mut self.reported;
        let mut change = ParameterChange { began_s_ago, ..ParameterChange::default() };
        if (thrust_share - reported.thrust_share).abs() > REPORTED_SHARE_MIN
            && self.recursion.deviation(THRUST_SHARE) < 0.5 * REPORTED_SHARE_MIN
        {
            reported.thrust_share = thrust_share;
            change.thrust_over_mass = Some(1.0 + thrust_share);
        }
        let [north, east] = [push[0] - reported.push[0], push[1] - reported.push[1]];
        if north.hypot(east) > REPORTED_PUSH_MIN_M_S2 {
            reported.push = push;
            change.push = Some(push);
        }
        if attitude
            .iter()
            .zip(reported.attitude)
            .any(|(a, b)| (a - b).abs() > REPORTED_ATTITUDE_MIN_RAD)
        {
            reported.attitude = attitude;
            change.attitude = Some(attitude);
        }
        if change.thrust_over_mass.is_some() || change.push.is_some() || change.attitude.is_some() {
            self.event = Some(AdaptationEvent::Changed(change));
        }
    }
}

fn regressor(moved: &Moved) -> Regressor {
    let axis = SVector::from(moved.attitude.to_world(Frd::new(0.0, 0.0, 1.0)).to_array());
    let (sin, cos) = moved.attitude.yaw().sin_cos();
    let mut slopes = Regressor::zeros();
    slopes.set_column(THRUST_SHARE, &(axis * -moved.thrust_m_s2));
    slopes
        .set_column(THRUST_BEND, &(axis * (-moved.thrust_m_s2 * (moved.thrust_over_hover - 1.0))));
    slopes.set_column(DRAG, &-SVector::from(moved.flow.to_array()));
    slopes.set_column(NORTH, &SVector::from([1.0, 0.0, 0.0]));
    slopes.set_column(EAST, &SVector::from([0.0, 1.0, 0.0]));
    slopes.set_column(FRONT, &SVector::from([cos, sin, 0.0]));
    slopes.set_column(RIGHT, &SVector::from([-sin, cos, 0.0]));
    slopes
}

/// An attitude offset, by scalar least squares with forgetting.
#[derive(Clone, Copy, Debug)]
struct Trim {
    value: f64,
    variance: f64,
    surprise: Surprise,
}

impl Default for Trim {
    fn default() -> Self {
        let surprise = Surprise::default();
        Self { value: 0.0, variance: TRIM_PRIOR_RAD.powi(2), surprise }
    }
}

impl Trim {
    /// Updates with the unexplained attitude; returns whether it changed.
    fn learn(&mut self, unexplained: f64, bound: f64, forgetting_s: f64, dt: f64) -> bool {
        let prior = TRIM_PRIOR_RAD.powi(2);
        let grown = (self.variance * (dt / forgetting_s).exp()).min(prior);
        let total = grown + TRIM_NOISE_RAD.powi(2);
        let innovation = wrap_angle(unexplained - self.value);
        self.value = (self.value + grown / total * innovation).clamp(-bound, bound);
        self.variance = grown * (1.0 - grown / total);
        let is_change = self.surprise.observe(innovation / total.sqrt(), dt, TRIM_SURPRISE_MIN);
        if is_change {
            self.variance = prior;
        }
        is_change
    }
}
