//! Checks that vectors stated in body axes are in them, and those in world axes likewise.

use vehicle::frame::{Attitude, Frd, Ned};

use super::agreement::Agreement;
use super::contrast::{Misfits, by_block, certain_contrast};
use super::initial_fit::InitialFit;
use super::kinematics::{
    AttitudeAndGyro, Kinematics, PositionAndVelocity, VelocityAndForce, by_attitude,
};
use super::pair::Pair;
use super::weak::Bump;
use super::{Audit, Finding, Severity};
use crate::log::import::{Flight, Stream};

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
    // As stated, then as the reader of the log turned it from other axes than stated.
    let body: fn(Attitude, &Frd) -> Frd = |q, v| q.to_body(Ned::from(v.to_array()));
    let back: fn(Attitude, &Frd) -> Frd = |q, v| Frd::from(q.to_world(*v).to_array());
    if let Some(stated) = Stated::of(&AttitudeAndGyro::of(flight, |q| q), attitude) {
        for (turned, what) in [
            (body, "matches the attitude in world axes, not in body axes"),
            (back, "matches the attitude in body axes, not in world axes as stated"),
        ] {
            let rate = by_attitude(flight, &flight.body_rate, turned);
            let other = AttitudeAndGyro::new(flight.attitude.clone(), &rate);
            report("body_rate", stated.explained_better(&other), what);
        }
    }
    if let Some(stated) = Stated::of(&PositionAndVelocity::of(flight), position) {
        let world: fn(Attitude, &Ned) -> Ned = |q, v| q.to_world(Frd::from(v.to_array()));
        let unturned: fn(Attitude, &Ned) -> Ned = |q, v| Ned::from(q.to_body(*v).to_array());
        for (turned, what) in [
            (world, "matches the position in body axes, not in world axes"),
            (unturned, "matches the position in world axes, not in body axes as stated"),
        ] {
            let velocity = by_attitude(flight, &flight.velocity, turned);
            let other = PositionAndVelocity::new(&flight.position, &velocity);
            report("velocity", stated.explained_better(&other), what);
        }
    }
    let by_force =
        |force: &Stream<Frd>| VelocityAndForce::by_accelerometer(flight, force, 0.0, [0.0; 3]);
    if let Some(stated) = Stated::of(&by_force(&flight.specific_force), velocity) {
        for (turned, what) in [
            (body, "matches the velocity in world axes, not in body axes"),
            (back, "matches the velocity in body axes, not in world axes as stated"),
        ] {
            let other = by_force(&by_attitude(flight, &flight.specific_force, turned));
            report("specific_force", stated.explained_better(&other), what);
        }
    }
}

/// A pair as stated, and what its best fit leaves unexplained.
struct Stated {
    agreement: Option<Agreement>,
    bumps: Vec<Bump>,
    /// Squared misfit under each bump.
    left: Vec<Option<f64>>,
}

impl Stated {
    /// `None` where the pair's streams do not overlap in time.
    fn of(pair: &impl Pair, agreement: Option<Agreement>) -> Option<Self> {
        let mut stated = Self { agreement, bumps: InitialFit::bumps(pair), left: Vec::new() };
        stated.left = stated.fit(pair)?.1;
        Some(stated)
    }

    /// The best fit of a pair, and what it leaves under each bump.
    fn fit(&self, pair: &impl Pair) -> Option<(InitialFit, Vec<Option<f64>>)> {
        let at = |delay: f64| InitialFit::with_misfits(pair, &self.bumps, delay);
        match self.agreement {
            // Streams of wrong axes may show no delay, or a wrong one.
            Some(agreement) => [0.0, agreement.delay_s.value]
                .map(at)
                .into_iter()
                .max_by(|(a, _), (b, _)| a.explained.total_cmp(&b.explained)),
            None => InitialFit::best(pair).map(|initial| at(initial.delay)),
        }
    }

    /// The share of the motion that another reading of the pair explains, if it is certainly the
    /// right one.
    fn explained_better(&self, other: &impl Pair) -> Option<f64> {
        let (fit, left) = self.fit(other)?;
        if fit.explained < READING_SHARE_MIN {
            return None;
        }
        let both = self.bumps.iter().zip(&self.left).zip(left);
        let (times, misfits): (Vec<f64>, Vec<Misfits>) = both
            .filter_map(|((bump, stated), other)| {
                Some((bump.centre, Misfits { stated: (*stated)?, other: other? }))
            })
            .unzip();
        certain_contrast(&by_block(&times, &misfits))?;
        Some(fit.explained)
    }
}
