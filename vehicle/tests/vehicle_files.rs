//! The shipped vehicle files, and those of the practice flights if available.

use crate::common::{practice_folders, root};
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use vehicle::physics::Physics;

#[test]
fn shipped_vehicles_hover_at_their_stated_thrust() {
    for name in ["crazyflie", "quad1200"] {
        let path = root().join(format!("config/vehicles/{name}.toml"));
        let vehicle = VehicleParams::load(path).unwrap();
        assert_eq!(vehicle.name, name);
        let collective = vehicle.allocation().unwrap().collective_max();
        let hover = vehicle.mass * vehicle.gravity / collective;
        assert!((vehicle.hover_thrust - hover).abs() < 1e-7, "{name}: {hover}");
        let pd = vehicle.attitude_pd.unwrap();
        assert_eq!(pd.rate_hz, 250.0);
        for axis in 0..3 {
            let inertia = vehicle.inertia[axis];
            let frequency = (pd.kp[axis] / inertia).sqrt();
            let damping = pd.kd[axis] / (2.0 * inertia * frequency);
            assert!((0.7..=1.0).contains(&damping), "{name}, axis {axis}: damping {damping}");
        }
    }
}

#[test]
fn vehicle_files_of_practice_flights_load() {
    let cases = practice_folders().into_iter().filter_map(|folder| folder.read_dir().ok());
    let files: Vec<_> = cases
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path().join("vehicle.json")))
        .filter(|file| file.exists())
        .collect();
    if files.is_empty() {
        eprintln!("skipped: no practice flights; set DOWNWASH_PRACTICE to their folder");
    }
    for file in &files {
        let vehicle = VehicleParams::load(file).unwrap_or_else(|error| panic!("{error}"));
        Physics::new(&vehicle, &EffectSet::new()).unwrap();
        assert_eq!(VehicleParams::from_toml_str(&vehicle.to_toml().unwrap()).unwrap(), vehicle);
    }
    println!("{} vehicle files", files.len());
}
