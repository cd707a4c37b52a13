//! What is recorded of a vehicle after its flight ended early.

use std::time::Duration;

use message::LandedState;

use crate::clock::HostTime;
use crate::telemetry::VehicleStatus;

/// The longest that is recorded after a flight's early end.
pub(super) const LIMIT: Duration = Duration::from_secs(10);
/// Recorded after the vehicle says that it is down: one whose motors stopped in the air still
/// falls.
const SETTLING: Duration = Duration::from_secs(2);

/// The time after a flight that ended early, in which the vehicle comes down without us.
pub(super) struct Aftermath {
    until: HostTime,
}

impl Aftermath {
    /// The flight ended now.
    pub fn new(now: HostTime) -> Self {
        Self { until: now + LIMIT }
    }

    /// Whether nothing more is to be seen.
    pub fn is_over(&mut self, now: HostTime, status: &VehicleStatus) -> bool {
        let is_down = status.armed == Some(false) || status.landed == LandedState::OnGround;
        if is_down {
            self.until = self.until.min(now + SETTLING);
        }
        now >= self.until
    }
}
