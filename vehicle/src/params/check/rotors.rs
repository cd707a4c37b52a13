//! The numbers of the rotors against each other: radius, speed, thrust and torque.

use super::{Doubt, Remark, brief, looks_like};
use crate::VehicleParams;

/// Radius of a rotor over half the least distance between two: overlapping ones reach beyond 1.
const RADIUS_SHARE: [f64; 2] = [0.2, 1.5];
/// Thrust coefficient `T / (rho n^2 D^4)`, n in turns per second. Propellers of aircraft models
/// have 0.05 to 0.3.
const THRUST_COEFFICIENT: [f64; 2] = [0.01, 1.0];
/// Drag torque per thrust over the rotor's diameter.
const TORQUE_SHARE: [f64; 2] = [0.005, 0.5];
/// Units in which radii and torques per thrust are often given, in m.
const LENGTH_UNITS: [(f64, &str); 3] = [(1e-2, "cm"), (1e-3, "mm"), (0.0254, "inches")];
/// Units in which speeds are often given, in 1/min.
const SPEED_UNITS: [(f64, &str); 2] = [(60.0 / std::f64::consts::TAU, "rad/s"), (60.0, "1/s")];

impl VehicleParams {
    /// If the radius does not fit, comparisons with it say nothing more.
    pub(super) fn rotor_remarks(&self) -> Vec<Remark> {
        let radius = self.radius_remark();
        if radius.is_some() {
            return radius.into_iter().collect();
        }
        self.speed_remark().into_iter().chain(self.torque_remark()).collect()
    }

    /// Least horizontal distance between the axes of two rotors, m.
    fn least_distance_m(&self) -> f64 {
        let places = self.rotors.map(|rotor| rotor.position_m);
        let pairs = places
            .iter()
            .enumerate()
            .flat_map(|(at, place)| places.iter().skip(at + 1).map(move |other| (place, other)));
        pairs.map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).fold(f64::INFINITY, f64::min)
    }

    fn radius_remark(&self) -> Option<Remark> {
        let (radius, distance) = (self.rotor_radius_m, self.least_distance_m());
        let expected = RADIUS_SHARE.map(|share| share * 0.5 * distance);
        let advice = looks_like(&LENGTH_UNITS, "rotor_radius_m is in m", |unit| {
            within(expected, unit * radius)
        });
        let what = format!(
            "rotor_radius_m is {} m, but two rotors are {} m from each other, expected {} to {} \
             m{advice}",
            brief(radius),
            brief(distance),
            brief(expected[0]),
            brief(expected[1])
        );
        remark("rotor_radius_m", radius, expected, "m", what)
    }

    fn speed_remark(&self) -> Option<Remark> {
        let speed = self.rotor_max_rpm?;
        let diameter = 2.0 * self.rotor_radius_m;
        let thrusts = self.rotors.map(|rotor| rotor.thrust_max_n);
        let thrust = thrusts.iter().sum::<f64>() / thrusts.len() as f64;
        let [least, most] = THRUST_COEFFICIENT;
        let expected = [most, least].map(|coefficient| {
            60.0 * (thrust / (self.air_density * coefficient * diameter.powi(4))).sqrt()
        });
        let advice = looks_like(&SPEED_UNITS, "rotor_max_rpm is in 1/min", |unit| {
            within(expected, unit * speed)
        });
        let what = format!(
            "rotor_max_rpm is {} 1/min; a rotor of {} m in diameter that gives {} N turns at {} to \
             {} 1/min{advice}",
            brief(speed),
            brief(diameter),
            brief(thrust),
            brief(expected[0]),
            brief(expected[1])
        );
        remark("rotor_max_rpm", speed, expected, "1/min", what)
    }

    fn torque_remark(&self) -> Option<Remark> {
        let diameter = 2.0 * self.rotor_radius_m;
        let expected = TORQUE_SHARE.map(|share| share * diameter);
        self.rotors.iter().find_map(|rotor| {
            let torque = rotor.drag_torque_per_thrust_m;
            let unit = "drag_torque_per_thrust_m is in m";
            let advice = looks_like(&LENGTH_UNITS, unit, |unit| within(expected, unit * torque));
            let what = format!(
                "drag_torque_per_thrust_m is {} m; of a rotor of {} m in diameter {} to {} m are \
                 expected{advice}",
                brief(torque),
                brief(diameter),
                brief(expected[0]),
                brief(expected[1])
            );
            remark("drag_torque_per_thrust_m", torque, expected, "m", what)
        })
    }
}

fn within([least, most]: [f64; 2], value: f64) -> bool {
    (least..=most).contains(&value)
}

fn remark(
    field: &'static str,
    found: f64,
    expected: [f64; 2],
    unit: &'static str,
    what: String,
) -> Option<Remark> {
    let fits = within(expected, found);
    (!fits).then_some(Remark { doubt: Doubt::Unlikely, field, found, expected, unit, what })
}

#[cfg(test)]
mod tests {
    use super::super::super::tests::quad;
    use super::*;

    fn told(change: impl FnOnce(&mut VehicleParams)) -> Vec<(&'static str, String)> {
        let mut vehicle = quad();
        change(&mut vehicle);
        vehicle.remarks().into_iter().map(|remark| (remark.field, remark.what)).collect()
    }

    #[test]
    fn numbers_of_the_rotors_in_other_units_are_told_as_such() {
        assert_eq!(told(|_| {}), []);
        let found = told(|v| v.rotor_radius_m = 120.0);
        assert_eq!(found[0].0, "rotor_radius_m");
        assert!(found[0].1.contains("looks like mm"), "{found:?}");
        let found = told(|v| v.rotor_max_rpm = Some(9000.0 / 9.5493));
        assert_eq!(found[0].0, "rotor_max_rpm");
        assert!(found[0].1.contains("looks like rad/s"), "{found:?}");
        let found = told(|v| v.rotors.iter_mut().for_each(|r| r.drag_torque_per_thrust_m = 16.0));
        assert_eq!((found.len(), found[0].0), (1, "drag_torque_per_thrust_m"));
        assert!(found[0].1.contains("looks like mm"), "{found:?}");
    }

    #[test]
    fn two_rotors_in_one_place_are_told() {
        let found = told(|v| v.rotors[1].position_m = v.rotors[0].position_m);
        assert!(
            found.iter().any(|(_, what)| what.contains("are 0.00000 m from each")),
            "{found:?}"
        );
    }
}
