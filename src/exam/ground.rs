//! A minimal ground station that flies a motion: it responds to each position with a setpoint from
//! the daemon's controller, designed for the nominal vehicle.

use mavlink::MessageData;
use sitl::autopilot::Mode;
use sitl::autopilot::offboard::AttitudeSetpoint;
use vehicle::VehicleParams;
use vehicle::effects::{EffectSet, PdGain};
use vehicle::frame::{Attitude, Euler, Frd, Heading, Ned};
use vehicle::physics::Physics;
use wire::dialect::*;
use wire::{Encoder, Frame};

use super::motion::Motion;
use crate::control::{
    Actuation, AttitudeLoop, ControlProblem, ControlSettings, Controller, HoverVehicle, Limits,
};
use crate::plan::DesiredPoint;
use crate::setpoint::{Reference, Setpoint, State};

/// MAVLink identity of the ground station.
const SYSTEM: u8 = 255;
const COMPONENT: u8 = 190;
/// Limit of the desired tilt, rad: the flights are bolder than a careful pilot.
const TILT_MAX: f64 = 0.9;
/// Time step for the rate of the desired attitude, s.
const RATE_SPAN_S: f64 = 0.01;

/// Requested message rates, Hz; 0 for none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// ATTITUDE_QUATERNION.
    pub attitude: f64,
    /// HIGHRES_IMU.
    pub imu: f64,
    /// LOCAL_POSITION_NED.
    pub position: f64,
    /// ACTUATOR_OUTPUT_STATUS.
    pub outputs: f64,
    /// BATTERY_STATUS.
    pub battery: f64,
    /// ESC_STATUS.
    pub rpm: f64,
}

/// Reasons that the ground station cannot fly a vehicle.
#[derive(Debug, thiserror::Error)]
pub enum GroundError {
    /// The physics rejects the vehicle.
    #[error(transparent)]
    Vehicle(#[from] vehicle::VehicleError),
    /// The design of the controller fails.
    #[error(transparent)]
    Design(#[from] crate::control::DesignError),
    /// The file has no on-board loop.
    #[error("vehicle {0}: the file has no on-board loop, which exam flights need")]
    NoLoop(String),
}

/// A ground station for one vehicle.
pub struct Ground {
    controller: Controller,
    limits: Limits,
    hover: HoverVehicle,
    thrust_full_n: f64,
    encoder: Encoder,
    attitude: Option<Attitude>,
    body_rate: Frd,
}

impl Ground {
    /// A ground station for the vehicle in a file.
    ///
    /// # Errors
    /// [`GroundError`].
    pub fn new(vehicle: &VehicleParams) -> Result<Self, GroundError> {
        let physics = Physics::new(vehicle, &EffectSet::new())?;
        let constants = physics.constants();
        let pd = vehicle.attitude_loop_pd();
        let pd = pd.ok_or_else(|| GroundError::NoLoop(vehicle.name.clone()))?;
        let gains = vehicle.modelled_effects.get::<PdGain>();
        let pd = gains.map_or(pd, |gains| gains.apply(&pd));
        let hover = HoverVehicle {
            mass_kg: constants.mass,
            inertia: constants.inertia,
            gravity: vehicle.gravity,
        };
        let actuation = Actuation {
            command_delay_s: vehicle.command_delay_s,
            motor_time_constant_s: constants.motor_time_constant,
        };
        let attitude_loop = AttitudeLoop::from(pd);
        let limits = Limits { tilt_max_rad: TILT_MAX, ..Limits::default() };
        let controller = Controller::design(&ControlProblem {
            vehicle: &hover,
            actuation: &actuation,
            attitude_loop: &attitude_loop,
            limits: &limits,
            settings: &ControlSettings::default(),
        })?;
        Ok(Self {
            controller,
            limits,
            hover,
            thrust_full_n: vehicle.thrust_full_n(),
            encoder: Encoder::new(SYSTEM, COMPONENT),
            attitude: None,
            body_rate: Frd::zero(),
        })
    }

    /// Its HEARTBEAT frame.
    pub fn heartbeat(&mut self) -> Vec<u8> {
        self.encoded(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype: MavType::MAV_TYPE_GCS,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            base_mode: MavModeFlag::empty(),
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        }))
    }

    /// Requests for the streams in `rates`; other streams are switched off.
    pub fn requests(&mut self, rates: &Rates) -> Vec<Vec<u8>> {
        [
            (ATTITUDE_QUATERNION_DATA::ID, rates.attitude),
            (HIGHRES_IMU_DATA::ID, rates.imu),
            (LOCAL_POSITION_NED_DATA::ID, rates.position),
            (ACTUATOR_OUTPUT_STATUS_DATA::ID, rates.outputs),
            (BATTERY_STATUS_DATA::ID, rates.battery),
            (ESC_STATUS_DATA::ID, rates.rpm),
            (ATTITUDE_DATA::ID, 0.0),
            (ODOMETRY_DATA::ID, 0.0),
            (ATTITUDE_TARGET_DATA::ID, 0.0),
            (SERVO_OUTPUT_RAW_DATA::ID, 0.0),
            (TIMESYNC_DATA::ID, 0.0),
            (GLOBAL_POSITION_INT_DATA::ID, 0.0),
            (VFR_HUD_DATA::ID, 0.0),
            (ALTITUDE_DATA::ID, 0.0),
            (GPS_RAW_INT_DATA::ID, 0.0),
        ]
        .into_iter()
        .map(|(id, rate)| {
            let interval_us = if rate > 0.0 { (1e6 / rate) as f32 } else { -1.0 };
            self.command(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, [id as f32, interval_us, 0.0])
        })
        .collect()
    }

