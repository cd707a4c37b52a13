//! Finds files of the same flight: the same bytes, the same samples under another name, a part of
//! another, or two recordings of one flight.

use std::collections::BTreeSet;

use vehicle::frame::{Attitude, Frd};

use super::{Audit, Finding, Severity};
use crate::learn::alignment::interpolated;
use crate::log::import::{Flight, Stream};

/// Fewest distinct samples for a comparison.
const SAMPLES_MIN: usize = 100;
/// Share of a flight's samples that another also has: different flights share hardly any.
const SHARED_MAX: f64 = 0.2;
/// Limits of the root mean square difference between two recordings of one flight: attitude, rad,
/// and position, m. Most flights of the same reference differ by more, since their clocks start
/// separately.
const SAME_ATTITUDE: f64 = 0.006;
const SAME_POSITION: f64 = 0.01;
/// Least spread of the attitude that two flights cannot share by chance, rad.
const SPREAD_MIN: f64 = 0.1;
/// Instants at which two recordings are compared.
const INSTANTS: usize = 200;
/// Distance between the attitudes whose second difference is the motion's fine structure, s.
const FINE_S: f64 = 0.05;
/// Least correlation of the fine structures. Simulators restart their clock with each flight, so two
/// flights of one reference may agree in all but the disturbances, which are each flight's own.
const FINE_CORRELATION: f64 = 0.5;

/// Finds duplicate pairs; the later file of each is at fault.
pub(super) fn check(flights: &[Flight], audits: &mut [Audit]) {
    let prints: Vec<BTreeSet<[u64; 4]>> = flights.iter().map(samples).collect();
    for (b, audit) in audits.iter_mut().enumerate() {
        for a in 0..b {
            let (first, second) = (&flights[a], &flights[b]);
            let name = first.origin.path.display();
            let finding = |severity, found, what, advice| Finding {
                severity,
                check: "duplicate",
                stream: None,
                found,
                expected: 0.0,
                unit: "",
                what,
                advice,
            };
            let is_same_file =
                !first.origin.sha256.is_empty() && first.origin.sha256 == second.origin.sha256;
            let shared = shared(&prints[a], &prints[b]);
            let found = if is_same_file {
                let what = format!("the same file as {name}");
                finding(Severity::Fault, 1.0, what, "leave one of them out")
            } else if shared > SHARED_MAX {
                let what = format!("{:.0} % of its samples are also in {name}", 100.0 * shared);
                finding(Severity::Fault, shared, what, "leave one of them out")
            } else if is_same_flight(first, second) {
                let what = format!("another recording of the flight in {name}");
                let advice =
                    "use only one: they are not independent, so neither can be a hold-out set";
                finding(Severity::Fault, 1.0, what, advice)
            } else {
                continue;
            };
            audit.findings.push(found);
            break;
        }
    }
}

/// Distinct samples of a flight: its attitudes, else its positions, else its specific forces.
fn samples(flight: &Flight) -> BTreeSet<[u64; 4]> {
    let attitudes = flight.attitude.values().iter().map(|q| [q.w, q.x, q.y, q.z].map(f64::to_bits));
    let vector = |v: [f64; 3]| [v[0].to_bits(), v[1].to_bits(), v[2].to_bits(), 0];
    let positions = flight.position.values().iter().map(|p| vector(p.to_array()));
    let forces = flight.specific_force.values().iter().map(|f| vector(f.to_array()));
    match (flight.attitude.is_empty(), flight.position.is_empty()) {
        (false, _) => attitudes.collect(),
        (true, false) => positions.collect(),
        (true, true) => forces.collect(),
    }
}

/// Share of the smaller set that is in both.
fn shared(a: &BTreeSet<[u64; 4]>, b: &BTreeSet<[u64; 4]>) -> f64 {
    let least = a.len().min(b.len());
    if least < SAMPLES_MIN {
        return 0.0;
    }
    a.intersection(b).count() as f64 / least as f64
}

/// The position at `time`, interpolated.
fn position_at(flight: &Flight, time: f64) -> Option<[f64; 3]> {
    let (before, after, share) = flight.position.around(time)?;
    Some((*before + (*after - *before) * share).to_array())
}

/// Whether two logs on the same clock show the same motion.
fn is_same_flight(a: &Flight, b: &Flight) -> bool {
    let ends = |flight: &Flight| {
        Some((*flight.attitude.times().first()?, *flight.attitude.times().last()?))
    };
    let (Some(first), Some(second)) = (ends(a), ends(b)) else { return false };
    let (from, to) = (first.0.max(second.0), first.1.min(second.1));
    let shorter = (first.1 - first.0).min(second.1 - second.0);
    if to - from < 0.5 * shorter || to - from < 5.0 {
        return false;
    }
    let (mut apart, mut spread, mut count) = (0.0, 0.0, 0.0);
    let (mut away, mut places) = (0.0, 0.0);
    let mut start = None;
    for k in 0..INSTANTS {
        let time = from + (to - from) * (k as f64 + 0.5) / INSTANTS as f64;
        let (Some(p), Some(q)) = (interpolated(&a.attitude, time), interpolated(&b.attitude, time))
        else {
            continue;
        };
        let start = *start.get_or_insert(p);
        apart += p.angle_to(q).powi(2);
        spread += p.angle_to(start).powi(2);
        count += 1.0;
        if let (Some(p), Some(q)) = (position_at(a, time), position_at(b, time)) {
            away += (0..3).map(|i| (p[i] - q[i]).powi(2)).sum::<f64>();
            places += 1.0;
        }
    }
    let rms = |sum: f64, count: f64| (sum / count).sqrt();
    let is_near = places == 0.0 || rms(away, places) < SAME_POSITION;
    count > 20.0
        && is_near
        && rms(apart, count) < SAME_ATTITUDE
        && rms(spread, count) > SPREAD_MIN
        && fine_correlation([&a.attitude, &b.attitude], [from, to]) > FINE_CORRELATION
}

/// The correlation of two attitudes' second differences between the times `from` and `to`, s: 1
/// where neither turns, 0 where only one does.
fn fine_correlation(attitudes: [&Stream<Attitude>; 2], [from, to]: [f64; 2]) -> f64 {
    let fine = |attitude: &Stream<Attitude>, time: f64| -> Option<Frd> {
        let at = |time: f64| interpolated(attitude, time);
        let (before, here, after) = (at(time - FINE_S)?, at(time)?, at(time + FINE_S)?);
        Some(here.rotation_to(after) + here.rotation_to(before))
    };
    // A grid of instants, but none in the gaps of a clock that runs wild.
    let within = attitudes[0].times().iter().filter(|time| (from..to).contains(*time));
    let mut instants: Vec<u64> = within.map(|time| ((time - from) / FINE_S) as u64).collect();
    instants.dedup();
    let [mut product, mut of_a, mut of_b] = [0.0; 3];
    for k in instants {
        let time = from + k as f64 * FINE_S;
        if let (Some(p), Some(q)) = (fine(attitudes[0], time), fine(attitudes[1], time)) {
            product += p.dot(q);
            of_a += p.dot(p);
            of_b += q.dot(q);
        }
    }
    match (of_a > 0.0, of_b > 0.0) {
        (true, true) => product / (of_a * of_b).sqrt(),
        (false, false) => 1.0,
        _ => 0.0,
    }
}
