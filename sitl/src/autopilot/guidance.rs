//! The target of the position controller in every mode except OFFBOARD.

use vehicle::frame::Ned;

use super::Mode;
use super::parameters::{Key, Parameters};
use super::position::PositionTarget;

/// Stopping distance of a moving vehicle over its velocity, s.
const BRAKING_S: f64 = 0.8;
/// Time for a take-off to reach its climb speed, s.
const SPOOL_UP_S: f64 = 1.0;
/// Distance to the target height at which a take-off ends, m.
const CLIMBED_WITHIN_M: f64 = 0.15;
/// Distance to home at which Return starts to descend, m.
const HOME_WITHIN_M: f64 = 0.3;
/// Height above which a landing descends at the vertical speed limit, m.
const SLOW_BELOW_M: f64 = 5.0;
/// Yaw rate of a fully deflected yaw stick, rad/s.
const YAW_RATE_MAX: f64 = 1.5;

/// The pilot's sticks, each -1..1: forward, right, up, clockwise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sticks {
    /// Forward deflection.
    pub forward: f64,
    /// Right deflection.
    pub right: f64,
    /// Up deflection.
    pub up: f64,
    /// Yaw deflection, clockwise seen from above.
    pub turn: f64,
}

impl Sticks {
    /// Deflection below which a stick counts as centred.
    const DEAD_ZONE: f64 = 0.1;

    /// Whether any stick is off centre.
    pub fn moved(&self) -> bool {
        [self.forward, self.right, self.up, self.turn].iter().any(|s| s.abs() > Self::DEAD_ZONE)
    }
}

/// The vehicle's pose and velocity, as inputs of guidance.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// Position, m.
    pub position: Ned,
    /// Velocity, m/s.
    pub velocity: Ned,
    /// Heading, rad.
    pub yaw: f64,
}

/// Home and target height of a flight.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Point of arming, m.
    pub home: Ned,
    /// Down coordinate at which a take-off ends, m.
    pub take_off_down: f64,
}

/// The state of guidance in the active mode.
#[derive(Clone, Debug)]
pub struct Guidance {
    mode: Option<Mode>,
    /// Position to hold, m.
    anchor: Ned,
    yaw: f64,
    /// Down coordinate at which a take-off ends, m.
    take_off_down: f64,
    climb_s: f64,
    climbed: bool,
}

impl Default for Guidance {
    /// Guidance before its first mode.
    fn default() -> Self {
        Self {
            mode: None,
            anchor: Ned::zero(),
            yaw: 0.0,
            take_off_down: 0.0,
            climb_s: 0.0,
            climbed: false,
        }
    }
}

impl Guidance {
    /// Whether a take-off has reached its height.
    pub fn climbed(&self) -> bool {
        self.climbed
    }

    /// Resets guidance: the next tick enters its mode anew from the vehicle's position.
    pub fn leave(&mut self) {
        self.mode = None;
        self.climbed = false;
    }

    fn enter(&mut self, mode: Mode, pose: &Pose, take_off_down: f64) {
        let after_take_off = self.mode == Some(Mode::Takeoff) && mode == Mode::Hold && self.climbed;
        if after_take_off {
            self.anchor = Ned::new(self.anchor.north(), self.anchor.east(), self.take_off_down);
        } else {
            self.anchor = match mode {
                Mode::Takeoff => pose.position,
                _ => pose.position + pose.velocity * BRAKING_S,
            };
            self.yaw = pose.yaw;
        }
        self.take_off_down = take_off_down.min(pose.position.down());
        self.climb_s = 0.0;
        self.climbed = false;
        self.mode = Some(mode);
    }

    /// The target in `mode`, `dt` s after the previous tick.
    ///
    /// `sticks` are the pilot's, if live.
    pub fn target(
        &mut self,
        mode: Mode,
        pose: &Pose,
        plan: &Plan,
        sticks: Option<Sticks>,
        parameters: &Parameters,
        dt: f64,
    ) -> PositionTarget {
        if self.mode != Some(mode) {
            self.enter(mode, pose, plan.take_off_down);
        }
        let home = plan.home;
        match mode {
            Mode::Takeoff => self.climb(pose, parameters, dt),
            Mode::Land => self.descend(pose, home, parameters),
            Mode::Return => {
                let there = Ned::new(home.north(), home.east(), self.anchor.down());
                let away = (pose.position - there).to_array();
                if away[0].hypot(away[1]) < HOME_WITHIN_M {
                    self.anchor = there;
                    self.descend(pose, home, parameters)
                } else {
                    PositionTarget::hold(there, self.yaw)
                }
            }
            Mode::Position => match sticks.filter(Sticks::moved) {
                Some(sticks) => self.follow(sticks, pose, parameters, dt),
                None => PositionTarget::hold(self.anchor, self.yaw),
            },
            Mode::Hold | Mode::Offboard | Mode::Altitude | Mode::Stabilized => {
                PositionTarget::hold(self.anchor, self.yaw)
            }
        }
    }

    fn climb(&mut self, pose: &Pose, parameters: &Parameters, dt: f64) -> PositionTarget {
        self.climb_s += dt;
        let speed = parameters.get(Key::MpcTkoSpeed) * (self.climb_s / SPOOL_UP_S).min(1.0);
        let down = (self.anchor.down() - speed * dt).max(self.take_off_down);
        self.anchor = Ned::new(self.anchor.north(), self.anchor.east(), down);
        self.climbed = pose.position.down() < self.take_off_down + CLIMBED_WITHIN_M;
        let arrived = down <= self.take_off_down;
        PositionTarget {
            velocity: Ned::new(0.0, 0.0, if arrived { 0.0 } else { -speed }),
            ..PositionTarget::hold(self.anchor, self.yaw)
        }
    }

    fn descend(&self, pose: &Pose, home: Ned, parameters: &Parameters) -> PositionTarget {
        let height = home.down() - pose.position.down();
        let slow = parameters.get(Key::MpcLandSpeed);
        let speed = if height > SLOW_BELOW_M { parameters.get(Key::MpcZVelMaxDn) } else { slow };
        PositionTarget {
            position: [Some(self.anchor.north()), Some(self.anchor.east()), None],
            velocity: Ned::new(0.0, 0.0, speed),
            yaw: self.yaw,
        }
    }

    fn follow(
        &mut self,
        sticks: Sticks,
        pose: &Pose,
        parameters: &Parameters,
        dt: f64,
    ) -> PositionTarget {
        self.yaw = vehicle::frame::wrap_angle(self.yaw + sticks.turn * YAW_RATE_MAX * dt);
        self.anchor = pose.position + pose.velocity * BRAKING_S;
        let (sin, cos) = self.yaw.sin_cos();
        let speed = parameters.get(Key::MpcXyVelMax);
        let vertical = if sticks.up > 0.0 { Key::MpcZVelMaxUp } else { Key::MpcZVelMaxDn };
        PositionTarget {
            position: [None; 3],
            velocity: Ned::new(
                (sticks.forward * cos - sticks.right * sin) * speed,
                (sticks.forward * sin + sticks.right * cos) * speed,
                -sticks.up * parameters.get(vertical),
            ),
            yaw: self.yaw,
        }
    }
}
