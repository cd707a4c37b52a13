//! The settings of a station, from files and the configuration.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::anyhow;
use vehicle::frame::Frd;
use vehicle::{AttitudePd, VehicleParams};
use wire::Endpoint;

use super::course::Course;
use super::vehicle_file::VehicleFile;
use super::{Exit, ExitContext};
use crate::config::{Config, FormSetting};
use crate::control::{Actuation, AttitudeLoop, ControlProblem, ControlSettings, Controller, Law};
use crate::link::profile::FormChoice;
use crate::link::session;
use crate::log::RunInfo;
use crate::offboard::EffectiveVehicle;
use crate::plan::Trajectory;
use crate::plan::programme::Capability;
use crate::station::StationSettings;
use crate::supervisor::EngagePolicy;

/// The built-in trajectory: the paper's.
pub(super) fn built_in_trajectory() -> anyhow::Result<Trajectory> {
    let text = include_str!("../../config/trajectories/sinusoid-yaw.toml");
    Ok(Trajectory::parse(text, Path::new("sinusoid-yaw.toml (built in)"))?)
}

/// The demands that a programme of flights may make on the vehicle.
pub(super) fn capability(
    params: &VehicleParams,
    settings: &ControlSettings,
) -> anyhow::Result<Capability> {
    let effective = EffectiveVehicle::new(params).or_exit(Exit::Usage)?;
    let inertia: [f64; 3] = effective.hover.inertia;
    let bandwidth = match effective.attitude_pd {
        Some(pd) => std::array::from_fn(|axis| (pd.kp[axis] / inertia[axis]).sqrt()),
        // An unknown loop counts as the slowest of the known ones.
        None => settings.attitude_response_rad_s.unwrap_or(AttitudeLoop::PX4_RAD_S),
    };
    let [roll, pitch, yaw] = bandwidth;
    Ok(Capability {
        gravity: params.gravity,
        thrust_to_weight: effective.thrust_full_n / effective.hover.hover_thrust_n(),
        tilt_bandwidth: f64::min(roll, pitch),
        yaw_bandwidth: yaw,
    })
}

/// Parses the URL of a vehicle.
pub(super) fn endpoint(url: &str) -> anyhow::Result<Endpoint> {
    url.parse::<Endpoint>().or_exit(Exit::Usage)
}

/// A station's settings.
pub(super) fn station_settings(
    config: &Config,
    vehicle: &VehicleFile,
    course: &Course,
    policy: EngagePolicy,
    link: Option<&Endpoint>,
) -> anyhow::Result<StationSettings> {
    let settings = &config.settings;
    let effective = EffectiveVehicle::new(&vehicle.params).or_exit(Exit::Usage)?;
    // The vehicle and its loop are not known yet. Settings that fail here fail with every loop.
    Controller::design(&ControlProblem {
        vehicle: &effective.hover,
        actuation: &Actuation::IMMEDIATE,
        attitude_loop: &AttitudeLoop::PX4,
        limits: &settings.offboard.limits,
        settings: &settings.control,
    })
    .or_exit(Exit::Usage)?;
    let endpoint = link;
    let link = &settings.link;
    let session = session::Settings {
        system: link.system,
        component: link.component,
        vehicle_system: link.vehicle_system,
        vehicle_has_attitude_pd: effective.is_pd,
        form: form_choice(link.attitude_target, effective.attitude_pd),
        answer_timesync: link.answer_timesync,
        stale_after: seconds("link.stale_after_s", link.stale_after_s)?,
        lost_after: seconds("link.lost_after_s", link.lost_after_s)?,
        baud: endpoint.and_then(baud),
        endpoint: endpoint.map(ToString::to_string),
        ..session::Settings::new(effective.thrust)
    };
    let mut offboard = settings.offboard.clone();
    offboard.telemetry.rate_hz = settings.control.rate_hz;
    if !settings.plan.keep_out.is_empty() {
        // A moved plan would lead through the regions that it avoids.
        offboard.adjustment.goal_max_m = 0.0;
    }
    Ok(StationSettings {
        session,
        offboard,
        control: settings.control.for_loop(vehicle.params.attitude_cascade.is_some()),
        policy,
        hover: effective.hover,
        drag_kg_s: effective.drag_kg_s,
        thrust_full_n: effective.thrust_full_n,
        battery_full_v: vehicle.params.battery.full_v,
        attitude_pd: effective.attitude_pd,
        actuation: effective.actuation,
        reference: course.reference(effective.hover.hover_thrust_n()),
        search_timeout_s: (policy == EngagePolicy::Command).then_some(link.search_timeout_s),
    })
}

/// The speed of a serial endpoint.
pub(super) fn baud(endpoint: &Endpoint) -> Option<u32> {
    match endpoint {
        Endpoint::Serial { baud, .. } => Some(*baud),
        _ => None,
    }
}

/// Largest gain of the daemon's attitude loop, 1/s: the link and the feedback's period are within
/// the loop and allow no more. A slower on-board loop gives a smaller gain.
const RATE_GAIN: f64 = 6.0;

fn form_choice(setting: FormSetting, pd: Option<AttitudePd>) -> FormChoice {
    match setting {
        FormSetting::Profile => FormChoice::Profile,
        FormSetting::ForceAttitudeRatesThrust => FormChoice::ForceAttitudeRatesThrust,
        FormSetting::ArducopterRates => FormChoice::ArduCopterRates,
        FormSetting::RatesThrust => {
            let gain = pd.map_or([RATE_GAIN; 3], |pd| {
                std::array::from_fn(|i| (pd.kp[i] / pd.kd[i]).min(RATE_GAIN))
            });
            FormChoice::RatesThrust { gain }
        }
    }
}

fn seconds(name: &str, value: f64) -> anyhow::Result<Duration> {
    Duration::try_from_secs_f64(value)
        .map_err(|_| anyhow!("{name}: expected seconds of at least 0, found {value}"))
        .or_exit(Exit::Usage)
}

/// The log's facts about the run.
pub(super) fn run_info(
    config: &Config,
    vehicle: &VehicleFile,
    run: &str,
    simulated: bool,
    seed: Option<u64>,
) -> RunInfo {
    let rotors = vehicle.params.rotors.map(|rotor| Frd::from(rotor.position_m));
    RunInfo {
        vehicle: vehicle.params.name.clone(),
        run: run.to_owned(),
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        git_revision: option_env!("DOWNWASH_GIT_REVISION").map(str::to_owned),
        simulated,
        seed,
        autopilot: None,
        dialect: "ardupilotmega".to_owned(),
        config: config.to_toml(),
        vehicle_file: Some((vehicle.name.clone(), vehicle.text.clone())),
        rotors: rotors.to_vec(),
        extra: BTreeMap::new(),
    }
}

/// A required setting, from a flag or the configuration.
pub(super) fn required<T: Clone>(value: &Option<T>, flag: &str, key: &str) -> anyhow::Result<T> {
    value
        .clone()
        .ok_or_else(|| anyhow!("{flag} is missing: give the flag, or {key} in the configuration"))
        .or_exit(Exit::Usage)
}

/// `--law` as a configuration layer.
pub(super) fn law_flag(law: Law) -> (&'static str, &'static str, toml::Value) {
    ("--law", "control.law", toml::Value::String(law.to_string()))
}

/// A flag's value as a configuration layer.
pub(super) fn path_flag(
    flag: &'static str,
    key: &'static str,
    value: &Option<PathBuf>,
) -> Option<(&'static str, &'static str, toml::Value)> {
    let path = value.as_ref()?.to_string_lossy().into_owned();
    Some((flag, key, toml::Value::String(path)))
}
