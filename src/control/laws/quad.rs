//! The quadrotor that the laws' tests fly.

use super::{ControlProblem, ControlSettings};
use crate::control::{Actuation, AttitudeLoop, HoverVehicle, Limits};

pub const QUAD: HoverVehicle =
    HoverVehicle { mass_kg: 1.2, inertia: [0.0112, 0.0123, 0.0206], gravity: 9.81 };
pub const PD: AttitudeLoop = AttitudeLoop::Pd { kp: [1.46, 1.6, 0.355], kd: [0.19, 0.22, 0.163] };

/// Calls `design` for this quadrotor, with setpoints that act at once.
pub fn designed<L>(design: impl FnOnce(&ControlProblem) -> L) -> L {
    design(&ControlProblem {
        vehicle: &QUAD,
        actuation: &Actuation::IMMEDIATE,
        attitude_loop: &PD,
        limits: &Limits::default(),
        settings: &ControlSettings::default(),
    })
}
