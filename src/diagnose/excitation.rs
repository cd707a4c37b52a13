//! Excitation: what flights are made to tell apart, whatever a fit finds.

use std::f64::consts::FRAC_PI_4;

use sitl::frame::wrap_angle;

use super::preparation::PreparedFlight;
use super::series::attitude;
use super::untestable::{is_flat, voltage_range};

/// Headings this far from their mean turn a trim against a wind, rad.
const HEADINGS: f64 = FRAC_PI_4;

/// Whether the pack's voltage goes far enough, within flights or from one to the next, for sag to
/// be told from another level of the thrust.
pub(super) fn voltages_differ(flights: &[PreparedFlight]) -> bool {
    let all = flights.iter().flat_map(|flight| flight.voltage.values().iter().map(|[v]| *v));
    flights.iter().all(|flight| flight.channels.voltage) && !is_flat(voltage_range(all))
}

/// Whether flights are made to tell a wind from a trim: an accelerometer feels the air's push and
/// not the trim, and at another heading the wind stays in the world and the trim with the vehicle.
pub(super) fn part_wind_from_trim(flights: &[PreparedFlight]) -> bool {
    let headings = || flights.iter().flat_map(headings);
    let [north, east] = headings().fold([0.0; 2], |[n, e], yaw| [n + yaw.cos(), e + yaw.sin()]);
    let mean = east.atan2(north);
    flights.iter().all(|flight| flight.channels.specific_force)
        || headings().any(|yaw| wrap_angle(yaw - mean).abs() > HEADINGS)
}

/// Headings in the air, rad.
fn headings(flight: &PreparedFlight) -> impl Iterator<Item = f64> {
    let samples = flight.attitude.times().iter().zip(flight.attitude.values());
    samples
        .filter(|(time, _)| flight.spans.iter().any(|span| span.contains(*time)))
        .map(|(_, q)| attitude(*q).yaw())
}

#[cfg(test)]
mod tests {
    use sitl::frame::{Attitude, Euler};

    use super::*;
    use crate::diagnose::series::Series;

    #[test]
    fn a_wind_is_told_from_a_trim_by_headings_or_by_an_accelerometer() {
        let flight = |yaw: f64, specific_force: bool| {
            let Attitude { w, x, y, z } = Euler { roll: 0.01, pitch: 0.0, yaw }.attitude();
            let mut flight = PreparedFlight::of_spans(vec![0.0..20.0]);
            flight.attitude = Series::new(vec![0.0, 20.0], vec![[w, x, y, z]; 2]);
            flight.channels.specific_force = specific_force;
            flight
        };
        // The same heading, on either side of half a turn.
        assert!(!part_wind_from_trim(&[flight(3.1, false), flight(-3.1, false)]));
        assert!(part_wind_from_trim(&[flight(0.0, false), flight(1.8, false)]));
        assert!(part_wind_from_trim(&[flight(0.0, true), flight(0.0, true)]));
        assert!(!part_wind_from_trim(&[flight(0.0, true), flight(0.0, false)]));
        // It was carried about on the ground.
        let mut carried = flight(0.0, false);
        let Attitude { w, x, y, z } = Euler { roll: 0.0, pitch: 0.0, yaw: 2.0 }.attitude();
        let [aloft, _] = carried.attitude.values() else { panic!("two samples") };
        carried.attitude = Series::new(vec![-9.0, 0.0, 19.0], vec![[w, x, y, z], *aloft, *aloft]);
        assert!(!part_wind_from_trim(&[carried]));
    }
}
