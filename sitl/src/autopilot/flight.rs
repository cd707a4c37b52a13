//! Flight control: from what is sensed to motor outputs, once per tick of the on-board loop.

use wire::dialect::AttitudeTargetTypemask;

use crate::frame::{Attitude, Frd, Ned};
use crate::vehicle::{AttitudePd, ROTORS, VehicleError, VehicleParams};

use super::Mode;
use super::arming::{Preflight, Refusal};
use super::commander::{Commander, Situation};
use super::guidance::{Guidance, Plan, Pose, Sticks};
use super::land_detector::{LandDetector, Motion};
use super::offboard::{AttitudeSetpoint, OffboardStream};
use super::parameters::{Key, Parameters};
use super::pd::AttitudeLoop;
use super::position::PositionController;

/// A ground station is lost when its last heartbeat is older than this, us.
const GROUND_STATION_LOST_US: u64 = 10_000_000;

/// What the loop sees: the estimate without the latency of its reports, and the battery.
#[derive(Clone, Copy, Debug)]
pub struct Perception {
    /// Position, m.
    pub position: Ned,
    /// Velocity, m/s.
    pub velocity: Ned,
    /// Attitude as reported, trim included.
    pub attitude: Attitude,
    /// Gyro, rad/s.
    pub body_rate: Frd,
    /// Remaining charge, 0..1.
    pub battery: f64,
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
#[derive(Clone, Debug)]
pub struct FlightControl {
    pub(super) parameters: Parameters,
    pub(super) commander: Commander,
    pub(super) stream: OffboardStream,
    guidance: Guidance,
    position_controller: PositionController,
    attitude_loop: AttitudeLoop,
    detector: LandDetector,
    sticks: Option<(u64, Sticks)>,
    ground_station_us: Option<u64>,
    home: Ned,
    take_off_height: Option<f64>,
    perception: Perception,
    setpoint: Option<AttitudeSetpoint>,
    outputs: [f64; ROTORS],
    tick_s: f64,
}

impl FlightControl {
    /// Flight control of `vehicle`, whose loop in its file is `nominal` and in truth `gains`, on
    /// the ground at `perception` or already in the air there.
    ///
    /// # Errors
    /// [`VehicleError`] if the mixer cannot be inverted.
    pub fn new(
        vehicle: &VehicleParams,
        nominal: &AttitudePd,
        gains: AttitudePd,
        command_delay_s: f64,
        perception: Perception,
        airborne: bool,
    ) -> Result<Self, VehicleError> {
        Ok(Self {
            parameters: Parameters::new(vehicle, nominal),
            commander: if airborne { Commander::airborne() } else { Commander::default() },
            stream: OffboardStream::new(command_delay_s),
            guidance: Guidance::default(),
            position_controller: PositionController::new(vehicle.gravity),
            attitude_loop: AttitudeLoop::new(gains, vehicle.allocation()?),
            detector: LandDetector::new(!airborne),
            sticks: None,
            ground_station_us: None,
            home: perception.position,
            take_off_height: None,
            perception,
            setpoint: None,
            outputs: [0.0; ROTORS],
            tick_s: 1.0 / gains.rate_hz,
        })
    }

    /// Whether the motors are armed.
    pub fn armed(&self) -> bool {
        self.commander.armed()
    }

    /// The mode in force.
    pub fn mode(&self) -> Mode {
        self.commander.mode()
    }

    /// The motor outputs in force, 0..1.
    pub fn outputs(&self) -> [f64; ROTORS] {
        self.outputs
    }

    /// The setpoint that the attitude loop tracks, where it runs.
    pub fn setpoint(&self) -> Option<&AttitudeSetpoint> {
        self.setpoint.as_ref()
    }

    /// Whether the vehicle stands on the ground, as far as it knows.
    pub fn landed(&self) -> bool {
        self.detector.landed()
    }

    /// Where the vehicle was armed, m.
    pub fn home(&self) -> Ned {
        self.home
    }

    /// Takes the pilot's sticks.
    pub fn take_sticks(&mut self, now_us: u64, sticks: Sticks) {
        self.sticks = Some((now_us, sticks));
    }

    /// Notes the heartbeat of a ground station.
    pub fn hear_ground_station(&mut self, now_us: u64) {
        self.ground_station_us = Some(now_us);
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
        self.commander.request_mode(mode, stream_live)?;
        self.take_off_height = None;
        Ok(())
    }

    /// Takes off to `height` above home in m, or to MIS_TAKEOFF_ALT; begins once armed.
    ///
    /// # Errors
    /// As [`Commander::request_mode`].
    pub fn request_take_off(&mut self, now_us: u64, height: Option<f64>) -> Result<(), Refusal> {
        self.request_mode(now_us, Mode::Takeoff)?;
        self.guidance.leave();
        self.take_off_height = height;
        Ok(())
    }

