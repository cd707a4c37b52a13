//! Simulates whole flights of a vehicle under the daemon's feedback, as SITL does: plant, sensors,
//! link delay, on-board loop and offboard controller on one clock, without encoding messages.

use std::f64::consts::{FRAC_PI_2, PI};

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use sitl::autopilot::offboard::{AttitudeSetpoint as OnboardSetpoint, OffboardStream};
use sitl::autopilot::pd::AttitudeLoop as OnboardLoop;
use sitl::config::{SensorConfig, SitlConfig};
use sitl::sensors::{Readings, Sensors};
use vehicle::effects::{CommandDelay, EffectSet, PdGain};
use vehicle::frame::Attitude;
use vehicle::plant::Plant;
use vehicle::rigid_body::State;
use vehicle::{ROTORS, VehicleError, VehicleParams};
use wire::dialect::AttitudeTargetTypemask;

use crate::control::{
    AttitudeLoop, ControlProblem, ControlSettings, Controller, DesignError, Limits,
};
use crate::diagnose::flights::series::Series;
use crate::log::import::{AttitudeSetpoint, Flight};
use crate::offboard::{EffectiveVehicle, Uncontrollable};
use crate::setpoint::Reference;

/// Rates of the streams that the daemon logs of the bundled vehicle, Hz.
const ATTITUDE_HZ: f64 = 250.0;
const POSITION_HZ: f64 = 100.0;
const IMU_HZ: f64 = 250.0;
const OUTPUTS_HZ: f64 = 100.0;
const VOLTAGE_HZ: f64 = 5.0;
/// Period at which a logged voltage is read, s: it changes slowly compared with this.
const VOLTAGE_HELD_S: f64 = 0.02;
/// Instants closer than this are simultaneous, s.
const SAME_TIME_S: f64 = 0.25 * Plant::STEP;