    /// The request for OFFBOARD mode.
    pub fn offboard(&mut self) -> Vec<u8> {
        let [_, _, main, sub] = Mode::Offboard.custom_mode().to_le_bytes();
        let parameters = [1.0, f32::from(main), f32::from(sub)];
        self.command(MavCmd::MAV_CMD_DO_SET_MODE, parameters)
    }

    fn command(&mut self, command: MavCmd, [param1, param2, param3]: [f32; 3]) -> Vec<u8> {
        self.encoded(&MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            param1,
            param2,
            param3,
            command,
            target_system: 1,
            target_component: 1,
            ..Default::default()
        }))
    }

    fn encoded(&mut self, message: &MavMessage) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.encoder.encode(message, &mut bytes);
        bytes
    }

    /// Processes a frame of the vehicle. A position yields a setpoint towards `motion` at `time`
    /// (s) into it: the frame, and the setpoint that the vehicle will decode from it.
    pub fn receive(
        &mut self,
        frame: &Frame,
        motion: &Motion,
        time: f64,
    ) -> Option<(Vec<u8>, AttitudeSetpoint)> {
        match frame.message().ok()? {
            MavMessage::ATTITUDE_QUATERNION(data) => {
                self.attitude = Attitude::from_wire([data.q1, data.q2, data.q3, data.q4]);
                self.body_rate =
                    [data.rollspeed, data.pitchspeed, data.yawspeed].map(f64::from).into();
                None
            }
            MavMessage::LOCAL_POSITION_NED(data) => {
                let state = State {
                    position: Ned::from([data.x, data.y, data.z].map(f64::from)),
                    velocity: Ned::from([data.vx, data.vy, data.vz].map(f64::from)),
                    attitude: self.attitude?,
                    body_rate: self.body_rate,
                };
                self.setpoint(&state, motion, time)
            }
            _ => None,
        }
    }

    fn setpoint(
        &mut self,
        state: &State,
        motion: &Motion,
        time: f64,
    ) -> Option<(Vec<u8>, AttitudeSetpoint)> {
        let reference = self.reference(motion, time);
        let command = self.controller.command(time, state, &reference);
        let yaw = state.attitude.yaw();
        let (setpoint, _) = self.limits.apply(command.setpoint, self.thrust_full_n, yaw)?;
        let [p, q, r] = setpoint.body_rate.to_array().map(|rate| rate as f32);
        let data = SET_ATTITUDE_TARGET_DATA {
            time_boot_ms: (time.max(0.0) * 1e3) as u32,
            q: setpoint.attitude.attitude().normalized().to_wire(),
            body_roll_rate: p,
            body_pitch_rate: q,
            body_yaw_rate: r,
            thrust: (setpoint.thrust_n / self.thrust_full_n) as f32,
            type_mask: AttitudeTargetTypemask::empty(),
            target_system: 1,
            target_component: 1,
            ..Default::default()
        };
        let understood = AttitudeSetpoint::from_message(&data)?;
        Some((self.encoded(&MavMessage::SET_ATTITUDE_TARGET(data)), understood))
    }

    /// A quadrotor is differentially flat: the thrust carries the weight and provides the
    /// acceleration, which with the yaw determines the attitude.
    fn reference(&self, motion: &Motion, time: f64) -> Reference {
        let point = motion.sample(time);
        let (thrust_n, attitude) = self.thrust_and_attitude(&point);
        let (_, later) = self.thrust_and_attitude(&motion.sample(time + RATE_SPAN_S));
        let rates = [
            (later.roll - attitude.roll) / RATE_SPAN_S,
            (later.pitch - attitude.pitch) / RATE_SPAN_S,
            point.yaw_rate,
        ];
        let bounded = rates.map(|rate| rate.clamp(-4.0, 4.0));
        let body_rate = attitude.body_rate(bounded);
        let attitude = Euler { yaw: vehicle::frame::wrap_angle(attitude.yaw), ..attitude };
        let input = Setpoint { thrust_n, attitude, body_rate };
        Reference::led_by(input, point.position, point.velocity)
    }

    fn thrust_and_attitude(&self, point: &DesiredPoint) -> (f64, Euler) {
        let carried = Ned::new(0.0, 0.0, self.hover.gravity) - point.acceleration;
        let [ahead, right, down] = Heading::new(point.yaw).to_level(carried);
        let down = down.max(0.3 * self.hover.gravity);
        let length = (ahead * ahead + right * right + down * down).sqrt();
        let roll = (-right / length).clamp(-1.0, 1.0).asin();
        (self.hover.mass_kg * length, Euler::new(roll, ahead.atan2(down), point.yaw))
    }
}
