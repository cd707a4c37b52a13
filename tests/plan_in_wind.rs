//! Plans for a vehicle whose file has a wind: they start, and are approached, tilted against it.

use std::fs;

use serde_json::Value;

use crate::command::{self, downwash};
use crate::lockstep;

#[test]
fn plan_through_a_model_with_wind_is_flown_as_well_as_in_still_air() {
    let folder = command::folder("plan-in-wind");
    let nano = lockstep::config_file("vehicles", lockstep::NANO);
    let still = fs::read_to_string(&nano).expect("the shipped vehicle");
    let drag = "\n[modelled_effects.rotor_drag]\nd_xy = 0.012\nd_z = 0.006\n";
    let wind = "\n[modelled_effects.wind]\nnorth_m_s = 2.0\neast_m_s = -1.5\n";
    let flown = |name: &str, text: String| {
        let (vehicle, plan) =
            (folder.join(format!("{name}.toml")), folder.join(format!("{name}.json")));
        fs::write(&vehicle, text).expect("a vehicle file");
        let planned = downwash(&folder)
            .args(["plan", "sinusoid-yaw", "--vehicle"])
            .arg(&vehicle)
            .arg("-o")
            .arg(&plan)
            .output()
            .expect("it plans");
        assert!(planned.status.success(), "{}", String::from_utf8_lossy(&planned.stderr));
        let output = downwash(&folder)
            .args(["simulate", "--no-log", "--json", "--vehicle"])
            .arg(&vehicle)
            .arg(&plan)
            .output()
            .expect("it flies");
        let row: Value = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&output.stderr)));
        row["true_position_rmse_m"].as_f64().expect("an error")
    };
    let calm = flown("calm", [&still, drag].concat());
    let windy = flown("windy", [&still, drag, wind].concat());
    assert!(windy < 0.01 && windy < 1.5 * calm, "{windy} m, in still air {calm} m");
}
