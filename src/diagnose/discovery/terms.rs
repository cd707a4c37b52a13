//! The grammar: the terms that a quadrotor's symmetry and the units allow.
//!
//! Force is a polar vector and moment an axial one. An airframe with fourfold symmetry relates
//! front and right: airspeed along right causes the same force to the right as airspeed along front
//! does to the front. Terms along a single axis cover other airframes.

use vehicle::VehicleParams;
use vehicle::law::{Channel, Quantity as Q};

use crate::diagnose::catalogue::term::{Factor, Term};
use crate::diagnose::flights::preparation::Channels;

/// Typical size of a term, as a share of the weight at the [usual](usual) values of its quantities.
/// It sets the width of the coefficient's prior.
const SHARE: f64 = 0.1;
/// Start values of powers and lengths.
const POWERS: [f64; 4] = [-0.5, 0.5, 1.5, 2.5];
const LENGTHS_M: [f64; 3] = [0.15, 0.5, 1.5];

/// A typical value of a quantity in flight, in SI.
fn usual(quantity: Q, weight: f64, arm: f64) -> f64 {
    match quantity {
        Q::Thrust => weight,
        Q::RotorMomentX | Q::RotorMomentY => 0.1 * weight * arm,
        Q::RotorMomentZ => 0.01 * weight * arm,
        Q::RateX | Q::RateY | Q::RateZ | Q::RotorSpeed => 1.0,
        _ => 2.0,
    }
}

