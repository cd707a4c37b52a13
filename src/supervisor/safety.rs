//! Faults in flight and the reactions to them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::table::Trigger;
use crate::telemetry::LateMessages;

/// The reaction to a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reaction {
    /// Reports an event; the flight goes on.
    Warn,
    /// Keeps control, holds the present place, then lands.
    Hold,
    /// Requests that the vehicle land itself.
    Land,
    /// Stops the stream at once; the vehicle's own offboard-loss failsafe acts.
    Stop,
}

impl Reaction {
    pub(super) fn trigger(self) -> Option<Trigger> {
        match self {
            Self::Warn => None,
            Self::Hold => Some(Trigger::HoldNow),
            Self::Land => Some(Trigger::LandNow),
            Self::Stop => Some(Trigger::StopNow),
        }
    }
}

/// A fault in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// No sample for too long.
    StaleTelemetry,
    /// The estimate jumped.
    TelemetryJump,
    /// The round trip is so long that setpoints are outdated when they reach the vehicle.
    SlowLink,
    /// Too far from the reference for too long.
    TrackingError,
    /// Tilted too far for too long.
    Tilt,
    /// Outside the fence.
    Geofence,
    /// The battery is low.
    Battery,
    /// The vehicle declares a failsafe but still obeys setpoints.
    Failsafe,
    /// The vehicle calls its position estimate unhealthy but still sends it.
    PositionLost,
}

/// Every fault.
pub(super) const FAULTS: [Fault; 9] = [
    Fault::StaleTelemetry,
    Fault::TelemetryJump,
    Fault::SlowLink,
    Fault::TrackingError,
    Fault::Tilt,
    Fault::Geofence,
    Fault::Battery,
    Fault::Failsafe,
    Fault::PositionLost,
];

/// Excess over the largest distance from the reference, as a share of it, that is not tolerated for
/// any time.
const PATIENCE_ENDS: f64 = 0.5;

/// Share of `tracking_error_for_s` to wait while the reference is not a number and no setpoint
/// follows from it: 0.1 s by default. Autopilots act by themselves from 0.2 s on.
const NO_REFERENCE_SHARE: f64 = 0.2;

/// The condition and the reaction of each fault. Link loss has no setting: it stops the stream.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SafetySettings {
    /// Age of the state that is a fault, s. No setpoint leaves without a fresh sample anyway.
    pub stale_after_s: f64,
    /// Reaction to a stale state: the vehicle lands itself, because the controller does not know
    /// where it is.
    pub on_stale: Reaction,
    /// Reaction to a jump of the estimate: the new position is held.
    pub on_jump: Reaction,
    /// Longest round trip of a TIMESYNC, s. While the state is fresh, only the path to the vehicle
    /// can lengthen it, and setpoints take as long. The default leaves room to 0.28 s, where every
    /// control law lost the vehicle in some simulated flights. A request that the vehicle answers
    /// again, this much later, counts too: old setpoints then reach it among the new ones.
    pub round_trip_max_s: f64,
    /// Time above that round trip, s.
    pub round_trip_for_s: f64,
    /// Reaction to a slow link: the vehicle lands itself.
    pub on_slow_link: Reaction,
    /// Largest distance from the reference, m.
    pub tracking_error_max_m: f64,
    /// Time beyond that distance, s. It shrinks with the excess and is zero at 1.5 times the
    /// distance.
    pub tracking_error_for_s: f64,
    /// Reaction to a distance beyond the limit.
    pub on_tracking_error: Reaction,
    /// Largest tilt, rad.
    pub tilt_max_rad: f64,
    /// Time beyond that tilt, s.
    pub tilt_for_s: f64,
    /// Reaction to a tilt beyond the limit.
    pub on_tilt: Reaction,
    /// Largest horizontal distance from the anchor, m.
    pub fence_radius_m: f64,
    /// Largest height above the anchor, m.
    pub fence_height_m: f64,
    /// Reaction outside the fence.
    pub on_geofence: Reaction,
    /// Least remaining charge, 0..1.
    pub battery_min: f64,
    /// Time below that charge, s. A single report can be wrong.
    pub battery_for_s: f64,
    /// Reaction to a low charge, also where the vehicle calls its battery critical.
    pub on_battery: Reaction,
    /// Time for which the vehicle stays in OFFBOARD after it declares a failsafe, s.
    pub failsafe_for_s: f64,
    /// Reaction to a declared failsafe.
    pub on_failsafe: Reaction,
    /// Time for which the vehicle calls a position estimate unhealthy that it called healthy
    /// before, s. Such an estimate drifts by metres, and feedback would follow it.
    pub position_lost_for_s: f64,
    /// Reaction to an unhealthy position estimate.
    pub on_position_lost: Reaction,
}

