//! The setpoint of a tick: from the offboard stream, from guidance to a place, or from the sticks.

use vehicle::frame::{Euler, Frd, Ned};
use wire::dialect::AttitudeTargetTypemask;

use super::{FlightControl, Perception};
use crate::autopilot::Mode;
use crate::autopilot::guidance::{Plan, Pose, Sticks};
use crate::autopilot::offboard::AttitudeSetpoint;
use crate::autopilot::parameters::Key;
use crate::autopilot::personality::{Pursuit, StreamState};
use crate::autopilot::position::PositionTarget;

impl FlightControl {
    /// The setpoint that the on-board loop flies in this tick; `None` leaves the motors idle.
    pub(super) fn choose_setpoint(&mut self, now_us: u64) -> Option<AttitudeSetpoint> {
        // The delay line runs in every mode, so OFFBOARD starts with the newest setpoint.
        let setpoint = self.stream.at(now_us);
        self.arrived_us = None;
        let mode = self.commander.mode();
        if mode != Mode::Offboard {
            return self.guided(now_us, mode);
        }
        if self.takes_off_here() && self.take_off_height.is_some() {
            return self.guided(now_us, Mode::Takeoff);
        }
        let pursuit = self.personality.pursue(
            &StreamState {
                setpoint,
                is_live: self.stream_live(now_us),
                yaw: self.perception.attitude.yaw(),
                landed: self.detector.landed(),
            },
            &self.parameters,
        );
        match pursuit {
            Pursuit::Setpoint(setpoint) => {
                self.guidance.leave();
                self.position_controller.reset();
                self.arrived_us = self.stream.arrived_us();
                setpoint
            }
            Pursuit::Climb(setpoint, rate_m_s) => {
                self.guidance.leave();
                Some(self.climbing(setpoint, rate_m_s))
            }
            Pursuit::Hold => self.guided(now_us, Mode::Hold),
        }
    }

    /// `setpoint` with the thrust for a climb rate in m/s.
    fn climbing(&mut self, setpoint: AttitudeSetpoint, rate_m_s: f64) -> AttitudeSetpoint {
        let Perception { position, velocity, attitude, .. } = self.perception;
        let target = PositionTarget {
            position: [None; 3],
            // The horizontal target is the present motion: only the height is controlled.
            velocity: Ned::new(velocity.north(), velocity.east(), -rate_m_s),
            yaw: attitude.yaw(),
        };
        let level = self.position_controller.update(
            &target,
            position,
            velocity,
            &self.parameters,
            self.tick_s,
        );
        let thrust = (level.thrust / attitude.tilt().cos().max(0.5)).min(1.0);
        AttitudeSetpoint { thrust, ..setpoint }
    }

    /// The setpoint of guidance and position control in `mode`.
    fn guided(&mut self, now_us: u64, mode: Mode) -> Option<AttitudeSetpoint> {
        let sticks = self.live_sticks(now_us).or(self.personality.sticks_without_radio());
        let up = sticks.map_or(0.0, |sticks| sticks.up);
        let lifts = match mode {
            Mode::Takeoff => true,
            Mode::Position | Mode::Altitude => up > 0.3,
            Mode::Stabilized => up > -0.9,
            _ => false,
        };
        if self.detector.landed() && !lifts {
            self.guidance.leave();
            self.position_controller.reset();
            return None;
        }
        let Perception { position, velocity, attitude, .. } = self.perception;
        let pose = Pose { position, velocity, yaw: attitude.euler().yaw };
        if matches!(mode, Mode::Altitude | Mode::Stabilized) {
            return Some(self.by_hand(mode, sticks.unwrap_or_default()));
        }
        if self.lacks_vision(now_us) {
            return Some(self.blind_descent());
        }
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

    /// Level attitude and a descent at landing speed, the only option without a position.
    fn blind_descent(&mut self) -> AttitudeSetpoint {
        self.guidance.leave();
        let level = AttitudeSetpoint {
            attitude: Some(Euler::new(0.0, 0.0, self.perception.attitude.yaw())),
            body_rate: Frd::zero(),
            thrust: 0.0,
            type_mask: AttitudeTargetTypemask::empty(),
        };
        self.climbing(level, -self.parameters.get(Key::MpcLandSpeed))
    }

    /// The setpoint from the sticks, which set the tilt and the climb rate or thrust.
    fn by_hand(&mut self, mode: Mode, sticks: Sticks) -> AttitudeSetpoint {
        self.guidance.leave();
        let tilt_max = self.parameters.get(Key::MpcTiltMaxAir).to_radians();
        let yaw = self.perception.attitude.yaw();
        let attitude = Euler::new(sticks.right * tilt_max, -sticks.forward * tilt_max, yaw);
        let by_stick = AttitudeSetpoint {
            attitude: Some(attitude),
            body_rate: Frd::zero(),
            thrust: 0.5 * (sticks.up + 1.0),
            type_mask: AttitudeTargetTypemask::empty(),
        };
        if mode == Mode::Stabilized {
            return by_stick;
        }
        let limit = if sticks.up > 0.0 { Key::MpcZVelMaxUp } else { Key::MpcZVelMaxDn };
        let rate_m_s = sticks.up * self.parameters.get(limit);
        self.climbing(by_stick, rate_m_s)
    }
}
