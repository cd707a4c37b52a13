//! Flight control: computes motor outputs from sensor data, once per tick of the on-board loop.

mod steering;

use rand::Rng;
use wire::dialect::{
    MavBatteryChargeState, MavParamType, MavSeverity, MavType, SET_ATTITUDE_TARGET_DATA,
};

use crate::config::SitlConfig;
use crate::sensors::EstimatorStatus;
use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::{ROTORS, VehicleParams};

use super::Mode;
use super::arming::{Preflight, Refusal};
use super::commander::{Commander, Situation};
use super::guidance::{Guidance, Sticks};
use super::land_detector::{LandDetector, Motion};
use super::offboard::{AttitudeSetpoint, OffboardStream};
use super::parameters::{Key, Parameters, SetError};
use super::personality::{LoopInput, Onboard, OnboardLoop, Personality, Reception};
use super::position::PositionController;
use super::vision::{OutsidePose, Vision};

/// Age of the last heartbeat above which a ground station is lost, us.
const GROUND_STATION_LOST_US: u64 = 10_000_000;

/// The loop's inputs: the estimate without latency, and the battery.
#[derive(Clone, Copy, Debug)]
pub struct Perception {
    /// Position, m.
    pub position: Ned,
    /// Velocity, m/s.
    pub velocity: Ned,
    /// Attitude as reported, including the trim error.
    pub attitude: Attitude,
    /// Gyro, rad/s.
    pub body_rate: Frd,
    /// Remaining charge, 0..1.
    pub battery: f64,
    /// Terminal voltage, V.
    pub voltage: f64,
    /// The estimator's status.
    pub estimator: EstimatorStatus,
}

impl Perception {
    fn is_finite(&self) -> bool {
        let q = self.attitude;
        self.position.is_finite()
            && self.velocity.is_finite()
            && self.body_rate.is_finite()
            && [q.w, q.x, q.y, q.z].iter().all(|c| c.is_finite())
    }
}

/// The vehicle's flight control.
#[derive(Debug)]
pub struct FlightControl {
    pub(super) personality: &'static dyn Personality,
    pub(super) parameters: Parameters,
    pub(super) commander: Commander,
    stream: OffboardStream,
    guidance: Guidance,
    position_controller: PositionController,
    attitude_loop: Box<dyn OnboardLoop>,
    detector: LandDetector,
    sticks: Option<(u64, Sticks)>,
    ground_station_us: Option<u64>,
    /// Time at which the position becomes known, us.
    ready_us: u64,
    /// The external position, if configured.
    vision: Option<Vision>,
    home: Ned,
    take_off_height: Option<f64>,
    perception: Perception,
    setpoint: Option<AttitudeSetpoint>,
    /// Time at which the setpoint took effect, us, if after the previous tick.
    arrived_us: Option<u64>,
    outputs: [f64; ROTORS],
    tick_s: f64,
}

/// Initial conditions of a flight.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beginning {
    pub perception: Perception,
    /// Whether the flight starts in the air.
    pub airborne: bool,
    /// Seed of the errors of the external position.
    pub seed: u64,
}

impl FlightControl {
    /// Flight control of `vehicle` by `personality` with its `onboard` loop.
    pub(super) fn new(
        vehicle: &VehicleParams,
        personality: &'static dyn Personality,
        onboard: Onboard,
        command_delay_s: f64,
        config: &SitlConfig,
        Beginning { perception, airborne, seed }: Beginning,
    ) -> Self {
        let vision = config
            .estimator
            .from_vision
            .then(|| Vision::new(personality.vision_lost_after_s(), seed));
        let Onboard { parameters, attitude_loop, rate_hz } = onboard;
        Self {
            personality,
            parameters,
            commander: Commander::new(personality, airborne),
            stream: OffboardStream::new(command_delay_s),
            guidance: Guidance::default(),
            position_controller: PositionController::new(vehicle.gravity),
            attitude_loop,
            detector: LandDetector::new(
                !airborne,
                !config.landing_goes_unnoticed,
                personality.landed_lean_max(),
            ),
            sticks: None,
            ground_station_us: None,
            ready_us: (config.estimator.ready_after_s * 1e6) as u64,
            vision,
            home: perception.position,
            take_off_height: None,
            perception,
            setpoint: None,
            arrived_us: None,
            outputs: [0.0; ROTORS],
            tick_s: 1.0 / rate_hz,
        }
    }