impl Default for SafetySettings {
    fn default() -> Self {
        Self {
            stale_after_s: 0.5,
            on_stale: Reaction::Land,
            on_jump: Reaction::Hold,
            round_trip_max_s: 0.2,
            round_trip_for_s: 0.3,
            on_slow_link: Reaction::Land,
            tracking_error_max_m: 2.0,
            tracking_error_for_s: 0.5,
            on_tracking_error: Reaction::Land,
            tilt_max_rad: 1.05,
            tilt_for_s: 0.15,
            on_tilt: Reaction::Land,
            fence_radius_m: 30.0,
            fence_height_m: 30.0,
            on_geofence: Reaction::Land,
            battery_min: 0.15,
            battery_for_s: 3.0,
            on_battery: Reaction::Land,
            failsafe_for_s: 1.5,
            on_failsafe: Reaction::Land,
            position_lost_for_s: 0.5,
            on_position_lost: Reaction::Land,
        }
    }
}

/// How late setpoints reach the vehicle, as its answers to TIMESYNC show.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UplinkDelay {
    /// Round trip of the newest answer, s; `None` where none arrived recently.
    pub round_trip_s: Option<f64>,
    /// Time from the first to the second answer to one request, s, if the vehicle recently answered
    /// one again. The link then carries old setpoints to it again, too.
    pub again_s: Option<f64>,
}

impl UplinkDelay {
    /// The larger of the two, s.
    pub fn largest_s(&self) -> Option<f64> {
        let times = [self.round_trip_s, self.again_s].into_iter().flatten();
        times.max_by(f64::total_cmp)
    }
}

/// The quantities that faults are judged by. NaN counts as beyond every limit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FlightCondition<'a> {
    /// Age of the newest sample, s.
    pub sample_age_s: f64,
    /// Messages since that sample which arrived too late to count as one.
    pub late: LateMessages,
    /// Whether the estimate jumped since the last observation.
    pub jumped: bool,
    /// Delay on the way to the vehicle.
    pub uplink: UplinkDelay,
    /// Whether setpoints may recently not have reached the vehicle.
    pub was_unreachable: bool,
    /// Distance from the reference, m.
    pub tracking_error_m: f64,
    /// Tilt from level, rad.
    pub tilt_rad: f64,
    /// Horizontal distance from the anchor, m.
    pub radius_m: f64,
    /// Height above the anchor, m.
    pub height_m: f64,
    /// Remaining charge, where known.
    pub battery: Option<f64>,
    /// Whether the vehicle calls its battery critical.
    pub battery_critical: bool,
    /// The failsafe that the vehicle declared since control began.
    pub failsafe: Option<&'a str>,
    /// Whether the vehicle calls its position estimate unhealthy after it called it healthy.
    pub position_lost: bool,
}

impl SafetySettings {
    /// Whether setpoints reach the vehicle too late, or again too late.
    pub fn is_link_slow(&self, uplink: UplinkDelay) -> bool {
        uplink.largest_s().is_some_and(|time_s| time_s > self.round_trip_max_s)
    }

    /// Whether the fault's condition holds now.
    pub(super) fn holds(&self, fault: Fault, c: &FlightCondition) -> bool {
        let beyond = |value: f64, limit: f64| value > limit || value.is_nan();
        match fault {
            Fault::StaleTelemetry => beyond(c.sample_age_s, self.stale_after_s),
            Fault::TelemetryJump => c.jumped,
            Fault::SlowLink => self.is_link_slow(c.uplink),
            Fault::TrackingError => beyond(c.tracking_error_m, self.tracking_error_max_m),
            Fault::Tilt => beyond(c.tilt_rad, self.tilt_max_rad),
            Fault::Geofence => {
                beyond(c.radius_m, self.fence_radius_m) || beyond(c.height_m, self.fence_height_m)
            }
            Fault::Battery => {
                c.battery.is_some_and(|left| left < self.battery_min) || c.battery_critical
            }
            Fault::Failsafe => c.failsafe.is_some(),
            Fault::PositionLost => c.position_lost,
        }
    }

    /// Time for which the condition must hold before the reaction, s.
    pub(super) fn dwell_s(&self, fault: Fault, c: &FlightCondition) -> f64 {
        match fault {
            Fault::SlowLink => self.round_trip_for_s,
            Fault::TrackingError => self.tracking_error_for_s * self.patience(c.tracking_error_m),
            Fault::Tilt => self.tilt_for_s,
            Fault::Battery => self.battery_for_s,
            Fault::Failsafe => self.failsafe_for_s,
            Fault::PositionLost => self.position_lost_for_s,
            Fault::StaleTelemetry | Fault::TelemetryJump | Fault::Geofence => 0.0,
        }
    }

    /// Share of `tracking_error_for_s` to wait: all of it at the limit, none at 1.5 times the
    /// limit. A vehicle that drifts off at metres per second is not coming back. Without a number
    /// for reference it is [`NO_REFERENCE_SHARE`].
    fn patience(&self, tracking_error_m: f64) -> f64 {
        let beyond = tracking_error_m / self.tracking_error_max_m - 1.0;
        if beyond.is_nan() {
            NO_REFERENCE_SHARE
        } else {
            (1.0 - beyond / PATIENCE_ENDS).clamp(0.0, 1.0)
        }
    }

