//! Why telemetry is not acted upon.

/// Telemetry that was not acted upon, and why.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TelemetryFault {
    /// NaN, infinite, or a quaternion that is not a rotation.
    #[error("telemetry with a value that is not finite")]
    NotFinite,
    /// A stamp that is not after the one before.
    #[error("telemetry out of order or twice")]
    OutOfOrder,
    /// It waited somewhere on its way.
    #[error("telemetry {seconds:.3} s late")]
    Late {
        /// Beyond the least delay.
        seconds: f64,
    },
    /// The position or velocity is not where it was heading.
    #[error("position estimate jumped by {metres:.2} m or its velocity by {metres_per_s:.2} m/s")]
    PositionJump {
        /// Step beyond what velocity explains.
        metres: f64,
        /// Step of the velocity.
        metres_per_s: f64,
    },
    /// The position goes elsewhere than its velocity, step by step.
    #[error("position estimate slid by {metres:.2} m beside its velocity")]
    PositionSlide {
        /// Of late, beyond what velocity explains.
        metres: f64,
    },
    /// The attitude is not where it was turning to.
    #[error("attitude estimate jumped by {radians:.2} rad")]
    AttitudeJump {
        /// Step beyond what the body rate explains.
        radians: f64,
    },
    /// The vehicle repeats one state in flight.
    #[error("the state has been told unchanged for {seconds:.2} s")]
    Frozen {
        /// For how long.
        seconds: f64,
    },
    /// ODOMETRY.reset_counter changed.
    #[error("the vehicle reset its estimate")]
    EstimateReset,
    /// The vehicle's clock stepped forward.
    #[error("the vehicle's clock jumped by {seconds:.1} s")]
    ClockJump {
        /// Beyond the host's time passed.
        seconds: f64,
    },
    /// The vehicle's clock went back: it restarted.
    #[error("the vehicle restarted: its clock went back by {seconds:.1} s")]
    Reboot {
        /// By how much.
        seconds: f64,
    },
}

impl TelemetryFault {
    /// Whether the estimate is no longer the one that control was relying on, rather than one
    /// message being of no use.
    pub fn is_jump(&self) -> bool {
        !matches!(
            self,
            Self::NotFinite | Self::OutOfOrder | Self::Late { .. } | Self::Frozen { .. }
        )
    }
}
