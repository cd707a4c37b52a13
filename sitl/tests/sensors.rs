//! What the vehicle reports about its state.

use std::path::Path;

use sitl::config::{SensorConfig, SitlConfig, Vibration};
use sitl::sensors::{Readings, Sensors};
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use vehicle::frame::{Attitude, Euler, Frd, Ned};
use vehicle::plant::{Plant, Setup};
use vehicle::rigid_body::State;

/// The shipped 1.2 kg quadrotor without drag and without lag.
fn quad() -> VehicleParams {
    let mut vehicle = VehicleParams::load("quad1200").unwrap();
    vehicle.modelled_effects = EffectSet::new();
    vehicle.motor_time_constant_s = 0.0;
    vehicle
}

fn effects(arguments: &[&str]) -> EffectSet {
    let mut set = EffectSet::new();
    for argument in arguments {
        set.insert_argument(argument).unwrap();
    }
    set
}

/// A plant high above the floor with a battery that does not sag.
fn airborne(vehicle: &VehicleParams, effects: &EffectSet) -> Plant {
    let mut setup = Setup::default();
    setup.battery.resistance_ohm = Some(0.0);
    setup.start.position_m = [0.0, 0.0, -100.0];
    Plant::new(vehicle, effects, &setup, 7).unwrap()
}

fn ideal() -> SitlConfig {
    SitlConfig { sensors: SensorConfig::IDEAL, ..SitlConfig::default() }
}

/// Free flight with rotation, sampled every fourth step.
fn fly(config: &SitlConfig, set: &EffectSet, seed: u64, steps: usize) -> Vec<(Readings, State)> {
    let mut plant = airborne(&quad(), set);
    plant.set_state(State {
        velocity: Ned::new(1.0, 2.0, -0.5),
        body_rate: Frd::new(0.2, 0.1, 0.5),
        ..*plant.state()
    });
    let mut sensors = Sensors::new(config, set, seed);
    let mut samples = Vec::new();
    for step in 0..steps {
        plant.step([0.5; 4]);
        sensors.record(&plant);
        if step % 4 == 3 {
            samples.push((sensors.sample(&plant), *plant.state()));
        }
    }
    samples
}

fn deviation(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<_> = values.collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let sum: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (sum / values.len() as f64).sqrt()
}

#[test]
fn ideal_sensors_report_the_true_state() {
    for (readings, truth) in fly(&ideal(), &EffectSet::new(), 1, 200) {
        assert_eq!(readings.estimate.position, truth.position);
        assert_eq!(readings.gyro, truth.body_rate);
        assert!(readings.onboard_attitude.angle_to(truth.attitude) < 1e-9);
        assert!((readings.specific_force.down() + 24.0 * 0.5 / 1.2).abs() < 1e-9);
    }
}

#[test]
fn same_seed_gives_the_same_readings() {
    let config = SitlConfig::default();
    assert_eq!(fly(&config, &EffectSet::new(), 5, 400), fly(&config, &EffectSet::new(), 5, 400));
    let (a, b) = (fly(&config, &EffectSet::new(), 5, 4), fly(&config, &EffectSet::new(), 6, 4));
    assert_ne!(a, b);
}

#[test]
fn noise_has_the_configured_size() {
    let config = SitlConfig::default();
    let samples = fly(&config, &EffectSet::new(), 2, 20_000);
    let position =
        deviation(samples.iter().map(|(r, s)| (r.estimate.position - s.position).east()));
    assert!((position / 0.001 - 1.0).abs() < 0.05, "{position}");
    let velocity =
        deviation(samples.iter().map(|(r, s)| (r.estimate.velocity - s.velocity).down()));
    assert!((velocity / 0.01 - 1.0).abs() < 0.05, "{velocity}");
    let gyro = deviation(samples.iter().map(|(r, s)| (r.gyro - s.body_rate).front()));
    assert!((gyro / 0.01 - 1.0).abs() < 0.1, "{gyro}");
    let roll =
        |(r, s): &(Readings, State)| 2.0 * s.attitude.inverse().compose(r.onboard_attitude).x;
    let attitude = deviation(samples.iter().map(roll));
    assert!((attitude / 0.001 - 1.0).abs() < 0.2, "{attitude}");
    // Correlated over 50 ms: neighbours 4 ms apart hardly differ.
    let change = deviation(samples.windows(2).map(|w| roll(&w[1]) - roll(&w[0])));
    let expected = 0.001 * (2.0_f64 * (1.0 - (-0.08_f64).exp())).sqrt();
    assert!((change / expected - 1.0).abs() < 0.1, "{change} not {expected}");
}

