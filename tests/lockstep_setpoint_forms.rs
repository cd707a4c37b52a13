//! Each form of setpoint in flight: attitude, rates and thrust (mask 0x00); attitude and thrust, as
//! for a PX4 (0x07); rates and thrust under the daemon's attitude loop (0x80). With the vehicle
//! file's delay and lag, and with more of both.

use crate::lockstep::{SLOW, VEHICLES, errors, fly, hover, ideal, masks, params, settings};
use crate::lockstep::{tracked, trajectory};
use downwash::control::Use;
use downwash::link::profile::FormChoice;
use downwash::log::record::Record;
use downwash::plan::Trajectory;
use downwash::station::{End, StationSettings};
use sitl::config::SitlConfig;
use vehicle::VehicleParams;

const MASKS: [u8; 3] = [0x00, 0x07, 0x80];

/// Settings that send setpoints of the form `mask` to a vehicle with a known on-board loop.
fn sending(mask: u8, params: &VehicleParams, trajectory: Trajectory) -> StationSettings {
    let mut settings = settings(params, trajectory);
    match mask {
        // For an autopilot that does not report accepting all three together.
        0x07 => settings.session.vehicle_has_attitude_pd = false,
        0x80 => settings.session.form = FormChoice::RatesThrust { gain: [6.0, 6.0, 3.0] },
        _ => {}
    }
    settings
}

#[test]
fn each_form_tracks_a_turning_sinusoid_with_and_without_delay_and_lag() {
    for vehicle in VEHICLES {
        let params = params(vehicle);
        for mask in MASKS {
            for effects in [&[][..], &SLOW] {
                let settings = sending(mask, &params, trajectory("sinusoid-yaw.toml"));
                let (end, records) = fly(settings, &params, effects, SitlConfig::default(), 1);
                let (rmse, largest) = errors(&records);
                assert_eq!((end, masks(&records)), (End::Done, vec![mask]), "{vehicle}");
                // Feedback alone lags behind what moves.
                assert!(
                    rmse < 0.33 && largest < 0.4,
                    "{vehicle} {mask:#04x} {effects:?}: {rmse} m, {largest} m"
                );
            }
        }
    }
}

#[test]
fn each_form_settles_in_hover_with_and_without_delay_and_lag() {
    for vehicle in VEHICLES {
        let params = params(vehicle);
        for mask in MASKS {
            for effects in [&[][..], &SLOW] {
                let settings = sending(mask, &params, hover(12.0));
                let (end, records) = fly(settings, &params, effects, ideal(), 1);
                assert_eq!((end, masks(&records)), (End::Done, vec![mask]), "{vehicle}");
                let (_, largest) = errors(&records);
                let rows = tracked(&records);
                let late = rows.iter().filter(|row| row.t > 8.0);
                let shaking = late.map(|row| row.state.body_rate.norm()).fold(0.0, f64::max);
                assert!(largest < 0.05, "{vehicle} {mask:#04x} {effects:?}: {largest} m");
                assert!(shaking < 0.05, "{vehicle} {mask:#04x} {effects:?}: {shaking} rad/s");
            }
        }
    }
}

/// Flies the turning sinusoid with attitude and thrust setpoints. The vehicle's own loop has a
/// bandwidth of `on_board` rad/s about roll and pitch (`None`: that of its file); the daemon does
/// not know the loop and uses `setting` for it. Returns the RMS and the largest error, m.
fn unknown_loop(vehicle: &str, on_board: Option<f64>, setting: Option<[f64; 3]>) -> (f64, f64) {
    let mut params = params(vehicle);
    if let Some(wn) = on_board {
        let pd = params.attitude_pd.as_mut().expect("a loop");
        for (axis, wn) in [wn, wn, 0.5 * wn].into_iter().enumerate() {
            pd.kp[axis] = wn * wn * params.inertia[axis];
            pd.kd[axis] = 2.0 * wn * params.inertia[axis];
        }
    }
    let mut settings = sending(0x07, &params, trajectory("sinusoid-yaw.toml"));
    settings.attitude_pd = None;
    // The regulator alone.
    settings.offboard.offset_free.observer = Use::Off;
    settings.offboard.offset_free.feed_forward = Use::Off;
    settings.control.attitude_response_rad_s = setting;
    let (end, records) = fly(settings, &params, &[], SitlConfig::default(), 1);
    assert_eq!((end, masks(&records)), (End::Done, vec![0x07]), "{vehicle}");
    let assumed = records.iter().any(|record| {
        matches!(record, Record::Event { text, .. } if text.contains("attitude loop is unknown"))
    });
    assert_eq!(assumed, setting.is_none(), "the assumption is reported");
    errors(&records)
}

#[test]
fn vehicle_with_unknown_loop_is_sent_attitude_and_thrust() {
    for vehicle in VEHICLES {
        let (rmse, largest) = unknown_loop(vehicle, None, None);
        assert!(rmse < 0.6 && largest < 0.7, "{vehicle}: {rmse} m, {largest} m");
    }
}

#[test]
fn unknown_loop_a_third_as_fast_still_flies() {
    for vehicle in VEHICLES {
        let (rmse, largest) = unknown_loop(vehicle, Some(2.5), None);
        assert!(rmse < 0.7 && largest < 0.9, "{vehicle}: {rmse} m, {largest} m");
    }
}

#[test]
fn feedback_is_designed_for_the_configured_response() {
    for vehicle in VEHICLES {
        // A loop slower still, and one faster than assumed.
        let (slow, largest) = unknown_loop(vehicle, Some(1.8), Some([1.8, 1.8, 0.9]));
        assert!(largest < 1.4, "{vehicle}: {slow} m, {largest} m");
        let (assumed, _) = unknown_loop(vehicle, Some(12.0), None);
        let (configured, _) = unknown_loop(vehicle, Some(12.0), Some([12.0, 12.0, 6.0]));
        assert!(
            configured < 0.8 * assumed,
            "{vehicle}: {configured} m configured, {assumed} m assumed"
        );
    }
}
