//! Flies the simulated vehicle along a trajectory, faster than real time, with rotors that produce
//! less thrust than the controller assumes:
//!
//!     cargo run --example fly_lockstep

use std::sync::Arc;

use anyhow::Context;
use downwash::control::{Actuation, ControlSettings, HoverVehicle, Law};
use downwash::link::attitude_target::ThrustMap;
use downwash::link::session;
use downwash::lockstep;
use downwash::log::record::Record;
use downwash::offboard::OffboardSettings;
use downwash::plan::{ModelFreeReference, Trajectory};
use downwash::station::{End, Station, StationSettings};
use downwash::supervisor::EngagePolicy;
use sitl::autopilot::Vehicle;
use sitl::config::SitlConfig;
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;

/// Flies with an effect and a law; returns how the flight ended and the RMS distance from the
/// trajectory, m.
pub fn fly(effect: &str, law: Law) -> anyhow::Result<(End, f64)> {
    let params = VehicleParams::from_toml_str(include_str!("../config/vehicles/crazyflie.toml"))?;
    let trajectory = Trajectory::parse(
        "family = 'sinusoid-yaw'\naltitude_m = 1.0\nduration_s = 6.0\namplitude_m = 0.5\n\
         period_s = 4.0\nyaw_period_s = 8.0\nramp_s = 1.0",
        "circle.toml".as_ref(),
    )?;

    // The vehicle: its file, and an effect that the file does not state.
    let mut effects = EffectSet::new();
    effects.insert_argument(effect)?;
    let mut vehicle = Vehicle::new(params.clone(), effects, SitlConfig::default(), 1)?;

    // The ground station: its assumptions about the vehicle, and the flight.
    let thrust_full_n = params.thrust_full_n();
    let hover =
        HoverVehicle { mass_kg: params.mass, inertia: params.inertia, gravity: params.gravity };
    let thrust = ThrustMap::linear(thrust_full_n).context("no thrust")?;
    let settings = StationSettings {
        session: session::Settings {
            vehicle_has_attitude_pd: params.attitude_pd.is_some(),
            ..session::Settings::new(thrust)
        },
        offboard: OffboardSettings::default(),
        control: ControlSettings { law, ..ControlSettings::default() },
        policy: EngagePolicy::Command,
        hover,
        thrust_full_n,
        drag_kg_s: [0.0; 2],
        battery_full_v: params.battery.full_v,
        attitude_pd: params.attitude_pd,
        actuation: Actuation {
            command_delay_s: params.command_delay_s,
            motor_time_constant_s: params.motor_time_constant_s,
        },
        reference: Arc::new(ModelFreeReference::new(trajectory, hover.hover_thrust_n())),
        search_timeout_s: Some(20.0),
    };
    let mut station = Station::new(settings, lockstep::host_time(0));

    // Both exchange MAVLink bytes on one virtual clock; the callback receives the log's records.
    let mut squares = Vec::new();
    let record = |record| {
        if let Record::Tick(tick) = record
            && let Some(reference) = tick.reference
            && tick.trajectory_time.is_some()
        {
            squares.push((tick.state.position - reference.position).norm().powi(2));
        }
    };
    let end = lockstep::fly(&mut vehicle, &mut station, 120.0, record, |_, _| {})?;
    Ok((end, (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()))
}

fn main() -> anyhow::Result<()> {
    for scale in [1.0, 0.95, 0.9] {
        let (end, rms_m) = fly(&format!("thrust_scale:scale={scale}"), Law::default())?;
        println!("{scale} of the thrust: {end:?}, {rms_m:.3} m RMS from the trajectory");
    }
    Ok(())
}
