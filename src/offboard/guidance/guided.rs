//! What guidance gives the controller at each tick.

use vehicle::frame::Ned;

use crate::setpoint::{Expected, Reference};
use crate::supervisor::Trigger;

/// The reference of one tick.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::offboard) struct Guided {
    pub reference: Reference,
    /// Where the vehicle is wanted.
    pub desired: Ned,
    /// Radius of the tube around the reference, m; `None` without a tube.
    pub tube_radius_m: Option<f64>,
    /// Whether feedback acts; on the ground only the feed-forward does.
    pub feedback: bool,
    /// Whether the vehicle is off the ground, where only its setpoints move it.
    pub aloft: bool,
    /// What the reference's model expects; `None` for what it expects at rest.
    pub expected: Option<Expected>,
    /// Whether that model's own trajectory leads.
    pub is_led: bool,
    /// Seconds into the trajectory, while it is tracked.
    pub trajectory_time: Option<f64>,
    /// The trigger that completes the state, once its condition holds.
    pub reached: Option<(Trigger, &'static str)>,
}

impl Guided {
    /// Flies a reference that no model leads.
    pub(super) fn fly(reference: Reference) -> Self {
        Self {
            desired: reference.position,
            tube_radius_m: None,
            reference,
            feedback: true,
            aloft: true,
            expected: None,
            is_led: false,
            trajectory_time: None,
            reached: None,
        }
    }
}
