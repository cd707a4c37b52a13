//! Checks that vectors stated in body axes are in them, and those in world axes likewise.

use vehicle::frame::{Attitude, Frd, Ned};

use super::agreement::Agreement;
use super::kinematics::{
    Kinematics, by_attitude, share_explained_by_accelerometer, share_explained_by_gyro,
    share_explained_by_velocity,
};
use super::{Audit, Finding, Severity};
use crate::log::import::Flight;

/// A reading that explains this share is the right one, where the stated one fails.
pub(super) const READING_SHARE_MIN: f64 = 0.8;
/// Above this explained share, the frames need no check.
const STATED_SHARE_MIN: f64 = 0.98;
/// Attitudes further apart than this distinguish body axes from world axes, rad.
const ATTITUDE_CHANGE_MIN: f64 = 0.1;
/// Other frames must leave less than this share of the unexplained part.
const UNEXPLAINED_RATIO_MAX: f64 = 0.5;

/// A stream's values in other axes, and what it means that they fit better there.
type OtherAxes<V> = (fn(Attitude, &V) -> V, &'static str);

/// Reports body vectors in world axes, or the reverse. At a single attitude, that looks like any
/// rotation; over several it does not.
pub(super) fn check(flight: &Flight, audit: &mut Audit) {
    let attitudes = flight.attitude.values();
    let turns =
        |first: &Attitude| attitudes.iter().any(|q| first.angle_to(*q) > ATTITUDE_CHANGE_MIN);
    if !attitudes.first().is_some_and(turns) {
        return;
    }
    let Kinematics { attitude, position, velocity, .. } = audit.kinematics;
    let is_open =
        |pair: Option<Agreement>| pair.is_none_or(|pair| pair.explained < STATED_SHARE_MIN);
    let follows_better = |stated: Option<f64>, otherwise: Option<f64>| {
        let (stated, otherwise) = (stated?, otherwise?);
        // Where the stated frames fit, the rest is rounding.
        let is_better = stated < STATED_SHARE_MIN
            && otherwise > READING_SHARE_MIN
            && 1.0 - otherwise < UNEXPLAINED_RATIO_MAX * (1.0 - stated);
        is_better.then_some(otherwise)
    };
    let mut report = |stream, found: f64, what: &str| {
        audit.findings.push(Finding {
            severity: Severity::Fault,
            check: "frame",
            stream: Some(stream),
            found,
            expected: 1.0,
            unit: "",
            what: what.to_owned(),
            advice: "check the frames stated for the log",
        });
    };
    let with = |change: &dyn Fn(&mut Flight)| {
        let mut other = flight.clone();
        change(&mut other);
        other
    };
    // As stated, then as the reader of the log turned it from other axes than stated.
    let body: fn(Attitude, &Frd) -> Frd = |q, v| q.to_body(Ned::from(v.to_array()));
    let back: fn(Attitude, &Frd) -> Frd = |q, v| Frd::from(q.to_world(*v).to_array());
    if is_open(attitude) {
        let readings: [OtherAxes<Frd>; 2] = [
            (body, "matches the attitude in world axes, not in body axes"),
            (back, "matches the attitude in body axes, not in world axes as stated"),
        ];
        for (turned, what) in readings {
            let other =
                with(&|other| other.body_rate = by_attitude(flight, &flight.body_rate, turned));
            if let Some(found) =
                follows_better(share_explained_by_gyro(flight), share_explained_by_gyro(&other))
            {
                report("body_rate", found, what);
            }
        }
    }
    if is_open(position) {
        let world = |q: Attitude, v: &Ned| q.to_world(Frd::from(v.to_array()));
        let back = |q: Attitude, v: &Ned| Ned::from(q.to_body(*v).to_array());
        let readings: [OtherAxes<Ned>; 2] = [
            (world, "matches the position in body axes, not in world axes"),
            (back, "matches the position in world axes, not in body axes as stated"),
        ];
        let follows = |flight: &Flight| Some(share_explained_by_velocity(flight)?.0);
        for (turned, what) in readings {
            let other =
                with(&|other| other.velocity = by_attitude(flight, &flight.velocity, turned));
            if let Some(found) = follows_better(follows(flight), follows(&other)) {
                report("velocity", found, what);
            }
        }
    }
    if is_open(velocity) {
        let readings: [OtherAxes<Frd>; 2] = [
            (body, "matches the velocity in world axes, not in body axes"),
            (back, "matches the velocity in body axes, not in world axes as stated"),
        ];
        for (turned, what) in readings {
            let other = with(&|other| {
                other.specific_force = by_attitude(flight, &flight.specific_force, turned);
            });
            if let Some(found) = follows_better(
                share_explained_by_accelerometer(flight),
                share_explained_by_accelerometer(&other),
            ) {
                report("specific_force", found, what);
            }
        }
    }
}
