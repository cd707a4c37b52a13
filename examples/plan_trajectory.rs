//! Plans a trajectory through the vehicle's physics, around a ball to avoid:
//!
//!     cargo run --example plan_trajectory

use std::sync::Arc;

use anyhow::Context;
use downwash::control::Limits;
use downwash::model::physics::{PhysicsModel, PhysicsParameters};
use downwash::offboard::EffectiveVehicle;
use downwash::plan::Trajectory;
use downwash::plan::planner::{KeepOutSetting, PlanSettings, PlannedVehicle, Planner};
use downwash::plan::scp::Outcome;
use vehicle::VehicleParams;

/// Plans two metres north past a ball; the plan has the thrust, attitude and rates of every step.
pub fn plan() -> anyhow::Result<Outcome<7>> {
    let params = VehicleParams::from_toml_str(include_str!("../config/vehicles/crazyflie.toml"))?;
    let trajectory = Trajectory::parse(
        "family = 'waypoints'\npace = { speed_m_s = 1.0, acceleration_m_s2 = 2.0 }\npoints = [\n\
         { north_m = 0, east_m = 0, altitude_m = 1 }, { north_m = 2, east_m = 0, altitude_m = 1 }]",
        "past.toml".as_ref(),
    )?;
    let ball = KeepOutSetting::Sphere { centre_m: [1.0, 0.1, -1.0], radius_m: 0.25 };
    let vehicle = PlannedVehicle {
        body: EffectiveVehicle::new(&params)?.body(),
        attitude_pd: params.attitude_pd.context("the file has no attitude loop")?,
        limits: Limits::default(),
    };
    let model = PhysicsModel::new(&params, &PhysicsParameters::default())?;
    let settings = PlanSettings { keep_out: vec![ball], ..PlanSettings::default() };
    let planner = Planner::new(Arc::new(model), vehicle, settings)?;
    let desire = planner.desire(&trajectory)?;
    let start = *desire.states.first().context("an empty trajectory")?;
    Ok(planner.plan(&desire, start, None, &|_| false))
}

fn main() -> anyhow::Result<()> {
    let outcome = plan()?;
    println!("{:?} after {} subproblems", outcome.status, outcome.records.len());
    for state in outcome.iterate.states.iter().step_by(20) {
        println!("north {:.2} m, east {:.2} m, altitude {:.2} m", state[0], state[1], -state[2]);
    }
    Ok(())
}