/// Every term for a vehicle and the channels of its logs, with the width of its coefficient's
/// prior.
pub fn terms(vehicle: &VehicleParams, channels: Channels) -> Vec<(Term, f64)> {
    let mut all: Vec<Term> = Vec::new();
    let [x, y, z] = [0, 1, 2].map(Channel::Force);
    let [roll, pitch, yaw] = [0, 1, 2].map(Channel::Moment);
    let mut add = |parts: &[(Channel, Option<Q>, f64)], factors: &[Factor]| {
        all.extend(factors.iter().map(|factor| Term { parts: parts.to_vec(), factor: *factor }));
    };
    let speeds = |more: &[Factor]| -> Vec<Factor> {
        let powers = POWERS.into_iter().map(|power| Factor::Power(Q::Airspeed, power));
        let own = [Factor::One, Factor::Quantity(Q::Airspeed), Factor::Quantity(Q::RotorSpeed)];
        own.into_iter().chain(powers).chain(more.iter().copied()).collect()
    };
    let one = &[Factor::One][..];
    let near_floor: Vec<Factor> = LENGTHS_M.into_iter().map(Factor::Decay).collect();
    // Forces along the airspeed: in all axes, in the rotors' plane, and along each axis.
    let (ax, ay, az) = ((x, Some(Q::AirX), 1.0), (y, Some(Q::AirY), 1.0), (z, Some(Q::AirZ), 1.0));
    add(&[ax, ay, az], &speeds(&[Factor::Quantity(Q::Thrust), Factor::Own]));
    add(&[ax, ay], &speeds(&[Factor::Quantity(Q::Thrust), Factor::Own]));
    let alone = [Factor::One, Factor::Own, Factor::Quantity(Q::RotorSpeed)];
    [ax, ay, az].iter().for_each(|part| add(&[*part], &alone));
    // Forces across the airspeed, as on a rotating body, and from rotation alone.
    let across = [(x, Some(Q::AirY), -1.0), (y, Some(Q::AirX), 1.0)];
    add(&across, &[Factor::One, Factor::Quantity(Q::RateZ)]);
    add(&[(x, Some(Q::RateY), 1.0), (y, Some(Q::RateX), -1.0)], one);
    for axis in [x, y, z] {
        add(&[(axis, None, 1.0)], &[Factor::One, Factor::Quantity(Q::RateZ)]);
    }
    // Forces along the rotors' axis.
    add(&[(z, Some(Q::AirspeedXy), 1.0)], &[Factor::One, Factor::Own]);
    // Changes of the thrust.
    let mut lifting = vec![Factor::One, Factor::Quantity(Q::AirspeedXy), Factor::Quantity(Q::AirZ)];
    lifting.push(Factor::Product(Q::AirspeedXy, Q::AirspeedXy));
    lifting.extend([0.5, 1.5].map(|power| Factor::Power(Q::AirspeedXy, power)));
    lifting.push(Factor::Quantity(Q::Thrust));
    lifting.extend(&near_floor);
    if channels.voltage {
        lifting.push(Factor::Sag);
    }
    add(&[(Channel::Thrust, None, 1.0)], &lifting);
    // Forces fixed in the world, and body forces that vary with heading.
    let headings = [Factor::Heading(true), Factor::Heading(false)];
    for axis in 0..3 {
        add(&[(Channel::WorldForce(axis), None, 1.0)], one);
    }
    add(&[(x, None, 1.0)], &headings);
    add(&[(y, None, 1.0)], &headings);
    // Moments: damping, the air's force on parts above or below the centre, and the rotors' own.
    let (rx, ry, rz) =
        ((roll, Some(Q::RateX), 1.0), (pitch, Some(Q::RateY), 1.0), (yaw, Some(Q::RateZ), 1.0));
    let damped =
        [Factor::One, Factor::Own, Factor::Quantity(Q::RotorSpeed), Factor::Quantity(Q::Airspeed)];
    add(&[rx, ry], &damped);
    [rx, ry, rz].iter().for_each(|part| add(&[*part], &[Factor::One, Factor::Own]));
    let lever = [(roll, Some(Q::AirY), 1.0), (pitch, Some(Q::AirX), -1.0)];
    add(&lever, &speeds(&[Factor::Quantity(Q::Thrust)]));
    lever.iter().for_each(|part| add(&[*part], one));
    add(&[(roll, Some(Q::AirX), 1.0), (pitch, Some(Q::AirY), 1.0)], one);
    add(&[(yaw, Some(Q::AirX), 1.0)], one);
    add(&[(yaw, Some(Q::AirY), 1.0)], one);
    for axis in [roll, pitch, yaw] {
        add(&[(axis, None, 1.0)], one);
        add(&[(axis, None, 1.0)], &headings);
    }
    let rotors = [(roll, Some(Q::RotorMomentX), 1.0), (pitch, Some(Q::RotorMomentY), 1.0)];
    add(&rotors, &[Factor::One, Factor::Quantity(Q::AirspeedXy)]);
    add(&[(yaw, Some(Q::RotorMomentZ), 1.0)], one);
    add(&[(yaw, Some(Q::RateZ), 1.0)], &[Factor::Quantity(Q::Airspeed)]);

    let weight = vehicle.mass * vehicle.gravity;
    let arms = vehicle.rotors.iter().map(|rotor| rotor.position_m[0].hypot(rotor.position_m[1]));
    let arm = arms.fold(0.0, f64::max);
    let is_shown = |term: &Term| {
        let needs = |channel: Channel| match channel {
            Channel::Moment(_) => channels.body_rate,
            _ => channels.velocity || channels.specific_force,
        };
        let is_known = |quantity: &Q| match quantity {
            Q::RateX | Q::RateY | Q::RateZ => channels.body_rate,
            Q::Heading => channels.attitude,
            Q::Thrust | Q::RotorSpeed => true,
            Q::RotorMomentX | Q::RotorMomentY | Q::RotorMomentZ => true,
            _ => channels.velocity && channels.attitude,
        };
        term.parts.iter().all(|(channel, _, _)| needs(*channel))
            && term.quantities().iter().all(is_known)
    };
    all.retain(is_shown);
    let with_width = |term: Term| {
        let unit = match term.parts.first().map(|(channel, _, _)| *channel) {
            Some(Channel::Moment(_)) => weight * arm,
            Some(Channel::Thrust) => 1.0,
            _ => weight,
        };
        let own = term.parts.first().and_then(|(_, quantity, _)| *quantity);
        let value = |quantity: Q| usual(quantity, weight, arm);
        let factor = match term.factor {
            Factor::Quantity(quantity) => value(quantity),
            Factor::Product(a, b) => value(a) * value(b),
            Factor::Power(quantity, power) => value(quantity).powf(power),
            Factor::Own => own.map_or(1.0, value),
            Factor::Sag => 0.1,
            _ => 1.0,
        };
        let width = SHARE * unit / (own.map_or(1.0, value) * factor);
        (term, width)
    };
    all.into_iter().map(with_width).collect()
}

#[cfg(test)]
mod tests {
    use vehicle::law::Law;

    use super::*;
    use crate::diagnose::catalogue::term::law_of;

    #[test]
    fn every_term_is_a_valid_and_unique_law() {
        let vehicle = VehicleParams::load("crazyflie").unwrap();
        let channels = Channels {
            velocity: true,
            attitude: true,
            body_rate: true,
            specific_force: true,
            outputs: true,
            setpoint: true,
            voltage: true,
            rotor_speed: true,
        };
        let all = terms(&vehicle, channels);
        assert!(all.len() > 80, "{}", all.len());
        for (index, (term, width)) in all.iter().enumerate() {
            let text = law_of([(term, 0.5)]).unwrap();
            assert!(Law::new("law", text).is_ok(), "{term:?}");
            assert!(width.is_finite() && *width > 0.0, "{term:?}");
            assert!(all[..index].iter().all(|(other, _)| other != term), "{term:?}");
        }
        // Without an attitude, the airspeed along the body axes is unknown.
        let blind = Channels { attitude: false, ..channels };
        assert!(terms(&vehicle, blind).iter().all(|(t, _)| !t.quantities().contains(&Q::AirX)));
    }
}
