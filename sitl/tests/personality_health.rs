//! What the vehicle reports when its estimate, battery or landing detection fails.

use crate::bench;
use crate::bench::{Bench, Received};
use sitl::autopilot::Mode;
use sitl::config::{Autopilot, EstimatorConfig, GpsGlitch, SensorConfig, SitlConfig};
use wire::dialect::*;

const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;

fn hovering(autopilot: Autopilot, change: impl FnOnce(&mut SitlConfig)) -> Bench {
    let mut config =
        SitlConfig { autopilot, sensors: SensorConfig::IDEAL, ..SitlConfig::default() };
    config.start.position_m = [0.0, 0.0, -5.0];
    change(&mut config);
    Bench::with(config, 1)
}

fn glitch(for_s: f64) -> EstimatorConfig {
    let offset_m = [5.5, 0.0, 0.0];
    EstimatorConfig {
        gps_glitch: Some(GpsGlitch { at_s: 2.0, for_s, offset_m }),
        ..EstimatorConfig::default()
    }
}

/// Reset counters of ODOMETRY and the largest jump between two positions, m.
fn resets(received: &[Received]) -> (Vec<u8>, f64) {
    let odometry = received.iter().filter_map(|received| match &received.message {
        MavMessage::ODOMETRY(odometry) => Some((odometry.reset_counter, odometry.x)),
        _ => None,
    });
    let odometry: Vec<_> = odometry.collect();
    let jump = odometry.windows(2).map(|pair| (pair[1].1 - pair[0].1).abs()).fold(0.0, f32::max);
    let mut counters: Vec<u8> = odometry.into_iter().map(|(counter, _)| counter).collect();
    counters.dedup();
    (counters, jump.into())
}

#[test]
fn short_gps_glitch_is_rejected_and_long_one_resets_the_estimate() {
    for (for_s, counters, least, most) in [(8.0, vec![0], 0.0, 0.5), (10.0, vec![0, 1], 5.0, 6.0)] {
        let mut bench = hovering(Autopilot::Px4, |config| config.estimator = glitch(for_s));
        bench.run(13.0);
        let (found, jump) = resets(&bench.received());
        assert_eq!(found, counters, "{for_s} s");
        assert!((least..=most).contains(&jump), "{for_s} s: {jump} m");
    }
}

#[test]
fn gps_glitch_is_reported_in_text_and_health_flags() {
    let cases = [
        (Autopilot::Px4, "GNSS data fusion stopped"),
        (Autopilot::Arducopter, "GPS Glitch or Compass error"),
    ];
    for (autopilot, words) in cases {
        let mut bench = hovering(autopilot, |config| config.estimator = glitch(5.0));
        let healthy = |bench: &mut Bench| {
            bench.received();
            bench.send(&bench::command_long(MavCmd::MAV_CMD_REQUEST_MESSAGE, &[1.0]));
            let gps = MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_GPS;
            bench.received().into_iter().find_map(|received| match received.message {
                MavMessage::SYS_STATUS(status) => {
                    Some(status.onboard_control_sensors_health.contains(gps))
                }
                _ => None,
            })
        };
        bench.run(1.0);
        assert_eq!(healthy(&mut bench), Some(true));
        bench.run(2.0);
        let texts = bench.texts();
        assert!(texts.contains(words), "{autopilot:?}: {texts}");
        assert_eq!(healthy(&mut bench), Some(false));
        bench.run(5.0);
        assert_eq!(healthy(&mut bench), Some(true));
    }
}

#[test]
fn position_estimate_wanders_by_the_configured_amount() {
    let mut bench = hovering(Autopilot::Px4, |config| {
        config.estimator.wander_m = 0.17;
        config.estimator.wander_time_s = 1.0;
    });
    let mut squares = 0.0;
    let mut count = 0;
    for _ in 0..600 {
        bench.received();
        bench.run(0.5);
        let truth = bench.vehicle.plant().state().position;
        let reported =
            bench.received().into_iter().rev().find_map(|received| match received.message {
                MavMessage::LOCAL_POSITION_NED(at) => Some([at.x, at.y, at.z]),
                _ => None,
            });
        let reported = reported.expect("a position").map(f64::from);
        // The vehicle hovers during the 33 ms between two messages.
        squares += reported.iter().zip(truth.to_array()).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        count += 3;
    }
    let deviation = (squares / f64::from(count)).sqrt();
    assert!((0.13..0.21).contains(&deviation), "{deviation} m");
}

