//! The flights for learning a model of the vehicle, after Bansal et al. 2016, section V-A:
//! sinusoids in the XY, XZ and YZ planes without yaw, yaw rotations at a fixed position, and
//! unstructured flight, in the proportions of the paper's data set.
//!
//! Every flight uses its limits to the full: the periods are random, and the amplitudes are the
//! largest within the box, the speed, the tilt and the thrust that the flight may use. Smaller and
//! faster waves, up to the bandwidth of the attitude loop, keep the rotational dynamics above the
//! noise.

mod composer;
mod kind;
mod limits;
mod shares;

use std::path::Path;

use self::composer::Composer;
pub use self::kind::FlightKind;
use self::limits::Limits;
pub use self::limits::{Capability, ProgrammeSettings};
pub(in crate::plan) use self::limits::{MARGIN, THRUST_SHARE};
use self::shares::{COMBINED_SHARES, SHARES, slots};
use super::feasibility::{Feasibility, FlightEnvelope, InfeasibleTrajectory};
use super::file::TrajectoryError;
use super::trajectory::Trajectory;

/// One flight of a programme.
#[derive(Clone, Debug)]
pub struct ProgrammeFlight {
    /// Its number and kind, such as `01-sinusoid-xy`; flights of one kind are consecutive.
    pub name: String,
    /// The axes and the pattern of its motion.
    pub kind: FlightKind,
    /// The flight's own random seed, for a simulation of it.
    pub seed: u64,
    /// The trajectory file.
    pub text: String,
    /// The trajectory in that file.
    pub trajectory: Trajectory,
    /// The largest speed, acceleration and other demands of the trajectory.
    pub demands: Feasibility,
}

/// Why no programme can be made.
#[derive(Debug, thiserror::Error)]
pub enum ProgrammeError {
    /// A length that is too short or too long.
    #[error(
        "a programme of {seconds:?} s: expected at least {least} s, so that each kind of flight has \
         room, and at most {most} s"
    )]
    Length {
        /// The length requested, s.
        seconds: f64,
        /// The shortest accepted, s.
        least: f64,
        /// The longest accepted, s.
        most: f64,
    },
    /// Settings that leave no room to fly in.
    #[error("[collect], [envelope] and the vehicle leave {quantity} of {found:.3}: {expected}")]
    NoRoom {
        /// The quantity with too little room.
        quantity: &'static str,
        /// Its value.
        found: f64,
        /// The requirement.
        expected: &'static str,
    },
    /// The trajectory parser rejected a flight.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// The envelope rejected a flight.
    #[error(transparent)]
    Infeasible(#[from] InfeasibleTrajectory),
}

/// The programme: `seconds` of trajectory in the kinds for training, then `combined_seconds` in the
/// kinds that combine both motions. The same arguments give the same flights, and the first part
/// does not depend on the second.
///
/// # Errors
/// [`ProgrammeError`]; every returned flight is within the envelope.
pub fn programme(
    settings: &ProgrammeSettings,
    envelope: &FlightEnvelope,
    capability: &Capability,
    seconds: f64,
    combined_seconds: f64,
    seed: u64,
) -> Result<Vec<ProgrammeFlight>, ProgrammeError> {
    let limits = Limits::new(settings, envelope, capability)?;
    let mut slots = slots(&SHARES, seconds, settings.flight_s)?;
    if combined_seconds != 0.0 {
        slots.extend(shares::slots(&COMBINED_SHARES, combined_seconds, settings.flight_s)?);
    }
    let mut flights = Vec::new();
    for (index, slot) in slots.iter().enumerate() {
        let flight_seed = mixed(seed, index as u64);
        let heading_deg = match settings.headings_deg.as_slice() {
            [] => 0.0,
            headings => headings[slot.number % headings.len()],
        };
        let text = Composer::new(&limits, slot, flight_seed).compose(heading_deg).to_toml();
        let name = format!("{:02}-{}", index + 1, slot.kind.name());
        let origin = format!("{name}.toml");
        let trajectory = Trajectory::parse(&text, Path::new(&origin))?;
        let demands = envelope.check(&trajectory, capability.gravity)?;
        flights.push(ProgrammeFlight {
            name,
            kind: slot.kind,
            seed: flight_seed,
            text,
            trajectory,
            demands,
        });
    }
    Ok(flights)
}

