//! Diagnosis of flights whose streams are on different clocks, or were logged faster than their source.

use std::path::{Path, PathBuf};

use downwash::audit::{Audit, Shift, align};
use downwash::log::import::{Flight, Stream, open, write};
use serde_json::Value;
use sitl::config::SitlConfig;

use crate::audit::{FLIGHT, LIVELY};
use crate::audit_practice::cases;
use crate::command;
use crate::damage;
use crate::lockstep::{self, NANO};

/// The flight with its streams on other clocks: the attitude, the velocity and the position are
/// later by these times, s.
fn on_other_clocks(flight: &Flight, [attitude, velocity, position]: [f64; 3]) -> Flight {
    let mut flight = flight.clone();
    flight.attitude = flight.attitude.shifted(attitude);
    flight.velocity = flight.velocity.shifted(velocity);
    flight.position = flight.position.shifted(position);
    flight
}

/// The shifts of flights whose streams are later by the given times, s, for a vehicle whose pose is
/// late by `stated`, s: of attitude, velocity and position, 0 for none.
fn shifts<const N: usize>(late: [[f64; 3]; N], stated: f64) -> [[f64; 3]; N] {
    let mut flights = late.map(|late| on_other_clocks(&FLIGHT, late));
    let mut audits = Audit::of_all(&flights);
    // The same motion twice is a fault for a diagnosis, but not for the clocks.
    audits.iter_mut().for_each(|audit| audit.findings.clear());
    let all = align(&mut flights, &mut audits, stated);
    let of = |shifts: &Vec<Shift>, stream: &str| {
        shifts.iter().find(|shift| shift.stream == stream).map_or(0.0, |shift| shift.late_s)
    };
    let found: Vec<[f64; 3]> = all
        .iter()
        .map(|shifts| ["attitude", "velocity", "position"].map(|stream| of(shifts, stream)))
        .collect();
    for (flight, (late, shifted)) in flights.iter().zip(late.iter().zip(&found)) {
        let first = FLIGHT.attitude.times()[0] + late[0] - shifted[0];
        assert!((flight.attitude.times()[0] - first).abs() < 1e-6, "{late:?}");
    }
    found.try_into().expect("one each")
}

#[test]
fn streams_on_other_clocks_are_shifted() {
    let expected = [
        // On one clock, or late as a whole, which is the vehicle's latency.
        ([[0.0; 3]; 2], 0.0, [[0.0; 3]; 2]),
        ([[0.08; 3]; 2], 0.0, [[0.0; 3]; 2]),
        // The attitude alone, and velocity and position alone.
        ([[0.06, 0.0, 0.0]; 2], 0.0, [[0.06, 0.0, 0.0]; 2]),
        ([[0.0, 0.05, 0.05]; 2], 0.0, [[0.0, 0.05, 0.05]; 2]),
        // A vehicle file that states the attitude's latency.
        ([[0.06, 0.0, 0.0]; 2], 0.06, [[0.0, -0.06, -0.06]; 2]),
        // Each flight on its own clock.
        ([[0.0; 3], [0.06; 3]], 0.0, [[-0.03; 3], [0.03; 3]]),
    ];
    for (late, stated, expected) in expected {
        let found = shifts(late, stated);
        for (found, expected) in found.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 2e-3, "{late:?}: {found}, expected {expected}");
        }
    }
}

/// The values at a tenth of a second, repeated in between.
fn held<T: Clone>(stream: &Stream<T>) -> Stream<T> {
    let mut last: Option<(f64, T)> = None;
    let values = stream.iter().map(|(time, value)| {
        let tenth = (10.0 * time).floor();
        match &last {
            Some((of, held)) if *of == tenth => held.clone(),
            _ => {
                last = Some((tenth, value.clone()));
                value.clone()
            }
        }
    });
    stream.with_values(values.collect())
}

/// Changes a flight as a logger on another clock, or a slower source, would.
type Fault = fn(&mut Flight);

fn intact(_: &mut Flight) {}

fn attitude_late(flight: &mut Flight) {
    flight.attitude = flight.attitude.clone().shifted(0.06);
}

fn velocity_late(flight: &mut Flight) {
    flight.velocity = flight.velocity.clone().shifted(0.06);
    flight.position = flight.position.clone().shifted(0.06);
}

