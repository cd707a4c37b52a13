//! The course of a flight: a desired trajectory as it is, or a plan.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, anyhow};

use super::vehicle_file::VehicleFile;
use super::{Exit, ExitContext};
use crate::config::Config;
use crate::offboard::EffectiveVehicle;
use crate::plan::planned::{Plan, PlannedReference};
use crate::plan::receding::RecedingReference;
use crate::plan::reference::ReferenceSource;
use crate::plan::{ModelFreeReference, Trajectory};

/// A desired trajectory, or a plan that leads along one.
#[derive(Clone)]
pub enum Course {
    /// Followed by feedback alone.
    Desired(Trajectory),
    /// Followed with its inputs.
    Planned(Arc<Plan>),
    /// Planned anew in flight.
    Receding {
        /// Its start.
        goal: Trajectory,
        /// Its planner.
        reference: Arc<RecedingReference>,
    },
}

impl Course {
    /// Reads a trajectory file or a plan, and checks that the vehicle can fly it.
    ///
    /// # Errors
    /// As [`check`](Self::check), and a file that cannot be read.
    pub fn load(path: &Path, vehicle: &VehicleFile, config: &Config) -> anyhow::Result<Self> {
        let course = if Plan::is_plan(path) {
            Self::Planned(Arc::new(Plan::load(path).or_exit(Exit::Usage)?))
        } else {
            Self::Desired(Trajectory::load(path).or_exit(Exit::Usage)?)
        };
        course.check(vehicle, config).with_context(|| path.display().to_string())?;
        Ok(course)
    }

    /// Checks that it is within the envelope, and that a plan is flyable and made for this vehicle.
    ///
    /// # Errors
    /// The first reason not to fly it.
    pub fn check(&self, vehicle: &VehicleFile, config: &Config) -> anyhow::Result<()> {
        let envelope = &config.settings.envelope;
        let params = &vehicle.params;
        match self {
            Self::Desired(trajectory) | Self::Receding { goal: trajectory, .. } => {
                envelope.check(trajectory, params.gravity).or_exit(Exit::Refused)?;
            }
            Self::Planned(plan) => {
                let effective = EffectiveVehicle::new(params).or_exit(Exit::Usage)?;
                if plan.vehicle != params.name {
                    return Err(anyhow!(
                        "the plan is for the vehicle {:?}, this is {:?}; make a plan for this one",
                        plan.vehicle,
                        params.name
                    ))
                    .or_exit(Exit::Refused);
                }
                if effective.body() != plan.body {
                    return Err(anyhow!(
                        "the plan is for another vehicle with this name: {:?} there and {:?} here; \
                         make a plan for this one",
                        plan.body,
                        effective.body()
                    ))
                    .or_exit(Exit::Refused);
                }
                if effective.attitude_pd != Some(plan.answer.attitude_pd) {
                    return Err(anyhow!(
                        "the plan's on-board attitude loop is not the vehicle file's; plan it again"
                    ))
                    .or_exit(Exit::Refused);
                }
                plan.check_flyable().or_exit(Exit::Refused)?;
                envelope
                    .check_plan(plan, effective.hover.mass_kg, params.gravity)
                    .or_exit(Exit::Refused)?;
            }
        }
        Ok(())
    }

    /// The reference of the first tick along it: before the first plan, the goal itself.
    pub fn at_start(&self) -> Self {
        match self {
            Self::Receding { goal, .. } => Self::Desired(goal.clone()),
            course => course.clone(),
        }
    }

    /// Its name in logs and reports.
    pub fn name(&self) -> &str {
        match self {
            Self::Desired(goal) | Self::Receding { goal, .. } => goal.name(),
            Self::Planned(plan) => &plan.trajectory,
        }
    }

    /// Length in s.
    pub fn duration(&self) -> f64 {
        match self {
            Self::Desired(goal) | Self::Receding { goal, .. } => goal.duration(),
            Self::Planned(plan) => plan.duration(),
        }
    }

    /// The reference that the controller follows. `hover_thrust_n` is the vehicle's effective
    /// weight.
    pub fn reference(&self, hover_thrust_n: f64) -> Arc<dyn ReferenceSource + Send + Sync> {
        match self {
            Self::Desired(trajectory) => {
                Arc::new(ModelFreeReference::new(trajectory.clone(), hover_thrust_n))
            }
            Self::Planned(plan) => Arc::new(PlannedReference::new(plan)),
            Self::Receding { reference, .. } => Arc::clone(reference) as _,
        }
    }
}