    /// Whether the motors are armed.
    pub fn armed(&self) -> bool {
        self.commander.armed()
    }

    /// The active mode.
    pub fn mode(&self) -> Mode {
        self.commander.mode()
    }

    /// The present motor outputs, 0..1.
    pub fn outputs(&self) -> [f64; ROTORS] {
        self.outputs
    }

    /// The setpoint that the attitude loop tracks; `None` while it does not run.
    pub fn setpoint(&self) -> Option<&AttitudeSetpoint> {
        self.setpoint.as_ref()
    }

    /// The setpoint that ATTITUDE_TARGET reports.
    pub(super) fn reported_setpoint(&self) -> Option<AttitudeSetpoint> {
        self.setpoint.map(|setpoint| self.attitude_loop.reported(setpoint))
    }

    /// Whether the estimator has a position.
    pub(super) fn position_known(&self, now_us: u64) -> bool {
        now_us >= self.ready_us && self.vision.as_ref().is_none_or(|vision| vision.is_known(now_us))
    }

    /// Whether the position is external and unknown.
    pub(super) fn lacks_vision(&self, now_us: u64) -> bool {
        self.vision.as_ref().is_some_and(|vision| !vision.is_known(now_us))
    }

    /// Processes an external pose, if the position is external.
    pub(super) fn take_outside_pose(&mut self, now_us: u64, pose: &OutsidePose) {
        if let Some(vision) = &mut self.vision {
            vision.take(now_us, pose);
        }
    }

    /// Adds the errors of the external position to the sensed one, if the position is external.
    pub(super) fn correct(
        &self,
        position: &mut Ned,
        velocity: &mut Ned,
        estimator: &mut EstimatorStatus,
    ) {
        if let Some(vision) = &self.vision {
            let [offset, drift] = vision.error();
            *position += offset;
            *velocity += drift;
            estimator.reset_count = estimator.reset_count.wrapping_add(vision.resets());
        }
    }

    /// The autopilot's assessment of the pack.
    pub(super) fn charge_state(&self) -> MavBatteryChargeState {
        let Self { perception, commander, parameters, .. } = self;
        self.personality.charge_state(perception.battery, commander.battery_warnings, parameters)
    }

    /// Reports a change of the estimator's status.
    fn report_estimator(&mut self, before: EstimatorStatus) {
        let now = self.perception.estimator;
        if now.rejects_gps == before.rejects_gps {
            return;
        }
        if let Some(text) = self.personality.gps_text(now.rejects_gps) {
            self.commander.notify(MavSeverity::MAV_SEVERITY_CRITICAL, text);
        }
    }

    /// Whether the land detector reports the vehicle as landed.
    pub fn landed(&self) -> bool {
        self.detector.landed()
    }

    /// Position of arming, m.
    pub fn home(&self) -> Ned {
        self.home
    }

    /// Updates the pilot's sticks.
    pub fn take_sticks(&mut self, now_us: u64, sticks: Sticks) {
        self.sticks = Some((now_us, sticks));
    }

    /// Records a HEARTBEAT from another system.
    pub(super) fn receive_heartbeat(&mut self, now_us: u64, system: u8, kind: MavType) {
        if self.personality.is_ground_station(system, kind, &self.parameters) {
            self.ground_station_us = Some(now_us);
        }
    }

