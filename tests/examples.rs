//! The examples do what they claim.

use std::fs;
use std::path::Path;

use crate::{lockstep, log_flight};
use downwash::control::Law;
use downwash::plan::scp::Status;
use downwash::station::End;
use sitl::config::SitlConfig;

#[path = "../examples/fly_lockstep.rs"]
#[allow(dead_code, reason = "`main` is for `cargo run --example`")]
mod fly_lockstep;
#[path = "../examples/own_control_law.rs"]
#[allow(dead_code, reason = "`main` is for `cargo run --example`")]
mod own_control_law;
#[path = "../examples/plan_trajectory.rs"]
#[allow(dead_code, reason = "`main` is for `cargo run --example`")]
mod plan_trajectory;
#[path = "../examples/read_log.rs"]
#[allow(dead_code, reason = "`main` is for `cargo run --example`")]
mod read_log;

#[test]
fn read_log_example_describes_a_flight() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("examples");
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a folder");
    let params = lockstep::params(lockstep::NANO);
    let settings = lockstep::settings(&params, lockstep::hover(2.0));
    let (_, records) = lockstep::fly(settings, &params, &[], SitlConfig::default(), 1);
    let log = log_flight::write(&folder, &records);
    let text = read_log::describe(&log).expect("a flight");
    assert!(text.contains("position: ") && text.contains("above the origin"), "{text}");
    assert!(read_log::describe(&folder.join("missing.ulg")).is_err());
}

#[test]
fn weak_rotors_degrade_pure_feedback() {
    let (end, sound_m) = fly_lockstep::fly("thrust_scale:scale=1", Law::default()).expect("flown");
    let (_, weak_m) = fly_lockstep::fly("thrust_scale:scale=0.9", Law::default()).expect("flown");
    assert_eq!(end, End::Done);
    assert!(weak_m > sound_m, "{weak_m} {sound_m}");
}

#[test]
fn custom_law_flies_about_as_well_as_the_lqr() {
    let [(lqr, lqr_m), (own, own_m)] = own_control_law::compare().expect("flown");
    assert_eq!((lqr, own), (End::Done, End::Done));
    assert!(own_m < 1.5 * lqr_m, "{own_m} {lqr_m}");
}

#[test]
fn planned_trajectory_avoids_the_sphere() {
    let outcome = plan_trajectory::plan().expect("a plan");
    assert_ne!(outcome.status, Status::Failed);
    let nearest = |state: &[f64; 12]| {
        ((state[0] - 1.0).powi(2) + (state[1] - 0.1).powi(2) + (state[2] + 1.0).powi(2)).sqrt()
    };
    let nearest = outcome.iterate.states.iter().map(nearest).fold(f64::INFINITY, f64::min);
    assert!(nearest > 0.249, "{nearest} m from the centre");
}