#[test]
fn velocity_wander_leaves_the_position_alone() {
    let mut bench = hovering(Autopilot::Px4, |config| {
        config.estimator.velocity_wander_m_s = 0.16;
        config.estimator.velocity_wander_time_s = 1.0;
    });
    let (mut squares, mut most, mut count) = (0.0, 0.0_f64, 0);
    for _ in 0..600 {
        bench.received();
        bench.run(0.5);
        let truth = *bench.vehicle.plant().state();
        let reported =
            bench.received().into_iter().rev().find_map(|received| match received.message {
                MavMessage::LOCAL_POSITION_NED(at) => Some([at.x, at.y, at.z, at.vx, at.vy, at.vz]),
                _ => None,
            });
        let [x, y, z, velocity @ ..] = reported.expect("a position").map(f64::from);
        let off = velocity.into_iter().zip(truth.velocity.to_array()).map(|(a, b)| (a - b).powi(2));
        squares += off.sum::<f64>();
        count += 3;
        for (reported, true_) in [x, y, z].into_iter().zip(truth.position.to_array()) {
            most = most.max((reported - true_).abs());
        }
    }
    let deviation = (squares / f64::from(count)).sqrt();
    assert!((0.12..0.20).contains(&deviation), "{deviation} m/s");
    // The position is unaffected: only its noise and the motion within 33 ms remain.
    assert!(most < 0.06, "{most} m");
}

#[test]
fn position_is_unknown_until_the_estimator_is_ready() {
    let mut config = SitlConfig { autopilot: Autopilot::Arducopter, ..SitlConfig::default() };
    config.estimator.ready_after_s = 5.0;
    let mut bench = Bench::with(config, 1);
    bench.set_mode_number(4);
    bench.request(32, 100.0);
    assert_eq!(bench.rate_of(32), 0.0, "silent");
    let (result, texts) = bench.command_and_texts(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, &[1.0]);
    assert_eq!(result, MavResult::MAV_RESULT_TEMPORARILY_REJECTED);
    assert!(texts.contains("Arm: no valid estimate"), "{texts}");
    bench.run(4.0);
    assert!(bench.rate_of(32) > 99.0);
    assert_eq!(bench.arm(), ACCEPTED);
}

#[test]
fn force_code_skips_arming_checks_on_arducopter_only() {
    let cases = [
        (Autopilot::Px4, MavResult::MAV_RESULT_TEMPORARILY_REJECTED),
        (Autopilot::Arducopter, ACCEPTED),
    ];
    for (autopilot, expected) in cases {
        let mut config = SitlConfig { autopilot, ..SitlConfig::default() };
        config.estimator.ready_after_s = 5.0;
        let mut bench = Bench::with(config, 1);
        let forced = [1.0, 21196.0];
        let result = bench.command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, &forced);
        assert_eq!(result, expected, "{autopilot:?}");
    }
}

/// The charge state in BATTERY_STATUS.
fn charge_state(bench: &mut Bench) -> Option<MavBatteryChargeState> {
    bench.received();
    bench.send(&bench::command_long(MavCmd::MAV_CMD_REQUEST_MESSAGE, &[147.0]));
    bench.received().into_iter().find_map(|received| match received.message {
        MavMessage::BATTERY_STATUS(status) => Some(status.charge_state),
        _ => None,
    })
}

#[test]
fn low_battery_is_reported_and_handled_per_parameters() {
    let low = |config: &mut SitlConfig| config.battery.charge = 0.05;
    let mut bench = hovering(Autopilot::Px4, low);
    bench.run(0.5);
    let critical = MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_CRITICAL;
    assert_eq!(charge_state(&mut bench), Some(critical));
    assert_eq!(bench.mode(), Mode::Hold, "COM_LOW_BAT_ACT 0");

    let mut bench = hovering(Autopilot::Arducopter, |config| {
        low(config);
        config.parameters.insert("BATT_LOW_VOLT".to_owned(), 12.0);
        config.parameters.insert("BATT_FS_LOW_ACT".to_owned(), 1.0);
    });
    bench.run(9.0);
    assert_eq!(bench.mode(), Mode::Hold, "low for less than BATT_LOW_TIMER");
    bench.run(1.5);
    assert_eq!(bench.mode(), Mode::Land);
    let texts = bench.texts();
    assert!(texts.contains("Battery 1 is low") && texts.contains("Battery Failsafe"), "{texts}");
    let state = MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_LOW;
    assert_eq!(charge_state(&mut bench), Some(state));
}

#[test]
fn unnoticed_landing_leaves_the_vehicle_armed() {
    for (unnoticed, armed) in [(false, false), (true, true)] {
        let mut bench = hovering(Autopilot::Arducopter, |config| {
            config.landing_goes_unnoticed = unnoticed;
        });
        bench.set_mode_number(9);
        bench.run(30.0);
        assert!(bench.height() < 0.05, "on the ground");
        assert_eq!(bench.armed(), armed, "unnoticed: {unnoticed}");
    }
}

#[test]
fn shipped_configurations_load_and_run() {
    for (name, autopilot) in
        [("sitl-px4-sih.toml", Autopilot::Px4), ("sitl-arducopter.toml", Autopilot::Arducopter)]
    {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../config");
        let config = SitlConfig::load(folder.join(name)).unwrap();
        assert_eq!(config.autopilot, autopilot);
        Bench::with(config, 1).run(0.1);
    }
}