    /// Processes a SET_ATTITUDE_TARGET.
    pub(super) fn receive(
        &mut self,
        now_us: u64,
        message: &SET_ATTITUDE_TARGET_DATA,
        rng: &mut impl Rng,
    ) {
        match self.personality.receive(message, self.commander.mode()) {
            Reception::Fly(setpoint) => {
                self.take_off_height = self.take_off_height.filter(|_| !self.takes_off_here());
                self.stream.receive(now_us, setpoint, rng);
            }
            Reception::Stop => self.stream.clear(),
            Reception::Ignore => {}
        }
    }

    /// Sets a parameter to a value from the wire and returns its index.
    ///
    /// # Errors
    /// As [`Parameters::set_from_wire`].
    pub(super) fn set_parameter(
        &mut self,
        name: &str,
        value: f32,
        kind: MavParamType,
    ) -> Result<usize, SetError> {
        let index = self.parameters.set_from_wire(name, value, kind)?;
        self.attitude_loop.configure(&self.parameters);
        Ok(index)
    }

    /// Whether the offboard stream is younger than COM_OF_LOSS_T.
    pub fn stream_live(&self, now_us: u64) -> bool {
        let timeout = self.parameters.timeout_us(Key::ComOfLossT).unwrap_or(0);
        self.stream.is_live(now_us, timeout)
    }

    /// Changes the mode.
    ///
    /// # Errors
    /// As [`Commander::request_mode`].
    pub fn request_mode(&mut self, now_us: u64, mode: Mode) -> Result<(), Refusal> {
        let stream_live = self.stream_live(now_us);
        let before = self.commander.mode();
        self.commander.request_mode(mode, stream_live)?;
        self.take_off_height = None;
        if before != mode && mode == Mode::Offboard && !self.personality.needs_stream() {
            self.stream.clear();
        }
        Ok(())
    }

    /// Takes off to `height` above home in m, or to MIS_TAKEOFF_ALT; starts once armed.
    ///
    /// # Errors
    /// As [`Commander::request_mode`].
    pub fn request_take_off(&mut self, now_us: u64, height: Option<f64>) -> Result<(), Refusal> {
        if self.takes_off_here() {
            self.stream.clear();
            let usual = self.parameters.get(Key::MisTakeoffAlt);
            self.take_off_height = Some(height.unwrap_or(usual));
        } else {
            self.request_mode(now_us, Mode::Takeoff)?;
            self.take_off_height = height;
        }
        self.guidance.leave();
        Ok(())
    }

    /// Whether a take-off keeps the active mode.
    fn takes_off_here(&self) -> bool {
        self.personality.takes_off_in_offboard() && self.commander.mode() == Mode::Offboard
    }

    /// Arms; `force` skips the checks if the personality allows it.
    ///
    /// # Errors
    /// The first [`Refusal`] of [`FlightControl::preflight`].
    pub fn arm(&mut self, now_us: u64, force: bool) -> Result<(), Refusal> {
        let preflight = self.preflight(now_us);
        let was_armed = self.commander.armed();
        let force = force && self.personality.forced_arming_skips_checks();
        self.commander.arm(now_us, &preflight, force)?;
        if !was_armed {
            self.home = self.perception.position;
            self.guidance.leave();
            self.position_controller.reset();
        }
        Ok(())
    }

    /// Disarms; in the air only with `force`.
    ///
    /// # Errors
    /// As [`Commander::disarm`].
    pub fn disarm(&mut self, force: bool) -> Result<(), Refusal> {
        self.commander.disarm(self.detector.landed(), force)
    }