#[test]
fn disabling_one_noise_leaves_other_sensors_unchanged() {
    let noisy = fly(&SitlConfig::default(), &EffectSet::new(), 3, 40);
    let mut config = SitlConfig::default();
    config.sensors.gyro = SensorConfig::IDEAL.gyro;
    let quiet = fly(&config, &EffectSet::new(), 3, 40);
    for ((a, _), (b, _)) in noisy.iter().zip(&quiet) {
        assert_eq!(a.specific_force, b.specific_force);
        assert_eq!(a.estimate.position, b.estimate.position);
    }
}

#[test]
fn trim_rotates_the_reported_attitude_but_not_the_imu() {
    let set = effects(&["attitude_trim:roll_rad=0.02,pitch_rad=-0.03,yaw_rad=0.01"]);
    let trim = Euler::new(0.02, -0.03, 0.01).attitude();
    for (readings, truth) in fly(&ideal(), &set, 1, 100) {
        let expected = truth.attitude.compose(trim);
        assert!(readings.estimate.attitude.angle_to(expected) < 1e-9);
        assert!(readings.onboard_attitude.angle_to(expected) < 1e-9);
        assert_eq!(readings.gyro, truth.body_rate);
        assert!(readings.specific_force.front().abs() < 1e-9);
    }
}

#[test]
fn latency_delays_pose_and_velocity_only() {
    let set = effects(&["estimator_latency:latency_s=0.0225"]);
    let mut plant = airborne(&quad(), &set);
    let start = State { velocity: Ned::new(1.0, 0.0, 0.0), ..*plant.state() };
    plant.set_state(State { body_rate: Frd::new(0.0, 0.0, 0.8), ..start });
    let mut sensors = Sensors::new(&ideal(), &set, 1);
    for _ in 0..100 {
        plant.step([quad().hover_thrust; 4]);
        sensors.record(&plant);
    }
    let readings = sensors.sample(&plant);
    let expected = 0.1 - 0.0225;
    assert!((readings.estimate.position.north() - expected).abs() < 1e-9);
    assert!((readings.estimate.attitude.euler().yaw - 0.8 * expected).abs() < 1e-7);
    assert!((readings.onboard_attitude.euler().yaw - 0.08).abs() < 1e-9);
    assert_eq!(readings.estimate.body_rate, plant.state().body_rate);
}

#[test]
fn latency_longer_than_the_flight_reports_the_start() {
    let set = effects(&["estimator_latency:latency_s=0.5"]);
    let mut plant = airborne(&quad(), &set);
    let mut sensors = Sensors::new(&ideal(), &set, 1);
    assert_eq!(sensors.sample(&plant).estimate.attitude, Attitude::default());
    for _ in 0..10 {
        plant.step([0.0; 4]);
        sensors.record(&plant);
    }
    assert!(sensors.sample(&plant).estimate.position.down() < -99.9);
}

#[test]
fn vibration_follows_the_rotor_speed() {
    let vehicle = quad();
    let vibration = Vibration { rotor_max_hz: 100.0, gyro_rad_s: 0.1, accelerometer_m_s2: 2.0 };
    let config = SitlConfig { sensors: SensorConfig::IDEAL, vibration, ..SitlConfig::default() };
    let mut plant = airborne(&vehicle, &effects(&[]));
    let outputs = [vehicle.hover_share(); 4];
    plant.set_rotor_states(outputs);
    let mut sensors = Sensors::new(&config, &EffectSet::new(), 1);
    let (mut squares, mut crossings, mut last) = (0.0, 0, 0.0);
    let steps = 2_000;
    for _ in 0..steps {
        plant.step(outputs);
        let shaken = sensors.sample(&plant).gyro.front() - plant.state().body_rate.front();
        crossings += usize::from((shaken > 0.0) != (last > 0.0));
        last = shaken;
        squares += shaken * shaken / f64::from(steps);
    }
    // The pack is nearly full, so rotor speed is the square root of the output.
    let wanted = 2.0 * 100.0 * vehicle.hover_share().sqrt() * 2.0;
    assert!((crossings as f64 / wanted - 1.0).abs() < 0.05, "{crossings} {wanted}");
    // Four spectral lines with fixed phases add up to between zero and four times the amplitude.
    assert!(squares.sqrt() < 0.4 && squares > 0.0, "{squares}");
}

#[test]
fn example_configuration_equals_the_default() {
    let config =
        SitlConfig::load(Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/sitl.toml"))
            .unwrap();
    assert_eq!(config, SitlConfig::default());
}
