//! A vehicle whose position comes only from external poses, over MAVLink.

use crate::bench::Bench;
use sitl::autopilot::Mode;
use sitl::config::{Autopilot, SitlConfig};
use wire::dialect::*;

const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;
const ALL: [Autopilot; 3] = [Autopilot::Bundled, Autopilot::Px4, Autopilot::Arducopter];

fn bench(autopilot: Autopilot) -> Bench {
    let mut config = SitlConfig { autopilot, ..SitlConfig::default() };
    config.estimator.from_vision = true;
    let mut bench = Bench::with(config, 1);
    if autopilot == Autopilot::Arducopter {
        bench.set_mode_number(4);
    }
    bench.request(32, 100.0);
    bench
}

/// Sends the vehicle's true position at 50 Hz.
fn see(bench: &mut Bench, seconds: f64, is_odometry: bool) {
    for _ in 0..(50.0 * seconds) as u32 {
        let [x, y, z] = bench.vehicle.plant().state().position.to_array().map(|value| value as f32);
        let now_us = bench.vehicle.now_us();
        bench.send(&if is_odometry {
            MavMessage::ODOMETRY(ODOMETRY_DATA {
                time_usec: now_us,
                x,
                y,
                z,
                q: [1.0, 0.0, 0.0, 0.0],
                frame_id: MavFrame::MAV_FRAME_LOCAL_FRD,
                child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
                estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_VISION,
                ..Default::default()
            })
        } else {
            MavMessage::VISION_POSITION_ESTIMATE(VISION_POSITION_ESTIMATE_DATA {
                usec: now_us,
                x,
                y,
                z,
                ..Default::default()
            })
        });
        bench.run(0.02);
    }
}

/// Whether the latest SYS_STATUS reports the position as healthy.
fn is_healthy(bench: &mut Bench) -> Option<bool> {
    let position = MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL;
    bench.received().into_iter().rev().find_map(|received| match received.message {
        MavMessage::SYS_STATUS(status) => {
            Some(status.onboard_control_sensors_health.contains(position))
        }
        _ => None,
    })
}

#[test]
fn no_position_or_arming_without_external_poses() {
    for autopilot in ALL {
        let mut bench = bench(autopilot);
        assert_eq!(bench.rate_of(32), 0.0, "{autopilot:?}");
        assert_ne!(bench.arm(), ACCEPTED, "{autopilot:?}");
        for is_odometry in [false, true] {
            see(&mut bench, 1.0, is_odometry);
            assert!(bench.rate_of(32) > 90.0, "{autopilot:?}");
        }
        see(&mut bench, 0.5, false);
        assert_eq!(bench.arm(), ACCEPTED, "{autopilot:?}");
    }
}

#[test]
fn external_poses_are_ignored_unless_configured() {
    let mut bench = Bench::with(SitlConfig::default(), 1);
    bench.run(0.5);
    bench.send(&MavMessage::VISION_POSITION_ESTIMATE(VISION_POSITION_ESTIMATE_DATA {
        x: 5.0,
        ..Default::default()
    }));
    bench.run(0.5);
    let place = bench.received().into_iter().rev().find_map(|received| match received.message {
        MavMessage::LOCAL_POSITION_NED(place) => Some(place.x),
        _ => None,
    });
    assert!(place.expect("it has a position").abs() < 0.1);
}

/// The poses end in the air: the position stays healthy for a while, then turns unhealthy, and the
/// vehicle lands.
#[test]
fn pose_loss_is_reported_and_leads_to_landing() {
    for (autopilot, after_s) in [(Autopilot::Px4, 5.8), (Autopilot::Bundled, 5.8)] {
        let mut bench = bench(autopilot);
        see(&mut bench, 1.0, false);
        assert_eq!(bench.set_mode(Mode::Takeoff), ACCEPTED);
        assert_eq!(bench.arm(), ACCEPTED);
        see(&mut bench, 8.0, false);
        assert!(bench.height() > 1.5, "{autopilot:?}: {} m", bench.height());
        assert_eq!(is_healthy(&mut bench), Some(true));
        bench.run(after_s - 0.5);
        assert_eq!(is_healthy(&mut bench), Some(true), "{autopilot:?}");
        bench.run(2.0);
        assert_eq!(is_healthy(&mut bench), Some(false), "{autopilot:?}");
        assert_eq!(bench.mode(), Mode::Land, "{autopilot:?}");
        assert!(bench.run_until(20.0, |bench| !bench.armed()), "{autopilot:?}: it has landed");
        assert!(bench.height() < 0.1);
    }
}