/// Why a vehicle cannot be flown in simulation.
#[derive(Debug, thiserror::Error)]
pub enum NotSimulated {
    /// The vehicle file does not describe the attitude loop.
    #[error("the vehicle file has no attitude_pd, so the response of its attitude loop is unknown")]
    NoAttitudeLoop,
    /// The physics rejects the vehicle.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// The vehicle's thrust cannot be controlled.
    #[error(transparent)]
    Control(#[from] Uncontrollable),
    /// The design of the feedback fails.
    #[error(transparent)]
    Design(#[from] DesignError),
}

/// The offboard controller's part: the feedback and limits that the daemon derives from a vehicle
/// file.
#[derive(Clone, Debug)]
pub struct GroundControl {
    vehicle: EffectiveVehicle,
    /// In its state at the start of a flight.
    controller: Controller,
    limits: Limits,
}

impl GroundControl {
    /// The daemon's default control of the vehicle in a file.
    ///
    /// # Errors
    /// [`NotSimulated`].
    pub fn new(vehicle: &VehicleParams) -> Result<Self, NotSimulated> {
        Self::with(vehicle, &ControlSettings::default())
    }

    /// As [`new`](Self::new), with other settings: another control law, or other gains.
    ///
    /// # Errors
    /// [`NotSimulated`].
    pub fn with(vehicle: &VehicleParams, settings: &ControlSettings) -> Result<Self, NotSimulated> {
        let vehicle = EffectiveVehicle::new(vehicle)?;
        let pd = vehicle.attitude_pd.ok_or(NotSimulated::NoAttitudeLoop)?;
        let attitude_loop = AttitudeLoop::from(pd);
        let limits = Limits::default();
        let controller = Controller::design(&ControlProblem {
            vehicle: &vehicle.hover,
            actuation: &vehicle.actuation,
            attitude_loop: &attitude_loop,
            limits: &limits,
            settings,
        })?;
        Ok(Self { vehicle, controller, limits })
    }

    /// The same without the daemon's limits on setpoints, for setpoints of a controller that had
    /// its own limits.
    pub fn without_limits(&self) -> Self {
        let limits = Limits {
            thrust_min: 0.0,
            thrust_max: 1.0,
            tilt_max_rad: FRAC_PI_2,
            body_rate_max_rad_s: f64::INFINITY,
            yaw_error_max_rad: PI,
            ..self.limits
        };
        Self { limits, ..self.clone() }
    }

    /// The vehicle according to its file.
    pub fn vehicle(&self) -> &EffectiveVehicle {
        &self.vehicle
    }

    /// The setpoint of `controller` for a state reported at `time`, s; `None` if it is not finite.
    fn setpoint(
        &self,
        controller: &mut Controller,
        time: f64,
        state: &State,
        reference: &Reference,
    ) -> Option<OnboardSetpoint> {
        let command = controller.command(time, state, reference);
        let (full_n, yaw) = (self.vehicle.thrust_full_n, state.attitude.yaw());
        let (setpoint, _) = self.limits.apply(command.setpoint, full_n, yaw)?;
        Some(OnboardSetpoint {
            attitude: Some(setpoint.attitude),
            body_rate: setpoint.body_rate,
            thrust: self.vehicle.thrust.fraction(setpoint.thrust_n),
            type_mask: AttitudeTargetTypemask::empty(),
        })
    }
}

/// The start of a flight, in the air.
#[derive(Clone, Copy, Debug)]
pub struct Departure {
    /// Time of the vehicle's clock, s.
    pub time: f64,
    /// The true state.
    pub state: State,
    /// The rotors' states, 0..1.
    pub rotors: [f64; ROTORS],
}

/// Flies a vehicle under feedback.
#[derive(Clone, Debug)]
pub struct FlightSimulator<'a> {
    control: &'a GroundControl,
    vehicle: &'a VehicleParams,
    effects: EffectSet,
    config: SitlConfig,
    onboard: OnboardLoop,
    rate_hz: f64,
    command_delay_s: f64,
}

impl<'a> FlightSimulator<'a> {
    /// Flies `vehicle`, with `effects` put over those that its file models, under `control`.
    ///
    /// # Errors
    /// [`NotSimulated`].
    pub fn new(
        control: &'a GroundControl,
        vehicle: &'a VehicleParams,
        effects: &EffectSet,
        sensors: SensorConfig,
    ) -> Result<Self, NotSimulated> {
        let pd = vehicle.attitude_pd.ok_or(NotSimulated::NoAttitudeLoop)?;
        let all = vehicle.modelled_effects.overlay(effects);
        let gains = all.get::<PdGain>().map_or(pd, |gains| gains.apply(&pd));
        let config = SitlConfig { sensors, ..SitlConfig::default() };
        // Fails here rather than at each flight.
        Plant::new(vehicle, effects, &config.plant(), 0)?;
        Ok(Self {
            control,
            vehicle,
            effects: effects.clone(),
            config,
            onboard: OnboardLoop::new(gains, vehicle.allocation()?),
            rate_hz: pd.rate_hz,
            command_delay_s: all
                .get::<CommandDelay>()
                .map_or(vehicle.command_delay_s, |delay| delay.delay_s),
        })
    }

