//! Diagnosis of flights whose logs hold setpoints, but nothing of the motors: the outputs are
//! computed from the setpoints, so their agreement with the setpoints is no evidence.

use std::path::PathBuf;

use downwash::diagnose::flights::preparation::PreparedFlight;
use downwash::diagnose::likelihood::channels::{COMMAND, RATE};
use downwash::diagnose::likelihood::layout::Layout;
use downwash::learn::commands::Onboard;
use downwash::log::import;
use serde_json::Value;
use sitl::config::SitlConfig;

use crate::command;
use crate::damage;
use crate::lockstep::{self, QUAD};

/// SERVO_OUTPUT_RAW, ESC_INFO, ESC_STATUS, ACTUATOR_OUTPUT_STATUS.
const MOTORS: [u32; 4] = [36, 290, 291, 375];

const TRAJECTORY: &str = "family = \"figure-8\"\naltitude_m = 1.5\nduration_s = 40\nlength_m = 4.0\n\
                          width_m = 2.0\nperiod_s = 5\nclimb_m = 0.4\n";

/// Two flights' telemetry without the messages about the motors.
fn logs(name: &str, effects: &[&str]) -> Vec<PathBuf> {
    let params = lockstep::params(QUAD);
    let folder = command::folder(&format!("diagnose-setpoints/{name}"));
    let fly = |seed: u64| {
        let settings = lockstep::settings(&params, lockstep::toml_trajectory(TRAJECTORY));
        let (_, records) = lockstep::fly(settings, &params, effects, SitlConfig::default(), seed);
        let mut entries = damage::entries(&records);
        let id = |bytes: &[u8]| u32::from_le_bytes([bytes[7], bytes[8], bytes[9], 0]);
        let all = entries.len();
        entries.retain(|(_, bytes)| !MOTORS.contains(&id(bytes)));
        assert!(entries.len() < all, "the flight reports its motors");
        let path = folder.join(format!("{seed}.tlog"));
        damage::write_tlog(&path, &entries);
        path
    };
    [1, 2].map(fly).to_vec()
}

fn diagnosis(name: &str, effects: &[&str]) -> Value {
    let logs = logs(name, effects);
    let folder = command::folder(&format!("diagnose-setpoints/{name}-diagnosis"));
    command::diagnosis(&folder, &lockstep::config_file("vehicles", QUAD), &logs)
}

#[test]
fn sound_vehicle_without_motor_reports_has_no_effect() {
    let answer = diagnosis("none", &[]);
    assert_eq!(answer["verdict"], "none", "{}", answer["finding"]);
}

#[test]
fn shifted_centre_of_mass_is_named_without_motor_reports() {
    let answer = diagnosis("com", &["com_offset:x_m=0.006,y_m=-0.004"]);
    assert_eq!(answer["verdict"], "effect", "{}", answer["finding"]);
    assert_eq!(answer["effects"][0]["id"], "com_offset", "{}", answer["finding"]);
}

#[test]
fn computed_outputs_are_not_compared_with_their_setpoints() {
    let vehicle = lockstep::params(QUAD);
    let mut flight = import::open(&logs("loop", &[])[0], None).expect("a flight");
    let onboard = Onboard::new(&vehicle).expect("rotors that mix");
    assert!(onboard.complete_outputs(&mut flight, vehicle.command_delay_s));
    let flight = PreparedFlight::new(flight, &vehicle).expect("outputs");
    assert!(flight.channels.setpoint);
    let layout = Layout::new(&flight);
    assert!(layout.has(RATE), "the computed outputs drive the equations");
    assert!(!layout.has(COMMAND));
}
