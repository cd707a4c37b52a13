//! The library of manoeuvres: its contents, and that they stay within their room.

use downwash::plan::FlightEnvelope;
use downwash::plan::manoeuvres::{Room, library};
use downwash::plan::programme::{Capability, ProgrammeSettings};
use proptest::prelude::*;

/// Rounding of waypoints, m.
const MILLIMETRE: f64 = 1e-3;

fn capability(thrust_to_weight: f64) -> Capability {
    let (tilt_bandwidth, yaw_bandwidth) = (17.0, 8.0);
    Capability { gravity: 9.80665, thrust_to_weight, tilt_bandwidth, yaw_bandwidth }
}

#[test]
fn every_manoeuvre_fits_the_default_room() {
    let envelope = FlightEnvelope::default();
    let room = Room::new(&ProgrammeSettings::default(), &envelope, &capability(1.95));
    let found = library(&room, &envelope);
    assert_eq!(found.len(), 16);
    for manoeuvre in &found {
        let seconds = manoeuvre.trajectory.duration();
        assert!((8.0..150.0).contains(&seconds), "{} takes {seconds} s", manoeuvre.name);
        assert_eq!(found.iter().filter(|other| other.name == manoeuvre.name).count(), 1);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn manoeuvres_stay_within_the_room(
        thrust_to_weight in 1.5..4.0f64,
        half in 0.5..6.0f64,
        ceiling in 1.5..6.0f64,
        tilt_max_deg in 8.0..35.0f64,
        speed_max_m_s in 0.5..5.0f64,
    ) {
        let envelope = FlightEnvelope::default();
        let settings = ProgrammeSettings {
            half_size_m: [half, half],
            height_max_m: ceiling,
            tilt_max_deg,
            speed_max_m_s,
            ..ProgrammeSettings::default()
        };
        let room = Room::new(&settings, &envelope, &capability(thrust_to_weight));
        for manoeuvre in library(&room, &envelope) {
            let demands = manoeuvre.demands;
            let name = manoeuvre.name;
            prop_assert!(demands.speed_m_s <= speed_max_m_s + 1e-3, "{name} {demands:?}");
            prop_assert!(demands.height_m <= ceiling + MILLIMETRE, "{name} {demands:?}");
            for step in 0..(manoeuvre.trajectory.duration() * 20.0) as usize {
                let [north, east, down]: [f64; 3] =
                    manoeuvre.trajectory.sample(step as f64 * 0.05).position.into();
                prop_assert!(north.abs() <= half * 2.0 && east.abs() <= half * 2.0, "{name}");
                prop_assert!(-down >= room.lowest_m - MILLIMETRE, "{name} at {down}");
            }
        }
    }
}
