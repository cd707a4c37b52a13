//! The summary of a plan, as JSON and as text.

use std::path::Path;

use schemars::JsonSchema;
use serde::Serialize;

use super::fastest::Fastest;
use super::tubed::TubeOfPlan;
use crate::plan::iterate::Violation;
use crate::plan::planned::{Plan, PlannedThrough};
use crate::plan::scp::Status;
use crate::plan::{Feasibility, InfeasibleTrajectory};

/// The result of a search.
pub(super) struct Searched<'a> {
    pub plan: &'a Plan,
    /// The fastest way, for a plan of least time.
    pub fastest: Option<Fastest>,
    pub wall_s: f64,
}

/// The JSON of `plan`.
#[derive(JsonSchema, Serialize)]
pub(in crate::command) struct PlanSummary<'a> {
    schema: &'static str,
    schema_version: u32,
    trajectory: &'a str,
    vehicle: &'a str,
    model: &'a PlannedThrough,
    status: Status,
    /// Why it may not be flown; null where it may.
    pub(super) not_flyable: Option<String>,
    cost: f64,
    violation: Violation,
    subproblems: usize,
    periods: usize,
    seconds: f64,
    wall_s: f64,
    /// Distance between planned and desired positions, m.
    position_rms_m: f64,
    position_max_m: f64,
    feasibility: Option<Feasibility>,
    /// The plan of least time; null for other plans.
    time_optimal: Option<Fastest>,
    /// The tube; null for a plan without one.
    tube: Option<TubeOfPlan>,
    plan: &'a Path,
}

impl<'a> PlanSummary<'a> {
    /// Summarises a plan in the file `out` that demands this much of the vehicle.
    pub(super) fn new(
        searched: Searched<'a>,
        demands: Result<Feasibility, InfeasibleTrajectory>,
        out: &'a Path,
    ) -> Self {
        let Searched { plan, fastest, wall_s } = searched;
        let distances = plan.distances();
        let count = distances.len() as f64;
        Self {
            schema: "downwash.plan.summary",
            schema_version: 1,
            trajectory: &plan.trajectory,
            vehicle: &plan.vehicle,
            model: &plan.model,
            status: plan.status,
            not_flyable: match (plan.check_flyable(), &demands) {
                (Err(reason), _) => Some(reason.to_string()),
                (_, Err(reason)) => Some(reason.to_string()),
                _ => None,
            },
            cost: plan.cost,
            violation: plan.violation,
            subproblems: plan.records.len(),
            periods: plan.inputs.len(),
            seconds: plan.duration(),
            wall_s,
            position_rms_m: (distances.iter().map(|d| d * d).sum::<f64>() / count).sqrt(),
            position_max_m: distances.iter().copied().fold(0.0, f64::max),
            feasibility: demands.ok(),
            time_optimal: fastest,
            tube: plan.tube.as_ref().map(TubeOfPlan::from),
            plan: out,
        }
    }

    /// The text for people.
    pub(super) fn text(&self, plan: &Plan) -> String {
        let wish = match &self.time_optimal {
            Some(fastest) => fastest.text(),
            None => format!(
                "from the desired position {:.3} m RMS, {:.3} m at most\n",
                self.position_rms_m, self.position_max_m
            ),
        };
        let tube = self.tube.as_ref().map_or(String::new(), TubeOfPlan::text);
        format!(
            "plan        {:.2} s through the {} model: {}\n\
             cost        {:.4} after {} subproblems in {:.2} s\n\
             violation   dynamics {:.1e}, bounds {:.1e}\n\
             {wish}{tube}\
             plan        {}\n",
            self.seconds,
            plan.model.kind,
            plan.status.text(),
            plan.cost,
            self.subproblems,
            self.wall_s,
            plan.violation.defect,
            plan.violation.overrun,
            self.plan.display()
        )
    }
}
