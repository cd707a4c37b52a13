//! The summary of a bridge.

use std::fmt;

use schemars::JsonSchema;
use serde::Serialize;

use crate::link::external_pose::PoseForm;
use crate::link::vehicle_clock::{ClockEstimate, ClockSource};
use crate::mocap::bridge::Tally;

/// The JSON of `mocap`.
#[derive(Debug, JsonSchema, Serialize)]
pub(in crate::command) struct MocapSummary {
    schema: &'static str,
    schema_version: u32,
    /// The room, as in `--room`.
    room: String,
    /// The vehicle; null if none was found.
    vehicle: Option<String>,
    /// The message that carried the poses.
    #[serde(rename = "as")]
    form: PoseForm,
    /// How long it ran, s.
    seconds: f64,
    /// Poses that were sent to the vehicle.
    sent: u64,
    /// Poses that could not be sent, because there was no vehicle or its clock was unknown.
    unsent: u64,
    /// The source of the vehicle's time: TIMESYNC, or the arrival of its messages.
    clock: Option<&'static str>,
    /// The room's counters.
    poses: Tally,
}

/// The parts of a summary.
pub(super) struct Ended {
    pub room: String,
    pub vehicle: Option<String>,
    pub form: PoseForm,
    pub seconds: f64,
    pub sent: u64,
    pub unsent: u64,
    pub clock: Option<ClockEstimate>,
    pub tally: Tally,
}

impl MocapSummary {
    pub(super) fn new(ended: Ended) -> Self {
        let source = |clock: ClockEstimate| match clock.source {
            ClockSource::Timesync => "TIMESYNC",
            ClockSource::Arrival => "arrival",
        };
        Self {
            schema: "downwash.mocap",
            schema_version: 1,
            room: ended.room,
            vehicle: ended.vehicle,
            form: ended.form,
            seconds: ended.seconds,
            sent: ended.sent,
            unsent: ended.unsent,
            clock: ended.clock.map(source),
            poses: ended.tally,
        }
    }

    pub(super) fn was_vehicle_found(&self) -> bool {
        self.vehicle.is_some()
    }

    pub(super) fn sent(&self) -> u64 {
        self.sent
    }
}

impl fmt::Display for MocapSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Tally { heard, good, losses, resets, age_mean_s, .. } = self.poses;
        write!(
            f,
            "{:.0} s: {} poses sent of {heard} received, {good} of them good; lost {losses} times, \
             restarted {resets} times; mean age {:.1} ms",
            self.seconds,
            self.sent,
            1e3 * age_mean_s
        )
    }
}