/// A seed of 32 bits, which every JSON reader preserves (splitmix64's mixing).
fn mixed(seed: u64, index: u64) -> u64 {
    let mut x = seed.wrapping_add((index + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    (x ^ (x >> 31)) >> 32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn nano() -> Capability {
        Capability {
            gravity: 9.80665,
            thrust_to_weight: 1.95,
            tilt_bandwidth: 17.0,
            yaw_bandwidth: 8.0,
        }
    }

    fn made(seconds: f64, combined: f64, seed: u64) -> Vec<ProgrammeFlight> {
        let (settings, envelope) = (ProgrammeSettings::default(), FlightEnvelope::default());
        programme(&settings, &envelope, &nano(), seconds, combined, seed).expect("a programme")
    }

    #[test]
    fn flight_shares_match_the_paper() {
        let flights = made(2400.0, 300.0, 1);
        let length = |kinds: &[FlightKind]| -> f64 {
            let of = flights.iter().filter(|flight| kinds.contains(&flight.kind));
            of.map(|flight| flight.trajectory.duration()).sum()
        };
        use FlightKind::*;
        for (kinds, seconds) in [
            (&[SinusoidXy, SinusoidXz, SinusoidYz][..], 900.0),
            (&[YawRotation], 500.0),
            (&[Unstructured], 1000.0),
            (&[CombinedSinusoidYaw, CombinedFigureEight, CombinedUnstructured], 300.0),
        ] {
            assert!((length(kinds) - seconds).abs() < 0.1, "{kinds:?}: {} s", length(kinds));
        }
        let mut kinds: Vec<_> = flights.iter().map(|flight| flight.kind).collect();
        assert!(kinds.is_sorted());
        kinds.dedup();
        assert_eq!(kinds.len(), 8);
        let names: Vec<_> = flights.iter().map(|flight| flight.name.as_str()).collect();
        assert_eq!((names[0], names[16]), ("01-sinusoid-xy", "17-yaw-rotation"));
    }

    #[test]
    fn only_combined_flights_move_and_turn() {
        for flight in made(300.0, 60.0, 3) {
            let (mut moves, mut turns) = (false, false);
            let start = flight.trajectory.sample(0.0).position;
            for step in 0..(flight.trajectory.duration() * 10.0) as usize {
                let point = flight.trajectory.sample(step as f64 * 0.1);
                moves |= (point.position - start).norm() > 1e-9;
                turns |= point.yaw_rate != 0.0;
            }
            let combines = flight.kind >= FlightKind::CombinedSinusoidYaw;
            assert_eq!(moves && turns, combines, "{}", flight.name);
            assert!(moves || turns, "{}", flight.name);
        }
    }

    #[test]
    fn combined_flights_leave_the_others_unchanged() {
        let texts = |flights: Vec<ProgrammeFlight>| -> Vec<String> {
            flights.into_iter().map(|flight| flight.text).collect()
        };
        let (short, long) = (texts(made(300.0, 0.0, 5)), texts(made(300.0, 60.0, 5)));
        assert_eq!(short[..], long[..short.len()]);
        assert_ne!(short, texts(made(300.0, 0.0, 6)));
    }

    #[test]
    fn infeasible_programme_is_refused_by_quantity() {
        let error = |settings: ProgrammeSettings, seconds: f64| {
            programme(&settings, &FlightEnvelope::default(), &nano(), seconds, 0.0, 1)
                .expect_err("refused")
                .to_string()
        };
        let settings = ProgrammeSettings::default;
        assert!(error(settings(), 10.0).contains("at least 32 s"));
        assert!(error(settings(), f64::NAN).contains("at least 32 s"));
        assert!(
            error(ProgrammeSettings { height_max_m: 0.7, ..settings() }, 60.0).contains("height")
        );
        assert!(
            error(ProgrammeSettings { speed_max_m_s: 0.0, ..settings() }, 60.0).contains("speed")
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn every_vehicle_has_a_feasible_programme(
            thrust_to_weight in 1.6..5.0f64,
            tilt_bandwidth in 5.0..30.0f64,
            yaw_bandwidth in 2.0..12.0f64,
            tilt_max_deg in 8.0..40.0f64,
            half in 0.5..10.0f64,
            height_max_m in 1.2..8.0f64,
            seed in 0..1000u64,
        ) {
            let capability = Capability { gravity: 9.80665, thrust_to_weight, tilt_bandwidth, yaw_bandwidth };
            let settings = ProgrammeSettings {
                half_size_m: [half, 0.7 * half],
                height_max_m,
                tilt_max_deg,
                ..ProgrammeSettings::default()
            };
            let envelope = FlightEnvelope { tilt_max_deg, ..FlightEnvelope::default() };
            let flights = programme(&settings, &envelope, &capability, 180.0, 40.0, seed);
            for flight in flights.map_err(|error| TestCaseError::fail(error.to_string()))? {
                let demands = flight.demands;
                prop_assert!(demands.speed_m_s <= settings.speed_max_m_s + 1e-3);
                prop_assert!(demands.tilt_deg <= tilt_max_deg);
                prop_assert!(demands.height_m <= height_max_m + 2e-3);
                // Bold enough: it moves or turns quickly, or as hard as its tilt allows. A fast
                // wave is slow where a small tilt accelerates it.
                let is_bold = demands.speed_m_s > 0.2
                    || demands.yaw_rate_deg_s > 20.0
                    || demands.tilt_deg > 0.4 * tilt_max_deg;
                prop_assert!(is_bold, "{demands:?}");
                for step in 0..(flight.trajectory.duration() * 50.0) as usize {
                    let point = flight.trajectory.sample(step as f64 * 0.02);
                    let [north, east, down]: [f64; 3] = point.position.into();
                    prop_assert!(north.abs() <= half + 2e-3 && east.abs() <= 0.7 * half + 2e-3);
                    prop_assert!(-down >= settings.height_min_m - 2e-3);
                }
            }
        }
    }
}
