//! Why telemetry is rejected.

/// Why a state message was rejected.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TelemetryFault {
    /// A value is NaN or infinite, or a quaternion does not have unit length.
    #[error("telemetry with a value that is not finite")]
    NotFinite,
    /// The stamp is not later than the one before.
    #[error("telemetry out of order or duplicated")]
    OutOfOrder,
    /// The message waited on its way.
    #[error("telemetry {seconds:.3} s late")]
    Late {
        /// Delay beyond the minimum.
        seconds: f64,
    },
    /// The position or velocity is not where its motion led.
    #[error("position estimate jumped by {metres:.2} m or its velocity by {metres_per_s:.2} m/s")]
    PositionJump {
        /// Step beyond what the velocity explains.
        metres: f64,
        /// Step of the velocity.
        metres_per_s: f64,
    },
    /// The position departs from its velocity, step by step.
    #[error("position estimate drifted by {metres:.2} m against its velocity")]
    PositionSlide {
        /// Recent distance beyond what the velocity explains.
        metres: f64,
    },
    /// The attitude is not where its rotation led.
    #[error("attitude estimate jumped by {radians:.2} rad")]
    AttitudeJump {
        /// Step beyond what the body rate explains.
        radians: f64,
    },
    /// The vehicle repeats one state in flight.
    #[error("the vehicle has repeated the same state for {seconds:.2} s")]
    Frozen {
        /// Time without a change.
        seconds: f64,
    },
    /// ODOMETRY.reset_counter changed.
    #[error("the vehicle reset its estimate")]
    EstimateReset,
    /// The vehicle's clock stepped forward.
    #[error("the vehicle's clock jumped by {seconds:.1} s")]
    ClockJump {
        /// Step beyond the host's elapsed time.
        seconds: f64,
    },
    /// The vehicle's clock went back: it restarted.
    #[error("the vehicle restarted: its clock went back by {seconds:.1} s")]
    Reboot {
        /// Step backwards.
        seconds: f64,
    },
}

impl TelemetryFault {
    /// Whether the estimate that control relied on is no longer valid, rather than one message
    /// being of no use.
    pub fn is_jump(&self) -> bool {
        !matches!(
            self,
            Self::NotFinite | Self::OutOfOrder | Self::Late { .. } | Self::Frozen { .. }
        )
    }
}
