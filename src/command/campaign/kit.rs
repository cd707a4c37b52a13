//! The settings that a fault script is flown with, and the limits that its judge expects of them.

use std::collections::BTreeMap;
use std::path::Path;

use sitl::config::Autopilot;
use toml::Value;

use crate::campaign::judge::Bounds;
use crate::campaign::kit::Kit;
use crate::campaign::script::Script;
use crate::command::setup::station_settings;
use crate::command::vehicle_file::VehicleFile;
use crate::command::{Course, Exit, ExitContext, configuration};
use crate::plan::Trajectory;

/// Sampling rate of the trajectory for its bounding box, Hz.
const POINTS_PER_S: f64 = 10.0;

/// The settings and the vehicle of a script, and the limits that its judge expects.
pub fn kit(script: &Script) -> anyhow::Result<Kit> {
    let law = Value::String(script.law.clone());
    let config = configuration(None, &BTreeMap::from([("control.law".to_owned(), law)]))?;
    let vehicle = VehicleFile::load(Path::new(&script.vehicle))?;
    let trajectory = Trajectory::parse(&script.trajectory, Path::new("the script's trajectory"))
        .or_exit(Exit::Usage)?;
    let course = Course::Desired(trajectory);
    course.check(&vehicle, &config)?;
    let settings = station_settings(&config, &vehicle, &course, script.policy, None)?;
    let limits = settings.offboard.limits;
    let thrust = settings.session.thrust;
    let field = |share: f64| thrust.fraction(share * settings.thrust_full_n);
    let (obeys, lands) = match script.autopilot {
        Autopilot::Arducopter => (4, 9),
        Autopilot::Bundled | Autopilot::Px4 => (6 << 16, 4 << 16 | 6 << 24),
    };
    let bounds = Bounds {
        thrust: [field(limits.thrust_min), field(limits.thrust_max)],
        tilt_rad: limits.tilt_max_rad,
        body_rate_rad_s: limits.body_rate_max_rad_s,
        // The thrust field changes more than the thrust where the thrust curve is flat.
        thrust_change_per_s: 2.0 * limits.thrust_change_max_per_s,
        body_rate_change_rad_s2: limits.body_rate_change_max_rad_s2,
        obeys,
        lands,
    };
    let points = (course.duration() * POINTS_PER_S) as usize;
    let at = |k: usize| settings.reference.sample(k as f64 / POINTS_PER_S).position.to_array();
    let path = (0..=points).map(at).collect();
    Ok(Kit { settings, params: vehicle.params, bounds, path })
}
