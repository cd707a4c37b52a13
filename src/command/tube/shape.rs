//! The shape of a tube: the feedback of a vehicle, and a model's errors on logs.

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use vehicle::VehicleParams;

use crate::command::logs::{Logs, listed};
use crate::command::plan::sha256_of;
use crate::command::{Exit, ExitContext};
use crate::config::Config;
use crate::control::{AttitudeLoop, Lqr};
use crate::learn::commands::Onboard;
use crate::learn::dataset::{ObservedFlight, WindowSettings};
use crate::learn::judgement::align;
use crate::model::Model;
use crate::model::actuation::Actuation;
use crate::model::file::{AccelerationSource, ModelFile, ModelKind};
use crate::model::physics::{PhysicsModel, PhysicsParameters};
use crate::offboard::EffectiveVehicle;
use crate::plan::planned::PlannedThrough;
use crate::plan::tube::error::{ModelError, Residual};
use crate::plan::tube::scale::TrackingLoop;
use vehicle::frame::Ned;

/// The slow part of the LQR's feedback with the current settings, whichever law flies.
pub(super) fn tracking_loop(
    vehicle: &VehicleParams,
    config: &Config,
) -> anyhow::Result<TrackingLoop> {
    let settings = &config.settings;
    let effective = EffectiveVehicle::new(vehicle).or_exit(Exit::Usage)?;
    let response = settings.control.attitude_response_rad_s.unwrap_or(AttitudeLoop::PX4_RAD_S);
    let attitude_loop = effective
        .attitude_pd
        .map_or_else(|| AttitudeLoop::responding_at(response), AttitudeLoop::from);
    let control = settings.control.for_loop(vehicle.attitude_cascade.is_some());
    let lqr = Lqr::design_for(&effective.actuation, &effective.hover, &attitude_loop, &control)
        .or_exit(Exit::Usage)?;
    let (stiffness, damping) = lqr.translational(&effective.hover);
    let both = |axes: [f64; 3]| [0.5 * (axes[0] + axes[1]), axes[2]];
    let offset_free = &settings.offboard.offset_free;
    let observes = offset_free.observer.applies(!effective.is_pd) || control.adaptive;
    Ok(TrackingLoop {
        stiffness_s2: both(stiffness),
        damping_s: both(damping),
        rejection_s: observes.then_some(offset_free.time_constant_s),
    })
}

/// A model, with what is needed to compute its errors on logs.
pub(super) struct JudgedModel {
    pub note: PlannedThrough,
    model: Box<dyn Model>,
    file: Option<ModelFile>,
    actuation: Actuation,
    acceleration: AccelerationSource,
    vehicle: VehicleParams,
}

impl JudgedModel {
    /// Loads a model from a file; without a path, the vehicle file's physics.
    pub fn new(
        vehicle: &VehicleParams,
        path: Option<&Path>,
        kind: Option<ModelKind>,
    ) -> anyhow::Result<Self> {
        let Some(path) = path else {
            let model =
                PhysicsModel::new(vehicle, &PhysicsParameters::default()).or_exit(Exit::Usage)?;
            let effective = EffectiveVehicle::new(vehicle).or_exit(Exit::Usage)?;
            return Ok(Self {
                note: PlannedThrough::nominal(),
                model: Box::new(model),
                file: None,
                actuation: Actuation {
                    delay_s: effective.actuation.command_delay_s,
                    lag_s: effective.actuation.motor_time_constant_s,
                    ..Actuation::default()
                },
                acceleration: AccelerationSource::SpecificForce,
                vehicle: vehicle.clone(),
            });
        };
        let file = ModelFile::load(path).or_exit(Exit::Usage)?;
        file.check_vehicle(vehicle, path).or_exit(Exit::Usage)?;
        let kind = kind.unwrap_or(file.preferred);
        Ok(Self {
            note: PlannedThrough { kind: kind.name().to_owned(), sha256: Some(sha256_of(path)?) },
            model: file.model(kind).or_exit(Exit::Usage)?,
            actuation: file.actuation,
            acceleration: file.acceleration,
            vehicle: file.vehicle.clone(),
            file: Some(file),
        })
    }

    /// The model's errors on logs.
    pub fn errors(&self, logs: &[PathBuf]) -> anyhow::Result<ModelError> {
        let onboard = Onboard::new(&self.vehicle).or_exit(Exit::Usage)?;
        let windows = WindowSettings::default();
        let mut read = Logs::read(logs, None, &self.vehicle, &onboard, &windows, |_| {});
        let flights: Vec<Vec<Residual>> = read
            .flights
            .iter_mut()
            .map(|flight| {
                if let Some(file) = &self.file {
                    align(file, &onboard, flight);
                }
                self.residuals(flight, &onboard)
            })
            .collect();
        ModelError::of(&flights)
            .ok_or_else(|| {
                anyhow!(
                    "no log has half a second of usable samples for the model's errors: {}",
                    listed(logs)
                )
            })
            .or_exit(Exit::Usage)
    }

    fn residuals(&self, flight: &ObservedFlight, onboard: &Onboard) -> Vec<Residual> {
        let rows = flight.rows(onboard, &self.actuation, self.acceleration);
        rows.iter()
            .map(|row| {
                let predicted = self.model.accelerations(&row.point);
                Residual {
                    time_s: row.time,
                    speed_m_s: row.point.velocity.norm(),
                    acceleration: Ned::new(
                        row.label[0] - predicted[0],
                        row.label[1] - predicted[1],
                        row.label[2] - predicted[2],
                    ),
                }
            })
            .collect()
    }
}
