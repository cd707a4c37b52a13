//! The audit of uninformative motion: about one axis, along one line, constant, exact or held. It
//! terminates, reports nothing unobservable, and finds no fault between consistent streams.

use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use downwash::audit::{Agreement, Audit, Estimate};
use downwash::log::import::Flight;
use proptest::prelude::*;
use vehicle::frame::{Attitude, Frd, Ned};

const RATE_HZ: f64 = 100.0;
const SECONDS: f64 = 12.0;
const GRAVITY: f64 = 9.806_65;
/// Checks of the agreement between two streams.
const PAIRS: [&str; 10] = [
    "axes",
    "frame",
    "unit",
    "scale",
    "delay",
    "clock_drift",
    "rotation",
    "bias",
    "quaternion",
    "motion",
];

/// An angle or a displacement as a function of time.
#[derive(Clone, Copy, Debug)]
enum Profile {
    Zero,
    Constant(f64),
    Ramp(f64),
    Sine { size: f64, hz: f64 },
}

impl Profile {
    /// Value, first and second derivative.
    fn at(self, time: f64) -> [f64; 3] {
        match self {
            Self::Zero => [0.0; 3],
            Self::Constant(value) => [value, 0.0, 0.0],
            Self::Ramp(rate) => [rate * time, rate, 0.0],
            Self::Sine { size, hz } => {
                let omega = std::f64::consts::TAU * hz;
                let (sine, cosine) = (omega * time).sin_cos();
                [size * sine, size * omega * cosine, -size * omega * omega * sine]
            }
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Motion {
    /// A unit vector, the same in world and body.
    axis: [f64; 3],
    angle: Profile,
    line: [f64; 3],
    way: Profile,
    /// Every sample twice, as written by a logger faster than its sensor.
    held: bool,
}

fn flight(motion: Motion) -> Flight {
    let mut flight = Flight::in_memory("degenerate", "csv");
    let times = |k: usize| k as f64 / RATE_HZ;
    for k in 0..(SECONDS * RATE_HZ) as usize {
        let time = times(if motion.held { k / 2 * 2 } else { k });
        let ([angle, rate, _], [way, speed, acceleration]) =
            (motion.angle.at(time), motion.way.at(time));
        let along = |size: f64| Ned::from(motion.line.map(|part| size * part));
        let (sine, w) = (0.5 * angle).sin_cos();
        let [x, y, z] = motion.axis.map(|part| sine * part);
        let attitude = Attitude { w, x, y, z };
        let force = along(acceleration) - Ned::new(0.0, 0.0, GRAVITY);
        let stamp = times(k);
        flight.attitude.push(stamp, attitude);
        flight.body_rate.push(stamp, Frd::from(motion.axis.map(|part| rate * part)));
        flight.position.push(stamp, along(way));
        flight.velocity.push(stamp, along(speed));
        flight.specific_force.push(stamp, attitude.to_body(force));
        flight.outputs.push(stamp, [0.5 + 0.01 * speed; 4]);
    }
    flight
}

/// The audit, which must end within the time that a user waits for a table of twelve seconds.
fn audited(flight: Flight) -> Audit {
    let (done, result) = mpsc::channel();
    thread::spawn(move || {
        // If nobody waits any more, the test has already failed.
        done.send(Audit::of(&flight)).ok();
    });
    result.recv_timeout(Duration::from_secs(30)).expect("the audit ends")
}

fn estimates(agreement: &Agreement) -> impl Iterator<Item = Estimate> {
    let shown = agreement.rotation_rad.into_iter().chain(agreement.bias).flatten();
    let scales = agreement.scale.into_iter().flatten();
    shown.chain(scales).chain([agreement.delay_s]).chain(agreement.drift)
}

fn assert_sound(audit: &Audit) {
    let pairs = &audit.kinematics;
    for agreement in [pairs.attitude, pairs.position, pairs.velocity].iter().flatten() {
        assert!(
            agreement.explained.is_finite() && agreement.common_scale.value.is_finite(),
            "{agreement:?}"
        );
        for estimate in estimates(agreement) {
            assert!(estimate.value.is_finite() && estimate.half_width.is_finite(), "{agreement:?}");
        }
    }
    let wrong: Vec<_> = audit.findings.iter().filter(|f| PAIRS.contains(&f.check)).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

const AXES: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn direction() -> impl Strategy<Value = [f64; 3]> {
    let any = (-1.0..1.0, -1.0..1.0, -1.0..1.0).prop_filter_map("no direction", |(x, y, z)| {
        let size = f64::sqrt(x * x + y * y + z * z);
        (size > 0.1).then(|| [x / size, y / size, z / size])
    });
    prop_oneof![prop::sample::select(&AXES[..]), any]
}

fn profile(most: f64) -> impl Strategy<Value = Profile> {
    prop_oneof![
        Just(Profile::Zero),
        (-most..most).prop_map(Profile::Constant),
        (-most..most).prop_map(Profile::Ramp),
        (0.05 * most..most, 0.2..1.2).prop_map(|(size, hz)| Profile::Sine { size, hz }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn unobservable_quantities_are_not_reported(
        axis in direction(),
        angle in profile(0.6),
        line in direction(),
        way in profile(2.0),
        held in any::<bool>(),
    ) {
        assert_sound(&audited(flight(Motion { axis, angle, line, way, held })));
    }
}

#[test]
fn rotation_about_the_only_axis_is_unobservable() {
    let sine = Profile::Sine { size: 0.4, hz: 0.5 };
    for (at, axis) in AXES.into_iter().enumerate() {
        let motion = Motion { axis, angle: sine, line: axis, way: sine, held: false };
        let audit = audited(flight(motion));
        assert_sound(&audit);
        for (pair, agreement) in
            [("attitude", audit.kinematics.attitude), ("position", audit.kinematics.position)]
        {
            let rotation = agreement.unwrap_or_else(|| panic!("{pair} moves")).rotation_rad;
            for (about, found) in rotation.into_iter().enumerate() {
                assert_eq!(found.is_none(), about == at, "{pair} about {about}: {rotation:?}");
            }
        }
    }
}

/// The audit finds a reversed stream even where only one axis moves.
#[test]
fn reversed_stream_is_a_fault() {
    let sine = Profile::Sine { size: 0.4, hz: 0.5 };
    for axis in AXES {
        let motion = Motion { axis, angle: sine, line: axis, way: sine, held: false };
        let mut flight = flight(motion);
        flight.velocity = flight.velocity.map(|v| Ned::from(v.to_array().map(|part| -part)));
        let audit = audited(flight);
        assert!(audit.is_faulty(), "{axis:?}: {:#?}", audit.kinematics.position);
    }
}

/// At constant attitude the body axes are a fixed rotation of the world axes: both fit to rounding,
/// and which fits better by rounding means nothing.
#[test]
fn line_at_constant_attitude_does_not_reveal_the_frame() {
    let line = [-0.3584472636188655, 0.897538830006485, 0.2567870865809597];
    let way = Profile::Sine { size: 0.3128056520084014, hz: 1.0942688341121647 };
    let angle = Profile::Constant(0.4398997665688817);
    let motion = Motion { axis: AXES[0], angle, line, way, held: false };
    assert_sound(&audited(flight(motion)));
}
