//! Checks that vectors stated in body axes are in them, and those in world axes likewise.

use vehicle::frame::{Attitude, Frd, Ned};

use super::agreement::Agreement;
use super::contrast::{Misfits, by_block, contrast, is_better};
use super::initial_fit::InitialFit;
use super::kinematics::{
    AttitudeAndGyro, Kinematics, PositionAndVelocity, VelocityAndForce, by_attitude,
};
use super::pair::Pair;
use super::{Audit, Finding, Severity};
use crate::log::import::Flight;

/// A reading that explains this share is the right one, where the stated one fails.
pub(super) const READING_SHARE_MIN: f64 = 0.8;
/// Attitudes further apart than this distinguish body axes from world axes, rad.
const ATTITUDE_CHANGE_MIN: f64 = 0.1;

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
    let mut report = |stream, found: Option<f64>, what: &str| {
        audit.findings.extend(found.map(|found| Finding {
            severity: Severity::Fault,
            check: "frame",
            stream: Some(stream),
            found,
            expected: 1.0,
            unit: "",
            what: what.to_owned(),
            advice: "check the frames stated for the log",
        }));
    };
    let with = |change: &dyn Fn(&mut Flight)| {
        let mut other = flight.clone();
        change(&mut other);
        other
    };
    // As stated, then as the reader of the log turned it from other axes than stated.
    let body: fn(Attitude, &Frd) -> Frd = |q, v| q.to_body(Ned::from(v.to_array()));
    let back: fn(Attitude, &Frd) -> Frd = |q, v| Frd::from(q.to_world(*v).to_array());
    let stated = AttitudeAndGyro::of(flight, |q| q);
    for (turned, what) in [
        (body, "matches the attitude in world axes, not in body axes"),
        (back, "matches the attitude in body axes, not in world axes as stated"),
    ] {
        let other = with(&|other| other.body_rate = by_attitude(flight, &flight.body_rate, turned));
        let other = AttitudeAndGyro::of(&other, |q| q);
        report("body_rate", explained_better(&stated, &other, attitude), what);
    }
    let stated = PositionAndVelocity::of(flight);
    let world: fn(Attitude, &Ned) -> Ned = |q, v| q.to_world(Frd::from(v.to_array()));
    let unturned: fn(Attitude, &Ned) -> Ned = |q, v| Ned::from(q.to_body(*v).to_array());
    for (turned, what) in [
        (world, "matches the position in body axes, not in world axes"),
        (unturned, "matches the position in world axes, not in body axes as stated"),
    ] {
        let other = with(&|other| other.velocity = by_attitude(flight, &flight.velocity, turned));
        let other = PositionAndVelocity::of(&other);
        report("velocity", explained_better(&stated, &other, position), what);
    }
    let stated = VelocityAndForce::by_accelerometer(flight, 0.0, [0.0; 3]);
    for (turned, what) in [
        (body, "matches the velocity in world axes, not in body axes"),
        (back, "matches the velocity in body axes, not in world axes as stated"),
    ] {
        let other = with(&|other| {
            other.specific_force = by_attitude(flight, &flight.specific_force, turned);
        });
        let other = VelocityAndForce::by_accelerometer(&other, 0.0, [0.0; 3]);
        report("specific_force", explained_better(&stated, &other, velocity), what);
    }
}

/// The share of the motion that another reading of a pair explains, if it is certainly the right
/// one. `agreement` is the pair's as stated.
fn explained_better<P: Pair>(stated: &P, other: &P, agreement: Option<Agreement>) -> Option<f64> {
    let bumps = InitialFit::bumps(stated);
    // Streams of wrong axes may show no delay, or a wrong one.
    let best = |pair: &P| match agreement {
        Some(agreement) => [0.0, agreement.delay_s.value]
            .map(|delay| InitialFit::with_misfits(pair, &bumps, delay))
            .into_iter()
            .max_by(|(a, _), (b, _)| a.explained.total_cmp(&b.explained)),
        None => InitialFit::best(pair)
            .map(|initial| InitialFit::with_misfits(pair, &bumps, initial.delay)),
    };
    let ((_, left), (fit, other_left)) = best(stated).zip(best(other))?;
    if fit.explained < READING_SHARE_MIN {
        return None;
    }
    let both = bumps.iter().zip(left).zip(other_left);
    let (times, misfits): (Vec<f64>, Vec<Misfits>) = both
        .filter_map(|((bump, stated), other)| {
            Some((bump.centre, Misfits { stated: stated?, other: other? }))
        })
        .unzip();
    let contrast = contrast(&by_block(&times, &misfits))?;
    is_better(&contrast).then_some(fit.explained)
}