    /// The reaction to the fault.
    pub fn reaction(&self, fault: Fault) -> Reaction {
        match fault {
            Fault::StaleTelemetry => self.on_stale,
            Fault::TelemetryJump => self.on_jump,
            Fault::SlowLink => self.on_slow_link,
            Fault::TrackingError => self.on_tracking_error,
            Fault::Tilt => self.on_tilt,
            Fault::Geofence => self.on_geofence,
            Fault::Battery => self.on_battery,
            Fault::Failsafe => self.on_failsafe,
            Fault::PositionLost => self.on_position_lost,
        }
    }

    /// Share of `land_brake_s` for which feedback may brake a vehicle that the fault lands. It is 0
    /// where the state, the attitude or the path to the vehicle is in doubt, or where the vehicle
    /// received its setpoints and feedback still did not keep it near the reference.
    pub(super) fn brake_share(&self, fault: Fault, c: &FlightCondition) -> f64 {
        match fault {
            Fault::StaleTelemetry
            | Fault::TelemetryJump
            | Fault::SlowLink
            | Fault::Tilt
            | Fault::PositionLost => 0.0,
            Fault::TrackingError if !c.was_unreachable => 0.0,
            Fault::TrackingError => self.patience(c.tracking_error_m),
            Fault::Geofence | Fault::Battery | Fault::Failsafe => 1.0,
        }
    }

    pub(super) fn describe(&self, fault: Fault, c: &FlightCondition) -> String {
        match fault {
            Fault::StaleTelemetry if c.late.count > 0 => {
                format!("no fresh state for {:.2} s: {}", c.sample_age_s, c.late)
            }
            Fault::StaleTelemetry => format!("no state for {:.2} s", c.sample_age_s),
            Fault::TelemetryJump => "the state estimate jumped".to_owned(),
            Fault::SlowLink => {
                let limit_s = self.round_trip_max_s;
                match (c.uplink.again_s, c.uplink.round_trip_s) {
                    (Some(again_s), _) if again_s > limit_s => format!(
                        "the link repeats frames after {again_s:.2} s, limit {limit_s:.2} s: old \
                         setpoints reach the vehicle among the new ones"
                    ),
                    (_, round_trip_s) => format!(
                        "round trip {:.2} s, limit {limit_s:.2} s: setpoints reach the vehicle too \
                         late",
                        round_trip_s.unwrap_or(f64::NAN)
                    ),
                }
            }
            Fault::TrackingError if c.tracking_error_m.is_nan() => {
                "the reference is not a number: the planner failed".to_owned()
            }
            Fault::TrackingError => format!(
                "{:.2} m from the reference, limit {:.2} m",
                c.tracking_error_m, self.tracking_error_max_m
            ),
            Fault::Tilt => format!(
                "tilted {:.0} deg, limit {:.0} deg",
                c.tilt_rad.to_degrees(),
                self.tilt_max_rad.to_degrees()
            ),
            Fault::Geofence => format!(
                "outside the geofence: {:.1} m away, limit {:.1} m; {:.1} m high, limit {:.1} m",
                c.radius_m, self.fence_radius_m, c.height_m, self.fence_height_m
            ),
            Fault::Battery if c.battery_critical => {
                "the vehicle reports a critical battery".to_owned()
            }
            Fault::Failsafe => {
                format!("the vehicle reports a failsafe: {}", c.failsafe.unwrap_or_default())
            }
            Fault::PositionLost => {
                "the vehicle reports an unhealthy position estimate: it may have lost GPS or \
                 motion capture"
                    .to_owned()
            }
            Fault::Battery => format!(
                "battery at {:.0} %, limit {:.0} %",
                c.battery.unwrap_or(f64::NAN) * 100.0,
                self.battery_min * 100.0
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn feedback_that_lost_tracking_does_not_brake() {
        let settings = SafetySettings::default();
        let share = |was_unreachable, tracking_error_m| {
            let condition =
                FlightCondition { was_unreachable, tracking_error_m, ..FlightCondition::default() };
            settings.brake_share(Fault::TrackingError, &condition)
        };
        let limit = settings.tracking_error_max_m;
        assert_eq!(
            [share(false, limit), share(true, limit), share(true, 2.0 * limit)],
            [0.0, 1.0, 0.0]
        );
        assert_eq!(settings.brake_share(Fault::Battery, &FlightCondition::default()), 1.0);
    }

    #[test]
    fn dwell_time_shrinks_with_tracking_error() {
        let settings = SafetySettings::default();
        let waits = |tracking_error_m| {
            let condition = FlightCondition { tracking_error_m, ..FlightCondition::default() };
            settings.dwell_s(Fault::TrackingError, &condition)
        };
        let [limit, time_s] = [settings.tracking_error_max_m, settings.tracking_error_for_s];
        assert_eq!(
            [limit, 1.25 * limit, 1.5 * limit, 9.0 * limit].map(waits),
            [time_s, 0.5 * time_s, 0.0, 0.0]
        );
        assert_eq!(waits(f64::NAN), NO_REFERENCE_SHARE * time_s);
        assert!(waits(f64::NAN) < 0.2, "before an autopilot without setpoints acts by itself");
    }
}
