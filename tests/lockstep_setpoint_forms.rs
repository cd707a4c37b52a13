//! Each form of setpoint in flight: attitude, rates and thrust (mask 0x00); attitude and thrust, as a
//! PX4 is sent (0x07); rates and thrust under the daemon's attitude loop (0x80). With the vehicle
//! file's delay and lag, and with more of both than the file says.

mod lockstep;

use downwash::link::profile::FormChoice;
use downwash::plan::Trajectory;
use downwash::station::{End, StationSettings};
use lockstep::{SLOW, VEHICLES, errors, fly, hover, ideal, masks, params, settings};
use lockstep::{tracked, trajectory};
use sitl::config::SitlConfig;
use sitl::vehicle::VehicleParams;

const MASKS: [u8; 3] = [0x00, 0x07, 0x80];

/// What sends setpoints of the form `mask` to the vehicle, whose on-board loop is known.
fn sending(mask: u8, params: &VehicleParams, trajectory: Trajectory) -> StationSettings {
    let mut settings = settings(params, trajectory);
    match mask {
        // As of an autopilot that does not say that it hears the three together.
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

#[test]
fn vehicle_whose_loop_is_not_known_is_sent_attitude_and_thrust() {
    for vehicle in VEHICLES {
        let params = params(vehicle);
        let mut settings = sending(0x07, &params, trajectory("sinusoid-yaw.toml"));
        settings.attitude_pd = None;
        let (end, records) = fly(settings, &params, &[], SitlConfig::default(), 1);
        let (rmse, largest) = errors(&records);
        assert_eq!((end, masks(&records)), (End::Done, vec![0x07]), "{vehicle}");
        assert!(rmse < 0.5 && largest < 0.6, "{vehicle}: {rmse} m, {largest} m");
    }
}
