//! The reference without a dynamics model.

use std::sync::Arc;

use vehicle::frame::{Euler, Frd, wrap_angle};

use super::flat::FlatReference;
use super::reference::{FeedForward, ReferenceSource};
use super::trajectory::Trajectory;
use crate::setpoint::{Reference, Setpoint};

/// The desired position, velocity, yaw and yaw rate as the reference state, and hover thrust,
/// level, at the desired yaw and yaw rate as the feed-forward: feedback alone moves the vehicle
/// along the trajectory. This is the baseline for planned references.
#[derive(Clone, Debug)]
pub struct ModelFreeReference {
    trajectory: Trajectory,
    hover_thrust_n: f64,
}

impl ModelFreeReference {
    /// `hover_thrust_n` is the vehicle's effective weight m g in N.
    pub fn new(trajectory: Trajectory, hover_thrust_n: f64) -> Self {
        Self { trajectory, hover_thrust_n }
    }
}

impl ReferenceSource for ModelFreeReference {
    fn duration(&self) -> f64 {
        self.trajectory.duration()
    }

    fn sample(&self, t: f64) -> Reference {
        model_free(&self.trajectory, t, self.hover_thrust_n)
    }

    fn with_feed_forward(
        &self,
        feed_forward: &FeedForward,
    ) -> Option<Arc<dyn ReferenceSource + Send + Sync>> {
        Some(Arc::new(FlatReference::new(self.trajectory.clone(), feed_forward)))
    }
}

/// The reference at `t` seconds.
pub(super) fn model_free(trajectory: &Trajectory, t: f64, hover_thrust_n: f64) -> Reference {
    let point = trajectory.sample(t);
    let attitude = Euler::new(0.0, 0.0, wrap_angle(point.yaw));
    let body_rate = Frd::new(0.0, 0.0, point.yaw_rate);
    let input = Setpoint { thrust_n: hover_thrust_n, attitude, body_rate };
    Reference::led_by(input, point.position, point.velocity)
}
