//! The airframe: the plant and its sensors.

use crate::config::SitlConfig;
use crate::sensors::{Readings, Sensors};
use vehicle::effects::{EffectSet, Onset};
use vehicle::foreign::Foreign;
use vehicle::physics::Physics;
use vehicle::plant::Plant;
use vehicle::{ROTORS, VehicleError, VehicleParams};

use super::flight::Perception;
use super::protocol::Report;
use super::telemetry::Battery;

/// A start higher than this above the floor is a start in flight, m.
const AIRBORNE_ABOVE_M: f64 = 0.05;

/// Plant and sensors. The sensors are sampled exactly once per step, so their noise does not depend
/// on who reads them.
pub(super) struct Airframe {
    plant: Plant,
    sensors: Sensors,
    readings: Readings,
    airborne: bool,
    cells: u8,
    consumed_ah: f64,
    /// Step and new physics of each onset, the next one last.
    onsets: Vec<(u64, Physics)>,
}

impl Airframe {
    /// Creates the airframe at the configured start; in the air, the rotors start at hover.
    pub(super) fn new(
        vehicle: &VehicleParams,
        truth: &EffectSet,
        config: &SitlConfig,
        seed: u64,
    ) -> Result<Self, VehicleError> {
        let mut plant = Plant::new(vehicle, truth, &config.plant(), seed)?;
        let airborne = plant.state().position.down() < config.floor_down_m - AIRBORNE_ABOVE_M;
        if airborne {
            let physics = plant.physics();
            let environment = physics.calm();
            if let Some(collective) = physics.hover_collective(&environment) {
                let rotors = physics.rotors_for_wrench(&[collective, 0.0, 0.0, 0.0]);
                plant.set_rotor_states(rotors);
            }
        }
        let effects = vehicle.modelled_effects.overlay(truth);
        let mut sensors = Sensors::new(config, &effects, seed);
        sensors.record(&plant);
        let readings = sensors.sample(&plant);
        let cells = vehicle.battery.cells;
        Ok(Self { plant, sensors, readings, airborne, cells, consumed_ah: 0.0, onsets: Vec::new() })
    }

    /// Schedules onsets; each overrides `truth` and the earlier onsets.
    pub(super) fn schedule(
        &mut self,
        vehicle: &VehicleParams,
        truth: &EffectSet,
        onsets: &[Onset],
    ) -> Result<(), VehicleError> {
        let mut effects = truth.clone();
        for onset in onsets {
            effects = effects.overlay(&onset.effects);
            let step = (onset.at_s / Plant::STEP).round() as u64;
            self.onsets.push((step, Physics::new(vehicle, &effects)?));
        }
        self.onsets.reverse();
        Ok(())
    }

    pub(super) fn disturb(&mut self, foreign: Foreign, seed: u64) {
        self.plant.disturb(foreign, seed);
    }

    pub(super) fn drain(&mut self, charge: f64) {
        self.plant.drain(charge);
    }

    pub(super) fn airborne(&self) -> bool {
        self.airborne
    }

    pub(super) fn plant(&self) -> &Plant {
        &self.plant
    }

    pub(super) fn step(&mut self, outputs: [f64; ROTORS]) {
        let now = self.plant.time_us() / 1000;
        while let Some((_, physics)) = self.onsets.pop_if(|(step, _)| *step <= now) {
            self.plant.become_vehicle(physics);
        }
        self.plant.step(outputs);
        self.sensors.record(&self.plant);
        self.readings = self.sensors.sample(&self.plant);
        self.consumed_ah += self.plant.current() * Plant::STEP / 3600.0;
    }

    /// The inputs of the on-board loop.
    pub(super) fn perceive(&self) -> Perception {
        let Readings { estimate, onboard_attitude, gyro, battery, estimator, .. } = self.readings;
        Perception {
            position: estimate.position,
            velocity: estimate.velocity,
            attitude: onboard_attitude,
            body_rate: gyro,
            battery: battery.remaining,
            voltage: battery.voltage,
            estimator,
        }
    }

    /// The data for telemetry.
    pub(super) fn report(&self) -> Report {
        let Readings { estimate, gyro, specific_force, battery, estimator, .. } = self.readings;
        Report {
            position: estimate.position,
            velocity: estimate.velocity,
            attitude: estimate.attitude,
            body_rate: gyro,
            specific_force,
            battery: Battery {
                cells: self.cells,
                voltage: battery.voltage,
                current: battery.current,
                consumed_ah: self.consumed_ah,
                remaining: battery.remaining,
            },
            rpm: self.plant.rpm(),
            estimator,
        }
    }
}