    /// Flies from `departure` through all `ticks` of the controller, each a time and the reference
    /// to track at it. The pack's voltage follows `voltage` if it is given, else the pack's model.
    /// Equal arguments give equal flights.
    ///
    /// # Errors
    /// [`VehicleError`], as in [`FlightSimulator::new`].
    pub fn fly(
        &self,
        departure: &Departure,
        ticks: &[(f64, Reference)],
        voltage: Option<&Series<1>>,
        seed: u64,
    ) -> Result<Flight, VehicleError> {
        let mut plant =
            Plant::new(self.vehicle, &self.effects, &self.config.plant(), seed)?.airborne();
        plant.set_rotor_states(departure.rotors);
        plant.set_state(departure.state);
        let all = self.vehicle.modelled_effects.overlay(&self.effects);
        let mut sensors = Sensors::new(&self.config, &all, seed);
        sensors.record(&plant);
        let mut stream = OffboardStream::new(self.command_delay_s);
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut flight = Recorder::new(departure.time);
        let mut logged_voltage = voltage.map(|voltage| voltage.cursor());
        let mut voltage_due = departure.time;
        let mut controller = self.control.controller.clone();
        let mut outputs = departure.rotors;
        let mut onboard = PeriodicEvent::new(self.rate_hz, departure.time);
        let mut next = 0;
        let end = ticks.last().map_or(departure.time, |(time, _)| *time);
        loop {
            let time = departure.time + plant.time();
            if time > end + SAME_TIME_S {
                return Ok(flight.flight);
            }
            if let Some(voltage) = &mut logged_voltage
                && time >= voltage_due
            {
                voltage_due += VOLTAGE_HELD_S;
                plant.hold_voltage(voltage.at(time)[0]);
            }
            let readings = sensors.sample(&plant);
            flight.record(time, &readings, outputs);
            while let Some((_, reference)) =
                ticks.get(next).filter(|(due, _)| *due <= time + SAME_TIME_S)
            {
                next += 1;
                let (control, state) = (self.control, &readings.estimate);
                if let Some(setpoint) = control.setpoint(&mut controller, time, state, reference) {
                    flight.sent(time, &setpoint);
                    stream.receive(plant.time_us(), setpoint, &mut rng);
                }
            }
            if onboard.is_at(time)
                && let Some(setpoint) = stream.at(plant.time_us())
            {
                let attitude = readings.onboard_attitude.euler();
                outputs = self.onboard.outputs(&setpoint, attitude, readings.gyro);
            }
            plant.step(outputs);
            sensors.record(&plant);
        }
    }
}

/// An event at multiples of a period of the vehicle's clock.
struct PeriodicEvent {
    rate_hz: f64,
    /// The next event, in periods from the clock's zero.
    count: f64,
}

impl PeriodicEvent {
    fn new(rate_hz: f64, from: f64) -> Self {
        Self { rate_hz, count: ((from - SAME_TIME_S) * rate_hz).ceil() }
    }

    /// Whether the event is due by `time`; if so, advances to the next one.
    fn is_at(&mut self, time: f64) -> bool {
        let is_due = self.count <= (time + SAME_TIME_S) * self.rate_hz;
        if is_due {
            self.count += 1.0;
        }
        is_due
    }
}

/// Records the streams of a flight.
struct Recorder {
    flight: Flight,
    attitude: PeriodicEvent,
    position: PeriodicEvent,
    imu: PeriodicEvent,
    outputs: PeriodicEvent,
    voltage: PeriodicEvent,
}

impl Recorder {
    fn new(from: f64) -> Self {
        Self {
            flight: Flight::in_memory("simulated", "simulated"),
            attitude: PeriodicEvent::new(ATTITUDE_HZ, from),
            position: PeriodicEvent::new(POSITION_HZ, from),
            imu: PeriodicEvent::new(IMU_HZ, from),
            outputs: PeriodicEvent::new(OUTPUTS_HZ, from),
            voltage: PeriodicEvent::new(VOLTAGE_HZ, from),
        }
    }

    /// Records the report of `time`, with the outputs of the latest tick before it.
    fn record(&mut self, time: f64, readings: &Readings, outputs: [f64; ROTORS]) {
        let Readings { estimate, gyro, specific_force, battery, .. } = readings;
        let flight = &mut self.flight;
        if self.attitude.is_at(time) {
            flight.attitude.push(time, estimate.attitude);
        }
        if self.position.is_at(time) {
            flight.position.push(time, estimate.position);
            flight.velocity.push(time, estimate.velocity);
        }
        if self.imu.is_at(time) {
            flight.body_rate.push(time, *gyro);
            flight.specific_force.push(time, *specific_force);
        }
        if self.outputs.is_at(time) {
            flight.outputs.push(time, outputs);
        }
        if self.voltage.is_at(time) {
            flight.voltage.push(time, battery.voltage);
        }
    }

