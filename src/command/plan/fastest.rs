//! The plan of least time through a course.

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use vehicle::physics::Physics;

use super::{PlanModel, planner};
use crate::command::{Exit, ExitContext};
use crate::config::Config;
use crate::offboard::EffectiveVehicle;
use crate::plan::planned::{Found, Plan};
use crate::plan::time_optimal::{FlightPlanner, Limits, Margin, Stop, Task};

/// The summary of the fastest way.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Fastest {
    /// Time from start to finish, s.
    duration_s: f64,
    /// Time of each passage, s.
    passed_s: Vec<f64>,
    /// Shares of the limits that are reserved for feedback.
    kept_back: KeptBack,
    /// Range of thrust left to the plan, as shares of the rotors' maximum.
    rotor: [f64; 2],
    /// Body rates left to the plan, rad/s.
    body_rate_rad_s: [f64; 3],
    /// Tilt left to the plan, rad; null without a limit.
    tilt_rad: Option<f64>,
    /// Speed left to the plan, m/s; null without a limit.
    speed_m_s: Option<f64>,
}

/// Shares of the limits that the plan leaves to feedback.
#[derive(Clone, Copy, Debug, JsonSchema, Serialize)]
struct KeptBack {
    /// Of each rotor's range, at either end.
    thrust: f64,
    /// Of the body rates.
    body_rate: f64,
    /// Of the tilt.
    tilt: f64,
}

impl Fastest {
    /// Time of each passage, s.
    pub fn passed_s(&self) -> &[f64] {
        &self.passed_s
    }

    /// The text for people, in whole lines.
    pub(in crate::command) fn text(&self) -> String {
        let percent = |share: f64| 100.0 * share;
        let times: Vec<String> = self.passed_s.iter().map(|t| format!("{t:.2}")).collect();
        let passages = match times.is_empty() {
            true => String::new(),
            false => format!(", its passages at {} s", times.join(", ")),
        };
        format!(
            "fastest     {:.3} s{passages}\n\
             kept back   {:.0} % of each rotor's range at either end, {:.0} % of the body rates, \
             {:.0} % of the tilt\n",
            self.duration_s,
            percent(self.kept_back.thrust),
            percent(self.kept_back.body_rate),
            percent(self.kept_back.tilt),
        )
    }
}

/// Plans a task for a vehicle.
///
/// # Errors
/// The vehicle has no known on-board loop, or no way leads through the course.
pub(super) fn plan(
    task: &Task,
    vehicle: &VehicleParams,
    config: &Config,
    stop: Stop<'_>,
) -> anyhow::Result<(Plan, Fastest)> {
    let plan_model = PlanModel::nominal(vehicle)?;
    let (checked, answer) = planner(vehicle, &plan_model, config)?;
    let effective = EffectiveVehicle::new(vehicle).or_exit(Exit::Usage)?;
    let flight = FlightPlanner {
        physics: Physics::new(vehicle, &EffectSet::new()).or_exit(Exit::Usage)?,
        attitude_pd: answer.attitude_pd,
        lag_s: answer.lag_s,
        limits: config.settings.offboard.limits,
        envelope: config.settings.envelope,
        settings: config.settings.plan.clone(),
    };
    let planned = flight.plan(task, &task.margin, stop).or_exit(Exit::NoPlan)?;
    let Limits { rotor, body_rate_rad_s, tilt_rad, speed_m_s, .. } =
        flight.limits(task, &task.margin);
    let Margin { thrust, body_rate, tilt } = task.margin;
    let fastest = Fastest {
        duration_s: planned.found.knots.duration_s(),
        passed_s: planned.found.knots.passed_s(),
        kept_back: KeptBack { thrust, body_rate, tilt },
        rotor,
        body_rate_rad_s,
        tilt_rad,
        speed_m_s,
    };
    let found = Found {
        trajectory: task.name.clone(),
        vehicle: vehicle.name.clone(),
        body: effective.body(),
        model: plan_model.note.clone(),
        period_s: checked.period_s(),
        answer,
        desired: planned.outcome.iterate.states.clone(),
    };
    Ok((Plan::new(found, planned.outcome), fastest))
}