    /// Arms.
    ///
    /// # Errors
    /// The first [`Refusal`] of [`FlightControl::preflight`].
    pub fn arm(&mut self, now_us: u64) -> Result<(), Refusal> {
        let preflight = self.preflight(now_us);
        let was_armed = self.commander.armed();
        self.commander.arm(now_us, &preflight)?;
        if !was_armed {
            self.home = self.perception.position;
            self.guidance.leave();
            self.position_controller.reset();
        }
        Ok(())
    }

    /// Disarms; `force` also in the air.
    ///
    /// # Errors
    /// As [`Commander::disarm`].
    pub fn disarm(&mut self, force: bool) -> Result<(), Refusal> {
        self.commander.disarm(self.detector.landed(), force)
    }

    /// What arming would look at now.
    pub fn preflight(&self, now_us: u64) -> Preflight {
        let heard = self
            .ground_station_us
            .is_some_and(|heard| now_us.saturating_sub(heard) < GROUND_STATION_LOST_US);
        Preflight {
            tilt: self.perception.attitude.tilt(),
            tilt_max: self.parameters.get(Key::ComArmLevel),
            battery: self.perception.battery,
            estimate_ok: self.perception.is_finite(),
            landed: self.detector.landed(),
            mode_can_arm: self.commander.mode_can_arm(),
            stream_missing: self.commander.mode() == Mode::Offboard && !self.stream_live(now_us),
            ground_station_missing: self.parameters.get(Key::NavDllAct) > 0.0 && !heard,
        }
    }

    fn live_sticks(&self, now_us: u64) -> Option<Sticks> {
        let timeout = self.parameters.timeout_us(Key::ComRcLossT)?;
        if self.parameters.get(Key::ComRcInMode) >= 4.0 {
            return None;
        }
        let (heard, sticks) = self.sticks?;
        (now_us.saturating_sub(heard) < timeout).then_some(sticks)
    }

    /// One tick of the on-board loop.
    pub fn tick(&mut self, now_us: u64, perception: Perception) {
        self.perception = perception;
        self.watch(now_us);
        self.setpoint = if self.commander.armed() { self.choose_setpoint(now_us) } else { None };
        self.outputs = match &self.setpoint {
            Some(setpoint) => self.attitude_loop.outputs(
                setpoint,
                perception.attitude.euler(),
                perception.body_rate,
            ),
            None => [0.0; ROTORS],
        };
    }

    fn watch(&mut self, now_us: u64) {
        let thrust = self.setpoint.map_or(0.0, |setpoint| setpoint.thrust);
        self.detector.update(
            now_us,
            &Motion {
                velocity: self.perception.velocity,
                body_rate: self.perception.body_rate,
                thrust_over_hover: thrust / self.parameters.get(Key::MpcThrHover),
            },
        );
        let sticks = self.live_sticks(now_us);
        let situation = Situation {
            now_us,
            stream_live: self.stream_live(now_us),
            sticks_live: sticks.is_some(),
            sticks_moved: sticks.is_some_and(|sticks| sticks.moved()),
            landed: self.detector.landed(),
            climbed: self.guidance.climbed(),
            battery: self.perception.battery,
        };
        self.commander.update(&situation, &self.parameters);
    }

    fn choose_setpoint(&mut self, now_us: u64) -> Option<AttitudeSetpoint> {
        // The delay line runs in every mode, so that OFFBOARD begins with the newest setpoint.
        let offboard = self.stream.at(now_us);
        let mode = self.commander.mode();
        if mode == Mode::Offboard {
            self.guidance.leave();
            self.position_controller.reset();
            return offboard;
        }
        let sticks = self.live_sticks(now_us);
        let lifts = mode == Mode::Takeoff
            || (mode == Mode::Position && sticks.is_some_and(|sticks| sticks.up > 0.3));
        if self.detector.landed() && !lifts {
            self.guidance.leave();
            self.position_controller.reset();
            return None;
        }
        let Perception { position, velocity, attitude, .. } = self.perception;
        let pose = Pose { position, velocity, yaw: attitude.euler().yaw };
        let height =
            self.take_off_height.unwrap_or_else(|| self.parameters.get(Key::MisTakeoffAlt));
        let plan = Plan { home: self.home, take_off_down: self.home.down() - height };
        let target =
            self.guidance.target(mode, &pose, &plan, sticks, &self.parameters, self.tick_s);
        let command = self.position_controller.update(
            &target,
            position,
            velocity,
            &self.parameters,
            self.tick_s,
        );
        Some(AttitudeSetpoint {
            attitude: Some(command.attitude),
            body_rate: Frd::zero(),
            thrust: command.thrust,
            type_mask: AttitudeTargetTypemask::empty(),
        })
    }
}
