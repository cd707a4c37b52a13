//! Estimator latency: reported pose and velocity show the state latency_s before their time stamp;
//! body rates, IMU and the on-board loop have no latency.

use super::{Effect, EffectId, Need, Parameter, Slots, Spec, slots};

/// Age of the reported pose and velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimatorLatency {
    /// Age in s.
    pub latency_s: f64,
}

impl Effect for EstimatorLatency {
    const ID: EffectId = EffectId::EstimatorLatency;
    const SPEC: Spec = Spec {
        id: "estimator_latency",
        parameters: &[Parameter::scalar("latency_s", "s", 0.0, [0.0, 1.0])],
        needs: &[Need::Pose, Need::Imu],
        typical: |_| slots([0.04]),
        strong: |_, _, growth| growth.by[0] = 0.09,
        ..Spec::PLAIN
    };

    fn from_slots(&[latency_s, ..]: &Slots) -> Self {
        Self { latency_s }
    }
}