    /// The inputs of the arming checks at `now_us`.
    pub fn preflight(&self, now_us: u64) -> Preflight {
        let is_ground_station_live = self
            .ground_station_us
            .is_some_and(|at| now_us.saturating_sub(at) < GROUND_STATION_LOST_US);
        Preflight {
            tilt: self.perception.attitude.tilt(),
            tilt_max: self.parameters.get(Key::ComArmLevel),
            battery: self.perception.battery,
            estimate_ok: self.perception.is_finite() && self.position_known(now_us),
            landed: self.detector.landed(),
            mode_can_arm: self.commander.mode_can_arm(),
            stream_missing: self.personality.needs_stream()
                && self.commander.mode() == Mode::Offboard
                && !self.stream_live(now_us),
            ground_station_missing: self.parameters.get(Key::NavDllAct) > 0.0
                && !is_ground_station_live,
        }
    }

    fn live_sticks(&self, now_us: u64) -> Option<Sticks> {
        let timeout = self.parameters.timeout_us(Key::ComRcLossT)?;
        if self.parameters.get(Key::ComRcInMode) >= 4.0 {
            return None;
        }
        let (received_us, sticks) = self.sticks?;
        (now_us.saturating_sub(received_us) < timeout).then_some(sticks)
    }

    /// Runs one tick of the on-board loop.
    pub fn tick(&mut self, now_us: u64, mut perception: Perception) {
        if let Some(vision) = &mut self.vision {
            vision.advance(now_us, perception.position);
        }
        let Perception { position, velocity, estimator, .. } = &mut perception;
        self.correct(position, velocity, estimator);
        let before = std::mem::replace(&mut self.perception, perception);
        self.report_estimator(before.estimator);
        self.watch(now_us);
        self.setpoint = if self.commander.armed() { self.choose_setpoint(now_us) } else { None };
        self.outputs = match &mut self.setpoint {
            Some(setpoint) => {
                let armed_s = now_us.saturating_sub(self.commander.armed_us) as f64 * 1e-6;
                let limit = match self.commander.flown {
                    true => 1.0,
                    false => self.personality.thrust_limit(armed_s, &self.parameters),
                };
                setpoint.thrust = setpoint.thrust.min(limit);
                self.attitude_loop.outputs(&LoopInput {
                    setpoint,
                    new_for_s: self
                        .arrived_us
                        .map(|arrived_us| now_us.saturating_sub(arrived_us) as f64 * 1e-6),
                    attitude: perception.attitude,
                    body_rate: perception.body_rate,
                    landed: self.detector.landed(),
                    dt: self.tick_s,
                })
            }
            None => {
                self.attitude_loop.rest();
                [0.0; ROTORS]
            }
        };
    }

    fn watch(&mut self, now_us: u64) {
        let thrust = self.setpoint.map_or(0.0, |setpoint| setpoint.thrust);
        let attitude = self.setpoint.and_then(|setpoint| setpoint.attitude);
        self.detector.update(
            now_us,
            &Motion {
                velocity: self.perception.velocity,
                body_rate: self.perception.body_rate,
                thrust_over_hover: thrust / self.parameters.get(Key::MpcThrHover),
                requested_tilt: attitude.map_or(0.0, |attitude| attitude.attitude().tilt()),
            },
        );
        let sticks = self.live_sticks(now_us);
        let situation = Situation {
            now_us,
            stream_live: self.stream_live(now_us),
            sticks_live: sticks.is_some(),
            sticks_moved: sticks.is_some_and(|sticks| sticks.moved()),
            sticks_known: self.sticks.is_some(),
            ground_station_age_us: self.ground_station_us.map(|at| now_us.saturating_sub(at)),
            landed: self.detector.landed(),
            climbed: self.guidance.climbed(),
            battery: self.perception.battery,
            voltage: self.perception.voltage,
        };
        self.commander.update(&situation, &self.parameters);
        let mode = self.commander.mode();
        if self.commander.armed()
            && self.lacks_vision(now_us)
            && self.personality.lands_without_position(mode)
        {
            self.commander.fail_over(Mode::Land);
            let text = self.personality.failsafe_text(Mode::Land, "No valid position estimate");
            self.commander.notify(MavSeverity::MAV_SEVERITY_CRITICAL, text);
        }
    }
}