    /// Records a setpoint sent at `time`.
    fn sent(&mut self, time: f64, setpoint: &OnboardSetpoint) {
        let attitude: Option<Attitude> = setpoint.attitude.map(|attitude| attitude.attitude());
        let setpoint = AttitudeSetpoint {
            attitude,
            body_rate: Some(setpoint.body_rate),
            thrust: Some(setpoint.thrust),
        };
        self.flight.setpoint.push(time, setpoint);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::setpoint::Setpoint;
    use vehicle::frame::{Euler, Frd, Ned};

    fn nano() -> VehicleParams {
        VehicleParams::from_toml_str(include_str!("../../../config/vehicles/crazyflie.toml"))
            .expect("a vehicle")
    }

    /// Hovers a metre up for `seconds`, from rest there.
    fn hover(vehicle: &VehicleParams, effects: &str, seconds: f64, seed: u64) -> Flight {
        let control = GroundControl::new(vehicle).expect("feedback");
        let mut set = EffectSet::new();
        if !effects.is_empty() {
            set.insert_argument(effects).expect("an effect");
        }
        let simulator = FlightSimulator::new(&control, vehicle, &set, SensorConfig::default())
            .expect("a simulator");
        let position = Ned::new(0.0, 0.0, -1.0);
        let thrust_n = control.vehicle().hover.hover_thrust_n();
        let reference = Reference {
            position,
            velocity: Ned::zero(),
            attitude: Euler::default(),
            body_rate: Frd::zero(),
            feedforward: Setpoint { thrust_n, ..Setpoint::default() },
        };
        let ticks: Vec<(f64, Reference)> =
            (0..(seconds * 100.0) as usize).map(|k| (5.0 + k as f64 * 0.01, reference)).collect();
        let departure = Departure {
            time: 5.0,
            state: State { position, ..State::default() },
            rotors: [vehicle.hover_thrust; ROTORS],
        };
        simulator.fly(&departure, &ticks, None, seed).expect("a flight")
    }

    #[test]
    fn hover_has_vehicle_rates_and_heavy_vehicle_sinks() {
        let vehicle = nano();
        let flight = hover(&vehicle, "", 6.0, 1);
        let height = |flight: &Flight| -flight.position.values().last().expect("a position").down();
        assert!((height(&flight) - 1.0).abs() < 0.02, "{}", height(&flight));
        for (rate, expected) in [
            (flight.attitude.rate(), 250.0),
            (flight.position.rate(), 100.0),
            (flight.outputs.rate(), 100.0),
            (flight.setpoint.rate(), 100.0),
        ] {
            assert!((rate / expected - 1.0).abs() < 0.01, "{rate}");
        }
        let first = flight.attitude.times().first().expect("a sample");
        assert!((first - 5.0).abs() < 1e-9);
        // The vertical position gain supports a twentieth of the weight after a few centimetres.
        let heavy = height(&hover(&vehicle, "thrust_scale:scale=0.95", 6.0, 1));
        assert!((0.9..0.985).contains(&heavy), "{heavy}");
    }

    #[test]
    fn same_seed_gives_the_same_flight() {
        let vehicle = nano();
        let of = |seed| hover(&vehicle, "", 1.0, seed).outputs;
        assert_eq!(of(3), of(3));
        assert_ne!(of(3), of(4));
    }

    #[test]
    fn vehicle_without_onboard_loop_is_refused() {
        let vehicle = VehicleParams { attitude_pd: None, ..nano() };
        let refused = GroundControl::new(&vehicle).expect_err("no loop").to_string();
        assert!(refused.contains("attitude_pd"), "{refused}");
    }
}