fn attitude_held(flight: &mut Flight) {
    flight.attitude = held(&flight.attitude);
}

fn pose_held(flight: &mut Flight) {
    attitude_held(flight);
    flight.velocity = held(&flight.velocity);
    flight.position = held(&flight.position);
}

/// The answer to flights with a fault.
fn diagnosis(vehicle: &Path, flights: &[Flight], name: &str, fault: Fault) -> Value {
    let folder = command::folder(&format!("diagnose-clocks/{name}"));
    let written = flights.iter().enumerate().map(|(index, flight)| {
        let path = folder.join(format!("{index}.mcap"));
        let mut flight = flight.clone();
        fault(&mut flight);
        write(&flight, &path).expect("a log");
        path
    });
    let logs: Vec<PathBuf> = written.collect();
    command::diagnosis(&folder, vehicle, &logs)
}

/// The ids of the named effects.
fn named(answer: &Value) -> Vec<&str> {
    let effects = answer["effects"].as_array().into_iter().flatten();
    let named = effects.filter(|effect| effect["probability"].as_f64() >= Some(0.5));
    named.filter_map(|effect| effect["id"].as_str()).collect()
}

/// Two flights of the nano quadrotor with a drag.
fn flights() -> Vec<Flight> {
    let drag = ["rotor_drag:d_xy=0.02,d_z=0.01"];
    let params = lockstep::params(NANO);
    let folder = command::folder("diagnose-clocks/flights");
    let fly = |seed: u64| {
        let settings = lockstep::settings(&params, lockstep::toml_trajectory(LIVELY));
        let (_, records) = lockstep::fly(settings, &params, &drag, SitlConfig::default(), seed);
        let path = folder.join(format!("{seed}.tlog"));
        damage::write_tlog(&path, &damage::entries(&records));
        open(&path, None).expect("a flight")
    };
    [1, 2].map(fly).to_vec()
}

#[test]
fn late_attitude_does_not_hide_a_drag() {
    let vehicle = lockstep::config_file("vehicles", NANO);
    let answer = diagnosis(&vehicle, &flights(), "dragging", attitude_late);
    assert_eq!(named(&answer), ["rotor_drag"], "{}", answer["finding"]);
    let drag = answer["effects"][0]["parameters"]["d_xy"].as_f64().expect("a number");
    assert!((drag - 0.02).abs() < 0.002, "{drag}");
    for log in answer["logs"].as_array().expect("logs") {
        let shift = &log["shifts"][0];
        assert_eq!(shift["stream"], "attitude", "{log}");
        assert!((shift["late_s"].as_f64().expect("a number") - 0.06).abs() < 2e-3, "{log}");
    }
}

#[test]
#[ignore = "minutes; prints answers on the practice flights, if they are there: tests/run --all"]
fn clocks_change_no_answer_on_flights_of_others() {
    let faults: [(&str, Fault); 4] = [
        ("attitude 60 ms late", attitude_late),
        ("position and velocity 60 ms late", velocity_late),
        ("attitude held for 100 ms", attitude_held),
        ("pose held for 100 ms", pose_held),
    ];
    let mut same = [0; 4];
    let mut count = 0;
    for case in cases() {
        let has_unit = |flight: &Flight| {
            !(flight.attitude.is_empty()
                || flight.velocity.is_empty()
                || flight.specific_force.is_empty())
        };
        if !case.flights.iter().all(has_unit) {
            continue;
        }
        count += 1;
        let answer = |name: &str, fault| {
            let name = format!("{} {name}", case.name);
            let answer = diagnosis(&case.vehicle_file, &case.flights, &name, fault);
            println!("{name}: {} {:?}", answer["verdict"], named(&answer));
            (
                answer["verdict"].clone(),
                named(&answer).iter().map(ToString::to_string).collect::<Vec<_>>(),
            )
        };
        let expected = answer("intact", intact);
        for ((name, fault), same) in faults.iter().zip(&mut same) {
            *same += usize::from(answer(name, *fault) == expected);
        }
    }
    for ((name, _), same) in faults.iter().zip(same) {
        println!("{name}: {same} of {count} answers as with intact logs");
    }
    assert_eq!(same[0], count, "a late attitude changes an answer");
}
