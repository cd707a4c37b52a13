//! Recording of a vehicle after its flight ended early.

use std::time::Duration;

use message::LandedState;

use crate::clock::HostTime;
use crate::telemetry::VehicleStatus;

/// The longest recording after a flight's early end.
pub(super) const LIMIT: Duration = Duration::from_secs(10);
/// Recording continues for this long after the vehicle reports that it is down: one whose motors
/// stopped in the air is still falling.
const SETTLING: Duration = Duration::from_secs(2);

/// The time after a flight's early end, in which the vehicle comes down without the controller.
pub(super) struct Aftermath {
    until: HostTime,
}

impl Aftermath {
    /// Starts at the flight's end.
    pub fn new(now: HostTime) -> Self {
        Self { until: now + LIMIT }
    }

    /// Whether the recording ends; shortens it once the vehicle is down.
    pub fn is_over(&mut self, now: HostTime, status: &VehicleStatus) -> bool {
        let is_down = status.armed == Some(false) || status.landed == LandedState::OnGround;
        if is_down {
            self.until = self.until.min(now + SETTLING);
        }
        now >= self.until
    }
}
